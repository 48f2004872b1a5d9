// The residual of a channel: measured and predicted, and what is left with its noise, over any variable; and whether it is noise.

import { P, arrange, at, colours, css, element, hear, now, put, send, themed } from "./shared.js";
import { leftBy, makeSides, ofSide } from "./sides.js";
import { shown } from "./signals.js";
import { channel, link, walk, windows } from "./windows.js";

const TURN = 73; // angles at which a turn is drawn
let drawn = ""; // what is drawn, with the choices
let row = 0; // number of the row of a channel
let over = "time";
let view = "over"; // or "order", "noise"
let other = "itself"; // what noise is correlated with
let lines = []; // at the cursor, where time is drawn, each with the recording
let picked = [];
const sides = makeSides("residual", () => showResidual());
let hidden = null; // titles of other models that are not drawn; before the user chose, all but the latest of the session
const SIGNS = [["cross", "✚", "--soft"], ["triangle", "▲", "#009E73"], ["square", "■", "#CC79A7"], ["diamond", "◆", "#E69F00"]];

for (const button of at("residual-view").querySelectorAll("button")) {
  button.addEventListener("click", () => {
    view = button.dataset.view;
    showResidual();
  });
}
at("residual-row").addEventListener("change", () => {
  row = Number(at("residual-row").value);
  showResidual();
});
at("residual-over").addEventListener("change", () => {
  if (view === "noise") other = at("residual-over").value;
  else over = at("residual-over").value;
  showResidual();
});
hear("shown", () => showResidual());
hear("channel", () => {
  const k = now.found?.residuals?.findIndex((own) => own.channel === channel) ?? -1;
  if (k < 0 || now.found.residuals[row]?.channel === channel) return;
  row = k;
  showResidual();
});
hear("picked", (windows) => {
  picked = windows;
  if (ofChosen()) showResidual();
});
hear("cursor", ({ key, time }) => {
  for (const own of lines) own.line.setv({ location: time, visible: own.key === key });
});
at("residual").addEventListener("keydown", walk);

// Before and after a change of the model: any share of it, as the residual is linear in what was fitted, or nearly so.
let ends = null; // of the dots: their source, and their values before and after
at("residual-slide").addEventListener("input", slide);
function slide() {
  if (!ends) return;
  const part = Number(at("residual-slide").value) / 100;
  at("residual-slid").textContent = part === 1 ? "" : `, ${Math.round(100 * part)} % of the change`;
  const { source, before, after } = ends;
  source.data = { ...source.data, residual: after.map((own, k) => before[k] + part * (own - before[k])) };
}

// Whether what is drawn is of the chosen windows alone.
const ofChosen = () => view === "order" || (view === "over" && over === "angle");

let seen = null;
let variables = []; // with their titles
export function showResidual(again = false) {
  const rows = now.found?.residuals ?? [];
  at("residual-none").hidden = rows.length > 0;
  at("residual-line").hidden = !rows.length;
  if (now.found !== seen) {
    seen = now.found;
    if (rows[row]?.channel !== channel) row = Math.max(rows.findIndex((own) => own.channel === channel), 0);
    at("residual-row").replaceChildren(...rows.map((own, k) => element("option", own.title, { value: String(k) })));
    const angle = rows.some((own) => own.order) ? [["angle", "shaft angle"]] : [];
    const names = [...(now.found?.variables ?? []).map((own) => [own.variable, own.title.split(", ")[0]]), ...angle];
    variables = names;
    if (!names.some(([name]) => name === over)) over = "time";
  }
  for (const button of at("residual-view").querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.view === view));
  const own = rows[row];
  at("residual-row").value = String(row);
  const choices = view === "over" ? variables : ["itself", ...Object.keys(own?.noise?.cross ?? {})].map((name) => [name, name]);
  if (at("residual-over").dataset.shown !== JSON.stringify(choices)) {
    at("residual-over").dataset.shown = JSON.stringify(choices);
    at("residual-over").previousElementSibling.textContent = view === "over" ? "over" : "correlated with";
    at("residual-over").replaceChildren(...choices.map(([value, title]) => element("option", title, { value })));
  }
  at("residual-over").value = view === "over" ? over : other;
  at("residual-over").parentElement.hidden = view === "order";
  const shownSides = sides(view === "over" && Boolean(own));
  const split = shownSides.length > 1;
  showModels(own, split);
  const mark = JSON.stringify([own, shownSides, drawnOthers(own), over, other, view, over === "time" ? shown()?.key : null, ofChosen() ? picked : null, view === "order" ? now.found.facts : null]);
  if (mark === drawn && !again) return;
  drawn = mark;
  asked++;
  lines = [];
  ends = null;
  at("residual-slider").hidden = true;
  put("residual", null);
  at("residual").tabIndex = own ? 0 : -1;
  at("residual-said").textContent = "";
  if (!own) return;
  if (view === "noise") return noise(own);
  if (view === "order") return void byOrder(own);
  const ranges = {}; // by what they are of: the same in both sides
  const pictures = shownSides.map((side, k) => (over === "angle" ? turn(rows, side, ranges) : against(own, side, k, ranges, shownSides)));
  if (pictures.some(({ figures }) => figures.length)) arrange("residual", pictures.map(({ figures }) => figures));
  at("residual-said").textContent = pictures.map(({ said }, k) => (split ? `${shownSides[k].title}: ${said}` : said)).join(" ");
  slide();
}

