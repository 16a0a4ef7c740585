"use strict";
const $ = (id) => document.getElementById(id);
const data = JSON.parse(new TextDecoder().decode(await bytes($("data").textContent)));
const state = { board: 0, part: 0, track: "", search: "", sort: null, chosen: null };
// Colour-blind readers tell them apart (reports/figures/style.py); symbols and dashes for grey print.
const COLOURS = data.colours;
const SYMBOLS = ["circle", "square", "diamond", "cross", "triangle-up", "star", "x", "hexagon"];
const DASHES = ["solid", "dash", "dot", "dashdot"];
const OUTSIDE = 255;

function el(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name === "class") node.className = value;
    else if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined).map((child) =>
    child instanceof Node ? child : document.createTextNode(String(child))));
  return node;
}

function number(form, value) {
  if (value === null || value === undefined || value === "") return "–";
  if (form === "" || typeof value === "string") return String(value);
  if (form === "d") return String(Math.round(value));
  if (form === "time") return value > 0 && value < 0.0005 ? "<0.001" : String(+(+value.toPrecision(3)).toFixed(3));
  if (form === "small") return Math.abs(value) >= 0.1 || value === 0 ? String(+value.toPrecision(3)) : value.toExponential(2);
  const digits = Number(form.slice(1, -1));
  return form.endsWith("%") ? (100 * value).toFixed(digits) + "%" : value.toFixed(digits);
}

const escaped = (text) => text.replace(/[&<>]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[c]);
const board = () => data.boards[state.board];
const view = () => board().views[state.part];
const nameOf = (row) => row.label;
const column = (name) => board().columns.find((c) => c.name === name);
const titleOf = (name) => (column(name) || { title: name }).title;
const ranking = () => column(board().ranked_by) || board().columns[0];
const passes = (row) => (!$("untrained").checked || row.training === "") &&
  (!$("fast").checked || (typeof row.frame_ms_p50 === "number" && row.frame_ms_p50 < data.fast_ms));
const boardsShown = () => data.boards.filter((b) => !$("sensor").value || b.sensor === $("sensor").value);
const rowsShown = () => view().rows.filter((row) => passes(row) &&
  (!state.track || row.track === state.track) && nameOf(row).toLowerCase().includes(state.search));

function options(select, values, chosen) {
  select.replaceChildren(...values.map(([value, label]) => {
    const option = el("option", { value }, label);
    option.selected = value === String(chosen);
    return option;
  }));
}

// ---- leaderboard -------------------------------------------------------------------------------

function interval(c, row) {
  const low = row[c.name + "_low"], high = row[c.name + "_high"];
  if (low === null || low === undefined || (c.name === "rank" && low === high)) return null;
  return `${number(c.form, low)} to ${number(c.form, high)}`;
}

function sorted(rows) {
  if (!state.sort) return rows;
  const { name, descending } = state.sort;
  const known = (row) => row[name] !== null && row[name] !== undefined;
  const order = (a, b) => typeof a === "string" ? a.localeCompare(b) : a - b;
  return [...rows].sort((a, b) => known(a) && known(b) ? (descending ? -1 : 1) * order(a[name], b[name]) :
    known(b) - known(a));
}

function choose(name) {
  state.chosen = state.chosen === name ? null : name;
  drawBoard();
  drawFrontier();
  markImages();
  if (state.chosen !== null && [...$("press-method").options].some((o) => o.value === name)) {
    $("press-method").value = name;
    drawPresses();
  }
}

