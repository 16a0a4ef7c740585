"use strict";
// Draws what live.js received: the image with its scale and contacts, and the voltages.

const $ = (id) => document.getElementById(id);
const COLOURS = JSON.parse($("colours").textContent);
let setup = null, liveImage = null, range = [0, 1], shownRange = "";

function set(element, text) { if (element.textContent !== text) element.textContent = text; }

// ---- The image, lower-left origin, in metres ----

const image = $("image"), context = image.getContext("2d");
const pixels = document.createElement("canvas"), rim = document.createElement("canvas");
let place = null, pixelData = null;

function theme(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }

function fit(canvas, width, height) {
  const scale = window.devicePixelRatio || 1;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  canvas.getContext("2d").setTransform(scale, 0, 0, scale, 0, 0);
}

function resize() {
  if (!setup) return;
  const [x0, y0, x1, y1] = setup.bounds_m;
  const aspect = (x1 - x0) / (y1 - y0);
  const narrow = window.innerWidth < 480;
  const margin = { left: narrow ? 44 : 48, right: narrow ? 18 : 26, top: narrow ? 18 : 26, bottom: narrow ? 34 : 44 };
  image.style.maxWidth = "";
  let width = image.clientWidth;
  const most = Math.max(240, Math.min(0.72 * window.innerHeight, 640));
  let inner = width - margin.left - margin.right;
  if (inner / aspect > most) inner = most * aspect;
  width = inner + margin.left + margin.right;
  const height = inner / aspect + margin.top + margin.bottom;
  image.style.maxWidth = `${width}px`;
  image.style.height = `${height}px`;
  fit(image, width, height);
  fit(rim, width, height);
  const perMetre = inner / (x1 - x0);
  place = {
    width, height, inner, tall: inner / aspect, left: margin.left, top: margin.top, perMetre,
    x: (x) => margin.left + (x - x0) * perMetre,
    y: (y) => margin.top + (y1 - y) * perMetre,
    toX: (px) => x0 + (px - margin.left) / perMetre,
    toY: (py) => y1 - (py - margin.top) / perMetre,
  };
  drawRim();
  shownRange = "";
  fit($("voltages"), $("voltages").clientWidth, $("voltages").clientHeight);
  if (liveImage) { drawVoltages(); schedule(); }
}

function path(ctx, points) {
  points.forEach(([x, y], k) => ctx[k ? "lineTo" : "moveTo"](place.x(x), place.y(y)));
}

function drawRim() {
  const ctx = rim.getContext("2d");
  ctx.clearRect(0, 0, place.width, place.height);
  ctx.strokeStyle = theme("--soft");
  ctx.lineWidth = 1;
  ctx.beginPath();
  path(ctx, setup.outline_m);
  ctx.closePath();
  ctx.stroke();
  ctx.font = "600 11px system-ui, sans-serif";
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.lineCap = "butt";
  setup.electrodes_m.forEach((points, k) => {
    ctx.strokeStyle = theme("--copper");
    ctx.lineWidth = 5;
    ctx.beginPath();
    path(ctx, points);
    ctx.stroke();
    // The rim runs counter-clockwise, so that outside is to the right.
    const [first, last] = [points[0], points[points.length - 1]];
    const [dx, dy] = [last[0] - first[0], last[1] - first[1]];
    const length = Math.hypot(dx, dy), [mx, my] = points[points.length >> 1];
    ctx.fillStyle = theme("--ink");
    ctx.fillText(String(k), place.x(mx) + (12 * dy) / length, place.y(my) + (12 * dx) / length);
  });
  const [x0, y0, x1, y1] = setup.bounds_m;
  ctx.fillStyle = theme("--soft");
  ctx.font = "11px system-ui, sans-serif";
  const low = place.top + place.tall;
  for (const t of [0, 0.5, 1]) {
    const [x, y] = [x0 + t * (x1 - x0), y0 + t * (y1 - y0)];
    ctx.textAlign = ["left", "center", "right"][2 * t];
    ctx.fillText(`${(1e3 * x).toFixed(0)}${t === 1 ? " mm" : ""}`, place.x(x), low + 27);
    ctx.textAlign = "right";
    ctx.fillText((1e3 * y).toFixed(0), place.left - 22, place.y(y) + [-5, 0, 5][2 * t]);
  }
}