// Other models, each with the χ²/N of the channel and its sign; files of models that can be compared, too.
function showModels(own, split) {
  const titles = Object.keys(own?.others ?? {});
  const files = (own && now.found.models.filter((name) => !titles.includes(name))) || [];
  at("residual-models").hidden = !own || split || view !== "over" || over === "angle" || !(titles.length || files.length);
  at("residual-files").hidden = !files.length;
  const text = JSON.stringify([titles, files, own?.channel, titles.map((title) => own.others[title].chi2)]);
  if (at("residual-models").dataset.shown === text) return;
  at("residual-models").dataset.shown = text;
  at("residual-file").replaceChildren(...files.map((name) => element("option", name)));
  at("residual-others").replaceChildren(
    ...titles.map((title, k) => {
      const box = element("input", undefined, { type: "checkbox", checked: drawnOthers(own).includes(title) });
      box.onchange = () => {
        hidden = [...at("residual-others").querySelectorAll("input")].flatMap((each, n) => (each.checked ? [] : [titles[n]]));
        showResidual();
      };
      const label = element("label");
      const sign = element("span", SIGNS[k % SIGNS.length][1]);
      sign.style.color = colourOf(k);
      label.append(box, " ", sign, ` ${title}: χ²/N ${figures(own.others[title].chi2)}`);
      return label;
    }),
  );
}
const figures = (value) => String(Number(value.toPrecision(3)));
function colourOf(k) {
  const colour = SIGNS[k % SIGNS.length][2];
  return colour.startsWith("--") ? css(colour) : colour;
}
function drawnOthers(own) {
  const titles = Object.keys(own?.others ?? {});
  return titles.filter((title, k) => (hidden ? !hidden.includes(title) : k === 0 || now.found.models.includes(title)));
}

function figure(options) {
  const made = P.figure({ height: 90, min_height: 70, sizing_mode: "stretch_both", tools: "xpan,xwheel_zoom,reset", active_scroll: "xwheel_zoom", toolbar_location: null, ...options });
  made.min_border_left = 56;
  made.on_event("doubletap", () => made.reset.emit());
  if ("range_padding" in made.y_range) made.y_range.range_padding = 0.2;
  made.left[0].ticker.desired_num_ticks = 4;
  return made;
}

function sign(size) {
  return { size, line_color: null, nonselection_alpha: 0.25 };
}

