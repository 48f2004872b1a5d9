// How the error fell with every change of the model.

import { P, colours, now, put, themed } from "./shared.js";

let drawn = "";
export function showFall(again = false) {
  const rows = now.found?.fall ?? [];
  const text = JSON.stringify(rows);
  if (text === drawn && !again) return;
  drawn = text;
  put("fall", null);
  if (!rows.length) return;
  const figure = P.figure({
    height: 240, sizing_mode: "stretch_width", x_range: new Bokeh.FactorRange({ factors: rows.map((own) => own.what) }), y_axis_type: "log",
    tools: "", toolbar_location: null, title: rows.at(-1).fitted < rows[0].fitted ? "The error falls: χ²/N with every change; 1 is the noise floor" : "χ²/N with every change; 1 is the noise floor",
  });
  const [one, other] = colours();
  for (const [field, label, colour] of [["fitted", "fitted", one], ["unused", "not used to fit", other]]) {
    const own = rows.filter((row) => row[field] !== null);
    if (!own.length) continue;
    const source = new Bokeh.ColumnDataSource({ data: { x: own.map((row) => row.what), y: own.map((row) => row[field]) } });
    figure.line({ field: "x" }, { field: "y" }, { source, line_color: colour, line_width: 2, legend_label: label });
    figure.scatter({ field: "x" }, { field: "y" }, { source, size: 9, fill_color: colour, line_color: null, legend_label: label });
  }
  figure.add_layout(new Bokeh.Span({ location: 1, dimension: "width", line_color: "#888888", line_width: 2, line_dash: "dashed" }));
  put("fall", themed(figure));
}
