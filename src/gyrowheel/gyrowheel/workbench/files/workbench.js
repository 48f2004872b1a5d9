// The page of the workbench: shows the state of the server, and sends what the user asks for.
// All words and tables come from the server, which escapes them; only the pictures are made here.

const P = Bokeh.Plotting;
const at = (id) => document.getElementById(id);
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const COLOURS = ["#0072B2", "#D55E00"]; // blue and vermilion, which people with any colour vision distinguish
const SIGHT = ["#56B4E9", "#E69F00"]; // the same on dark ground
const POINTS = 2000;
const NOISE = 9; // χ²/N of a window up to which it may be noise

let state = null;
let shown = {}; // parts as they were written last
let signal = null; // the recording whose signals are drawn
let figures = [];

// --- talking with the server

async function ask(path) {
  const answer = await fetch(path);
  if (answer.status === 401) location.reload();
  if (!answer.ok) throw new Error((await answer.json()).error);
  return answer;
}

async function send(name, content) {
  const answer = await fetch(`/do/${name}`, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(content),
  });
  const result = await answer.json();
  if (!answer.ok) throw new Error(result.error);
  return result;
}

function tell(place, sentence) {
  const field = document.querySelector(`[data-trouble="${place}"]`);
  if (field) field.textContent = sentence;
}

let reading = false;
let again = false;
async function refresh() {
  if (reading) {
    again = true;
    return;
  }
  reading = true;
  try {
    do {
      again = false;
      state = await (await ask("/state")).json();
      await show();
    } while (again);
  } catch (error) {
    console.warn(error.message);
  } finally {
    reading = false;
  }
}

function listen() {
  const events = new EventSource("/events");
  events.onmessage = () => {
    at("lost").hidden = true;
    refresh();
  };
  events.onerror = () => {
    at("lost").hidden = false; // the browser tries again by itself
    if (events.readyState === EventSource.CLOSED) setTimeout(listen, 2000);
  };
}

// --- words and tables

async function show() {
  for (const [name, html] of Object.entries(state.parts)) {
    if (shown[name] === html) continue;
    const place = at(`part-${name}`);
    const focus = place.contains(document.activeElement) ? mark(document.activeElement) : null;
    const open = [...place.querySelectorAll("details")].map((d) => d.open);
    place.innerHTML = html;
    place.querySelectorAll("details").forEach((d, k) => (d.open = open[k] ?? d.open));
    if (focus) place.querySelector(focus)?.focus();
    shown[name] = html;
  }
  for (const field of document.querySelectorAll("[data-trouble]")) {
    const own = state.trouble && state.trouble.place === field.dataset.trouble;
    if (own) field.textContent = state.trouble.sentence;
    else if (!state.trouble && state.job) field.textContent = "";
  }
  showJob();
  await showSignals();
  showWhere();
  showFall();
}

function mark(element) {
  const data = Object.entries(element.dataset).map(([key, value]) => `[data-${key}="${CSS.escape(value)}"]`);
  return element.id ? `#${element.id}` : element.tagName.toLowerCase() + data.join("");
}

function showJob() {
  const place = at("job");
  if (!state.job) {
    place.replaceChildren();
    return;
  }
  const turning = document.createElement("span");
  turning.className = "turning";
  const text = document.createElement("span");
  text.textContent = state.job.line ? `${state.job.title}: ${state.job.line}` : state.job.title;
  const end = document.createElement("button");
  end.textContent = "End";
  end.dataset.do = "end";
  place.replaceChildren(turning, text, end);
}

document.addEventListener("click", async (event) => {
  const button = event.target.closest("button[data-do]");
  if (!button) return;
  const { do: name, ...content } = button.dataset;
  const place = { open: "recordings", close: "recordings", undo: "model" }[name] ?? "missing";
  try {
    tell(place, "");
    await send(name, content);
  } catch (error) {
    tell(place, error.message);
  }
});

document.addEventListener("submit", async (event) => {
  const form = event.target.closest("form[data-do]");
  if (!form) return;
  event.preventDefault();
  const place = form.dataset.do === "save" ? "save" : "formula";
  try {
    tell(place, "");
    await send(form.dataset.do, Object.fromEntries(new FormData(form)));
  } catch (error) {
    tell(place, error.message);
  }
});

let typing = 0;
at("formula").addEventListener("input", () => {
  clearTimeout(typing);
  typing = setTimeout(checkFormula, 250);
});

