// The signals of a recording over time: measured, asked for and predicted; zoom, pan, and the sample at the cursor.

import { P, ask, at, colours, complete, css, element, hear, now, put, remember, remembered, say, send, tell, themed } from "./shared.js";

const POINTS = 2000;
const SETTLED = 500; // ms after which the page is there
const MEASURED = JSON.parse(at("plots").dataset.panels);
const NAMES = JSON.parse(at("derive").dataset.names);
// The panels of the recording: what is measured, and derived channels.
const panels = () => [...MEASURED, ...now.state.derived.map(({ name, title }) => ({ title, columns: [{ name, label: name }] }))];

const OTHERS = ["#009E73", "#CC79A7"]; // lines of the recording that is drawn over it
let own = null; // the recording that is shown
let other = ""; // key of the one that is drawn over it, from its start on
let figures = [];
let empty = false; // whether there is nothing to draw
let range = null;
let parts = []; // sources of each panel: lines, setpoints, predicted levels
let marks = null; // windows chosen, events, ranges with a use of their own, the range that is being marked
let pulls = []; // of each panel: what a drag does, pan or mark
let marking = false;
let marked = ""; // of what the marks are
let chosen = {}; // spans of the windows chosen, by recording
let cursors = [];
let cursor = null; // s
let zooming = 0;
let drawing = null;

export const shown = () => own;
export const span = () => (range ? [range.start, range.end] : null);

export async function showSignals() {
  const signals = now.state.signals;
  if (own) own = signals.find((each) => each.key === own.key) ?? null;
  const names = JSON.stringify(signals.map(({ key, name }) => [key, name]));
  if (at("tabs").dataset.shown !== names) {
    at("tabs").dataset.shown = names;
    at("tabs").replaceChildren(
      ...signals.map((each) => {
        const tab = element("button", each.name, { type: "button" });
        tab.dataset.signal = each.key;
        tab.onclick = () => choose(each.key);
        return tab;
      }),
    );
  }
  press();
  showOthers();
  showRanges();
  await showDerived();
  at("readout").hidden = at("keys").hidden = at("range-mark").hidden = at("derive-show").hidden = !signals.length;
  if (!signals.length) at("derive-form").hidden = true;
  if (!signals.length && now.state.job?.title.startsWith("opening ")) {
    if (!figures.length) draw(); // while a recording is read: its lines are to come soon
    at("span").textContent = "";
  } else if (!signals.length) {
    if (!empty) blank();
    cursor = null;
    at("span").textContent = "Open a recording on the left.";
  } else if (!own) {
    const [key, from, until] = remembered("view") ?? [];
    if (signals.some((each) => each.key === key)) await choose(key, from, until);
    else await choose(signals[0].key);
  }
}

// Makes the figures before there is anything to draw, once the rest of the page is there: the first recording is then shown sooner.
function blank() {
  put("plots", null);
  figures = [];
  empty = true;
  setTimeout(() => empty && !figures.length && draw(), SETTLED);
}

// The other open recordings, one of which can be drawn over the one that is shown.
function showOthers() {
  const signals = now.state.signals.filter(({ key }) => key !== own?.key);
  if (!signals.some(({ key }) => key === other)) other = "";
  at("over-line").hidden = !signals.length || !own;
  const names = JSON.stringify(signals.map(({ key, name }) => [key, name]));
  if (at("over").dataset.shown !== names) {
    at("over").dataset.shown = names; // a list that is open is not written again
    at("over").replaceChildren(element("option", "none", { value: "" }), ...signals.map(({ key, name }) => element("option", name, { value: key })));
  }
  at("over").value = other;
}
at("over").addEventListener("change", () => {
  other = at("over").value;
  if (range) zoom(range.start, range.end);
});

function press() {
  for (const tab of at("tabs").children) tab.setAttribute("aria-pressed", String(own && tab.dataset.signal === own.key));
}

export async function choose(key, from, until) {
  const wanted = now.state.signals.find((each) => each.key === key);
  if (!wanted) return;
  if (own && own.key !== key) {
    putCursor(null);
    putRange(null, null);
  }
  own = wanted;
  empty = false;
  if (!figures.length) draw();
  press();
  showOthers();
  showRanges();
  showFound();
  await zoom(from ?? 0, until ?? own.duration);
  say("shown", own.key);
}

