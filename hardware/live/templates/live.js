"use strict";
// Messages of the page, both ways; drawing.js, which stands before it, draws.

const PLOT_EVERY_MS = 100;
const RETRY_MS = 1000;
const REFUSED_MS = 10000;
const OLD_S = 1;

let state = null, pending = null, scheduled = false, socket = null;
const paints = [];

// ---- The server: setup and state as JSON, images as bytes (hardware/live/viewer.py) ----

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => {
    if (data instanceof ArrayBuffer) return receive(data);
    const message = JSON.parse(data);
    if (message.type === "setup") showSetup(message);
    else if (message.type === "state") showState(message);
    else if (message.type === "refused") showRefused(message.why);
  };
  socket.onclose = () => {
    status("bad", "▲", "No connection to eitbench: trying again");
    setTimeout(connect, RETRY_MS);
  };
}

function ask(command) {
  if (command.do !== "painted" && command.do !== "release") showRefused("");
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(command));
}

function receive(data) {
  const length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  let at = 4 + length;
  const values = (count) => {
    const part = new Float32Array(data, at, count);
    at += 4 * count;
    return part;
  };
  header.image = header.shape ? values(header.shape[0] * header.shape[1]) : null;
  header.voltages = values(header.values);
  header.untouched = header.reference ? values(header.values) : null;
  pending = header;
  schedule();
}

function schedule() {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(paint);
}

function paint(now) {
  scheduled = false;
  const isNew = pending !== null;
  if (isNew) { liveImage = pending; pending = null; }
  if (!setup) return;
  drawImage();
  if (!isNew) return;
  ask({ do: "painted", number: liveImage.number });
  image.dataset.number = liveImage.number;
  paints.push(now);
  while (paints[0] < now - 2000) paints.shift();
  if (now - plotted > PLOT_EVERY_MS) {
    plotted = now;
    drawVoltages();
    showContacts();
    showNote();
    $("method-shown").textContent = liveImage.method || "–";
  }
}

// ---- Words ----

let refused = "", fades = 0, methodShown = "", plotted = 0;

function status(kind, sign, text) {
  $("status").dataset.kind = kind;
  image.classList.toggle("stale", kind === "bad" || kind === "old");
  set($("status-sign"), sign);
  set($("status-text"), text);
}

function showSetup(message) {
  setup = message;
  document.title = `${setup.board} – eitbench live`;
  set($("board"), setup.board);
  set($("sensor"), setup.sensor);
  $("emulated").hidden = !setup.emulated;
  $("method").replaceChildren(...setup.methods.map(({ name }) => new Option(name, name)));
  methodShown = "";
  allowPresses();
  resize();
}

function showState(message) {
  state = message;
  const left = state.reference_left;
  if (state.board === "lost") status("bad", "▲", "Board lost: trying again");
  else if (state.board === "silent") status("bad", "■", "No frames from the board");
  else if (left) status("wait", "◌", `Taking the reference: do not touch (${left} more)`);
  // A board that sends less than once a second leaves an image that old, whatever the method.
  else if (state.rate_hz && state.age_s > OLD_S + 1 / state.rate_hz) {
    status("old", "◔", `Image of ${state.age_s.toFixed(0)} s ago: ${state.method} is slower than the board`);
  } else status("good", "●", "Running");
  // Only when it changes: what is being chosen just now must stay as it is.
  const inUse = state.fitting || state.method;
  if (inUse && inUse !== methodShown) $("method").value = methodShown = inUse;
  const chosen = setup.methods.find(({ name }) => name === $("method").value);
  set($("about"), chosen ? chosen.about : "");
  const number = (value, digits) => (value === null ? "–" : value.toFixed(digits));
  set($("rate"), number(state.rate_hz, 1));
  set($("snr"), number(state.snr_db, 0));
  set($("latency"), number(state.latency_ms, 0));
  set($("lost"), String(state.dropped + state.damaged));
  set($("reciprocity"), number(state.reciprocity === null ? null : 100 * state.reciprocity, 1));
  const suspects = state.suspects.join(", ");
  $("suspects").dataset.kind = suspects ? "bad" : "";
  set($("suspects"), suspects ? `▲ Suspect electrodes: ${suspects}` : "No suspect electrodes.");
  while (paints.length && paints[0] < performance.now() - 2000) paints.shift();
  const span = paints.length > 1 ? paints[paints.length - 1] - paints[0] : 0;
  set($("painted"), (span ? (1000 * (paints.length - 1)) / span : 0).toFixed(1));
  showRecording(state.recording);
  showNote();
}

function showRecording(recording) {
  const running = Boolean(recording && recording.running);
  const button = $("record");
  if (button.getAttribute("aria-pressed") !== String(running)) {
    button.setAttribute("aria-pressed", String(running));
    set($("record-sign"), running ? "■" : "●");
    set($("record-word"), running ? "Stop" : "Record");
  }
  const words = $("recording");
  words.dataset.kind = recording && recording.failed ? "bad" : "";
  if (!recording) set(words, "Not recording.");
  else if (recording.failed) set(words, `▲ ${recording.failed}`);
  else {
    const { file, frames, touches, enough, suite } = recording;
    let said = `${running ? "Recording to" : "Recorded"} ${file}: ${frames} frames, ${touches} of ${enough} touches.`;
    if (!running && suite) said += ` Score methods on them: eitbench run ${suite}`;
    set(words, said);
  }
}

