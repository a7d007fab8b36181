// Curves that one can zoom: drag over a range, or use the buttons. Data come with the page; nothing is loaded.
for (const figure of document.querySelectorAll("figure.plot")) {
  const plot = JSON.parse(figure.querySelector("script").textContent);
  figure.hidden = false;
  const [W, H, LEFT, RIGHT, TOP, BOTTOM] = [Math.min(760, figure.clientWidth), 340, 74, 12, 12, 46];
  const svg = figure.querySelector("svg[role=img]"), choose = figure.querySelector("select"), said = figure.querySelector("output");
  const make = (name, to, attributes, text) => {
    const node = document.createElementNS(svg.namespaceURI, name);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    if (text !== undefined) node.textContent = text;
    return to.appendChild(node);
  };
  svg.setAttribute("viewBox", `0 0 ${W} ${H}`);
  const ends = (v) => [v[0], v[v.length - 1]];
  let panel = plot.panels[0], x = plot.x[panel.x], whole = ends(x), shown = whole, start = null;
  const digits = (v) => (v === 0 || (Math.abs(v) >= 0.01 && Math.abs(v) < 1e5) ? String(+v.toPrecision(4)) : v.toExponential(2));

  function ticks(low, high) {
    const rough = (high - low) / (W > 500 ? 8 : 4), power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find((f) => f * power >= rough), out = [];
    for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12); k++) out.push(k * step);
    return out;
  }

  function decades(low, high) {
    const powers = [], [from, to] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    for (let p = from; p <= to; p++) for (const m of to - from > 2 ? [1] : [1, 2, 5]) powers.push(m * 10 ** p);
    return powers.filter((v) => v >= low && v <= high);
  }

  function limits() {
    let low = Infinity, high = -Infinity;
    for (const { y } of panel.curves)
      y.forEach((v, k) => {
        if (v === null || x[k] < shown[0] || x[k] > shown[1] || (plot.log && v <= 0)) return;
        [low, high] = [Math.min(low, v), Math.max(high, v)];
      });
    if (low > high) return plot.log ? [0.1, 1] : [0, 1];
    if (plot.log) return [low / 1.5, high * 1.5];
    const room = 0.06 * (high - low) || 1;
    return [low - room, high + room];
  }

  function draw() {
    svg.replaceChildren();
    const [low, high] = limits(), f = plot.log ? Math.log10 : (v) => v;
    const px = (v) => LEFT + ((v - shown[0]) / (shown[1] - shown[0])) * (W - LEFT - RIGHT);
    const py = (v) => H - BOTTOM - ((f(v) - f(low)) / (f(high) - f(low))) * (H - TOP - BOTTOM);
    for (const v of ticks(...shown)) {
      make("line", svg, { class: "grid", x1: px(v), x2: px(v), y1: TOP, y2: H - BOTTOM });
      make("text", svg, { x: px(v), y: H - BOTTOM + 16, "text-anchor": "middle" }, digits(v));
    }
    for (const v of plot.log ? decades(low, high) : ticks(low, high)) {
      make("line", svg, { class: "grid", x1: LEFT, x2: W - RIGHT, y1: py(v), y2: py(v) });
      make("text", svg, { x: LEFT - 6, y: py(v) + 4, "text-anchor": "end" }, digits(v));
    }
    make("text", svg, { x: (LEFT + W - RIGHT) / 2, y: H - 8, "text-anchor": "middle" }, plot.x_label);
    make("text", svg, { transform: `translate(14 ${(TOP + H - BOTTOM) / 2}) rotate(-90)`, "text-anchor": "middle" }, plot.y_label);
    const inside = make("svg", svg, { x: LEFT, y: TOP, width: W - LEFT - RIGHT, height: H - TOP - BOTTOM, viewBox: `${LEFT} ${TOP} ${W - LEFT - RIGHT} ${H - TOP - BOTTOM}` });
    panel.curves.forEach(({ y }, number) => {
      let path = "", pen = "M";
      y.forEach((v, k) => {
        if (v === null || (plot.log && v <= 0)) return void (pen = "M");
        if (x[k + 1] < shown[0] || x[k - 1] > shown[1]) return void (pen = "M");
        path += `${pen}${px(x[k]).toFixed(1)} ${py(v).toFixed(1)}`;
        pen = "L";
      });
      make("path", inside, { d: path, class: `curve curve${number}` });
    });
  }

  function zoom(low, high) {
    const all = whole[1] - whole[0], width = Math.min(Math.max(high - low, all / 500), all);
    const from = Math.min(Math.max(low, whole[0]), whole[1] - width);
    shown = [from, from + width];
    draw();
  }

  const at = (event) => {
    const box = svg.getBoundingClientRect(), v = ((event.clientX - box.left) / box.width) * W;
    return shown[0] + ((v - LEFT) / (W - LEFT - RIGHT)) * (shown[1] - shown[0]);
  };
  svg.addEventListener("pointerdown", (event) => { start = at(event); });
  svg.addEventListener("pointermove", (event) => {
    const here = at(event), k = x.reduce((best, v, j) => (Math.abs(v - here) < Math.abs(x[best] - here) ? j : best), 0);
    const values = panel.curves.map((c) => `${c.name} ${c.y[k] === null ? "–" : digits(c.y[k])}`);
    said.textContent = `${digits(x[k])}: ${values.join(" · ")}`;
  });
  svg.addEventListener("pointerup", (event) => {
    const [low, high] = [start, at(event)].sort((a, b) => a - b);
    if (start !== null && high - low > 0.01 * (shown[1] - shown[0])) zoom(low, high);
    start = null;
  });
  svg.addEventListener("dblclick", () => zoom(...whole));
  for (const button of figure.querySelectorAll("button")) {
    button.addEventListener("click", () => {
      const [low, high] = shown, w = high - low;
      ({ whole: () => zoom(...whole), in: () => zoom(low + w / 4, high - w / 4), out: () => zoom(low - w / 2, high + w / 2),
         left: () => zoom(low - w / 4, high - w / 4), right: () => zoom(low + w / 4, high + w / 4) })[button.value]();
    });
  }
  choose.addEventListener("change", () => {
    panel = plot.panels[choose.selectedIndex];
    x = plot.x[panel.x];
    whole = ends(x);
    zoom(...shown);
  });
  draw();
}
