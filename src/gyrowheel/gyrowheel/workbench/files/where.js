// Where the model fails: windows in the tilt plane and over a variable, every channel over every variable, linked.

import { P, arrange, at, css, dark, element, fixed, hear, legible, now, put } from "./shared.js";
import { leftBy, makeSides, ofSide } from "./sides.js";
import { channel, current, link, pick, setChannel, walk, windows } from "./windows.js";

const WORST = 1000; // χ²/N at the end of the colours
let drawn = null; // windows and maps, as they were drawn
let seen = null;
let variable = ""; // of the right picture, or "map" and what it acts on: the missing torque as a map
let speed = 0; // number of the speed of that
let rings = []; // around the window at the cursor, one in each side: source, side, χ²/N
const sides = makeSides("where", () => plane(windows()));

// White for noise, on to red; on dark ground from dark to bright.
function shade(value) {
  const part = Math.min(Math.max(Math.log10(Math.max(value, 1)) / Math.log10(WORST), 0), 1);
  return dark.matches ? `hsl(${48 - 40 * part} ${25 + 65 * part}% ${18 + 47 * part}%)` : `hsl(${40 - 35 * part} 90% ${97 - 55 * part}%)`;
}
const short = (value) => (value >= 9.95 ? value.toFixed(0) : value.toFixed(1));

export function showWhere(again = false) {
  if (now.found === seen && !again) return;
  seen = now.found;
  const w = windows();
  const text = JSON.stringify([w, now.found?.maps, now.found?.variables, now.found?.torque_maps]);
  if (text === drawn && !again) return;
  if (w && text !== drawn && (w.fails || !(variable in w.over))) variable = w.variable;
  drawn = text;
  put("where", null);
  at("where").tabIndex = w ? 0 : -1;
  at("where-line").hidden = !w;
  at("map").replaceChildren();
  at("map-help").hidden = Boolean(w);
  at("where-help").textContent = w
    ? "Each point is a window of steady motion" +
      (w.of_coils ? ", each line the residual torque of the coils, cut off where it is more than twice as long as most" : "") +
      (w.noisy.some(Boolean) ? "; a cross is far noisier than the others" : "") +
      ". Choose points by click or box, or with arrow keys (right, left: in time; down, up: less bad, worse; with Shift more; Escape: none). Wheel: zoom; double click: all."
    : "";
  at("where-none").hidden = Boolean(w);
  if (!w) return;
  options("where-channel", Object.entries(w.chi2).map(([name, { title }]) => [name, title]));
  options("where-variable", [
    ...now.found.variables.map((own) => [own.variable, own.title.split(", ")[0]]),
    ...now.found.torque_maps.map(({ target, title }) => [`map ${target}`, `map of the missing ${title}`]),
  ]);
  plane(w);
  map(w);
}

function options(id, entries) {
  at(id).replaceChildren(...entries.map(([value, title]) => element("option", title, { value })));
}
for (const id of ["where-channel", "where-variable"]) {
  at(id).addEventListener("change", () => look(at("where-channel").value, at("where-variable").value));
}

at("where-speed").addEventListener("change", () => {
  speed = Number(at("where-speed").value);
  plane(windows());
});

// Draws another channel, or over another variable.
function look(name, over) {
  if (name === channel && over === variable) return;
  setChannel(name);
  variable = over;
  plane(windows());
}

// No cell of the map stands for what is chosen, unless it was pressed now.
hear("picked", () => {
  for (const cell of at("map").querySelectorAll("[aria-pressed]")) cell.removeAttribute("aria-pressed");
});

const TOOLS = { height: 200, min_height: 125, sizing_mode: "stretch_both", tools: "tap,box_select,wheel_zoom,reset", active_drag: "box_select", active_scroll: "wheel_zoom", toolbar_location: null };

function figure(options) {
  const made = P.figure({ ...TOOLS, ...options });
  made.on_event("doubletap", () => made.reset.emit());
  return made;
}

// A figure of the tilt plane; another one with the same ranges follows it.
function tiltPlane(title, like = {}) {
  const made = figure({ title, match_aspect: true, ...like });
  made.below[0].axis_label = "tilt about x, °";
  made.left[0].axis_label = "tilt about y, °";
  return made;
}

function plane(w) {
  at("where-channel").value = channel;
  at("where-variable").value = variable;
  const map = now.found.torque_maps.find(({ target }) => variable === `map ${target}`);
  at("where-of").hidden = Boolean(map);
  at("where-at").hidden = !map;
  at("where-said").textContent = "";
  const shown = sides(!map);
  at("where").classList.toggle("split", shown.length > 1);
  rings = [];
  if (map) return torque(map, w);
  const over = now.found.variables.find((own) => own.variable === variable);
  const { title } = w.chi2[channel];
  // one scale for all arrows: that of the larger residuals
  const scale = Math.min(...shown.map((side) => leftBy(side, w).scale));
  let [same, level] = [{}, {}]; // ranges of the first side, which the other one has, too
  const columns = shown.map((side, n) => {
    const [left, right] = windowsOf(side, w, scale, n, same, level);
    left.title.text = side.title || `tilt plane, colour: χ²/N of ${title}`;
    right.title.text = `χ²/N of ${title}`;
    right.below[0].axis_label = over.title;
    [same, level] = [left, right].map(({ x_range, y_range }) => ({ x_range, y_range }));
    return [left, right];
  });
  arrange("where", shown.length > 1 ? columns : columns[0].map((own) => [own]));
  at("where").dataset.drawn = [channel, variable, ...shown.map((side) => side.title).filter(Boolean)].join(" ");
  circle();
}