// Measured and predicted above, below the residual on its noise, over a variable, of one side.
function against(row, side, number, ranges, all) {
  const w = windows();
  const own = leftBy(side, row);
  const split = all.length > 1;
  // over time, the windows of the recording that is shown, or of the first one that has any
  const key = side.key ?? (w.recording.includes(shown()?.key) ? shown().key : w.recording[0]);
  const [one, other] = colours();
  const order = ofSide(side, [...own.residual.keys()]).filter((k) => over !== "time" || w.recording[k] === key);
  order.sort((a, b) => w.over[over][a] - w.over[over][b]);
  const column = (values) => order.map((k) => values[k]);
  const x = column(w.over[over]);
  const nothing = order.map(() => NaN);
  const others = split ? [] : Object.entries(own.others).filter(([title]) => drawnOthers(own).includes(title));
  const place = (title) => Object.keys(own.others).indexOf(title); // of its sign
  const source = new Bokeh.ColumnDataSource({
    data: {
      x, residual: column(own.residual), low: order.map((k) => -own.sigma[k]), high: order.map((k) => own.sigma[k]),
      measured: own.measured ? column(own.measured) : nothing, predicted: own.predicted ? column(own.predicted) : nothing,
      ...Object.fromEntries(others.map(([title, each]) => [`of ${title}`, column(each.residual)])), marker: order.map((k) => (w.noisy[k] ? "x" : "circle")),
    },
  });
  // windows far noisier than the others do not set the scale
  const drawnRows = [...all.map((each) => leftBy(each, row)), ...others.map(([, each]) => ({ ...each, sigma: own.sigma.map(() => 0) }))];
  const seenWindows = split ? [...own.residual.keys()] : order;
  const reach = 1.15 * Math.max(...seenWindows.filter((k) => !w.noisy[k]).flatMap((k) => drawnRows.map((each) => Math.abs(each.residual[k]) + each.sigma[k])));
  const outside = reach > 0 ? order.filter((k) => Math.abs(own.residual[k]) > reach).length : 0;
  const title = now.found.variables.find((each) => each.variable === over).title;
  ranges.x ??= new Bokeh.DataRange1d();
  ranges.above ??= new Bokeh.DataRange1d();
  ranges.below ??= outside || split ? new Bokeh.Range1d({ start: -reach, end: reach }) : new Bokeh.DataRange1d();
  const tools = { x_range: ranges.x, tools: "tap,xbox_select,xpan,xwheel_zoom,reset", active_drag: "xbox_select" };
  // what is left gets most of the room
  const above = figure({ ...tools, sizing_mode: "stretch_width", height: 70, y_range: ranges.above, title: side.title || `${own.title}, ${own.measured_unit}: measured •, predicted ×` });
  above.left[0].ticker.desired_num_ticks = 2;
  above.below[0].visible = false; // that of the residual serves both
  above.scatter({ field: "x" }, { field: "measured" }, { source, fill_color: one, ...sign(7) });
  above.scatter({ field: "x" }, { field: "predicted" }, { source, marker: "x", ...sign(9), line_color: other, line_width: 2 });
  const below = figure({ ...tools, y_range: ranges.below, title: split ? `${own.measured ? "" : `${side.title}: `}residual, ${own.unit}` : `residual, ${own.unit}, on its noise of ±1 σ` });
  const band = new Bokeh.ColumnDataSource({ data: { x, low: source.data.low, high: source.data.high } });
  if (over === "time") below.varea({ field: "x" }, { field: "low" }, { field: "high" }, { source: band, fill_color: css("--soft"), fill_alpha: 0.18 });
  below.segment({ field: "x" }, { field: "low" }, { field: "x" }, { field: "high" }, { source: band, line_color: css("--soft"), line_alpha: 0.6 });
  below.add_layout(new Bokeh.Span({ location: 0, dimension: "width", line_color: css("--soft") }));
  for (const [name] of others) {
    const colour = colourOf(place(name));
    below.scatter({ field: "x" }, { field: `of ${name}` }, { source, marker: SIGNS[place(name) % SIGNS.length][0], ...sign(8), fill_color: colour, fill_alpha: 0.6, line_color: colour, line_width: 1.5 });
  }
  below.scatter({ field: "x" }, { field: "residual" }, { source, marker: { field: "marker" }, ...sign(7), fill_color: one, line_color: one });
  below.below[0].axis_label = title;
  if (over === "time") {
    const line = new Bokeh.Span({ dimension: "height", location: 0, line_color: css("--ink"), line_dash: "dotted", visible: false });
    below.add_layout(line);
    lines.push({ line, key });
  }
  link(`residual ${number}`, source, order);
  const [earlier] = others.map(([name]) => name).filter((name) => !now.found.models.includes(name));
  if (earlier) {
    ends = { source, before: column(own.others[earlier].residual), after: source.data.residual };
    at("residual-slider").hidden = false;
  }
  const beyond = order.filter((k) => Math.abs(own.residual[k]) > own.sigma[k]).length;
  const said =
    (over === "time" && key !== shown()?.key ? `Of ${now.state.signals.find((each) => each.key === key)?.name}: ` : "") +
    (outside ? `Outside of the picture: ${outside} far noisier. ` : "") +
    (split
      ? `${beyond} of ${order.length} windows beyond ±1 σ${side.key === null ? `, χ²/N ${figures(own.chi2)}` : ""}.`
      : `${beyond} of ${order.length} windows lie beyond their noise of ±1 σ; of noise alone about ${Math.round(0.317 * order.length)} do.`) +
    (others.length ? ` Dots: the model as it is, χ²/N ${figures(own.chi2)}.` : "");
  return { figures: own.measured ? [above, below] : [below], said };
}