function draw() {
  marked = "";
  range = new Bokeh.Range1d({ start: 0, end: 1 });
  parts = [];
  cursors = [];
  pulls = [];
  const spans = () => new Bokeh.ColumnDataSource({ data: { x0: [], x1: [] } });
  marks = { windows: spans(), events: spans(), predict: spans(), out: spans(), range: spans() };
  const [ink, soft] = [css("--ink"), css("--soft")];
  const all = panels();
  figures = all.map((panel, k) => {
    const last = k === all.length - 1;
    const figure = P.figure({
      height: last ? 90 : 60, min_height: last ? 84 : 36, sizing_mode: "stretch_both", x_range: range, tools: "xpan,xwheel_zoom,xbox_zoom",
      active_scroll: "xwheel_zoom", toolbar_location: null, output_backend: "canvas",
      styles: last ? { "flex-grow": "1.4" } : {}, // it has the axis, too
    });
    figure.add_layout(new Bokeh.Label({
      x: 4, y: 1, x_units: "screen", y_units: "screen", anchor: "bottom_left", text: panel.title, text_font_size: "10px",
      text_color: ink, background_fill_color: css("--card"), background_fill_alpha: 0.75,
    }));
    figure.left[0].ticker.desired_num_ticks = 3;
    figure.below[0].visible = last;
    if (last) figure.below[0].axis_label = "time, s";
    figure.min_border_left = 48;
    figure.min_border_top = 3;
    figure.min_border_bottom = 3;
    const strip = (source, options) => figure.vstrip({ field: "x0" }, { field: "x1" }, { source, line_color: null, ...options });
    strip(marks.predict, { fill_color: "#009E73", fill_alpha: 0.16 });
    strip(marks.out, { fill_color: soft, fill_alpha: 0.14, hatch_pattern: "/", hatch_color: soft, hatch_alpha: 0.5, hatch_scale: 10 });
    strip(marks.range, { fill_color: css("--accent"), fill_alpha: 0.12, line_color: css("--accent"), line_width: 2 });
    const drag = new Bokeh.BoxSelectTool({ dimensions: "width", renderers: [] });
    figure.add_tools(drag);
    figure.on_event("selectiongeometry", ({ geometry }) => {
      if (geometry.type === "rect") putRange(...[geometry.x0, geometry.x1].map((time) => Math.min(Math.max(time, 0), own.duration)));
    });
    pulls.push({ pan: figure.toolbar.tools.find((tool) => tool.type === "PanTool"), drag });
    figure.vstrip({ field: "x0" }, { field: "x1" }, { source: marks.windows, fill_color: "#E69F00", fill_alpha: 0.22, line_color: null });
    figure.vstrip({ field: "x0" }, { field: "x1" }, {
      source: marks.events, fill_color: "#CC79A7", fill_alpha: 0.35, line_color: "#CC79A7", line_width: 2,
    });
    const nothing = (names) => new Bokeh.ColumnDataSource({ data: Object.fromEntries(names.map((name) => [name, []])) });
    const names = panel.columns.map((each) => each.name);
    const part = { names, lines: nothing(["t", ...names]), others: nothing(["t", ...names]), setpoints: nothing(["t", ...names]), levels: nothing(["x0", "x1", "y"]) };
    parts.push(part);
    panel.columns.forEach(({ name, label }, c) => {
      const several = panel.columns.length > 1 ? { legend_label: label } : {};
      figure.line({ field: "t" }, { field: name }, { source: part.lines, line_color: colours()[c], line_width: 1.2, ...several });
      figure.line({ field: "t" }, { field: name }, { source: part.others, line_color: OTHERS[c], line_width: 1 });
      figure.line({ field: "t" }, { field: name }, { source: part.setpoints, line_color: soft, line_width: 1.2, line_dash: "dashed" });
    });
    figure.segment({ field: "x0" }, { field: "y" }, { field: "x1" }, { field: "y" }, { source: part.levels, line_color: ink, line_width: 2.5 });
    const line = new Bokeh.Span({ dimension: "height", location: 0, line_color: ink, line_width: 1, line_dash: "dotted", visible: false });
    figure.add_layout(line);
    cursors.push(line);
    figure.on_event("mousemove", (event) => {
      at("readout").setAttribute("aria-live", "off");
      if (own && Number.isFinite(event.x)) putCursor(event.x);
    });
    return figure;
  });
  for (const figure of figures) {
    const legend = figure.center.find((each) => each.type === "Legend");
    themed(figure);
    if (!legend) continue;
    legend.setv({
      location: "top_right", orientation: "horizontal", padding: 0, margin: 6, label_height: 11, glyph_height: 11,
      label_text_font_size: "11px", background_fill_alpha: 0.75,
    });
  }
  mark(marking);
  showRanges();
  // one layout, as figures that share a span or a source must belong together
  put("plots", new Bokeh.Column({ children: figures, sizing_mode: "stretch_both", spacing: 0 }));
  // asked again when the span has stood still for a moment, so that a turned wheel asks once
  const moved = () => {
    clearTimeout(zooming);
    zooming = setTimeout(() => zoom(range.start, range.end), 60);
  };
  range.properties.start.change.connect(moved);
  range.properties.end.change.connect(moved);
}