function drawBoard() {
  const rows = rowsShown(), columns = board().columns;
  const head = columns.map((c) => {
    const of = state.sort && state.sort.name === c.name;
    const press = () => {
      const first = c.best === "max";
      state.sort = of && state.sort.descending !== first ? null : { name: c.name, descending: of ? !first : first };
      drawBoard();
      const again = [...$("leaderboard").querySelectorAll("th button")].find((b) => b.textContent === c.title);
      if (again) again.focus();
    };
    return el("th", { scope: "col", class: c.form ? "" : "text", "aria-sort": of ? (state.sort.descending ? "descending" : "ascending") : "none" },
      el("button", { type: "button", onclick: press }, c.title));
  });
  const body = sorted(rows).map((row) => el("tr", { class: nameOf(row) === state.chosen ? "chosen" : "" }, ...columns.map((c) => {
    const text = c.name === board().kind ? nameOf(row) : number(c.form, row[c.name]);
    if (c.name === board().kind) return el("th", { scope: "row", class: "text" }, el("button", { type: "button", "aria-pressed": String(nameOf(row) === state.chosen), onclick: () => choose(nameOf(row)) }, text));
    const ends = interval(c, row);
    return el("td", { class: (c.form ? "" : "text ") + (row.best.includes(c.name) ? "best" : "") }, text, ends ? el("small", {}, ends) : null);
  })));
  $("leaderboard").replaceChildren(el("caption", { class: "soft" }, `${board().name}, ${view().label}`),
    el("thead", {}, el("tr", {}, ...head)), el("tbody", {}, ...(body.length ? body : [el("tr", {}, el("td", { class: "text", colspan: columns.length }, "Nothing matches."))])));
  const notes = [view().clusters ? `Intervals from ${view().clusters} sessions or objects` : view().why_not.replace(/\.$/, ""), ...board().notes];
  $("board-note").textContent = notes.filter(Boolean).join("; ") + ".";
  $("prior_knowledge").replaceChildren(...board().prior_knowledge.map((sentence) => el("li", {}, sentence)));
  $("knowledge-section").hidden = !board().prior_knowledge.length;
  const [heads, ...tracks] = board().tracks.length ? board().tracks : [[]];
  const cells = (kind, texts) => texts.map((text, k) => el(kind, { class: k ? "" : "text", ...(kind === "th" && { scope: "col" }) }, text));
  $("tracks").replaceChildren(el("caption", { class: "soft" }, "On each track, with 95 % intervals of the gaps"),
    el("thead", {}, el("tr", {}, ...cells("th", heads))), el("tbody", {}, ...tracks.map((texts) => el("tr", {}, ...cells("td", texts)))));
  $("tracks-section").hidden = !tracks.length;
}

// ---- plots -------------------------------------------------------------------------------------

function bytes(text) {
  const binary = atob(text);
  const stream = new Blob([Uint8Array.from(binary, (c) => c.charCodeAt(0))]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer().then((buffer) => new Uint8Array(buffer));
}

const plotly = bytes($("plotly").textContent).then((code) => new Promise((done, failed) => {
  const url = URL.createObjectURL(new Blob([code], { type: "text/javascript" }));
  document.head.append(el("script", { src: url, onload: done, onerror: failed }));
}));

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function axis(title, more) {
  return { title: { text: title }, gridcolor: style("--line"), zerolinecolor: style("--line"), automargin: true, ...more };
}

function plot(id, label, traces, x, y, more) {
  $(id).setAttribute("role", "img");
  $(id).setAttribute("aria-label", label);
  const layout = { font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: style("--ink") },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", margin: { l: 60, r: 20, t: 20, b: 50 },
    xaxis: x, yaxis: y, hoverlabel: { namelength: -1 }, legend: { orientation: "h", y: 1.02, yanchor: "bottom" }, ...more };
  return plotly.then(() => Plotly.react($(id), traces, layout, { displayModeBar: false, responsive: true }));
}

const place = (name) => Math.max(0, board().views[0].rows.findIndex((row) => nameOf(row) === name));
// Shifted by one each time round, so that no pair of colour and symbol comes twice.
const symbol = (k) => SYMBOLS[(k + Math.floor(k / COLOURS.length)) % SYMBOLS.length];
const colour = (name) => COLOURS[place(name) % COLOURS.length];