async function checkFormula() {
  const text = at("formula").value;
  const said = at("formula-said");
  const add = at("formula-form").querySelector("button");
  said.textContent = "";
  tell("formula", "");
  add.disabled = true;
  if (!text.trim()) return;
  try {
    const read = await send("formula", { text });
    if (text !== at("formula").value) return;
    if (read.refused) return tell("formula", read.refused);
    said.textContent = `${read.name}: ${read.law}; to be fitted: ${read.coefficients.join(", ") || "nothing"}`;
    add.disabled = false;
  } catch (error) {
    tell("formula", error.message);
  }
}

// --- pictures

function themed(figure) {
  const css = getComputedStyle(document.documentElement);
  const [card, ink, soft, line] = ["--card", "--ink", "--soft", "--line"].map((n) => css.getPropertyValue(n).trim());
  figure.background_fill_color = card;
  figure.border_fill_color = card;
  figure.outline_line_color = line;
  for (const axis of [...figure.left, ...figure.below]) {
    if (!("axis_label_text_color" in axis)) continue;
    axis.axis_label_text_color = ink;
    axis.major_label_text_color = soft;
    axis.axis_line_color = line;
    axis.major_tick_line_color = line;
    axis.minor_tick_line_color = null;
    axis.axis_label_text_font_style = "normal";
  }
  for (const grid of figure.center) {
    if ("grid_line_color" in grid) grid.grid_line_color = line;
    if ("label_text_color" in grid) {
      grid.label_text_color = ink;
      grid.background_fill_color = card;
      grid.border_line_color = null;
    }
  }
  figure.title.text_color = ink;
  figure.toolbar.logo = null;
  return figure;
}

// Shows a layout in a place, and forgets the one that was there.
const drawn = {};
function put(place, layout) {
  const old = drawn[place];
  if (old) {
    old.clear();
    Bokeh.documents.splice(Bokeh.documents.indexOf(old), 1);
    delete drawn[place];
  }
  at(place).replaceChildren();
  if (!layout) return;
  P.show(layout, `#${place}`);
  drawn[place] = Bokeh.documents.at(-1);
}

function colours() {
  return dark.matches ? SIGHT : COLOURS;
}

async function showSignals() {
  const keys = state.signals.map((own) => own.key);
  if (signal && !keys.includes(signal.key)) signal = null;
  const tabs = at("tabs");
  tabs.replaceChildren(
    ...state.signals.map((own) => {
      const tab = document.createElement("button");
      tab.textContent = own.name;
      tab.setAttribute("aria-pressed", String(signal ? own.key === signal.key : own === state.signals[0]));
      tab.onclick = () => chooseSignal(own.key);
      return tab;
    }),
  );
  if (!keys.length) {
    put("plots", null);
    figures = [];
    at("span").textContent = "Open a recording on the left.";
  } else if (!signal) await chooseSignal(keys[0]);
}

async function chooseSignal(key, from, until) {
  const own = state.signals.find((each) => each.key === key);
  if (!own) return;
  signal = own;
  if (!figures.length) drawPanels();
  for (const tab of at("tabs").children) tab.setAttribute("aria-pressed", String(tab.textContent === own.name));
  await zoom(from ?? 0, until ?? own.duration);
}

let range = null;
let sources = [];
let boxes = [];
let zooming = 0;
let drawing = null;

function drawPanels() {
  const panels = JSON.parse(at("plots").dataset.panels);
  range = new Bokeh.Range1d({ start: 0, end: 1 });
  sources = [];
  boxes = [];
  figures = panels.map((panel, k) => {
    const last = k === panels.length - 1;
    const figure = P.figure({
      height: last ? 175 : 140,
      sizing_mode: "stretch_width",
      x_range: range,
      tools: "xpan,xwheel_zoom,xbox_zoom,crosshair",
      active_scroll: "xwheel_zoom",
      toolbar_location: null,
      output_backend: "canvas",
    });
    figure.left[0].axis_label = panel.title;
    figure.below[0].visible = last;
    if (last) figure.below[0].axis_label = "time, s";
    figure.min_border_left = 72;
    const source = new Bokeh.ColumnDataSource({ data: { t: [0, 1], ...Object.fromEntries(panel.columns.map((_, c) => [`v${c}`, [0, 0]])) } });
    sources.push(source);
    panel.columns.forEach((label, c) => {
      figure.line({ field: "t" }, { field: `v${c}` }, {
        source, line_color: colours()[c], line_width: 1.2, ...(panel.columns.length > 1 ? { legend_label: label } : {}),
      });
    });
    const box = new Bokeh.BoxAnnotation({ fill_color: "#E69F00", fill_alpha: 0.22, left: 0, right: 0, visible: false });
    figure.add_layout(box);
    boxes.push(box);
    return figure;
  });
  for (const figure of figures) {
    const legend = figure.center.find((each) => each.type === "Legend");
    legend?.setv({ location: "top_right", orientation: "horizontal" });
    themed(figure);
  }
  // one layout, as figures that share a span or a source must belong together
  put("plots", new Bokeh.Column({ children: figures, sizing_mode: "stretch_width", spacing: 0 }));
  // asked anew when the span has stood still for a moment, so that a turned wheel asks once
  const moved = () => {
    clearTimeout(zooming);
    zooming = setTimeout(() => fetchSpan(range.start, range.end), 60);
  };
  range.properties.start.change.connect(moved);
  range.properties.end.change.connect(moved);
}

