// The rotor in space at the cursor: spin axis, tilt, torque of the coils as measured and as predicted; plays with the recording.

import { ask, at, colours, css, dark, element, fixed, hear, now, still } from "./shared.js";
import { putCursor, shown, span, zoom } from "./signals.js";

const TIMES = 5; // tilts are drawn so many times larger: they are a few degrees
const SLOWER = 100; // and turns so many times slower
const CHUNK = 100; // s of states that are asked for at once
const TRAIL = 2; // s of the path of the axis
const RADIUS = 0.95; // of the rotor, where the view is about 2.7 wide
const RIBS = Array.from({ length: 24 }, (_, k) => (k * Math.PI) / 12); // of the mesh
const canvas = at("rotor");
const pen = canvas.getContext("2d");

let view = { turn: -0.6, lift: 0.42 };
let states = null; // of a chunk
let fetching = null;
let cursor = null;
let angle = 0; // of the mark on the rotor
let playing = false;
let before = 0; // ms, of the frame before
let told = 0;

hear("cursor", ({ time }) => {
  if (!playing) cursor = time;
  if (!playing) show();
});
hear("shown", () => {
  stop();
  states = null;
  cursor = null;
  at("rotor-time").max = shown().duration;
  show();
});

at("rotor-play").addEventListener("click", () => (playing ? stop() : play()));
at("rotor-time").addEventListener("input", () => {
  cursor = Number(at("rotor-time").value);
  putCursor(cursor);
  show();
});

function play() {
  if (!shown()) return;
  if (cursor === null || cursor >= shown().duration - 0.05) cursor = span()[0] > 0 ? span()[0] : 0;
  playing = true;
  at("rotor-play").textContent = "Pause";
  before = performance.now();
  requestAnimationFrame(frame);
}

function stop() {
  playing = false;
  at("rotor-play").textContent = "Play";
}

function frame(now) {
  if (!playing || !shown()) return;
  // where motion is unwanted: from half second to half second, and nothing turns
  const least = still.matches ? 500 : 0;
  const passed = now - before;
  if (passed >= least) {
    before = now;
    const step = (Math.min(passed, 1000) / 1000) * Number(at("rotor-pace").value);
    cursor = Math.min(cursor + step, shown().duration);
    const own = stateAt(cursor);
    if (own && !still.matches) angle += (own.spin * step) / SLOWER;
    if (now - told > 120) {
      told = now;
      putCursor(cursor);
      const [from, until] = span();
      if (cursor > until || cursor < from) zoom(cursor, Math.min(cursor + until - from, shown().duration));
    }
    show();
  }
  if (cursor >= shown().duration) stop();
  else requestAnimationFrame(frame);
}

// The state at a time, between two of those that were asked for; null while they are on their way.
function stateAt(time) {
  const key = shown()?.key;
  if (!key || time === null) return null;
  const begin = CHUNK * Math.floor(time / CHUNK);
  if (!states || states.key !== key || states.begin !== begin) {
    fetchStates(key, begin);
    return null;
  }
  const t = states.time;
  if (!t.length) return null;
  let k = t.findIndex((each) => each > time);
  if (k < 0) k = t.length - 1;
  const low = Math.max(k - 1, 0);
  const part = k === low ? 0 : Math.min(Math.max((time - t[low]) / (t[k] - t[low]), 0), 1);
  const between = (name) => states[name][low] + part * (states[name][k] - states[name][low]);
  return { k, ...Object.fromEntries(["tilt_x", "tilt_y", "spin", "torque_x", "torque_y"].map((name) => [name, between(name)])) };
}

async function fetchStates(key, begin) {
  const wanted = `${key} ${begin}`;
  if (fetching === wanted) return;
  fetching = wanted;
  try {
    const query = new URLSearchParams({ key, from: begin, until: begin + CHUNK });
    const found = await (await ask(`/motion?${query}`)).json();
    states = { key, begin, ...found };
    show();
  } catch {
    // the recording was closed
  } finally {
    fetching = null;
  }
}

// The hold at a time: its torques of the coils, measured and predicted [N·m].
function holdAt(time) {
  const holds = now.found?.holds[shown()?.key];
  const k = holds ? holds.start.findIndex((start, i) => start <= time && time <= holds.end[i]) : -1;
  if (k < 0) return null;
  const [x, y] = holds.actuators.map((own) => own.torque);
  return { measured: [x.measured[k] / 1e3, y.measured[k] / 1e3], predicted: [x.predicted[k] / 1e3, y.predicted[k] / 1e3] };
}