function drawFrontier() {
  const c = ranking(), time = ["frame_ms_p50", "frame_solves", "forward_ms"].find((name) => column(name)) || "frame_ms_p50";
  const rows = rowsShown().filter((row) => typeof row[c.name] === "number" && typeof row[time] === "number");
  $("frontier").hidden = !rows.length;
  if (!rows.length) return;
  const sign = c.best === "max" ? 1 : -1;
  const front = rows.filter((a) => !rows.some((b) => b !== a && b[time] <= a[time] && sign * b[c.name] >= sign * a[c.name] &&
    (b[time] < a[time] || b[c.name] !== a[c.name]))).sort((a, b) => a[time] - b[time]);
  const end = (row, name, s) => typeof row[c.name + name] === "number" ? s * (row[c.name + name] - row[c.name]) : 0;
  const traces = [
    { x: front.map((row) => row[time]), y: front.map((row) => row[c.name]), mode: "lines", line: { color: style("--soft"), width: 1, shape: "hv" }, hoverinfo: "skip", showlegend: false },
    ...rows.map((row) => ({ x: [row[time]], y: [row[c.name]], name: escaped(nameOf(row)), mode: "markers",
      marker: { size: nameOf(row) === state.chosen ? 15 : 9, color: colour(nameOf(row)), symbol: symbol(place(nameOf(row))), line: { width: 1, color: style("--ink") } },
      error_y: { type: "data", symmetric: false, array: [end(row, "_high", 1)], arrayminus: [end(row, "_low", -1)], color: style("--soft"), thickness: 1, width: 3 },
      hovertemplate: `%{fullData.name}<br>${escaped(titleOf(time))} %{x:.3g}<br>${escaped(c.title)} %{y:.4g}<extra></extra>` }))];
  const times = rows.map((row) => row[time]).concat(time === "frame_ms_p50" ? [100] : []);
  const range = [Math.log10(Math.min(...times)) - 0.3, Math.log10(Math.max(...times)) + 0.3];
  const line = time !== "frame_ms_p50" ? {} : {
    shapes: [{ type: "line", x0: 100, x1: 100, yref: "paper", y0: 0, y1: 1, line: { color: style("--mark"), width: 1, dash: "dash" }, name: "10 frames/s", showlegend: true }] };
  plot("frontier", `${c.title} of ${rows.length} methods against the time of a frame`, traces,
    axis(titleOf(time), { type: "log", range, dtick: 1 }), axis(c.title, sign < 0 ? { autorange: "reversed" } : {}), line);
}

function drawNoise() {
  const of = data.boards.filter((b) => b.suite === board().suite && b.snr_db !== null);
  // Boards of one level differ in something else.
  const levels = new Set(of.map((b) => b.snr_db)).size;
  $("noise-section").hidden = levels < 2 || levels < of.length;
  if ($("noise-section").hidden) return;
  const level = (b) => b.snr_db === "clean" ? Infinity : b.snr_db;
  of.sort((a, b) => level(a) - level(b));
  const names = [...new Set(of.flatMap((b) => b.views[0].rows.map(nameOf)))];
  if (!$("noise-figure").options.length) options($("noise-figure"), ["score", "ssim", "cc", "rie", "psnr", "localisation_mm"].map((n) => [n, titleOf(n)]), "score");
  const figure = $("noise-figure").value, x = of.map((b) => b.snr_db === "clean" ? "clean" : `${b.snr_db} dB${b.touch_snr_db === null ? "" : ` (${b.touch_snr_db.toFixed(0)} dB)`}`);
  const traces = names.flatMap((name, k) => {
    const rows = of.map((b) => b.views[0].rows.find((row) => nameOf(row) === name));
    const get = (end) => rows.map((row) => row ? row[figure + end] ?? null : null);
    const of_line = { color: COLOURS[k % COLOURS.length], dash: DASHES[Math.floor(k / COLOURS.length) % DASHES.length], width: 2 };
    const band = get("_low").some((v) => v === null) ? [] : [{ x: [...x, ...[...x].reverse()], y: [...get("_high"), ...get("_low").reverse()], fill: "toself", mode: "none", fillcolor: COLOURS[k % COLOURS.length] + "22", hoverinfo: "skip", showlegend: false }];
    return [...band, { x, y: get(""), name: escaped(name), mode: "lines+markers", line: of_line, marker: { symbol: symbol(k), size: 7 } }];
  });
  plot("noise", `${titleOf(figure)} of every method at ${x.join(", ")}`, traces, axis("SNR of a frame (of what a touch changes in it, median)", { type: "category" }), axis(titleOf(figure)));
}

// The edge of the sensor [mm], row by row of its mask: up along the right side, down along the left.
function outline() {
  const of = board().images;
  if (!of || !pixels) return { x: [], y: [] };
  const [height, width] = of.shape, [x0, y0, x1, y1] = of.bounds.map((v) => 1000 * v);
  const right = [], left = [];
  for (let row = 0; row < height; row++) {
    const line = pixels.subarray(row * width, (row + 1) * width);
    const first = line.findIndex((v) => v !== OUTSIDE), last = width - 1 - [...line].reverse().findIndex((v) => v !== OUTSIDE);
    if (first < 0) continue;
    const at = (k) => x0 + (x1 - x0) * k / width, y = y0 + (y1 - y0) * (row + 0.5) / height;
    right.push([at(last + 1), y]);
    left.unshift([at(first), y]);
  }
  const points = [...right, ...left, right[0]];
  return { x: points.map((p) => p[0]), y: points.map((p) => p[1]) };
}