// A span within the recording, of ten samples or more.
function within(from, until) {
  const least = Math.min((10 * own.duration) / Math.max(own.samples - 1, 1), own.duration);
  const length = Math.min(Math.max(until - from, least), own.duration);
  if (length === until - from && from >= 0 && until <= own.duration) return [from, until];
  const begin = Math.min(Math.max(0.5 * (from + until - length), 0), own.duration - length);
  return [begin, begin + length];
}

export async function zoom(first, last) {
  clearTimeout(zooming);
  if (!own) return;
  const [from, until] = within(first, last);
  range.setv({ start: from, end: until });
  clearTimeout(zooming);
  remember("view", [own.key, from, until]);
  await fetchSpan(from, until);
}

// One block of the answer: times, and a column for each name.
function block(buffer, place, names) {
  const [count] = new Float64Array(buffer, place, 1);
  const t = new Float64Array(buffer, place + 8, count);
  place += 8 * (1 + count);
  const data = {};
  if (count || names.length) {
    for (const name of names) {
      data[name] = count ? new Float32Array(buffer, place, count) : [];
      place += 4 * count;
    }
  }
  return [{ t, ...data }, place + ((8 - (place % 8)) % 8)];
}

async function fetchSpan(from, until) {
  const began = performance.now();
  drawing?.abort();
  drawing = new AbortController();
  const { signal } = drawing;
  const samples = async (key) => (await ask(`/signal?${new URLSearchParams({ key, from, until, points: POINTS })}`, { signal })).arrayBuffer();
  let buffers;
  try {
    buffers = await Promise.all([own.key, ...(other ? [other] : [])].map(samples));
  } catch {
    return; // another span was asked for meanwhile, or the recording was closed
  }
  const [buffer, over] = buffers;
  const every = panels().flatMap((panel) => panel.columns.map((each) => each.name));
  const others = over ? block(over, 0, every)[0] : null;
  const [lines, place] = block(buffer, 0, every);
  const [setpoints] = block(buffer, place, ["tilt_x", "tilt_y", "spin_rate"]);
  for (const part of parts) {
    const pick = (data) => Object.fromEntries(["t", ...part.names].map((name) => [name, data[name]]));
    part.lines.data = pick(lines);
    part.others.data = others ? pick(others) : Object.fromEntries(["t", ...part.names].map((name) => [name, []]));
    if (part.names.every((name) => name in setpoints)) part.setpoints.data = pick(setpoints);
  }
  const count = lines.t.length;
  at("span").textContent =
    `${from.toFixed(3)} to ${until.toFixed(3)} s, ` +
    (count < POINTS ? `${count} samples, every one.` : "extremes of each interval: no spike is lost.");
  at("plots").dataset.drawn = `${from},${until},${count}`;
  at("plots").dataset.milliseconds = (performance.now() - began).toFixed(1);
}