// N·m as long as the rotor's radius: the largest of the holds, else of the states.
function reach() {
  const holds = now.found?.holds[shown()?.key];
  if (holds) {
    const [x, y] = holds.actuators.map((own) => own.torque);
    const every = x.measured.flatMap((mx, k) => [Math.hypot(mx, y.measured[k]), Math.hypot(x.predicted[k], y.predicted[k])]);
    if (every.length) return Math.max(...every) / 1e3 || 1;
  }
  const sizes = (states?.torque_x ?? []).map((x, k) => Math.hypot(x, states.torque_y[k])).sort((a, b) => a - b);
  return sizes[Math.floor(0.7 * sizes.length)] || 1;
}

// --- drawing: the axes of the case from the side and above, without perspective

function project([x, y, z]) {
  const [c, s] = [Math.cos(view.turn), Math.sin(view.turn)];
  const [cl, sl] = [Math.cos(view.lift), Math.sin(view.lift)];
  const [across, along] = [x * c - y * s, x * s + y * c];
  const size = 0.36 * Math.min(canvas.width, canvas.height);
  return [canvas.width / 2 + size * across, canvas.height * 0.56 - size * (z * cl + along * sl)];
}

function line(points, colour, width = 1, dash = []) {
  pen.beginPath();
  points.forEach((point, k) => (k ? pen.lineTo(...project(point)) : pen.moveTo(...project(point))));
  pen.strokeStyle = colour;
  pen.lineWidth = width * ratio();
  pen.setLineDash(dash.map((each) => each * ratio()));
  pen.stroke();
}

function arrow(from, to, colour, width, label) {
  line([from, to], colour, width);
  const [[x0, y0], [x1, y1]] = [project(from), project(to)];
  const length = Math.hypot(x1 - x0, y1 - y0);
  if (length > 3 * ratio()) {
    const [ux, uy] = [(x1 - x0) / length, (y1 - y0) / length];
    const head = Math.min(10 * ratio(), length);
    pen.beginPath();
    pen.moveTo(x1, y1);
    pen.lineTo(x1 - head * ux - 0.45 * head * uy, y1 - head * uy + 0.45 * head * ux);
    pen.lineTo(x1 - head * ux + 0.45 * head * uy, y1 - head * uy - 0.45 * head * ux);
    pen.fillStyle = colour;
    pen.fill();
  }
  if (label) write(label, [x1, y1], colour);
}

function write(text, [x, y], colour) {
  pen.fillStyle = colour;
  pen.fillText(text, x + 6 * ratio(), y - 4 * ratio());
}

const ratio = () => window.devicePixelRatio || 1;
const circle = (make) => Array.from({ length: 73 }, (_, k) => make((k * Math.PI) / 36));

// Two unit vectors across the spin axis n.
function across([nx, ny, nz]) {
  const size = Math.hypot(nz, nx);
  const u = [nz / size, 0, -nx / size];
  return [u, [ny * u[2] - nz * u[1], nz * u[0] - nx * u[2], nx * u[1] - ny * u[0]]];
}

function axisOf(tilt_x, tilt_y) {
  const [x, y] = [TIMES * Math.tan(tilt_y), -TIMES * Math.tan(tilt_x)];
  const size = Math.hypot(x, y, 1);
  return [x / size, y / size, 1 / size];
}