function drawPresses() {
  const presses = board().presses.find((p) => p.method === $("press-method").value);
  if (!presses) return;
  const mm = (values) => values.map((v) => v === null ? null : 1000 * v);
  const [ex, ey, fx, fy] = ["expected_x_m", "expected_y_m", "found_x_m", "found_y_m"].map((n) => mm(presses[n]));
  const lines = { x: [], y: [] };
  ex.forEach((_, k) => { lines.x.push(ex[k], fx[k], null); lines.y.push(ey[k], fy[k], null); });
  const text = presses.localisation_mm.map((v) => v === null ? "" : `${v.toFixed(1)} mm off`);
  plot("presses", `Where ${presses.method} found ${ex.length} presses`, [
    { ...outline(), mode: "lines", line: { color: style("--ink"), width: 1.5 }, hoverinfo: "skip", showlegend: false },
    { ...lines, mode: "lines", line: { color: style("--soft"), width: 1 }, hoverinfo: "skip", showlegend: false },
    { x: ex, y: ey, text, name: "pressed", mode: "markers", marker: { color: COLOURS[0], size: 6 }, hovertemplate: "pressed, %{text}<extra></extra>" },
    { x: fx, y: fy, text, name: "found", mode: "markers", marker: { color: COLOURS[1], size: 6, symbol: "x" }, hovertemplate: "found, %{text}<extra></extra>" }],
  axis("x [mm]"), axis("y [mm]", { scaleanchor: "x" }));
}

// ---- images ------------------------------------------------------------------------------------

let pixels = null;

function lookup(map, value) {
  const k = 6 * Math.max(0, Math.min(255, Math.round(255 * value)));
  return [0, 2, 4].map((i) => parseInt(map.slice(k + i, k + i + 2), 16));
}

function values(name, sample) {
  const of = board().images, size = of.shape[0] * of.shape[1];
  const start = (of.names.indexOf(name) * of.samples.length + of.samples.indexOf(sample)) * size;
  const scale = (of.high - of.low) / of.steps;
  return Array.from(pixels.subarray(start, start + size), (byte) => byte === OUTSIDE ? NaN : of.low + scale * byte);
}

// What is shown of an image: conductivity, its error, or, where no truth is known, its contrast.
function modes() {
  if (!board().images.has_truth) return ["contrast"];
  return $("shown").value === "both" ? ["conductivity", "error"] : [$("shown").value];
}

function image(name, sample, mode) {
  const of = board().images, found = values(name, sample);
  if (mode === "contrast") return { found: found.map((v) => v - of.background), signed: true };
  if (mode === "conductivity") return { found, signed: false };
  const truth = values("truth", sample);
  return { found: found.map((v, k) => v - truth[k]), signed: true };
}

function paint(canvas, name, sample, mode) {
  const of = board().images, [height, width] = of.shape, { found, signed } = image(name, sample, mode);
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d"), shown = context.createImageData(width, height), span = of.high - of.low;
  for (let row = 0; row < height; row++) for (let x = 0; x < width; x++) {
    const value = found[(height - 1 - row) * width + x], at = 4 * (row * width + x);
    if (Number.isNaN(value)) continue;
    const part = signed ? 0.5 + value / span : (value - of.low) / span;
    shown.data.set([...lookup(signed ? data.maps.signed : data.maps.value, part), 255], at);
  }
  context.putImageData(shown, 0, 0);
}

function figuresOf(name, sample) {
  const of = board().images, figures = (of.figures[name] || [])[of.samples.indexOf(sample)];
  if (!figures) return "";
  if (figures.status !== "ok") return figures.status;
  if (figures.ssim !== undefined) return `SSIM ${figures.ssim.toFixed(3)}, PSNR ${figures.psnr.toFixed(1)} dB`;
  return figures.localisation_mm === undefined ? "" : `${figures.localisation_mm.toFixed(1)} mm off`;
}

