// Where the model fails: windows in the tilt plane and over the spin rate, every channel over every variable, linked.

import { P, at, dark, element, fixed, now, put, say, send, table, tell, themed } from "./shared.js";
import { choose } from "./signals.js";

const WORST = 1000; // χ²/N at the end of the colours
let source = null;
let drawn = null;
let seen = null; // what was found, as it was drawn
let channel = "tilt";

// White for noise, on to red; on dark ground from dark to bright.
function shade(value) {
  const part = Math.min(Math.max(Math.log10(Math.max(value, 1)) / Math.log10(WORST), 0), 1);
  return dark.matches ? `hsl(${48 - 40 * part} ${25 + 65 * part}% ${18 + 47 * part}%)` : `hsl(${40 - 35 * part} 90% ${97 - 55 * part}%)`;
}
// Black or white, whichever stands out more from a colour "rgb(r, g, b)".
function legible(colour) {
  const [r, g, b] = colour.match(/[0-9.]+/g).map((part) => {
    const value = Number(part) / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.179 ? "#000000" : "#ffffff";
}
const short = (value) => (value >= 9.95 ? value.toFixed(0) : value.toFixed(1));

export function showWhere(again = false) {
  if (now.found === seen && !again) return;
  seen = now.found;
  const w = now.found?.windows ?? null;
  const text = JSON.stringify([w, now.found?.maps]);
  if (text === drawn && !again) return;
  drawn = text;
  put("where", null);
  at("where").tabIndex = w ? 0 : -1;
  say("windows", {});
  at("map").replaceChildren();
  at("chosen").replaceChildren();
  at("where-help").textContent = w
    ? "Each point is a window of steady motion" +
      (w.of_coils ? ", each line the residual torque of the coils from the tilt at which it acts. " : ". ") +
      "Choose points with a click or a box, by the arrow keys (right and left in time, down to less bad and up to worse, with Shift " +
      "more of them, Escape none), or a cell of the map below: their samples are shown above."
    : "Compare and diagnose first.";
  if (!w) return;
  if (!(channel in w.chi2)) channel = w.of_coils ? "tilt" : Object.keys(w.chi2)[0];
  plane(w);
  map(w);
}

// No cell of the map stands for what is chosen.
function release() {
  for (const cell of at("map").querySelectorAll("[aria-pressed]")) cell.removeAttribute("aria-pressed");
}

function plane(w) {
  const chi2 = w.chi2[channel].values;
  const scale = w.noisy.map((noisy) => (noisy ? 0 : w.arrow));
  source = new Bokeh.ColumnDataSource({
    data: {
      x: w.tilt_x, y: w.tilt_y, speed: w.speed, chi2: chi2.map((v) => Math.max(v, 0.05)),
      x1: w.tilt_x.map((x, k) => x + scale[k] * w.residual_x[k]), y1: w.tilt_y.map((y, k) => y + scale[k] * w.residual_y[k]),
      colour: chi2.map(shade), marker: w.noisy.map((noisy) => (noisy ? "x" : "circle")),
    },
  });
  const mark = { source, size: 9, marker: { field: "marker" }, fill_color: { field: "colour" }, line_color: "#777777", nonselection_alpha: 0.2 };
  const title = w.chi2[channel].title;
  const options = { height: 430, sizing_mode: "stretch_width", tools: "tap,box_select,pan,wheel_zoom,reset", toolbar_location: "right" };
  const left = P.figure({ ...options, title: `tilt plane; colour: χ²/N of the ${title} (1: noise)`, match_aspect: true });
  left.below[0].axis_label = "tilt about x, °";
  left.left[0].axis_label = "tilt about y, °";
  left.segment({ field: "x" }, { field: "y" }, { field: "x1" }, { field: "y1" }, { source, line_color: "#888888", line_width: 1.5 });
  left.scatter({ field: "x" }, { field: "y" }, mark);
  const right = P.figure({ ...options, title: `χ²/N of the ${title} over the spin rate`, y_axis_type: "log" });
  right.below[0].axis_label = "spin rate, rpm";
  right.left[0].axis_label = "χ²/N";
  right.scatter({ field: "speed" }, { field: "chi2" }, mark);
  put("where", new Bokeh.Row({ children: [themed(left), themed(right)], spacing: 16, sizing_mode: "stretch_width" }));
  source.selected.properties.indices.change.connect(() => {
    release();
    choosing([...source.selected.indices]);
  });
}

// Windows one by one: in time, or from the worst on.
at("where").addEventListener("keydown", (event) => {
  const chi2 = now.found?.windows?.chi2[channel].values;
  if (!chi2 || !source) return;
  const selected = source.selected.indices;
  if (event.key === "Escape") return void (source.selected.indices = []);
  const worstFirst = [...chi2.keys()].sort((a, b) => chi2[b] - chi2[a]);
  const inTime = event.key === "ArrowRight" || event.key === "ArrowLeft";
  const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (step === undefined && event.key !== "Home") return;
  event.preventDefault();
  const order = inTime ? [...chi2.keys()] : worstFirst;
  const last = selected.at(-1); // the one that was chosen last
  const k = step === undefined || last === undefined ? 0 : Math.min(Math.max(order.indexOf(last) + step, 0), order.length - 1);
  source.selected.indices = [...(event.shiftKey ? selected.filter((own) => own !== order[k]) : []), order[k]];
});

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
          const other = channel !== name;
          channel = name;
          if (other) plane(w);
          release();
          source.selected.indices = cell.windows;
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

let turn = 0;
async function choosing(indices) {
  const w = now.found.windows;
  const place = at("chosen");
  const mine = ++turn;
  place.replaceChildren();
  tell("where", "");
  if (!w || !indices.length) return say("windows", {});
  const chi2 = w.chi2[channel].values;
  const sorted = [...indices].sort((a, b) => chi2[b] - chi2[a]);
  const key = w.recording[sorted[0]];
  const spans = {};
  for (const k of indices) (spans[w.recording[k]] ??= []).push([w.start[k], w.start[k] + w.duration[k]]);
  // the worst is looked at, the others are marked
  const [start, end] = [w.start[sorted[0]], w.start[sorted[0]] + w.duration[sorted[0]]];
  const margin = 0.25 * (end - start) + 0.1;
  await choose(key, start - margin, end + margin);
  say("windows", spans);
  let said;
  try {
    said = await send("region", { windows: indices.join(",") });
  } catch (error) {
    return tell("where", error.message);
  }
  if (mine !== turn) return;
  const percent = (share) => `${(100 * share).toFixed(share < 0.1 ? 1 : 0)} %`;
  place.append(
    element("p", `${indices.length} of ${w.start.length} windows chosen; they have ${percent(said.share)} of the whole χ². What the residual looks like in them:`),
    table([["share of χ²", "where", "shape of the residual"], ...said.said.map((own) => [percent(own.share), own.where, own.looks])]),
  );
  place.lastChild.classList.add("said");
  const kinds = Object.values(w.chi2);
  const several = Object.keys(spans).length > 1;
  const name = (k) => now.state.signals.find((each) => each.key === w.recording[k])?.name ?? "";
  place.append(
    element("p", indices.length > 12 ? "The twelve worst windows:" : "Window by window:"),
    table([
      [...(several ? ["recording"] : []), "time, s", "tilt x, °", "tilt y, °", "rpm", ...(w.of_coils ? [`residual x, ${w.unit}`, `residual y, ${w.unit}`] : []), ...kinds.map((c) => `χ²/N ${c.title}`)],
      ...sorted.slice(0, 12).map((k) => [
        ...(several ? [name(k)] : []), w.start[k].toFixed(2), fixed(w.tilt_x[k], 2), fixed(w.tilt_y[k], 2), w.speed[k].toFixed(0),
        ...(w.of_coils ? [fixed(w.residual_x[k], 3), fixed(w.residual_y[k], 3)] : []), ...kinds.map((c) => c.values[k].toFixed(1)),
      ]),
    ]),
  );
}
