// Torques and voltages of the holds, measured and predicted, over time, tilt and spin rate.

import { reveal } from "./layout.js";
import { P, at, colours, css, element, hear, now, put, table, themed } from "./shared.js";
import { shown } from "./signals.js";
import { pick, within } from "./windows.js";

const UNITS = { torque: ["torque, mN·m", "torque"], voltage: ["change of voltage, mV", "voltage"] };
let quantity = "torque";
let of = "recording"; // or the key of a running bench
let drawn = "";
let listed = null; // what there is to list of the holds
let sources = []; // of the pictures, one an actuator
let mirroring = false; // while a choice of another pane is shown

document.addEventListener("click", (event) => {
  const button = event.target.closest("[data-of], [data-live]");
  if (!button) return;
  of = button.dataset.of ?? button.dataset.live;
  showPredicted();
  if (button.dataset.live) reveal("holds");
});

// A button for the recording, and one for each running bench that has holds.
function choices(running) {
  const titles = { recording: "recording", ...Object.fromEntries(running.map((key) => [key, now.state.live[key].title])) };
  const place = at("of");
  place.hidden = !running.length;
  const text = JSON.stringify(titles);
  if (place.dataset.shown !== text) {
    place.dataset.shown = text;
    place.replaceChildren(...Object.entries(titles).map(([key, title]) => {
      const button = element("button", title, { type: "button" });
      button.dataset.of = key;
      return button;
    }));
  }
  for (const button of place.children) button.setAttribute("aria-pressed", String(button.dataset.of === of));
}

for (const button of at("quantity").querySelectorAll("button")) {
  button.addEventListener("click", () => {
    quantity = button.dataset.quantity;
    showPredicted();
  });
}

export function showPredicted(again = false) {
  for (const button of at("quantity").querySelectorAll("button")) {
    button.setAttribute("aria-pressed", String(button.dataset.quantity === quantity));
  }
  const running = Object.keys(now.state.live).filter((key) => now.live[key]);
  if (!running.includes(of)) of = "recording";
  choices(running);
  const live = of !== "recording";
  const key = live ? of : shown()?.key;
  const holds = live ? now.live[key] : now.found?.holds[key];
  at("predicted-by").textContent = live ? "Predicted by the drag estimator of the running graph." : "";
  const mark = JSON.stringify([key, quantity, holds]);
  if (mark === drawn && !again) return;
  drawn = mark;
  at("predicted-none").hidden = Boolean(holds);
  at("quantity").hidden = at("predicted").hidden = !holds;
  listed = holds ? { holds, live, key } : null;
  list();
  if (!holds) {
    at("signs").replaceChildren();
    at("predicted-said").replaceChildren();
    return put("predicted", null);
  }
  const [one, other] = colours();
  const soft = css("--soft");
  const signs = [["●", one, "measured"], ["✕", other, "predicted"], ["✚", soft, "predicted before the last change"]];
  at("signs").replaceChildren(
    ...signs.slice(0, holds.actuators[0][quantity].before ? 3 : 2).map(([sign, colour, title]) => {
      const entry = element("span");
      const drawnSign = element("span", sign);
      drawnSign.style.color = colour;
      entry.append(drawnSign, ` ${title}`);
      return entry;
    }),
  );
  sources = holds.actuators.map((actuator) => {
    const { measured, error, predicted, before } = actuator[quantity];
    return new Bokeh.ColumnDataSource({
      data: {
        time: holds.start.map((start, k) => 0.5 * (start + holds.end[k])), tilt: holds.tilt, speed: holds.speed, measured, predicted,
        before: before ?? measured.map(() => NaN), low: measured.map((value, k) => value - error[k]), high: measured.map((value, k) => value + error[k]),
      },
    });
  });
  const axes = [["time", "time, s"], ["tilt", holds.tilt_title], ["speed", "spin rate, rpm"]];
  const ranges = axes.map(() => new Bokeh.DataRange1d());
  const children = [];
  holds.actuators.forEach((actuator, row) => {
    const source = sources[row];
    axes.forEach(([field, title], column) => {
      const last = row === holds.actuators.length - 1;
      const figure = P.figure({
        height: last ? 150 : 120, sizing_mode: "stretch_both", tools: "tap,pan,wheel_zoom,reset", toolbar_location: null, x_range: ranges[column],
        title: column ? "" : `${actuator.title}, ${UNITS[quantity][0].split(", ").at(-1)}`, // the quantity is that of the button
      });
      if (last) figure.below[0].setv({ axis_label: title, axis_label_text_font_size: "11px" }); // three stand side by side
      figure.below[0].ticker.desired_num_ticks = figure.left[0].ticker.desired_num_ticks = 3;
      figure.min_border_left = 40;
      const x = { field };
      figure.segment(x, { field: "low" }, x, { field: "high" }, { source, line_color: one, line_width: 1 });
      figure.scatter(x, { field: "measured" }, { source, size: 7, fill_color: one, line_color: null, nonselection_alpha: 0.25 });
      if (actuator[quantity].before) {
        figure.scatter(x, { field: "before" }, {
          source, size: 8, marker: "cross", line_color: soft, line_width: 1.5,
        });
      }
      figure.scatter(x, { field: "predicted" }, {
        source, size: 9, marker: "x", line_color: other, line_width: 2, nonselection_alpha: 0.25,
      });
      children.push([themed(figure), row, column]);
    });
    source.selected.properties.indices.change.connect(() => {
      const [k] = source.selected.indices;
      if (k !== undefined && !live && !mirroring) look(key, holds, k);
    });
  });
  put("predicted", new Bokeh.GridBox({ children, sizing_mode: "stretch_both", spacing: 4 }));
  at("predicted-said").replaceChildren(
    ...holds.actuators.map((actuator) => element("li", `${actuator.title}: ${actuator.said.replace("SE", "standard errors")}`)),
    element("li", holds.calibrated
      ? "The constants of coils and motor were calibrated from recordings."
      : "The constants of coils and motor are those stated for the bench; the error bars include their uncertainty."),
  );
}

