// The signals of a running bench as they arrive: a ring of extremes, drawn as a strip that moves.

import { reveal } from "./layout.js";
import { at, colours, css, dark, element, hear, now, send, still, tell, troubleField } from "./shared.js";

const canvas = at("live");
const pen = canvas.getContext("2d", { willReadFrequently: true }); // drawn by the processor: lines of pixels are quicker so
const PANELS = JSON.parse(at("plots").dataset.panels);
const { bin: BIN, kept: KEPT, row: ROW } = JSON.parse(canvas.dataset.trace);
const LEFT = 52; // px for the numbers of the axes
const SLOW = 500; // ms between two pictures where motion is unwanted

const ring = new Float32Array(KEPT * ROW.length); // this page needs no more memory however long it listens
export const seen = { frames: 0, bins: 0 };
let end = 0; // number of the bin after the latest
let first = 0; // and of the oldest one that was received
let zero = null; // s, of the beginning of the run
let key = null; // of the bench
let source = null;
let asked = false; // whether a picture is to be drawn
let drawn = 0; // ms
let paused = false;
let held = 0; // `end` where it is paused
let pointer = null; // px
let palette = null; // colours of the theme: asked for once, not for every picture

// --- which bench, and what of it is in sight

document.addEventListener("click", (event) => {
  const button = event.target.closest("[data-watch]");
  if (!button) return;
  key = button.dataset.watch;
  reveal("live");
  showLive();
});
at("live-pause").addEventListener("click", () => {
  paused = !paused;
  held = end;
  at("live-pause").setAttribute("aria-pressed", String(paused));
  ask();
});
at("live-span").addEventListener("change", () => ask());
canvas.addEventListener("pointermove", (event) => ((pointer = event.offsetX), ask()));
canvas.addEventListener("pointerleave", () => ((pointer = null), ask()));
document.addEventListener("visibilitychange", connect);
dark.addEventListener("change", () => ((palette = null), ask()));
hear("layout", () => connect());
new ResizeObserver(() => (connect(), ask())).observe(canvas);

// A plan or a setpoint moves the machine: asked for twice.
function confirm(words, name, content) {
  at("live-sure-words").textContent = words;
  at("live-sure").querySelector("form").dataset.do = name;
  at("live-sure-content").replaceChildren(...Object.entries(content).map(([field, value]) => element("input", undefined, { type: "hidden", name: field, value })));
  at("live-sure").showModal();
}
at("live-run").addEventListener("submit", (event) => {
  event.preventDefault();
  confirm(
    `Plan ${at("live-plan").selectedOptions[0].text}: the ${now.state.live[key].title} moves. The plan is recorded, and the recording is diagnosed. End, in the first line of the page, stops it.`,
    "walk",
    { plan: at("live-plan").value, bench: key },
  );
});
at("live-setpoint").addEventListener("submit", async (event) => {
  event.preventDefault();
  const content = { bench: key, ...Object.fromEntries(new FormData(event.target)) };
  tell("setpoint", "");
  try {
    const { said } = await send("setpoint", content); // what it would do: nothing is sent to the bench yet
    confirm(said, "setpoint", { ...content, sure: "yes" });
  } catch (error) {
    tell("setpoint", error.message);
    troubleField("setpoint").scrollIntoView({ block: "nearest" });
  }
});
at("live-sure").addEventListener("submit", () => at("live-sure").close());
at("live-not").addEventListener("click", () => at("live-sure").close());

export function showLive() {
  const benches = Object.entries(now.state.live);
  if (!(key in now.state.live)) key = benches[0]?.[0] ?? null;
  at("live-none").hidden = key !== null;
  at("live-run").hidden = key === null || now.state.live[key].silent;
  at("live-setpoint").hidden = at("live-run").hidden;
  for (const form of ["live-run", "live-setpoint"]) at(form).querySelector("button").disabled = Boolean(now.state.job);
  if (key !== null) {
    const { tilt, slowest, fastest } = now.state.live[key].allowed;
    const [most, low, high] = [tilt, slowest, fastest].map((own) => Number(own.toPrecision(5)));
    at("live-allowed").textContent = `Allowed: tilts from −${most} to ${most}°, both together up to ${most}°; spin rates from ${low} to ${high} rpm.`;
    if (!at("live-spin").value) at("live-spin").value = String(Math.round(0.5 * (low + high)));
  }
  at("live-line").hidden = canvas.hidden = at("live-said").hidden = key === null;
  const titles = JSON.stringify(benches.map(([name, { title }]) => [name, title]));
  const place = at("live-of");
  if (place.dataset.shown !== titles) {
    place.dataset.shown = titles;
    place.replaceChildren(...benches.map(([name, { title }]) => {
      const button = element("button", title, { type: "button" });
      button.dataset.watch = name;
      return button;
    }));
  }
  for (const button of place.children) button.setAttribute("aria-pressed", String(button.dataset.watch === key));
  at("live-words").textContent = key === null ? "" : now.state.live[key].words;
  connect();
}