function drawImages() {
  const of = board().images;
  $("images-section").hidden = !of || !pixels;
  if (!of || !pixels) return;
  const shown = of.names.filter((name) => name === "truth" || rowsShown().some((row) => nameOf(row) === name));
  const cases = of.cases.filter((c) => c.family === $("family").value);
  $("images").style.gridTemplateColumns = `auto repeat(${shown.length}, 6.5rem)`;
  const cells = [el("div"), ...shown.map((name) => el("div", { class: "head", "data-name": name }, name))];
  for (const c of cases) {
    cells.push(el("div", { class: "case" }, c.kind, el("br"), `sample ${c.sample}`));
    for (const name of shown) {
      const figures = figuresOf(name, c.sample);
      const buttons = modes().filter((mode) => name !== "truth" || mode !== "error" || modes().length === 1).map((mode) => {
        const shown_as = name === "truth" ? modes()[0] === "contrast" ? "contrast" : "conductivity" : mode;
        const canvas = el("canvas", { "aria-hidden": "true" });
        const label = `${name}, ${c.family} ${c.kind} case, sample ${c.sample}, ${shown_as}${figures ? ": " + figures : ""}; enlarge`;
        paint(canvas, name, c.sample, shown_as);
        return el("button", { type: "button", "aria-label": label, onclick: () => zoom(name, c, shown_as) }, canvas);
      });
      cells.push(el("div", {}, ...buttons, el("div", { class: "note" }, figures)));
    }
  }
  $("images").replaceChildren(...cells);
  $("scale").replaceChildren(...modes().map((mode) => {
    const ramp = el("canvas", { width: 256, height: 1, "aria-hidden": "true" }), context = ramp.getContext("2d"), line = context.createImageData(256, 1);
    const signed = mode !== "conductivity", half = (of.high - of.low) / 2, ends = signed ? [-half, half] : [of.low, of.high];
    for (let k = 0; k < 256; k++) line.data.set([...lookup(signed ? data.maps.signed : data.maps.value, k / 255), 255], 4 * k);
    context.putImageData(line, 0, 0);
    return el("span", {}, `${mode} ${ends[0].toPrecision(3)} S/m `, ramp, ` ${ends[1].toPrecision(3)} S/m`);
  }));
  markImages();
}

function markImages() {
  for (const head of $("images").querySelectorAll(".head")) head.classList.toggle("chosen", head.dataset.name === state.chosen);
}

function zoom(name, c, mode) {
  const canvas = $("zoom-canvas"), [height, width] = board().images.shape, { found } = image(name, c.sample, mode);
  paint(canvas, name, c.sample, mode);
  $("zoom-title").textContent = `${name}, ${[c.family, c.kind].filter(Boolean).join(", ")} (sample ${c.sample})`;
  const rest = `${figuresOf(name, c.sample)} Move over the image, or use the arrow keys on it, to read its values.`.trim();
  $("zoom-value").textContent = rest;
  let x = Math.floor(width / 2), y = Math.floor(height / 2);
  // As many decimals as the steps that a byte holds.
  const of = board().images, digits = Math.max(2, Math.min(6, Math.floor(-Math.log10((of.high - of.low) / of.steps))));
  const tell = () => {
    const value = found[y * width + x];
    $("zoom-value").textContent = Number.isNaN(value) ? `pixel ${x}, ${y}: outside the sensor` :
      `pixel ${x}, ${y}: ${mode === "conductivity" ? "" : mode + " "}${value.toFixed(digits)} S/m`;
  };
  canvas.onpointerleave = () => { $("zoom-value").textContent = rest; };
  canvas.onpointermove = (event) => {
    const box = canvas.getBoundingClientRect();
    x = Math.max(0, Math.min(width - 1, Math.floor(width * (event.clientX - box.left) / box.width)));
    y = Math.max(0, height - 1 - Math.min(height - 1, Math.floor(height * (event.clientY - box.top) / box.height)));
    tell();
  };
  canvas.onkeydown = (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!step) return;
    event.preventDefault();
    x = Math.max(0, Math.min(width - 1, x + step[0]));
    y = Math.max(0, Math.min(height - 1, y + step[1]));
    tell();
  };
  $("zoom").showModal();
}

// ---- families, weights, differences ------------------------------------------------------------

function drawFamilies() {
  const parts = board().views.slice(1), c = ranking();
  $("families-section").hidden = !parts.length;
  if (!parts.length) return;
  const body = board().views[0].rows.map((row) => el("tr", {}, el("th", { scope: "row", class: "text" }, nameOf(row)), ...parts.map((part) => {
    const of = part.rows.find((r) => nameOf(r) === nameOf(row));
    const values = part.rows.map((r) => r[c.name]).filter((v) => typeof v === "number");
    const best = c.best === "max" ? Math.max(...values) : Math.min(...values);
    const text = of ? number(c.form, of[c.name]) : "–";
    return el("td", { class: of && text === number(c.form, best) ? "best" : "" }, text, of && interval(c, of) ? el("small", {}, interval(c, of)) : null);
  })));
  $("families").replaceChildren(el("caption", { class: "soft" }, c.title), el("thead", {}, el("tr", {}, el("th", { class: "text", scope: "col" }, "Method"),
    ...parts.map((part) => el("th", { scope: "col" }, part.label, el("small", {}, ` (${part.rows[0].n})`))))), el("tbody", {}, ...body));
}