async function zoom(from, until) {
  clearTimeout(zooming);
  range.setv({ start: from, end: until });
  clearTimeout(zooming);
  await fetchSpan(from, until);
}

async function fetchSpan(from, until) {
  const began = performance.now();
  const key = signal.key;
  drawing?.abort();
  drawing = new AbortController();
  const query = new URLSearchParams({ key, from, until, points: POINTS });
  let buffer;
  try {
    const answer = await fetch(`/signal?${query}`, { signal: drawing.signal });
    if (!answer.ok) return;
    buffer = await answer.arrayBuffer();
  } catch {
    return; // another span was asked for meanwhile
  }
  const [count] = new Float64Array(buffer, 0, 1);
  const t = new Float64Array(buffer, 8, count);
  let place = 8 * (1 + count);
  for (const source of sources) {
    const data = { t };
    for (const name of Object.keys(source.data).filter((each) => each !== "t")) {
      data[name] = new Float32Array(buffer, place, count);
      place += 4 * count;
    }
    source.data = data;
  }
  const raw = count < POINTS;
  at("span").textContent =
    `${signal.name}, ${from.toFixed(3)} to ${until.toFixed(3)} s: ` +
    (raw ? `${count} samples, every one` : "smallest and largest value of every stretch, so that no spike is lost") +
    ". Wheel: zoom; drag: pan; keys ← → + − 0.";
  at("plots").dataset.drawn = `${from},${until},${count}`;
  at("plots").dataset.milliseconds = (performance.now() - began).toFixed(1);
}