// Listens while the picture is in sight: the server then receives the samples, and otherwise does not.
function connect() {
  const wanted = canvas.clientWidth && !document.hidden && key !== null ? `/live?${new URLSearchParams({ key })}` : null;
  if (wanted === (source?.wanted ?? null)) return;
  if (source?.wanted !== wanted) source?.events.close();
  source = null;
  if (wanted === null) return;
  end = first = 0;
  const events = new EventSource(wanted);
  source = { wanted, events };
  events.onmessage = ({ data }) => take(JSON.parse(data));
  events.onerror = () => {
    if (events.readyState === EventSource.CLOSED && source?.events === events) source = null; // tried again with the next state
  };
}

function take(piece) {
  if (piece.first !== end) first = piece.first; // another run, or a reconnection
  zero = piece.zero ?? zero ?? piece.first * BIN;
  piece.rows.forEach((row, k) => {
    const place = ((piece.first + k) % KEPT) * ROW.length;
    for (let c = 0; c < ROW.length; c++) ring[place + c] = row[c] ?? NaN;
  });
  end = piece.next;
  first = Math.max(first, end - KEPT);
  seen.bins += piece.rows.filter(([low]) => low !== null).length;
  if (!paused && piece.rows.length) ask();
}

// --- drawing

function ask() {
  if (asked) return;
  asked = true;
  requestAnimationFrame((time) => {
    asked = false;
    if (still.matches && time - drawn < SLOW && pointer === null) return;
    drawn = time;
    draw();
  });
}

const value = (number, column) => ring[(number % KEPT) * ROW.length + column];

// Three or four round numbers over a range.
function ticks(low, high) {
  const rough = Math.max(high - low, 1e-6 * Math.max(Math.abs(low), Math.abs(high)), 1e-9) / 3;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((each) => each * power >= rough);
  const [from, until] = [Math.floor(low / step), Math.ceil(high / step)];
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return Array.from({ length: Math.max(until - from, 1) + 1 }, (_, k) => [(from + k) * step, ((from + k) * step).toFixed(digits).replace("-", "−")]);
}

function draw() {
  if (!canvas.clientWidth) return;
  const ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const size = [width, height].map((each) => Math.round(each * ratio));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "11px system-ui, sans-serif";
  const count = Math.round(Number(at("live-span").value) / BIN);
  const last = paused ? held : end;
  const from = last - count;
  const wide = width - LEFT - 4;
  const across = (number) => LEFT + (wide * (number - from)) / count;
  palette ??= { ink: css("--ink"), soft: css("--soft"), line: css("--line"), ground: css("--code"), lines: colours() };
  const high = (height - 22) / PANELS.length;
  const begin = Math.max(first, from);
  PANELS.forEach((panel, k) => strip(panel, begin, last, across, k * high + 3, high - 6, width));
  // time below all
  pen.fillStyle = palette.soft;
  pen.textAlign = "center";
  const step = count * BIN > 30 ? 10 : count * BIN > 10 ? 5 : 1;
  const start = from * BIN - (zero ?? 0);
  for (let time = Math.ceil(start / step) * step; time <= start + count * BIN; time += step) {
    if (time >= 0) pen.fillText(`${time} s`, across((time + (zero ?? 0)) / BIN), height - 6);
  }
  const under = pointer === null ? null : Math.floor(from + ((pointer - LEFT) / wide) * count);
  const there = under !== null && under >= begin && under < last;
  if (there) {
    pen.fillStyle = palette.ink;
    pen.fillRect(pointer, 0, 1, height - 20);
  }
  read(there ? under : last - 1, there);
  seen.frames++;
}