const WEIGHTED = ["ssim", "cc", "rie", "psnr"];
const weights = Object.fromEntries(WEIGHTED.map((name) => [name, 0.25]));
let bounded = false;

function weighted(row) {
  return WEIGHTED.reduce((sum, name, k) => sum + weights[name] * (bounded ? row.anchored[k] : (name === "rie" ? -1 : 1) * row[name]), 0);
}

function buildSliders() {
  const sliders = WEIGHTED.map((name) => {
    const out = el("output", {}, "0.25");
    const input = el("input", { type: "range", min: 0, max: 1, step: 0.01, value: 0.25, "data-weight": name });
    input.addEventListener("input", () => { weights[name] = Number(input.value); out.textContent = Number(input.value).toFixed(2); drawWeighted(); });
    return el("label", {}, el("span", {}, titleOf(name).replace(" [dB]", ""), " ", out), input);
  });
  const units = el("select", { "aria-label": "Units of the figures" }, el("option", { value: "" }, "as published, PSNR in dB"), el("option", { value: "1" }, "between fixed ends"));
  units.addEventListener("change", () => { bounded = units.value === "1"; drawWeighted(); });
  const reset = el("button", { type: "button", onclick: () => {
    for (const input of $("sliders").querySelectorAll("input")) { input.value = 0.25; input.dispatchEvent(new Event("input")); }
    units.value = "";
    units.dispatchEvent(new Event("change"));
  } }, "Reset");
  $("sliders").replaceChildren(...sliders, el("label", {}, "Units", units), reset);
}

function drawWeighted() {
  const rows = board().views[0].rows.filter((row) => row.anchored && WEIGHTED.every((name) => typeof row[name] === "number"));
  $("weights-section").hidden = !rows.length;
  if (!rows.length) return;
  const order = [...rows].sort((a, b) => weighted(b) - weighted(a));
  $("weighted").replaceChildren(el("thead", {}, el("tr", {}, el("th", { scope: "col" }, "#"), el("th", { scope: "col", class: "text" }, "Method"), el("th", { scope: "col" }, "Score"),
    el("th", { scope: "col" }, "# as published"), el("th", { scope: "col" }, "Weightings won"))),
  el("tbody", {}, ...order.map((row, k) => el("tr", {}, el("td", {}, k + 1), el("th", { scope: "row", class: "text" }, nameOf(row)), el("td", {}, weighted(row).toFixed(3)), el("td", {}, row.rank),
    el("td", {}, number(".1%", row.weights_won))))));
  const found = board().sensitivity;
  $("sensitivity").replaceChildren(el("thead", {}, el("tr", {}, el("th", { scope: "col", class: "text" }, "Choice"), el("th", { scope: "col", class: "text" }, "Best by S"),
    el("th", { scope: "col" }, "Kendall τ of S"), el("th", { scope: "col", class: "text" }, "Best by SSIM"), el("th", { scope: "col" }, "Kendall τ of SSIM"))),
  el("tbody", {}, ...found.map((choice) => {
    const first = (figures) => Object.entries(figures).sort((a, b) => b[1] - a[1]).map(([name, v]) => `${name} (${v.toFixed(3)})`)[0];
    return el("tr", {}, el("td", { class: "text" }, choice.says), el("td", { class: "text" }, first(choice.score)), el("td", {}, number(".2f", choice.score_tau)),
      el("td", { class: "text" }, first(choice.ssim)), el("td", {}, number(".2f", choice.ssim_tau)));
  })));
  $("sensitivity-note").textContent = found.length ? `Of ${board().sensitivity_samples} samples. τ compares the order of all methods with the benchmark's own: 1 is the same order. Weightings won: the share of all weightings of the four figures, between fixed ends, under which the method is the best.` : `Only reports of methods with all images, on at most ${data.most_single} scenarios, have this.`;
}

