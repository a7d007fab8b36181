// Curves and maps that one can zoom: drag over a range, or use the buttons. Data come with the page; nothing is loaded.
for (const figure of document.querySelectorAll("figure.plot")) {
  const plot = JSON.parse(figure.querySelector("script").textContent);
  figure.hidden = false;
  const [W, RIGHT, TOP] = [Math.min(760, figure.clientWidth), 26, 12]; // right: half of the last number
  const svg = figure.querySelector("svg[role=img]"), choose = figure.querySelector("select"), said = figure.querySelector("output");
  const make = (name, to, attributes, text) => {
    const node = document.createElementNS(svg.namespaceURI, name);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    if (text !== undefined) node.textContent = text;
    return to.appendChild(node);
  };
  const ends = (v) => [v[0], v[v.length - 1]];
  let panel = plot.panels[0], x = plot.x[panel.x], whole = ends(x), shown = whole, start = null, cell = null, H, LEFT, BOTTOM;
  const digits = (v) => (v === 0 || (Math.abs(v) >= 0.001 && Math.abs(v) < 1e5) ? String(+v.toPrecision(4)) : v.toExponential(2));

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

  const px = (v) => LEFT + ((v - shown[0]) / (shown[1] - shown[0])) * (W - LEFT - RIGHT);

  function frame(height, left, bottom) {
    [H, LEFT, BOTTOM] = [height, left, bottom];
    svg.setAttribute("viewBox", `0 0 ${W} ${H}`);
    svg.replaceChildren();
  }

  function name_axes(x_label, y_label, below) {
    make("text", svg, { x: (LEFT + W - RIGHT) / 2, y: H - BOTTOM + below, "text-anchor": "middle" }, x_label);
    make("text", svg, { transform: `translate(14 ${(TOP + H - BOTTOM) / 2}) rotate(-90)`, "text-anchor": "middle" }, y_label);
    const [width, height] = [W - LEFT - RIGHT, H - TOP - BOTTOM];
    return make("svg", svg, { x: LEFT, y: TOP, width, height, viewBox: `${LEFT} ${TOP} ${width} ${height}` });
  }

  function number_columns(class_name) {
    for (const v of ticks(...shown)) {
      make("line", svg, { class: class_name, x1: px(v), x2: px(v), y1: class_name === "grid" ? TOP : H - BOTTOM, y2: H - BOTTOM + (class_name === "grid" ? 0 : 4) });
      make("text", svg, { x: px(v), y: H - BOTTOM + 16, "text-anchor": "middle" }, digits(v));
    }
  }

  function draw_curves() {
    frame(340, 74, 46);
    const [low, high] = limits(), f = plot.log ? Math.log10 : (v) => v;
    const py = (v) => H - BOTTOM - ((f(v) - f(low)) / (f(high) - f(low))) * (H - TOP - BOTTOM);
    number_columns("grid");
    for (const v of plot.log ? decades(low, high) : ticks(low, high)) {
      make("line", svg, { class: "grid", x1: LEFT, x2: W - RIGHT, y1: py(v), y2: py(v) });
      make("text", svg, { x: LEFT - 6, y: py(v) + 4, "text-anchor": "end" }, digits(v));
    }
    const inside = name_axes(plot.x_label, plot.y_label, 38);
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

  const LETTER = 7; // width of one, about
  const ROW = () => Math.max(15, Math.min(26, 330 / panel.rows.length));
  const share = (v) => Math.log(v / plot.range[0]) / Math.log(plot.range[1] / plot.range[0]);
  const colour = (v) => plot.colours[Math.max(0, Math.min(plot.colours.length - 1, Math.floor(share(v) * plot.colours.length)))];

  function draw_map() {
    const longest = (names) => Math.max(...names.map((name) => name.length)) * LETTER;
    const below = panel.columns ? Math.min(90, longest(panel.columns) + 10) : 20, h = ROW();
    frame(TOP + panel.rows.length * h + below + 72, Math.min(W / 2.5, longest(panel.rows) + 34), below + 72);
    const inside = name_axes(panel.x_label, panel.y_label, below + 14), bottom = H - BOTTOM;
    panel.values.forEach((row, r) => {
      make("text", svg, { x: LEFT - 6, y: TOP + (r + 0.5) * h + 4, "text-anchor": "end" }, panel.rows[r]);
      row.forEach((v, k) => {
        if (v === null || x[k + 1] <= shown[0] || x[k] >= shown[1]) return;
        make("rect", inside, { x: px(x[k]), y: TOP + r * h, width: px(x[k + 1]) - px(x[k]) + 0.4, height: h - 0.6, fill: colour(v), "shape-rendering": "crispEdges" });
      });
    });
    if (panel.columns) {
      const every = Math.ceil((13 * (shown[1] - shown[0])) / (W - LEFT - RIGHT)); // labels need 13 pixels
      panel.columns.forEach((name, k) => {
        const at = px(k + 0.5);
        if (k % every || at < LEFT || at > W - RIGHT) return;
        make("text", svg, { transform: `translate(${at + 4} ${bottom + 6}) rotate(-90)`, "text-anchor": "end" }, name);
      });
    } else number_columns("tick");
    const [from, width, y] = [LEFT, Math.min(300, W - LEFT - RIGHT), bottom + below + 26];
    plot.colours.forEach((fill, k) => make("rect", svg, { x: from + (k * width) / plot.colours.length, y, width: width / plot.colours.length + 0.5, height: 10, fill }));
    for (const v of decades(...plot.range)) make("text", svg, { x: from + share(v) * width, y: y + 22, "text-anchor": "middle" }, digits(v));
    make("text", svg, { x: from + width / 2, y: y + 38, "text-anchor": "middle" }, plot.y_label);
    if (cell) make("rect", inside, { class: "cell", x: px(x[cell[1]]), y: TOP + cell[0] * h, width: px(x[cell[1] + 1]) - px(x[cell[1]]), height: h - 0.6 });
  }

  function say_curves(here) {
    const k = x.reduce((best, v, j) => (Math.abs(v - here) < Math.abs(x[best] - here) ? j : best), 0);
    const values = panel.curves.map((c) => `${c.name} ${c.y[k] === null ? "–" : digits(c.y[k])}`);
    said.textContent = `${digits(x[k])}: ${values.join(" · ")}`;
  }

  function say_map(r, k) {
    [r, k] = [Math.max(0, Math.min(panel.rows.length - 1, r)), Math.max(0, Math.min(x.length - 2, k))];
    cell = [r, k];
    const v = panel.values[r][k], where = panel.columns ? panel.columns[k] : `${digits(x[k])} to ${digits(x[k + 1])} Hz`;
    said.textContent = `${panel.rows[r]}, ${where}: ${v === null ? "not used" : `${digits(v)} times the noise`}`;
    draw();
  }

  const draw = () => (plot.colours ? draw_map() : draw_curves());

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
    const here = at(event), box = svg.getBoundingClientRect();
    if (!plot.colours) return say_curves(here);
    const row = Math.floor((((event.clientY - box.top) / box.height) * H - TOP) / ROW());
    if (row < panel.rows.length && here >= shown[0]) say_map(row, x.findIndex((v) => v > here) - 1);
  });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
    if (!step || !plot.colours) return;
    event.preventDefault();
    const [r, k] = cell ?? [0, -1];
    say_map(r + step[0], k + step[1]);
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
    const next = plot.x[panel.x], same = String(whole) === String(ends(next));
    [x, whole, cell] = [next, ends(next), null];
    zoom(...(same ? shown : whole));
  });
  draw();
}