// One panel: its axis, holds, setpoints, and between the extremes of each group of bins a line.
function strip(panel, begin, last, across, top, high, width) {
  const { ink, soft, line, ground, lines } = palette;
  const columns = panel.columns.map(({ name }) => [`low ${name}`, `high ${name}`, name].map((each) => ROW.indexOf(each)));
  let [low, most] = [Infinity, -Infinity];
  for (const each of columns) for (const c of each) for (let k = begin; c >= 0 && k < last; k++) {
    const own = value(k, c);
    if (own < low) low = own;
    if (own > most) most = own;
  }
  const marks = low <= most ? ticks(low, most) : [];
  const [bottom, above] = marks.length ? [marks[0][0], marks.at(-1)[0]] : [0, 1];
  const up = (own) => top + high - (high * (own - bottom)) / (above - bottom);
  pen.fillStyle = ground;
  const holds = now.live[key];
  holds?.start.forEach((start, k) => {
    const [one, other] = [start, holds.end[k]].map((time) => Math.max(across((time + zero) / BIN), LEFT));
    if (other > LEFT) pen.fillRect(one, top, Math.min(other, width - 4) - one, high);
  });
  pen.lineWidth = 1;
  pen.strokeStyle = line;
  pen.fillStyle = soft;
  pen.textAlign = "right";
  pen.setLineDash([]);
  marks.forEach(([at, text], k) => {
    pen.beginPath();
    pen.moveTo(LEFT, up(at));
    pen.lineTo(width - 4, up(at));
    pen.stroke();
    const few = marks.length <= Math.max(high / 14, 2);
    if (few || k === 0 || k === marks.length - 1) pen.fillText(text, LEFT - 5, Math.min(Math.max(up(at) + 4, top + 8), top + high));
  });
  const group = Math.max(1, Math.round((last - begin) / (width - LEFT)));
  columns.forEach(([lows, highs, asked], n) => {
    if (asked >= 0) trace(soft, [5, 4], (k) => [value(k, asked), value(k, asked)]);
    trace(lines[n], [], (k) => {
      let [least, largest] = [Infinity, -Infinity];
      for (let own = Math.max(k, begin); own < Math.min(k + group, last); own++) {
        if (value(own, lows) < least) least = value(own, lows); // false for a bin without a sample
        if (value(own, highs) > largest) largest = value(own, highs);
      }
      return least <= largest ? [least, largest] : [NaN, NaN];
    });
  });
  function trace(stroke, dash, extremes) {
    pen.beginPath();
    pen.strokeStyle = stroke;
    pen.setLineDash(dash);
    let on = false;
    for (let k = Math.floor(begin / group) * group; k < last; k += group) {
      const [least, largest] = extremes(k);
      if (Number.isNaN(least)) {
        on = false;
        continue;
      }
      const x = across(k + 0.5 * group);
      if (on) pen.lineTo(x, up(least));
      else pen.moveTo(x, up(least));
      if (largest !== least) pen.lineTo(x, up(largest));
      on = true;
    }
    pen.stroke();
    pen.setLineDash([]);
  }
  pen.textAlign = "left";
  pen.fillStyle = ink;
  pen.fillText(panel.title, LEFT + 5, top + 11);
  if (panel.columns.length < 2) return;
  let right = width - 10;
  panel.columns.toReversed().forEach(({ label }, n) => {
    right -= pen.measureText(label).width + 22;
    pen.fillStyle = lines[panel.columns.length - 1 - n];
    pen.fillRect(right, top + 6, 12, 3);
    pen.fillStyle = ink;
    pen.fillText(label, right + 16, top + 11);
  });
}

let told = 0;
let later = 0;
function read(number, pointed) {
  const time = performance.now();
  clearTimeout(later);
  // numbers that change faster cannot be read; the last ones are shown where no more come
  if (!pointed && time - told < 500) return void (later = setTimeout(ask, 500));
  told = time;
  const texts = PANELS.map((panel) => {
    const [title, unit] = panel.title.split(", ");
    const values = panel.columns.map(({ name }) => 0.5 * (value(number, ROW.indexOf(`low ${name}`)) + value(number, ROW.indexOf(`high ${name}`))));
    return `${title} ${values.map((own) => (Number.isFinite(own) ? own.toPrecision(4).replace("-", "−") : "none")).join(", ")} ${unit}`;
  });
  at("live-said").textContent = end ? `${(number * BIN - (zero ?? 0)).toFixed(2)} s: ${texts.join("; ")}` : "";
}
