// Two pictures side by side in a pane: the same picture, each of a model or a recording of its own, on the same axes.

import { at, element, now } from "./shared.js";

const PRESENT = "model as it is";

// What a picture can be of: { title, model (null: the present one), key of a recording (null: of all) }, by its name.
function choices() {
  const w = now.found?.windows;
  if (!w) return new Map();
  const keys = [...new Set(w.recording)];
  const name = (key) => now.state.signals.find((own) => own.key === key)?.name ?? key;
  return new Map([
    ["now", { title: PRESENT, model: null, key: null }],
    ...Object.keys(w.others).map((model) => [`model ${model}`, { title: `model: ${model}`, model, key: null }]),
    ...(keys.length > 1 ? keys.map((key) => [`recording ${key}`, { title: `recording: ${name(key)}`, model: null, key }]) : []),
  ]);
}

// The windows of a side, of those given.
export const ofSide = (side, order) => order.filter((k) => side.key === null || now.found.windows.recording[k] === side.key);

// The results of a side: those of its model.
export const leftBy = (side, own) => (side.model === null ? own : { ...own, ...own.others[side.model] });

// Makes the choice of the sides of a pane in a line of it; `redraw` is called when it changes.
export function makeSides(pane, redraw) {
  const place = at(`${pane}-sides`);
  const button = element("button", "Side by side", { type: "button" });
  button.setAttribute("aria-pressed", "false");
  const fields = ["left", "right"].map((which) => {
    const label = element("label", which, { htmlFor: `${pane}-${which}` });
    const select = element("select", undefined, { id: label.htmlFor });
    const both = element("span", undefined, { hidden: true });
    both.append(label, " ", select);
    select.addEventListener("change", redraw);
    return { both, select };
  });
  place.append(button, ...fields.flatMap(({ both }) => [" ", both]));
  let split = false;
  button.addEventListener("click", () => {
    split = !split;
    redraw();
  });
  // Returns the sides to draw: one of all, or two. `possible`: whether what is drawn can be split.
  return (possible = true) => {
    const all = choices();
    const names = [...all.keys()];
    place.hidden = !possible || names.length < 2;
    const two = split && !place.hidden;
    button.setAttribute("aria-pressed", String(two));
    fields.forEach(({ both, select }, k) => {
      both.hidden = !two;
      const entries = JSON.stringify([...all].map(([name, { title }]) => [name, title]));
      if (select.dataset.shown === entries) return;
      select.dataset.shown = entries;
      const before = select.value;
      select.replaceChildren(...[...all].map(([value, { title }]) => element("option", title, { value })));
      // at first a change of the model: before, and after; without one the first recordings
      const others = names.slice(1);
      const first = others[0]?.startsWith("model") ? [others[0], "now"] : others;
      select.value = all.has(before) ? before : (first[k] ?? "now");
    });
    return two ? fields.map(({ select }) => all.get(select.value)) : [{ title: "", model: null, key: null }];
  };
}