function drawImage() {
  const ctx = context;
  ctx.clearRect(0, 0, place.width, place.height);
  if (liveImage && liveImage.image) {
    fillPixels();
    ctx.save();
    ctx.beginPath();
    path(ctx, setup.outline_m);
    ctx.clip();
    ctx.imageSmoothingEnabled = true;
    ctx.drawImage(pixels, place.left, place.top, place.inner, place.tall);
    ctx.restore();
  }
  ctx.drawImage(rim, 0, 0, place.width, place.height);
  if (liveImage) liveImage.contacts.forEach(drawMarker);
  if (showsPointer()) drawPointer();
  labels = [];
  if (liveImage) liveImage.contacts.slice(0, MOST_LABELS).forEach(drawLabel);
}

function fillPixels() {
  const [height, width] = liveImage.shape, values = liveImage.image;
  if (pixels.width !== width || pixels.height !== height || !pixelData) {
    pixels.width = width;
    pixels.height = height;
    pixelData = pixels.getContext("2d").createImageData(width, height);
  }
  chooseRange(values);
  const [low, high] = range, scale = 255 / (high - low), data = pixelData.data;
  for (let row = 0; row < height; row++) {
    let out = 4 * (height - 1 - row) * width;
    for (let k = row * width; k < (row + 1) * width; k++, out += 4) {
      const value = values[k];
      const level = Math.round((value - low) * scale);
      // Outside the sensor there is no value: what is there is clipped, but is blended at the rim.
      const colour = COLOURS[level > 255 ? 255 : level > 0 ? level : value === value ? 0 : background];
      data[out] = colour[0];
      data[out + 1] = colour[1];
      data[out + 2] = colour[2];
      data[out + 3] = 255;
    }
  }
  pixels.getContext("2d").putImageData(pixelData, 0, 0);
}

let background = 0;

function chooseRange(values) {
  let [low, high] = setup.scale;
  if ($("adaptive").checked) {
    low = Infinity;
    high = -Infinity;
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    // Noise alone must not fill the scale.
    const least = 0.05 * setup.background, missing = least - (high - low);
    if (missing > 0) { low -= missing / 2; high += missing / 2; }
  }
  range = [low, high];
  background = Math.max(0, Math.min(255, Math.round((255 * (setup.background - low)) / (high - low))));
  const words = range.map((value) => value.toPrecision(3)).join();
  if (words !== shownRange) { shownRange = words; drawBar(); }
}

function drawBar() {
  const bar = $("bar"), ctx = bar.getContext("2d");
  bar.width = 256;
  bar.height = 1;
  COLOURS.forEach(([r, g, b], k) => { ctx.fillStyle = `rgb(${r} ${g} ${b})`; ctx.fillRect(k, 0, 1, 1); });
  const [low, high] = range, step = niceStep((high - low) / 5);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high * (1 + 1e-9); k++) {
    const tick = document.createElement("span");
    tick.style.left = `${(100 * (k * step - low)) / (high - low)}%`;
    tick.textContent = (k * step).toFixed(digits);
    ticks.push(tick);
  }
  $("ticks").replaceChildren(...ticks);
}

function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least * (1 - 1e-9));
}

function ring(x, y, radius, width, colour, dashes) {
  context.setLineDash(dashes);
  context.lineWidth = width;
  context.strokeStyle = colour;
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.stroke();
  context.setLineDash([]);
}

function drawMarker(contact) {
  const [x, y] = [place.x(contact.x_m), place.y(contact.y_m)];
  ring(x, y, MARKER, 5, "#000", []);
  ring(x, y, MARKER, 2.5, "#fff", []);
}

const MARKER = 9, MOST_LABELS = 3, LABEL_HEIGHT = 18;
let labels = [];

function drawLabel(contact, k) {
  const words = `${k + 1}: ${(1e3 * contact.x_m).toFixed(0)}, ${(1e3 * contact.y_m).toFixed(0)} mm`;
  context.font = "600 12px system-ui, sans-serif";
  context.textBaseline = "middle";
  const box = labelBox(place.x(contact.x_m), place.y(contact.y_m), context.measureText(words).width + 8);
  labels.push(box);
  context.fillStyle = "rgb(0 0 0 / .78)";
  context.fillRect(box.x, box.y, box.width, LABEL_HEIGHT);
  context.fillStyle = "#fff";
  context.textAlign = "left";
  context.fillText(words, box.x + 4, box.y + LABEL_HEIGHT / 2 + 0.5);
}

