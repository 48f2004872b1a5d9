// Estimated parameters: as stated, from the recordings alone, and both; the profile of one; how they are correlated.

import { P, at, colours, css, element, fixed, legible, now, put, table, themed } from "./shared.js";

const LIMIT = 3.84; // rise of χ² at the ends of a 95 % interval
const NARROWEST = 25; // standard errors to either side that are drawn at most
let drawn = "";
let chosen = "";

at("coefficient").addEventListener("change", () => {
  chosen = at("coefficient").value;
  showCoefficients();
});

export function showCoefficients(again = false) {
  const found = now.found?.estimates;
  const text = JSON.stringify([found, chosen]);
  if (text === drawn && !again) return;
  drawn = text;
  for (const id of ["coefficients-words", "correlation"]) at(id).replaceChildren();
  put("coefficient-drawn", null);
  at("coefficient-said").textContent = "";
  at("coefficient-line").hidden = at("coefficients-all").hidden = !found;
  if (!found) return;
  at("coefficients-of").textContent = `of the model${found.added.length ? ` with ${found.added.join(" and ")}, found and not yet added` : ""}`;
  at("coefficients-words").append(...found.said.map((said) => element("li", said)));
  at("coefficient").replaceChildren(...found.rows.map(({ name }) => element("option", name)));
  const own = found.rows.find(({ name }) => name === chosen) ?? found.rows[0];
  at("coefficient").value = chosen = own.name;
  drawn = JSON.stringify([found, chosen]);
  at("profile").dataset.name = own.name;
  at("profile").hidden = Boolean(own.profile);
  draw(own);
  matrix(found);
  const rows = found.rows.map(({ name, words }) => [name, words.stated, words.data, words.both]);
  at("coefficients-all").lastElementChild.replaceChildren(table([["parameter", "stated", "recordings alone", "both"], ...rows]));
}

// Probability densities, each relative to its peak; with a profile, the rise of χ² below them.
function draw(own) {
  const [one, other] = colours();
  const [best, error] = own.both;
  const ends = [[own.both, 4], [own.data, 3], [own.stated, 2.5]].flatMap(([of, reach]) => (of ? [of[0] - reach * of[1], of[0] + reach * of[1]] : []));
  const low = Math.max(Math.min(...ends), best - NARROWEST * error);
  const high = Math.min(Math.max(...ends), best + NARROWEST * error);
  const range = new Bokeh.Range1d({ start: low, end: high });
  const label = own.unit ? `${own.name}, ${own.unit}` : own.name;
  const options = { height: 130, min_height: 130, sizing_mode: "stretch_both", x_range: range, tools: "xpan,xwheel_zoom,reset", active_scroll: "xwheel_zoom", toolbar_location: null };
  const above = P.figure({ ...options, title: `${own.name} = ${own.words.both}`, y_range: new Bokeh.Range1d({ start: 0, end: 1.08 }) });
  const x = Array.from({ length: 401 }, (_, k) => low + ((high - low) * k) / 400);
  const bell = ([mean, deviation]) => new Bokeh.ColumnDataSource({ data: { x, y: x.map((at) => Math.exp(-0.5 * ((at - mean) / deviation) ** 2)) } });
  if (own.usual) above.add_layout(new Bokeh.BoxAnnotation({ left: own.usual[0], right: own.usual[1], fill_color: css("--soft"), fill_alpha: 0.12, line_color: null }));
  const both = bell(own.both);
  above.varea({ field: "x" }, 0, { field: "y" }, { source: both, fill_color: one, fill_alpha: 0.25 });
  above.line({ field: "x" }, { field: "y" }, { source: both, line_color: one, line_width: 2.5, legend_label: own.stated ? "both" : "recordings" });
  if (own.stated) above.line({ field: "x" }, { field: "y" }, { source: bell(own.stated), line_color: css("--soft"), line_width: 2, line_dash: "dashed", legend_label: "stated" });
  if (own.stated && own.data) above.line({ field: "x" }, { field: "y" }, { source: bell(own.data), line_color: other, line_width: 2, line_dash: "dotdash", legend_label: "recordings alone" });
  above.yaxis.visible = false;
  above.ygrid.visible = false;
  at("coefficient-drawn").style.minHeight = own.profile ? "18rem" : "";
  const figures = [above];
  if (own.profile) {
    const below = P.figure({ ...options, title: "rise of χ², all others fitted; dashed: by the standard error", y_range: new Bokeh.Range1d({ start: 0, end: 10 }) });
    const [from, until] = own.profile.interval;
    below.add_layout(new Bokeh.BoxAnnotation({ left: from, right: until, fill_color: one, fill_alpha: 0.12, line_color: null }));
    const parabola = new Bokeh.ColumnDataSource({ data: { x, y: x.map((at) => ((at - best) / error) ** 2) } });
    below.line({ field: "x" }, { field: "y" }, { source: parabola, line_color: css("--soft"), line_width: 1.5, line_dash: "dashed" });
    const profile = new Bokeh.ColumnDataSource({ data: { x: own.profile.values, y: own.profile.rise } });
    below.line({ field: "x" }, { field: "y" }, { source: profile, line_color: one, line_width: 2.5 });
    below.add_layout(new Bokeh.Span({ location: LIMIT, dimension: "width", line_color: css("--soft") }));
    below.left[0].axis_label = "Δχ²";
    figures.push(below);
  }
  figures.at(-1).below[0].axis_label = label;
  put("coefficient-drawn", new Bokeh.Column({ children: figures.map(themed), sizing_mode: "stretch_both" }));
  above.legend.background_fill_alpha = 0.7;
  const { stated, data } = own.words;
  at("coefficient-said").textContent =
    (own.stated ? `Stated ${stated}; the recordings alone: ${data}; both: ${own.words.both}.` : `The recordings alone: ${own.words.both}; no value is stated${own.usual ? ` (usual: ${own.usual.join(" … ")} ${own.unit})` : ""}.`) +
    (own.profile ? ` 95 % interval of the profile: ${own.profile.words}.` : "");
}

const part = (colour, k) => parseInt(colour.slice(k, k + 2), 16);
const mixed = (one, other, share) => `rgb(${[1, 3, 5].map((k) => Math.round(share * part(one, k) + (1 - share) * part(other, k))).join(", ")})`;

// Correlation of the coefficients of effects and of the most correlated bench parameters.
function matrix({ names, correlation }) {
  const grid = element("table", undefined, { className: "map" });
  grid.setAttribute("aria-label", "Correlation of the estimates");
  const head = grid.createTHead().insertRow();
  head.append(element("td"));
  names.slice(0, -1).forEach((name, k) => head.append(element("th", String(k + 1), { scope: "col", ariaLabel: name })));
  const body = grid.createTBody();
  correlation.forEach((row, i) => {
    const line = body.insertRow();
    line.append(element("th", `${i + 1} ${names[i]}`, { scope: "row" }));
    row.slice(0, -1).forEach((value, k) => {
      const cell = line.insertCell();
      cell.className = "figure";
      if (k >= i) return; // each pair once
      cell.textContent = fixed(value, 2);
      cell.style.background = mixed(value > 0 ? "#D55E00" : "#0072B2", css("--card"), value ** 2);
      cell.style.color = legible(cell.style.background);
    });
  });
  at("correlation").append(element("p", "Correlation: coefficients of effects, and the most correlated bench parameters", { className: "quiet" }), grid);
}