function showRefused(why) {
  refused = why;
  clearTimeout(fades);
  if (why) fades = setTimeout(showRefused, REFUSED_MS, "");
  showNote();
}

function showNote() {
  if (!state) return;
  const note = $("note");
  const wrong = state.sentence || refused || state.method_failed || (liveImage && liveImage.failed);
  // A slow method is fitted long before its first image is there.
  const preparing = state.fitting || (liveImage && liveImage.method === state.method ? "" : state.method);
  note.dataset.kind = wrong ? "bad" : "";
  set(note, wrong ? `▲ ${wrong}` : preparing ? `◌ Preparing ${preparing}` : "");
}

function showContacts() {
  const rows = liveImage.contacts.slice(0, 3);
  $("untouched").hidden = rows.length > 0;
  $("contacts").hidden = rows.length === 0;
  const body = $("contacts").tBodies[0];
  while (body.rows.length > rows.length) body.deleteRow(-1);
  while (body.rows.length < rows.length) for (let k = 0, row = body.insertRow(); k < 5; k++) row.insertCell();
  rows.forEach((contact, k) => {
    const words = [k + 1, (1e3 * contact.x_m).toFixed(1), (1e3 * contact.y_m).toFixed(1),
      (1e4 * contact.area_m2).toFixed(1), (1e4 * contact.strength).toFixed(2)];
    words.forEach((word, c) => set(body.rows[k].cells[c], String(word)));
  });
}

// ---- Touches: they press an emulated board, and a recording keeps their places ----

let pointer = null, pressed = false, moved = false;

function allowPresses() {
  if (pointer) return;
  const [x0, y0, x1, y1] = setup.bounds_m;
  pointer = { x: (x0 + x1) / 2, y: (y0 + y1) / 2 };
  $("press").hidden = false;
  image.classList.add("pressable");
  image.tabIndex = 0;
  image.setAttribute("role", "application");
  const real = Object.keys(setup.touch.pressures_pa).length === 0;
  set($("press-title"), real ? "Where you touch it" : "Press it");
  $("hint-real").hidden = !real;
  image.setAttribute("aria-label", `Image of the sensor's conductivity, ${real ? "to mark touches on" : "which can be pressed"}`);
  image.setAttribute("aria-describedby", "hint");
  $("pressures").replaceChildren(...Object.entries(setup.touch.pressures_pa).map(([name, pa]) => {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "radio", name: "pressure", value: pa, checked: name === "medium" });
    label.append(input, `${name}, ${pa / 1e3} kPa`);
    return label;
  }));
  image.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    image.setPointerCapture(event.pointerId);
    follow(event);
    press(true);
  });
  image.addEventListener("pointermove", (event) => { if (pressed) follow(event); });
  for (const end of ["pointerup", "pointercancel"]) image.addEventListener(end, () => press(false));
  image.addEventListener("keydown", (event) => {
    const step = (event.shiftKey ? 0.1 : 0.02) * (x1 - x0);
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
    if (by) move(pointer.x + step * by[0], pointer.y + step * by[1]);
    else if (event.key !== " ") return;
    else if (!event.repeat) press(true);
    event.preventDefault();
  });
  image.addEventListener("keyup", (event) => { if (event.key === " ") press(false); });
  image.addEventListener("focus", schedule);
  image.addEventListener("blur", () => { press(false); schedule(); });
}

function follow(event) {
  const box = image.getBoundingClientRect(), [sx, sy] = [place.width / box.width, place.height / box.height];
  move(place.toX((event.clientX - box.left) * sx), place.toY((event.clientY - box.top) * sy));
}

function move(x, y) {
  const [x0, y0, x1, y1] = setup.bounds_m;
  pointer = { x: Math.min(x1, Math.max(x0, x)), y: Math.min(y1, Math.max(y0, y)) };
  // Once for each painted frame is enough.
  if (pressed && !moved) {
    moved = true;
    requestAnimationFrame(() => { moved = false; if (pressed) touch(); });
  }
  schedule();
}

function touch() {
  const chosen = document.querySelector("input[name=pressure]:checked");
  const place_m = { x_m: pointer.x, y_m: pointer.y, radius_m: setup.touch.radius_m };
  ask({ do: "touch", ...place_m, pressure_pa: chosen ? Number(chosen.value) : null });
}

function press(down) {
  if (down === pressed) return;
  pressed = down;
  if (down) touch();
  else ask({ do: "release" });
  schedule();
}

function showsPointer() { return pointer && (pressed || document.activeElement === image); }

function drawPointer() {
  const [x, y] = [place.x(pointer.x), place.y(pointer.y)], radius = setup.touch.radius_m * place.perMetre;
  ring(x, y, radius, pressed ? 4 : 3, "#000", []);
  ring(x, y, radius, pressed ? 2 : 1, "#fff", pressed ? [] : [4, 4]);
}

// ---- Controls ----

$("method").addEventListener("change", (event) => {
  methodShown = event.target.value;
  ask({ do: "method", name: methodShown });
});
$("reference").addEventListener("click", () => ask({ do: "reference" }));
$("record").addEventListener("click", () => {
  ask({ do: "record", on: $("record").getAttribute("aria-pressed") !== "true" });
});
$("adaptive").addEventListener("change", schedule);
new ResizeObserver(resize).observe($("view"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", resize);
connect();