// Beside the marker, or farther out, where it covers no marker, no ring and no other label.
function labelBox(x, y, width) {
  const boxes = [];
  for (let out = MARKER + 4; out < 0.7 * place.inner; out += 12) {
    const [across, down] = [y - LABEL_HEIGHT / 2, x - width / 2];
    boxes.push({ x: x + out, y: across, width }, { x: x - out - width, y: across, width },
      { x: down, y: y + out, width }, { x: down, y: y - out - LABEL_HEIGHT, width });
  }
  return boxes.find(isFree) || boxes[0];
}

function isFree(box) {
  const [right, low] = [box.x + box.width, box.y + LABEL_HEIGHT];
  if (box.x < 0 || box.y < 0 || right > place.width || low > place.height) return false;
  if (labels.some((l) => l.x < right && box.x < l.x + l.width && l.y < low && box.y < l.y + LABEL_HEIGHT)) return false;
  const nearest = (x, y) => Math.hypot(Math.max(box.x - x, 0, x - right), Math.max(box.y - y, 0, y - low));
  if (liveImage.contacts.some((c) => nearest(place.x(c.x_m), place.y(c.y_m)) < MARKER + 3)) return false;
  if (!showsPointer()) return true;
  const [x, y] = [place.x(pointer.x), place.y(pointer.y)], radius = setup.touch.radius_m * place.perMetre;
  const farthest = Math.hypot(Math.max(x - box.x, right - x), Math.max(y - box.y, low - y));
  return nearest(x, y) > radius + 3 || farthest < radius - 3;
}

// ---- Voltages over the reference, and their difference ----

function drawVoltages() {
  const canvas = $("voltages"), ctx = canvas.getContext("2d");
  const width = canvas.clientWidth, height = canvas.clientHeight, left = 52, right = width - 4;
  const { voltages, untouched } = liveImage;
  ctx.clearRect(0, 0, width, height);
  const difference = untouched ? voltages.map((value, k) => value - untouched[k]) : null;
  const split = difference ? 0.56 * height : height;
  const x = (k) => left + ((k + 0.5) * (right - left)) / voltages.length;
  const panel = (top, bottom, low, high) => {
    ctx.strokeStyle = theme("--line");
    ctx.lineWidth = 1;
    ctx.strokeRect(left, top, right - left, bottom - top);
    ctx.fillStyle = theme("--soft");
    ctx.font = "11px system-ui, sans-serif";
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    ctx.fillText(high.toPrecision(2), left - 5, top + 6);
    ctx.fillText(low.toPrecision(2), left - 5, bottom - 6);
    const span = high - low || 1;
    return (value) => bottom - ((value - low) / span) * (bottom - top);
  };
  let low = Infinity, high = -Infinity;
  for (const values of [voltages, untouched || []]) {
    for (const value of values) { low = Math.min(low, value); high = Math.max(high, value); }
  }
  const y = panel(4, split - 8, low, high);
  const line = (values, colour, dashes) => {
    ctx.strokeStyle = colour;
    ctx.setLineDash(dashes);
    ctx.beginPath();
    values.forEach((value, k) => ctx[k ? "lineTo" : "moveTo"](x(k), y(value)));
    ctx.stroke();
    ctx.setLineDash([]);
  };
  line(voltages, theme("--mark"), []);
  if (!difference) return;
  line(untouched, theme("--soft"), [3, 2]);
  let most = 0;
  for (const value of difference) most = Math.max(most, Math.abs(value));
  const d = panel(split + 4, height - 16, -most, most);
  const zero = d(0), bar = Math.max(1, (0.7 * (right - left)) / voltages.length);
  ctx.fillStyle = theme("--copper");
  difference.forEach((value, k) => ctx.fillRect(x(k) - bar / 2, Math.min(zero, d(value)), bar, Math.abs(d(value) - zero)));
  ctx.fillStyle = theme("--soft");
  ctx.textAlign = "left";
  ctx.fillText("measurement 1", left, height - 6);
  ctx.textAlign = "right";
  ctx.fillText(String(voltages.length), right, height - 6);
}