// The residual torque of the coils over a turn of the shaft, from its parts once and twice a turn, in the chosen windows or in all.
function turn(rows, side, ranges) {
  const [one, other] = colours();
  const harmonics = rows.filter((own) => own.order && own.channel.startsWith("tilt")).map((own) => leftBy(side, own));
  const chosen = ofSide(side, picked.length ? picked : [...rows[0].residual.keys()]);
  const parts = harmonics.map((own) => {
    const weight = chosen.map((k) => own.sigma[k] ** -2);
    const whole = weight.reduce((sum, each) => sum + each, 0);
    return { order: own.order, place: own.place, mean: chosen.reduce((sum, k, i) => sum + weight[i] * own.residual[k], 0) / whole, variance: 1 / whole };
  });
  if (!parts.length) return { figures: [], said: "These recordings have no parts once or twice a turn." };
  if (!chosen.length) return { figures: [], said: "None of the chosen windows." };
  const unit = harmonics[0].unit;
  const angle = Array.from({ length: TURN }, (_, k) => (360 * k) / (TURN - 1));
  // x + i y is the sum of (a + i b) exp(i n angle)
  const sum = (axis, degrees) =>
    parts.reduce((all, { order, place, mean }) => {
      const [c, s] = [Math.cos((order * degrees * Math.PI) / 180), Math.sin((order * degrees * Math.PI) / 180)];
      return all + mean * (axis ? (place ? c : s) : place ? -s : c);
    }, 0);
  // both parts of an order have the same noise, so that of their sum is the same at every angle
  const sigma = Math.sqrt(parts.filter(({ place }) => !place).reduce((all, { variance }) => all + variance, 0));
  const drawn = ["x", "y"].map((name, axis) => {
    const y = angle.map((own) => sum(axis, own));
    const source = new Bokeh.ColumnDataSource({ data: { angle, y, low: y.map((own) => own - sigma), high: y.map((own) => own + sigma) } });
    ranges[name] ??= new Bokeh.DataRange1d();
    const made = figure({ y_range: ranges[name], title: side.title ? `${axis ? "" : `${side.title}; `}${name}, ${unit}` : `residual torque of the coils about ${name}, ${unit}, ±1 σ` });
    made.varea({ field: "angle" }, { field: "low" }, { field: "high" }, { source, fill_color: css("--soft"), fill_alpha: 0.3 });
    made.line({ field: "angle" }, { field: "y" }, { source, line_color: axis ? other : one, line_width: 2 });
    made.add_layout(new Bokeh.Span({ location: 0, dimension: "width", line_color: css("--soft") }));
    if (axis) made.below[0].axis_label = "shaft angle, °";
    return made;
  });
  return { figures: drawn, said: `Sum of the parts once and twice a turn, mean of ${picked.length ? `${chosen.length} chosen` : `all ${chosen.length}`} windows.` };
}

// By the order of the rotation, in the chosen windows or in all: computed from the samples when it is looked at.
let asked = 0;
async function byOrder(own) {
  const mine = asked;
  at("residual-said").textContent = "Reading the samples …";
  let found;
  try {
    found = await send("orders", { channel: own.channel, windows: picked.join(",") });
  } catch (error) {
    found = { lines: [], said: error.message };
  }
  if (mine !== asked) return; // something else is shown by now
  at("residual-said").textContent = found.said;
  const x_range = new Bokeh.Range1d({ start: 0, end: found.order?.at(-1) ?? 1 });
  const all = found.lines.flatMap(({ amplitude, level }) => [...amplitude, ...level]);
  const y_range = new Bokeh.Range1d({ start: 0.7 * Math.min(...all), end: 1.5 * Math.max(...all) });
  const ticks = logTicks(y_range.start, y_range.end);
  const made = found.lines.map(({ title, amplitude, level }, k) => {
    const colour = colours()[k];
    const source = new Bokeh.ColumnDataSource({ data: { x: found.order, y: amplitude, level } });
    const clear = [...amplitude.keys()].filter((i) => amplitude[i] > level[i]);
    const marks = new Bokeh.ColumnDataSource({ data: { x: clear.map((i) => found.order[i]), y: clear.map((i) => amplitude[i]) } });
    const each = figure({ title, x_range, y_range, y_axis_type: "log" });
    each.below[0].ticker.desired_num_ticks = 11;
    each.left[0].ticker = new Bokeh.FixedTicker({ ticks, minor_ticks: [] });
    each.left[0].formatter = new Bokeh.BasicTickFormatter();
    each.line({ field: "x" }, { field: "level" }, { source, line_color: css("--soft"), line_width: 1.5, line_dash: "dashed" });
    each.line({ field: "x" }, { field: "y" }, { source, line_color: colour, line_width: 1.5 });
    each.scatter({ field: "x" }, { field: "y" }, { source: marks, size: 7, fill_color: colour, line_color: null });
    if (k === found.lines.length - 1) each.below[0].axis_label = "order, per turn of the shaft";
    return themed(each);
  });
  put("residual", made.length && all.length ? new Bokeh.Column({ children: made, sizing_mode: "stretch_both" }) : null);
}

