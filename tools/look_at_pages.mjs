// Looks at pages as a person would: in a real browser, wide and narrow, on paper, dark, and with a test of accessibility.
//
//   npm install puppeteer-core axe-core                  (in any folder, outside the repository)
//   node /path/to/tools/look_at_pages.mjs PAGES OUT      (from that folder; PAGES: a folder or HTML files)
//
// The browser is Chromium, as `chromium` of a Linux distribution; CHROMIUM names another place than /usr/bin/chromium.
//
// OUT gets a picture per page and width, and a PDF. Printed is what is wrong: requests that leave the disk, errors of
// scripts, content wider than the window, findings of axe-core that are serious or critical. Exit code 1 if anything is.
import { createRequire } from "node:module";
import { mkdirSync, readdirSync, readFileSync, statSync } from "node:fs";
import { basename, join, relative, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const require = createRequire(join(process.cwd(), "package.json"));
const puppeteer = (await import(pathToFileURL(require.resolve("puppeteer-core")))).default;
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

const WIDTHS = [1280, 390]; // pixels: a screen, a telephone
const TALLEST = 12000; // pixels of a picture: what is taller goes on in another
const [out, ...given] = process.argv.slice(2).reverse().map((path) => resolve(path));
const pages = given.flatMap((path) => (statSync(path).isDirectory() ? inside(path) : [path]));
const root = given.length === 1 && statSync(given[0]).isDirectory() ? given[0] : null;
mkdirSync(out, { recursive: true });

function inside(folder) {
  return readdirSync(folder, { recursive: true }).filter((name) => name.endsWith(".html")).map((name) => join(folder, name));
}

async function pictures(page, name, width) {
  const tall = await page.evaluate(() => document.documentElement.scrollHeight);
  for (let y = 0, k = 1; y < tall; y += TALLEST, k += 1) {
    const clip = { x: 0, y, width, height: Math.min(tall - y, TALLEST) };
    await page.screenshot({ path: join(out, `${name}${k > 1 ? `-${k}` : ""}.png`), clip, captureBeyondViewport: true });
  }
}

const browser = await puppeteer.launch({
  args: ["--no-sandbox", "--allow-file-access-from-files"],
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
});
let faults = 0;
for (const path of pages) {
  const name = (root ? relative(root, path) : basename(path)).replaceAll("/", "-").replace(/\.html$/, "");
  const found = new Set();
  const page = await browser.newPage();
  await page.evaluateOnNewDocument(() => localStorage.clear()); // a site remembers the scheme it showed before
  page.on("request", (r) => /^(file|data|blob|about):/.test(r.url()) || found.add(`leaves the disk: ${r.url()}`));
  page.on("pageerror", (error) => found.add(`script: ${error.message}`));
  for (const width of WIDTHS) {
    await page.setViewport({ width, height: 900 });
    await page.goto(pathToFileURL(path), { waitUntil: "load" });
    const wide = await page.evaluate(() => document.documentElement.scrollWidth);
    if (wide > width) found.add(`${wide} pixels wide in a window of ${width}`);
    await pictures(page, `${name}-${width}`, width);
  }
  await page.pdf({ path: join(out, `${name}.pdf`), format: "A4", printBackground: true });
  for (const scheme of ["light", "dark"]) {
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
    await page.setViewport({ width: WIDTHS[0], height: 900 });
    await page.goto(pathToFileURL(path), { waitUntil: "networkidle0" });
    await page.evaluate(axe);
    const { violations } = await page.evaluate(() => axe.run(document, { resultTypes: ["violations"] }));
    for (const { id, impact, nodes } of violations) {
      if (["serious", "critical"].includes(impact)) {
        found.add(`${scheme}: ${impact}: ${id}, ${nodes.length} times, as ${nodes[0].html.slice(0, 160)}`);
      }
    }
    if (scheme === "dark") await pictures(page, `${name}-dark`, WIDTHS[0]);
  }
  await page.close();
  faults += found.size;
  console.log(`${name}: ${found.size ? "" : "nothing"}`);
  for (const fault of found) console.log(`  ${fault}`);
}
await browser.close();
console.log(`${pages.length} pages, ${faults} faults`);
process.exit(faults ? 1 : 0);