// --- what was found, on top of the samples

export function showFound() {
  if (!figures.length || !own || marked === `${own.key} ${now.found?.facts}`) return;
  marked = `${own.key} ${now.found?.facts}`;
  const holds = now.found?.holds[own.key];
  for (const part of parts) {
    const levels = { x0: [], x1: [], y: [] };
    for (const name of part.names) {
      if (!holds?.levels[name]) continue;
      levels.x0.push(...holds.start);
      levels.x1.push(...holds.end);
      levels.y.push(...holds.levels[name].predicted);
    }
    part.levels.data = levels;
  }
  const events = now.found?.events[own.key] ?? [];
  marks.events.data = { x0: events.map((each) => each.time), x1: events.map((each) => each.end) };
  at("events").replaceChildren(
    ...events.slice(0, 20).map((each) => {
      const line = element("li");
      const go = element("button", `${each.time.toFixed(2)} s`, { type: "button", className: "plain" });
      const reach = Math.max(2 * (each.end - each.time), 1);
      go.onclick = () => zoom(each.time - reach, each.end + reach);
      line.append(go, ` ${each.said}`);
      return line;
    }),
  );
  at("drawn").textContent =
    "Dashed: setpoints of the plan." + (holds ? " Thick: what the model predicts for each hold." : "") +
    " Green and pink: the recording drawn over it, both from their starts." +
    " Shaded: the chosen windows; green: only predicted; hatched: left out.";
}

function showChosen() {
  const spans = chosen[own?.key] ?? [];
  if (marks) marks.windows.data = { x0: spans.map(([start]) => start), x1: spans.map(([, end]) => end) };
}
hear("windows", (spans) => {
  chosen = spans;
  showChosen();
});
hear("shown", showChosen);

// --- ranges of the recording, and their uses

function showRanges() {
  const uses = own?.uses ?? [];
  const text = JSON.stringify(uses);
  if (at("range").dataset.uses !== text) putRange(null, null); // it has its use now
  at("range").dataset.uses = text;
  at("range-key").value = at("range-all").dataset.key = own?.key ?? "";
  at("range-all").hidden = uses.length < 2;
  for (const button of at("range").querySelectorAll("[name=use], [data-do]")) button.disabled = Boolean(now.state.job);
  if (!marks) return;
  // where all of it is only predicted, no range stands out
  for (const [name, use] of [["predict", "not used to fit"], ["out", "left out"]]) {
    const some = uses.filter((each) => each.use === use && (uses.length > 1 || use === "left out"));
    marks[name].data = { x0: some.map((each) => each.from), x1: some.map((each) => each.until) };
  }
}

const typedRange = () => ["range-from", "range-until"].map((id) => (at(id).value === "" ? null : Number(at(id).value)));

// Shows a range that has no use of its own yet; null where an end is missing.
function putRange(from, until, typed = false) {
  if (!typed) {
    at("range-from").value = from === null ? "" : from.toFixed(3);
    at("range-until").value = until === null ? "" : until.toFixed(3);
  }
  const given = [from, until].filter((time) => time !== null);
  at("range").hidden = !own || !(marking || given.length);
  if (marks) marks.range.data = given.length ? { x0: [Math.min(...given)], x1: [Math.max(...given)] } : { x0: [], x1: [] };
}

function mark(on) {
  marking = on;
  at("range-mark").setAttribute("aria-pressed", String(on));
  putRange(...typedRange(), true);
  for (const { pan, drag } of pulls) {
    drag.active = on;
    pan.active = !on;
  }
}

at("range-mark").addEventListener("click", () => mark(!marking));
at("range").addEventListener("submit", () => putRange(...typedRange().sort((one, other) => one - other))); // in either order
at("range").addEventListener("input", () => putRange(...typedRange(), true));

// --- derived channels

let derived = "[]"; // as they were drawn
async function showDerived() {
  const text = JSON.stringify(now.state.derived);
  if (text === derived) return;
  derived = text;
  at("derived").replaceChildren(...now.state.derived.map(({ name, title }) => {
    const button = element("button", `Remove ${title}`, { type: "button", className: "plain" });
    Object.assign(button.dataset, { do: "underive", text: name });
    return button;
  }));
  if (figures.length) await redraw();
}