function drawPairs() {
  const b = board(), c = ranking(), rows = b.views[0].rows;
  $("pairs-section").hidden = !b.pairs.length;
  if (!b.pairs.length) return;
  const heads = ["First", "Second", `Difference in ${c.title}`, "95 %", "p (adjusted)", "Effect", "Wins"];
  $("pairs").replaceChildren(el("thead", {}, el("tr", {}, ...heads.map((h, k) => el("th", { scope: "col", class: k < 2 ? "text" : "" }, h)))),
    el("tbody", {}, ...b.pairs.map((pair) => el("tr", {}, el("th", { scope: "row", class: "text" }, nameOf(rows[pair.first])), el("td", { class: "text" }, nameOf(rows[pair.second])),
      el("td", { class: pair.p < 0.05 ? "best" : "" }, number(c.form, pair.difference)), el("td", {}, `${number(c.form, pair.low)} to ${number(c.form, pair.high)}`),
      el("td", {}, pair.p < 0.001 ? "<0.001" : pair.p.toFixed(3)), el("td", {}, pair.effect === null ? "–" : pair.effect.toFixed(2)), el("td", {}, number(".0%", pair.wins))))));
}

// ---- over all scenarios ------------------------------------------------------------------------

const heads = (names) => el("thead", {}, el("tr", {}, ...names.map((name, k) => el("th", { scope: "col", class: k ? "" : "text" }, name))));
const withEnds = (form, value, low, high) => el("td", {}, number(form, value), low === null ? null : el("small", {}, `${number(form, low)} to ${number(form, high)}`));

function drawOverall() {
  const of = boardsShown().filter((b) => b.kind === "method"), names = [...new Set(of.flatMap((b) => b.views[0].rows.map(nameOf)))];
  $("overall-section").hidden = of.length < 2 || names.length < 2;
  const found = data.overall[[$("untrained").checked ? "untrained" : "", $("fast").checked ? "fast" : "", $("sensor").value].join("|")];
  const guessed = found && found.rows[0].ratio !== null;
  $("overall").hidden = !found;
  if (found) $("overall").replaceChildren(heads(["Method", "Mean rank", "Wins", ...(guessed ? ["Error over a guess’s"] : [])]), el("tbody", {}, ...found.rows.map((row) => {
    const at = data.methods.indexOf(row.method);
    return el("tr", {}, el("th", { scope: "row", class: "text" }, el("a", { href: `#method-${at}` }, row.method)),
      withEnds(".2f", row.rank, row.rank_low, row.rank_high), withEnds(".0%", row.wins, row.wins_low, row.wins_high),
      guessed ? withEnds(".2f", row.ratio, row.ratio_low, row.ratio_high) : null);
  })));
  $("overall-note").textContent = !found ? "A comparison over scenarios needs two methods that were run on all samples of the same two or more scenarios, and that pass the filters." :
    `Of ${found.scenarios.length} scenarios${found.scenarios.length > 8 ? "" : ": " + found.scenarios.join(", ")}. Wins: share of them on which the method is the best. ` +
    (guessed ? "Error over a guess’s: median over them of its error over that of guessing one place. " : "") +
    (found.rows[0].rank_low === null ? "These are too few scenarios for intervals. " : "Intervals are of a bootstrap over scenarios. ") +
    `Mean ranks that differ by ${found.critical_difference.toFixed(2)} or more differ significantly (Nemenyi)` +
    (found.friedman_p === null ? "." : `; of no difference between all of them, p ${found.friedman_p < 0.001 ? "< 0.001" : "= " + found.friedman_p.toFixed(3)} (Friedman).`) +
    (found.left_out.length ? ` Not on all of these scenarios: ${found.left_out.join(", ")}.` : "");
  const passing = names.filter((name) => of.some((b) => b.views[0].rows.some((row) => nameOf(row) === name && passes(row))));
  options($("mine"), passing.map((name) => [name, name]), passing.includes($("mine").value) ? $("mine").value : passing[0]);
  drawAgainst();
}