document.addEventListener("keydown", (event) => {
  if (!range || !signal || event.target.closest("input, textarea, select")) return;
  const span = range.end - range.start;
  const middle = 0.5 * (range.end + range.start);
  const moves = {
    ArrowLeft: [range.start - 0.25 * span, range.end - 0.25 * span],
    ArrowRight: [range.start + 0.25 * span, range.end + 0.25 * span],
    "+": [middle - 0.25 * span, middle + 0.25 * span],
    "-": [middle - span, middle + span],
    0: [0, signal.duration],
  };
  if (!(event.key in moves) || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  zoom(...moves[event.key]);
});

let drawnWindows = "";
function showWhere() {
  const w = state.windows;
  const text = JSON.stringify(w);
  if (text === drawnWindows) return;
  drawnWindows = text;
  put("where", null);
  at("chosen").replaceChildren();
  at("where-help").textContent = w
    ? "Each point is a window of steady motion, each line the residual torque of the coils from the tilt at which it acts. " +
      "Click a point, or draw a box: its samples are shown above, its numbers below."
    : "Compare and diagnose first.";
  if (!w) return;
  const tilt = w.chi2.tilt.values;
  const size = Math.max(...w.residual_x.map((x, k) => Math.hypot(x, w.residual_y[k])), 1e-12);
  const reach = 1.2 * Math.max(...w.tilt_x.map((x, k) => Math.hypot(x, w.tilt_y[k])), 0.5);
  // what is noise alone is drawn short
  const scale = ((Math.max(...tilt) > NOISE ? 0.3 : 0.08) * reach) / size;
  const shade = (value) => {
    const part = Math.min(Math.max(Math.log10(Math.max(value, 1)) / 3, 0), 1);
    return dark.matches ? `hsl(${45 - 40 * part} 90% ${45 + 20 * part}%)` : `hsl(${40 - 35 * part} 90% ${80 - 45 * part}%)`;
  };
  const source = new Bokeh.ColumnDataSource({
    data: {
      x: w.tilt_x, y: w.tilt_y, speed: w.speed, time: w.start, chi2: tilt.map((v) => Math.max(v, 0.05)),
      x1: w.tilt_x.map((x, k) => x + scale * w.residual_x[k]), y1: w.tilt_y.map((y, k) => y + scale * w.residual_y[k]),
      colour: tilt.map(shade),
    },
  });
  const mark = { source, size: 9, fill_color: { field: "colour" }, line_color: "#777777", nonselection_alpha: 0.25 };
  const plane = P.figure({
    width: 430, height: 430, title: "tilt plane, colour: χ²/N of the tilt (1: noise)", tools: "tap,box_select,pan,wheel_zoom,reset",
    toolbar_location: "right", match_aspect: true,
  });
  plane.below[0].axis_label = "tilt about x, °";
  plane.left[0].axis_label = "tilt about y, °";
  plane.segment({ field: "x" }, { field: "y" }, { field: "x1" }, { field: "y1" }, { source, line_color: "#888888", line_width: 1.5 });
  plane.scatter({ field: "x" }, { field: "y" }, mark);
  const speed = P.figure({
    width: 430, height: 430, title: "χ²/N of the tilt over the spin rate", tools: "tap,box_select,pan,wheel_zoom,reset",
    toolbar_location: "right", y_axis_type: "log",
  });
  speed.below[0].axis_label = "spin rate, rpm";
  speed.left[0].axis_label = "χ²/N";
  speed.scatter({ field: "speed" }, { field: "chi2" }, mark);
  put("where", new Bokeh.Row({ children: [themed(plane), themed(speed)], spacing: 16 }));
  source.selected.properties.indices.change.connect(() => chooseWindows([...source.selected.indices]));
}

async function chooseWindows(indices) {
  const w = state.windows;
  const place = at("chosen");
  place.replaceChildren();
  for (const box of boxes) box.visible = false;
  if (!w || !indices.length) return;
  const worst = indices.reduce((a, b) => (w.chi2.tilt.values[b] > w.chi2.tilt.values[a] ? b : a));
  const key = w.recording[worst];
  const start = Math.min(...indices.filter((k) => w.recording[k] === key).map((k) => w.start[k]));
  const end = Math.max(...indices.filter((k) => w.recording[k] === key).map((k) => w.start[k] + w.duration[k]));
  const table = document.createElement("table");
  const row = (cells, tag) => {
    const line = table.insertRow();
    for (const text of cells) {
      const cell = document.createElement(tag);
      cell.textContent = text;
      cell.className = "figure";
      line.append(cell);
    }
  };
  const kinds = Object.values(w.chi2);
  row(["time, s", "tilt x, °", "tilt y, °", "rpm", `residual x, ${w.unit}`, `residual y, ${w.unit}`, ...kinds.map((c) => `χ²/N ${c.title}`)], "th");
  for (const k of [...indices].sort((a, b) => w.chi2.tilt.values[b] - w.chi2.tilt.values[a]).slice(0, 12)) {
    row([w.start[k].toFixed(2), w.tilt_x[k].toFixed(2), w.tilt_y[k].toFixed(2), w.speed[k].toFixed(0), w.residual_x[k].toFixed(3),
      w.residual_y[k].toFixed(3), ...kinds.map((c) => c.values[k].toFixed(1))], "td");
  }
  const said = document.createElement("p");
  said.textContent = `${indices.length} of ${w.start.length} windows chosen` + (indices.length > 12 ? "; the worst twelve:" : ":");
  const frame = document.createElement("div");
  frame.className = "scroll";
  frame.append(table);
  place.append(said, frame);
  const margin = 0.25 * (end - start) + 0.1;
  await chooseSignal(key, start - margin, end + margin);
  for (const box of boxes) box.setv({ left: start, right: end, visible: true });
}

let drawnFall = "";
function showFall() {
  const text = JSON.stringify(state.fall);
  if (text === drawnFall) return;
  drawnFall = text;
  put("fall", null);
  if (!state.fall.length) return;
  const names = state.fall.map((own) => own.what);
  const figure = P.figure({
    height: 260, sizing_mode: "stretch_width", x_range: new Bokeh.FactorRange({ factors: names }), y_axis_type: "log", tools: "",
    toolbar_location: null, title: "χ²/N with every change; 1 is the noise floor",
  });
  const [one, other] = colours();
  for (const [field, label, colour] of [["fitted", "fitted", one], ["unused", "not used to fit", other]]) {
    const rows = state.fall.filter((own) => own[field] !== null);
    if (!rows.length) continue;
    const source = new Bokeh.ColumnDataSource({ data: { x: rows.map((own) => own.what), y: rows.map((own) => own[field]) } });
    figure.line({ field: "x" }, { field: "y" }, { source, line_color: colour, line_width: 2, legend_label: label });
    figure.scatter({ field: "x" }, { field: "y" }, { source, size: 9, fill_color: colour, line_color: null, legend_label: label });
  }
  figure.add_layout(new Bokeh.Span({ location: 1, dimension: "width", line_color: "#888888", line_width: 2, line_dash: "dashed" }));
  put("fall", themed(figure));
}

dark.addEventListener("change", () => {
  drawnWindows = drawnFall = "";
  const [from, until] = range ? [range.start, range.end] : [];
  figures = [];
  if (signal) chooseSignal(signal.key, from, until);
  showWhere();
  showFall();
});

listen();