// The windows of a side in the tilt plane, and their χ²/N over the variable.
function windowsOf(side, w, scale, number, same, level) {
  const own = leftBy(side, w);
  const chi2 = own.chi2[channel].values;
  const order = ofSide(side, [...chi2.keys()]).sort((a, b) => chi2[a] - chi2[b]); // the worst on top of those at the same tilt
  const column = (make) => order.map(make);
  const long = (k) => (own.noisy[k] ? 0 : Math.min(scale, w.longest / Math.max(Math.hypot(own.residual_x[k], own.residual_y[k]), 1e-300)));
  const source = new Bokeh.ColumnDataSource({
    data: {
      x: column((k) => w.tilt_x[k]), y: column((k) => w.tilt_y[k]), over: column((k) => w.over[variable][k]),
      x1: column((k) => w.tilt_x[k] + long(k) * own.residual_x[k]), y1: column((k) => w.tilt_y[k] + long(k) * own.residual_y[k]),
      chi2: column((k) => Math.max(chi2[k], 0.05)), colour: column((k) => shade(chi2[k])),
      marker: column((k) => (own.noisy[k] ? "x" : "circle")),
    },
  });
  const ring = new Bokeh.ColumnDataSource({ data: { k: [], x: [], y: [], over: [], chi2: [] } });
  rings.push({ ring, side, chi2 });
  const mark = { source, size: 9, marker: { field: "marker" }, fill_color: { field: "colour" }, line_color: "#777777", nonselection_alpha: 0.2 };
  const around = { source: ring, size: 17, fill_color: null, line_color: css("--accent"), line_width: 2 };
  const left = tiltPlane("", same);
  if (w.of_coils && channel.startsWith("tilt")) {
    left.segment({ field: "x" }, { field: "y" }, { field: "x1" }, { field: "y1" }, { source, line_color: "#888888", line_width: 1.5 });
  }
  left.scatter({ field: "x" }, { field: "y" }, mark);
  left.scatter({ field: "x" }, { field: "y" }, around);
  const right = figure({ y_axis_type: "log", ...level });
  right.left[0].axis_label = "χ²/N";
  right.left[0].ticker.desired_num_ticks = 3;
  right.add_layout(new Bokeh.Span({ location: 1, dimension: "width", line_color: css("--soft"), line_dash: "dashed" }));
  right.scatter({ field: "over" }, { field: "chi2" }, mark);
  right.scatter({ field: "over" }, { field: "chi2" }, around);
  link(`where ${number}`, source, order);
  return [left, right];
}