// The pairs of a board are of its rows over all samples; the first of a pair ranks no lower.
function drawAgainst() {
  const mine = $("mine").value, rivals = new Map();
  for (const b of boardsShown()) {
    const rows = b.views[0].rows, me = rows.findIndex((row) => nameOf(row) === mine && passes(row));
    if (me < 0 || b.kind !== "method") continue;
    rows.forEach((row, k) => {
      if (k === me || !passes(row)) return;
      const pair = b.pairs.find((p) => (p.first === me && p.second === k) || (p.first === k && p.second === me));
      const verdict = !pair ? "untested" : pair.p >= 0.05 ? "tied" : pair.first === me ? "better" : "worse";
      if (!rivals.has(nameOf(row))) rivals.set(nameOf(row), { better: [], tied: [], worse: [], untested: [] });
      rivals.get(nameOf(row))[verdict].push(b.apart ? `${b.scenario} (${b.apart})` : b.scenario);
    });
  }
  const cell = (scenarios, named) => el("td", {}, scenarios.length || "–", named && scenarios.length ? el("small", {}, scenarios.slice(0, 3).join(", ") + (scenarios.length > 3 ? ", …" : "")) : null);
  const none = el("tr", {}, el("td", { class: "text", colspan: 5 }, "No scenario was tested in common."));
  $("against").replaceChildren(heads([`${mine || "–"} against`, "better on", "not told apart on", "worse on", "not tested on"]),
    el("tbody", {}, ...[...rivals].map(([name, of]) => el("tr", {}, el("th", { scope: "row", class: "text" }, name), cell(of.better, true), cell(of.tied, false), cell(of.worse, true), cell(of.untested, false))), ...(rivals.size ? [] : [none])));
}

// ---- what is chosen ----------------------------------------------------------------------------

function filter() {
  const shown = boardsShown();
  if (!shown.includes(board())) state.board = data.boards.indexOf(shown[0]);
  options($("board"), shown.map((b) => [String(data.boards.indexOf(b)), b.name]), state.board);
  drawOverall();
  openBoard();
}

function openPart() {
  drawBoard();
  drawFrontier();
}

async function openBoard() {
  const b = board();
  state.part = 0;
  state.sort = null;
  state.chosen = null;
  options($("part"), b.views.map((v, k) => [String(k), v.label]), 0);
  const tracks = [...new Set(b.views[0].rows.map((row) => row.track).filter(Boolean))];
  state.track = "";
  options($("track"), [["", "all"], ...tracks.map((t) => [t, t])], "");
  openPart();
  drawNoise();
  drawFamilies();
  drawWeighted();
  drawPairs();
  options($("press-method"), b.presses.map((p) => [p.method, p.method]), b.presses.length ? b.presses[0].method : "");
  $("presses-section").hidden = !b.presses.length;
  const unpacked = b.images ? await bytes(b.images.data) : null;
  if (b !== board()) return; // another was chosen meanwhile
  pixels = unpacked;
  if (b.presses.length) drawPresses();
  if (b.images) {
    const families = [...new Set(b.images.cases.map((c) => c.family))];
    options($("family"), families.map((f) => [f, f || "all"]), families[0]);
    $("family").closest("label").hidden = b.images.families < 2;
    $("shown").closest("label").hidden = !b.images.has_truth;
  }
  drawImages();
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  $("theme").textContent = name === "dark" ? "Light" : "Dark";
}

function changeTheme(name) {
  setTheme(name);
  drawFrontier();
  drawNoise();
  if (board().presses.length) drawPresses();
}

setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
$("theme").addEventListener("click", () => changeTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
// Paper is light.
let before = "light";
addEventListener("beforeprint", () => {
  before = document.documentElement.dataset.theme;
  if (before === "dark") changeTheme("light");
});
// Plots take the width of the paper.
matchMedia("print").addEventListener("change", () => document.querySelectorAll(".plot.js-plotly-plot").forEach((p) => Plotly.Plots.resize(p)));
addEventListener("afterprint", () => { if (before === "dark") changeTheme("dark"); });
const sensors = [...new Set(data.boards.map((b) => b.sensor).filter(Boolean))];
options($("sensor"), [["", "all"], ...sensors.map((name) => [name, name])], "");
$("sensor-label").hidden = sensors.length < 2;
for (const id of ["untrained", "fast", "sensor"]) $(id).addEventListener("change", filter);
$("mine").addEventListener("change", drawAgainst);
$("board").addEventListener("change", () => { state.board = Number($("board").value); openBoard(); });
$("part").addEventListener("change", () => { state.part = Number($("part").value); openPart(); });
$("track").addEventListener("change", () => { state.track = $("track").value; openPart(); drawImages(); });
$("search").addEventListener("input", () => { state.search = $("search").value.trim().toLowerCase(); openPart(); drawImages(); });
$("family").addEventListener("change", drawImages);
$("shown").addEventListener("change", drawImages);
$("press-method").addEventListener("change", drawPresses);
$("noise-figure").addEventListener("change", drawNoise);
buildSliders();
options($("board"), data.boards.map((b, k) => [String(k), b.name]), 0);
drawOverall();
openBoard().then(() => plotly).then(() => { document.documentElement.dataset.ready = "true"; });