// Numbers for a logarithmic axis: 1, 2 and 5 in every decade, of many decades its ends alone.
function logTicks(low, high) {
  const [first, last] = [low, high].map((own) => Math.floor(Math.log10(own)));
  const steps = last - first < 2 ? [1, 2, 5] : [1];
  const every = Math.max(1, Math.ceil((last - first) / 4));
  const decades = Array.from({ length: Math.max(last - first + 1, 0) }, (_, k) => first + k).filter((power) => power % every === 0);
  return decades.flatMap((power) => steps.map((step) => step * 10 ** power));
}

// Whether the residual is noise: order in time, frequency, distribution. All in units of the noise.
function noise(own) {
  const found = own.noise;
  if (!found) return void (at("residual-said").textContent = "Too few windows.");
  const [one] = colours();
  const soft = css("--soft");
  const level = (made, location, dimension = "width") => made.add_layout(new Bokeh.Span({ location, dimension, line_color: soft, line_dash: "dashed" }));
  const source = (data) => new Bokeh.ColumnDataSource({ data });
  const f = figure({ title: "spectrum (1: noise)", y_range: new Bokeh.Range1d({ start: 0, end: 1.15 * Math.max(found.level, ...found.power) }) });
  f.below[0].axis_label = "frequency, Hz";
  f.segment({ field: "x" }, 0, { field: "x" }, { field: "y" }, { source: source({ x: found.frequency, y: found.power }), line_color: one, line_width: 2 });
  level(f, found.level);
  const lags = found.cross[other] ?? found.correlation;
  const first = other in found.cross ? -(lags.length - 1) / 2 : 1;
  const most = 1.15 * Math.max(found.band, ...lags.map(Math.abs));
  const c = figure({ title: first < 0 ? `correlation with ${other} before` : "autocorrelation", y_range: new Bokeh.Range1d({ start: -most, end: most }) });
  c.below[0].axis_label = "lag, windows";
  c.segment({ field: "x" }, 0, { field: "x" }, { field: "y" }, { source: source({ x: lags.map((_, k) => k + first), y: lags }), line_color: one, line_width: 3 });
  level(c, found.band);
  level(c, -found.band);
  const q = figure({ title: "quantiles; grey: of noise" });
  q.below[0].axis_label = "of a normal distribution";
  const data = source({ x: found.quantile, y: found.white, low: found.low, high: found.high });
  q.varea({ field: "x" }, { field: "low" }, { field: "high" }, { source: data, fill_color: soft, fill_alpha: 0.3 });
  q.scatter({ field: "x" }, { field: "y" }, { source: data, size: 6, fill_color: one, line_color: null });
  const h = figure({ title: "distribution, and noise (line)" });
  h.below[0].axis_label = "residual in units of its noise";
  const n = found.white.length;
  const reach = Math.max(4, Math.ceil(Math.max(-found.white[0], found.white[n - 1])));
  const width = Math.max(0.5, reach / 20);
  const left = Array.from({ length: Math.round((2 * reach) / width) }, (_, k) => -reach + k * width);
  const top = left.map((low) => found.white.filter((own) => own >= low && own < low + width).length);
  h.quad({ field: "left" }, { field: "right" }, { field: "top" }, 0, { source: source({ left, right: left.map((own) => own + width), top }), fill_color: one, fill_alpha: 0.5, line_color: null });
  const x = Array.from({ length: 81 }, (_, k) => -4 + k / 10);
  h.line({ field: "x" }, { field: "y" }, { source: source({ x, y: x.map((own) => (n * width * Math.exp(-0.5 * own * own)) / Math.sqrt(2 * Math.PI)) }), line_color: css("--ink"), line_width: 2 });
  const children = [[themed(f), 0, 0], [themed(c), 0, 1], [themed(h), 1, 0], [themed(q), 1, 1]];
  put("residual", new Bokeh.GridBox({ children, sizing_mode: "stretch_both", spacing: 4 }));
  const out = lags.filter((each) => Math.abs(each) > found.band).length;
  at("residual-said").textContent =
    `${own.title}: ${n} windows. Dashed: 95 % of noise lies within; ${out} of ${lags.length} lags do not. Grey: 95 % of each quantile of noise.`;
}