// The missing torque as a map at a speed, and its standard deviation, over the tilts; dots: the windows it is from.
const SHADES = 64;
function torque(map, w) {
  speed = Math.min(speed, map.speeds.length - 1);
  options("where-speed", map.speeds.map((own, k) => [String(k), `${own.speed} rpm`]));
  at("where-speed").value = String(speed);
  const { value_x, value_y, sigma, shape } = map.speeds[speed];
  const rotor = map.target === "rotor_torque";
  const size = value_x.map((own, k) => Math.hypot(own, value_y[k]));
  const order = [...w.start.keys()];
  const held = new Bokeh.ColumnDataSource({ data: { x: w.tilt_x, y: w.tilt_y } });
  const draw = (title, values, low, high, shades, like) => {
    const made = tiltPlane(title, like);
    const mapper = new Bokeh.LinearColorMapper({ palette: shades, low, high });
    const source = new Bokeh.ColumnDataSource({ data: { x: map.x, y: map.y, value: values } });
    const side = 1.2 * map.cell; // no gaps where pixels are rounded
    made.rect({ field: "x" }, { field: "y" }, side, side, { source, fill_color: { field: "value", transform: mapper }, line_color: null });
    const bar = new Bokeh.ColorBar({ color_mapper: mapper, width: 10, padding: 4, background_fill_color: null, major_label_text_color: css("--soft"), bar_line_color: css("--line"), ticker: new Bokeh.BasicTicker({ desired_num_ticks: 4 }) });
    made.add_layout(bar, "right");
    return made;
  };
  const ramp = Array.from({ length: SHADES }, (_, k) => shade(WORST ** (k / (SHADES - 1))));
  const both = [...ramp.toReversed().map((own) => own.replace(/hsl\(([\d.]+)/, "hsl(215")), ...ramp];
  const left = draw(`missing torque, ${map.unit}`, rotor ? size : value_x, rotor ? 0 : -map.most, map.most, rotor ? ramp : both);
  const right = draw(`±1 σ of it, ${map.unit}`, sigma, 0, Math.max(...map.speeds.flatMap((own) => own.sigma)), ramp, { x_range: left.x_range, y_range: left.y_range });
  if (rotor) {
    const reach = Math.max(...map.x);
    const some = [...size.keys()].filter((k) => [map.x[k], map.y[k]].every((own) => Math.abs(Math.round(own / map.cell)) % 3 === 0));
    const end = (from, part) => some.map((k) => from[k] + (0.28 * reach * part[k]) / map.most);
    const arrows = new Bokeh.ColumnDataSource({
      data: { x: some.map((k) => map.x[k]), y: some.map((k) => map.y[k]), x1: end(map.x, value_x), y1: end(map.y, value_y), angle: some.map((k) => Math.atan2(value_y[k], value_x[k]) - Math.PI / 2) },
    });
    left.segment({ field: "x" }, { field: "y" }, { field: "x1" }, { field: "y1" }, { source: arrows, line_color: css("--ink"), line_width: 1.5 });
    left.scatter({ field: "x1" }, { field: "y1" }, { source: arrows, marker: "triangle", size: 6, angle: { field: "angle" }, fill_color: css("--ink"), line_color: null });
  }
  right.scatter({ field: "x" }, { field: "y" }, { source: held, size: 7, fill_color: css("--card"), line_color: css("--ink"), nonselection_alpha: 0.25 });
  arrange("where", [[left], [right]]);
  link("where 0", held, order);
  at("where").dataset.drawn = `${variable} ${map.speeds[speed].speed}`;
  const most = size.indexOf(Math.max(...size));
  at("where-said").textContent =
    `Largest at ${map.speeds[speed].speed} rpm: ${figures(size[most])} ± ${figures(sigma[most])} ${map.unit}${rotor ? " (both axes together)" : ""}, at a tilt of ${fixed(map.x[most], 1)}, ${fixed(map.y[most], 1)}°. ` +
    `Without an offset and a slope over the tilts, which it shares with the bench parameters: ±${figures(shape)} ${map.unit}. The map holds ${map.range}. Dots: windows that it is from.`;
}
const figures = (value) => String(Number(value.toPrecision(3)));

function circle() {
  const w = windows();
  if (!w) return;
  for (const { ring, side, chi2 } of rings) {
    const own = ofSide(side, current < 0 ? [] : [current]);
    ring.data = {
      k: own, x: own.map((k) => w.tilt_x[k]), y: own.map((k) => w.tilt_y[k]), over: own.map((k) => w.over[variable][k]),
      chi2: own.map((k) => Math.max(chi2[k], 0.05)),
    };
  }
}
hear("current", circle);
at("where").addEventListener("keydown", walk);

// --- every channel over every variable: a grid of buttons, one of which is in the order of Tab

function map(w) {
  const grid = element("table", undefined, { className: "map" });
  grid.setAttribute("role", "grid");
  grid.setAttribute("aria-label", "χ²/N of every channel over every variable");
  const [over, labels] = [grid.createTHead().insertRow(), grid.tHead.insertRow()];
  over.append(element("th", "χ²/N"));
  labels.append(element("td", ""));
  for (const own of now.found.maps) {
    const [title, unit] = own.title.split(", ");
    const head = element("th", `${title}, ${unit}`, { colSpan: own.cells.length, scope: "colgroup" });
    over.append(head);
    own.cells.forEach((cell, k) => labels.append(element("th", cell.label, { scope: "col", className: k ? "" : "first" })));
  }
  const body = grid.createTBody();
  for (const [name, { title }] of Object.entries(w.chi2)) {
    const row = body.insertRow();
    row.append(element("th", title, { scope: "row" }));
    for (const own of now.found.maps) {
      own.cells.forEach((cell, k) => {
        const value = cell.chi2[name];
        const place = row.insertCell();
        place.className = k ? "" : "first";
        const button = element("button", short(value), { type: "button", tabIndex: -1 });
        button.style.background = shade(value);
        button.style.color = legible(button.style.background);
        button.setAttribute("aria-label", `${title}, ${own.title} ${cell.label}: χ²/N ${short(value)}`);
        button.onclick = () => {
          look(name, own.variable);
          pick(cell.windows);
          button.setAttribute("aria-pressed", "true");
        };
        place.append(button);
      });
    }
  }
  const buttons = [...body.querySelectorAll("button")];
  if (buttons.length) buttons[0].tabIndex = 0;
  const wide = body.rows[0] ? body.rows[0].cells.length - 1 : 1;
  grid.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -wide, ArrowDown: wide }[event.key];
    const k = buttons.indexOf(document.activeElement) + (step ?? 0);
    if (step === undefined || !buttons[k]) return;
    event.preventDefault();
    for (const each of buttons) each.tabIndex = -1;
    buttons[k].tabIndex = 0;
    buttons[k].focus();
  });
  const frame = element("div", undefined, { className: "scroll" });
  frame.append(grid);
  at("map").append(frame);
}