export function show() {
  at("rotor-none").hidden = Boolean(shown());
  if (!canvas.clientWidth || !shown()) return; // its pane is not in sight
  const [wide, high] = [canvas.clientWidth * ratio(), canvas.clientHeight * ratio()].map(Math.round);
  if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
  pen.clearRect(0, 0, wide, high);
  pen.font = `${13 * ratio()}px system-ui, sans-serif`;
  const [ink, soft, faint] = ["--ink", "--soft", "--line"].map(css);
  const [one, other] = colours();
  const time = cursor ?? (span() ? span()[0] : 0);
  const own = stateAt(time);
  // rotor and case to scale where their lengths are known, else a thin disc
  const { rotor_height, case_radius, case_height } = now.found?.geometry ?? { rotor_height: 0.12 / RADIUS };
  const half = 0.5 * RADIUS * rotor_height;
  // the case: its axes, and its wall, or the plane of the rotor without tilt
  const wall = case_radius ? RADIUS * case_radius : 1.15;
  const rise = case_radius ? 0.5 * RADIUS * case_height : 0;
  for (const z of rise ? [-rise, rise] : [0]) line(circle((a) => [wall * Math.cos(a), wall * Math.sin(a), z]), faint, 1);
  if (rise) for (const a of RIBS) line([-rise, rise].map((z) => [wall * Math.cos(a), wall * Math.sin(a), z]), faint, 1);
  for (const [tip, name] of [[[1.35, 0, 0], "x"], [[0, 1.35, 0], "y"], [[0, 0, 1.3], "z"]]) {
    line([[0, 0, 0], tip], soft, 1, [3, 4]);
    const [x, y] = project(tip);
    write(name, [name === "z" ? x - 18 * ratio() : x, y], soft); // the other side has the name of the spin axis
  }
  if (!own) return read(null, null);
  const n = axisOf(own.tilt_x, own.tilt_y);
  const [u, v] = across(n);
  const rim = (a, r, h) => [0, 1, 2].map((k) => r * (Math.cos(a) * u[k] + Math.sin(a) * v[k]) + h * n[k]);
  // path of the axis
  const first = states.time.findIndex((each) => each >= time - TRAIL);
  const trail = first < 0 ? [] : states.tilt_x.slice(first, own.k).map((x, k) => axisOf(x, states.tilt_y[first + k]));
  if (trail.length > 1) line(trail, soft, 1.5);
  // the rotor: a cylinder with one marked spoke
  const ends = [-half, half].map((h) => circle((a) => rim(a, RADIUS, h)));
  pen.beginPath();
  for (const end of ends) end.forEach((point, k) => (k ? pen.lineTo(...project(point)) : pen.moveTo(...project(point))));
  pen.fillStyle = dark.matches ? "rgba(140, 160, 180, 0.28)" : "rgba(90, 110, 130, 0.22)";
  pen.fill("nonzero");
  line(ends[0], soft, 1);
  line(ends[1], ink, 1.5);
  if (case_radius) for (const a of RIBS) line([-half, half].map((h) => rim(angle + a, RADIUS, h)), soft, 0.7);
  for (let k = 0; k < 6; k++) line([0.12, RADIUS].map((r) => rim(angle + (k * Math.PI) / 3, r, half)), k ? soft : ink, k ? 1 : 3);
  arrow([0, 0, 0], n.map((each) => 1.15 * each), ink, 2, "spin axis");
  // torques lie in the plane of the case
  const hold = holdAt(time);
  const scale = 1.1 / reach();
  const tip = ([x, y]) => {
    const size = Math.hypot(x, y) * scale;
    const cut = size > 1.5 ? 1.5 / size : 1; // larger ones are cut off
    return [x * scale * cut, y * scale * cut, 0];
  };
  if (hold) arrow([0, 0, 0], tip(hold.predicted), other, 3, "predicted");
  arrow([0, 0, 0], tip(hold ? hold.measured : [own.torque_x, own.torque_y]), one, 3, "measured");
  read(own, hold, time);
}

let words = "";
function read(own, hold, time) {
  const degrees = (value) => fixed((value * 180) / Math.PI, 2);
  const milli = ([x, y]) => `${fixed(1e3 * x, 2)}, ${fixed(1e3 * y, 2)} mN·m`;
  const text = own
    ? `${time.toFixed(2)} s: tilt ${degrees(own.tilt_x)}, ${degrees(own.tilt_y)} °; ${((own.spin * 30) / Math.PI).toFixed(0)} rpm; torque of the coils ` +
      (hold ? `in this hold ${milli(hold.measured)}, predicted ${milli(hold.predicted)}` : `${milli([own.torque_x, own.torque_y])}, no hold`)
    : "";
  if (text === words) return;
  words = text;
  at("rotor-said").textContent = text;
  canvas.setAttribute("aria-label", text ? `The rotor at ${text}` : "The rotor");
  if (own && document.activeElement !== at("rotor-time")) at("rotor-time").value = time;
}

// --- the flow of the air, when asked for

for (const button of at("rotor-flow").querySelectorAll("button")) {
  button.addEventListener("click", () => {
    for (const each of at("rotor-flow").querySelectorAll("button")) each.setAttribute("aria-pressed", String(each === button));
    const which = button.dataset.flow;
    const picture = element("img", undefined, { src: `/flow/${which}.png`, alt: `Computed ${which} velocity of the air on a section across the axis of the tilt, without tilt and at 5°` });
    const link = element("a", undefined, { href: picture.src, target: "_blank", rel: "noopener" }); // in its full size
    link.append(picture);
    at("rotor-flow").querySelector("div").replaceChildren(link);
  });
}

// --- turning the view: drag, or the arrow keys

function look(turn, lift) {
  view = { turn: view.turn + turn, lift: Math.min(Math.max(view.lift + lift, 0), 1.5) };
  show();
}
canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
canvas.addEventListener("pointermove", (event) => {
  if (canvas.hasPointerCapture(event.pointerId)) look(-event.movementX / 150, event.movementY / 150);
});
canvas.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
  if (!step) return;
  event.preventDefault();
  event.stopPropagation();
  look(...step);
});
new ResizeObserver(() => show()).observe(canvas);
dark.addEventListener("change", () => show());