at("derive-show").addEventListener("click", () => {
  const hidden = at("derive-form").toggleAttribute("hidden");
  at("derive-show").setAttribute("aria-expanded", String(!hidden));
  if (!hidden) at("derive").focus();
});
let typing = 0;
at("derive").addEventListener("input", () => {
  clearTimeout(typing);
  typing = setTimeout(checkDerived, 250);
  complete(at("derive"), at("derive-names"), NAMES);
});

async function checkDerived() {
  const text = at("derive").value;
  tell("derive", "");
  at("derive-said").textContent = "";
  at("derive-add").disabled = true;
  if (!text.trim()) return;
  try {
    const read = await send("derived", { text });
    if (text !== at("derive").value) return;
    if (read.refused) return tell("derive", read.refused);
    at("derive-said").textContent = `unit: ${read.unit}`;
    at("derive-add").disabled = false;
  } catch (error) {
    tell("derive", error.message);
  }
}

// --- the cursor

let asking = false;
let asked = null;
export async function putCursor(time) {
  cursor = time;
  for (const line of cursors) line.setv(time === null ? { visible: false } : { location: time, visible: true });
  if (time === null) {
    at("readout").textContent = "Point at a signal, or press , and . to step through the samples.";
    return;
  }
  asked = time;
  if (asking) return;
  asking = true;
  try {
    while (asked !== null) {
      const time = asked;
      asked = null;
      const found = await (await ask(`/sample?${new URLSearchParams({ key: own.key, time })}`)).json();
      read(found);
      say("cursor", { key: own.key, time, ...found });
    }
  } catch {
    // the recording was closed
  } finally {
    asking = false;
  }
}

function read(found) {
  let k = 0;
  const texts = panels().map((panel) => {
    const values = panel.columns.map(() => found.values[k++] ?? null);
    const [title, unit] = panel.title.split(/, (?=[^,]*$)/);
    return `${title} ${values.map((value) => (value === null ? "none" : value.toPrecision(5))).join(", ")} ${unit}`;
  });
  at("readout").textContent = `sample ${found.sample} at ${found.time.toFixed(4)} s: ${texts.join("; ")}`;
}

// Keys without Ctrl or Alt are for the picture in focus alone: elsewhere who speaks to the computer would press them.
at("plots").addEventListener("pointerdown", () => at("plots").focus({ preventScroll: true }));
at("plots").addEventListener("keydown", (event) => {
  if (!range || !own || event.ctrlKey || event.metaKey || event.altKey) return;
  const length = range.end - range.start;
  const middle = 0.5 * (range.end + range.start);
  const moves = {
    ArrowLeft: [range.start - 0.25 * length, range.end - 0.25 * length],
    ArrowRight: [range.start + 0.25 * length, range.end + 0.25 * length],
    "+": [middle - 0.25 * length, middle + 0.25 * length],
    "-": [middle - length, middle + length],
    0: [0, own.duration],
  };
  const steps = { ",": -1, ".": 1 };
  const time = cursor ?? middle;
  const [from, until] = typedRange();
  const ranges = { m: () => mark(!marking), "[": () => putRange(time, until), "]": () => putRange(from, time), Escape: () => putRange(null, null) };
  if (event.key in ranges) {
    event.preventDefault();
    ranges[event.key]();
  } else if (event.key in moves) {
    event.preventDefault();
    zoom(...moves[event.key]);
  } else if (event.key in steps) {
    event.preventDefault();
    at("readout").setAttribute("aria-live", "polite"); // who uses the keys may listen
    const step = own.duration / Math.max(own.samples - 1, 1);
    putCursor(Math.min(Math.max((cursor ?? middle) + step * steps[event.key], 0), own.duration));
  }
});

export async function redraw() {
  const before = span();
  if (!own) return void (empty && blank());
  figures = [];
  await choose(own.key, ...(before ?? []));
  if (cursor !== null) putCursor(cursor); // on the new picture
}