// Shows the samples of a hold, and chooses its windows in all panes.
async function look(key, holds, k) {
  const [start, end] = [holds.start[k], holds.end[k]];
  const margin = 0.25 * (end - start) + 0.1;
  pick(within(key, start, end), [key, start - margin, end + margin]);
  mirror((hold) => hold === k);
}

// Marks the holds for which a test is true.
function mirror(test) {
  mirroring = true;
  for (const source of sources) source.selected.indices = [...source.data.time.keys()].filter(test);
  mirroring = false;
}
hear("windows", (spans) => {
  if (!listed || listed.live) return;
  const { holds, key } = listed;
  const own = spans[key] ?? [];
  mirror((k) => own.some(([start, end]) => start < holds.end[k] && end > holds.start[k]));
});

// The same holds as numbers, with a button for each: for the keyboard, and for who does not see the pictures.
function list() {
  const place = at("holds");
  place.hidden = !listed;
  if (!listed || !place.open) return place.lastElementChild.replaceChildren();
  const { holds, live, key } = listed;
  const unit = UNITS[quantity][0].split(", ")[1];
  const figure = (value, digits = 3) => (value === null ? "none" : value.toFixed(digits));
  const made = table([
    ["hold", "time, s", "tilt x, °", "tilt y, °", "rpm", ...holds.actuators.flatMap(({ title }) => [`${title} measured, ${unit}`, "predicted"])],
    ...holds.hold.map((number, k) => [
      String(number), figure(0.5 * (holds.start[k] + holds.end[k]), 1), figure(holds.tilt_x[k], 2), figure(holds.tilt_y[k], 2), figure(holds.speed[k], 0),
      ...holds.actuators.flatMap(({ [quantity]: own }) => [`${figure(own.measured[k])} ± ${figure(own.error[k])}`, figure(own.predicted[k])]),
    ]),
  ]);
  if (!live) {
    [...(made.querySelector("tbody")?.rows ?? [])].forEach((row, k) => {
      const button = element("button", row.cells[0].textContent, { type: "button", ariaLabel: `hold ${row.cells[0].textContent}: show its samples` });
      button.onclick = () => look(key, holds, k);
      row.cells[0].replaceChildren(button);
    });
  }
  place.lastElementChild.replaceChildren(made);
}
at("holds").addEventListener("toggle", list);
