// What all parts of the page use: the server, the theme, and the place where a picture is put.

export const P = Bokeh.Plotting;
export const at = (id) => document.getElementById(id);
export const dark = window.matchMedia("(prefers-color-scheme: dark)");
export const still = window.matchMedia("(prefers-reduced-motion: reduce)");
const COLOURS = ["#0072B2", "#D55E00"]; // blue and vermilion, which people with any colour vision distinguish
const SIGHT = ["#56B4E9", "#E69F00"]; // the same on dark ground

// What the server says: its state, what was found, and the holds of running benches.
export const now = { state: null, found: null, live: {} };
// Carries what one part of the page tells the others: "cursor", "shown", "windows", "layout".
export const wire = new EventTarget();
export const say = (name, detail) => wire.dispatchEvent(new CustomEvent(name, { detail }));
export const hear = (name, listener) => wire.addEventListener(name, (event) => listener(event.detail));

async function reach(path, options) {
  try {
    return await fetch(path, options);
  } catch (error) {
    throw error.name === "AbortError" ? error : new Error("the server does not answer");
  }
}

export async function ask(path, options) {
  const answer = await reach(path, options);
  if (answer.status === 401) location.reload();
  if (!answer.ok) throw new Error((await answer.json()).error);
  return answer;
}

export async function send(name, content) {
  const answer = await reach(`/do/${name}`, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(content),
  });
  const result = await answer.json();
  if (!answer.ok) throw new Error(result.error);
  return result;
}

// The field of a place for what is said of an error: that of the page, where the place has none or it is not in sight.
export function troubleField(place) {
  const own = [...document.querySelectorAll("[data-trouble]")].find((each) => each.dataset.trouble === place);
  return own && !own.closest("[hidden]") ? own : at("trouble");
}

export function tell(place, sentence) {
  const field = troubleField(place);
  if (!sentence) at("trouble").textContent = "";
  field.textContent = sentence;
  delete field.dataset.said; // it is not the server's
}

// What this page keeps over a reload, where the browser lets it.
export function remember(name, value) {
  try {
    sessionStorage.setItem(name, JSON.stringify(value));
  } catch {
    // then not
  }
}
export function remembered(name) {
  try {
    return JSON.parse(sessionStorage.getItem(name));
  } catch {
    return null;
  }
}

export const colours = () => (dark.matches ? SIGHT : COLOURS);
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Black or white, whichever stands out more from a colour "rgb(r, g, b)".
export function legible(colour) {
  const [r, g, b] = colour.match(/[0-9.]+/g).map((part) => {
    const value = Number(part) / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.179 ? "#000000" : "#ffffff";
}

// Offers the names that begin as the last word of a formula does, each with its unit.
export function complete(field, list, names) {
  const [word] = field.value.match(/[A-Za-z_]\w*$/) ?? [""];
  const before = field.value.slice(0, field.value.length - word.length);
  const fit = word ? Object.entries(names).filter(([name]) => name.startsWith(word) && name !== word) : [];
  list.replaceChildren(...fit.map(([name, unit]) => element("option", `${name}, ${unit}`, { value: before + name })));
}

// A number in digits, without the sign of what is rounded to nothing.
export const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "").replace("-", "−");

export function element(tag, text, properties = {}) {
  const made = Object.assign(document.createElement(tag), properties);
  if (text !== undefined) made.textContent = text;
  return made;
}

export function themed(figure) {
  const [card, ink, soft, line] = ["--card", "--ink", "--soft", "--line"].map(css);
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

// Every figure of Bokeh listens here for a change of the resolution and never ends that, so that each one that is replaced
// would stay in memory: one listener does the same for all that are there.
if (window.visualViewport) {
  visualViewport.addEventListener("resize", () => {
    for (const view of Bokeh.index.all_views()) if (view.canvas?.resize?.()) view.request_repaint();
  });
  visualViewport.addEventListener = () => {};
}

// Shows a layout in a place, and forgets the one that was there.
const drawn = {};
export function put(place, layout) {
  const old = drawn[place];
  if (old) {
    Bokeh.documents.splice(Bokeh.documents.indexOf(old.document), 1);
    // not while it is being drawn; its notifications are a view that Bokeh keeps when the document is cleared
    old.ready.finally(() => (old.document.clear(), old.document.views_manager.clear()));
    delete drawn[place];
  }
  at(place).replaceChildren();
  if (!layout) return;
  // each in a frame of its own: one that is still being drawn while another takes its place has no place any more
  const frame = element("div", undefined, { className: "frame" });
  at(place).append(frame);
  const ready = P.show(layout, frame);
  drawn[place] = { document: Bokeh.documents.at(-1), ready };
}

// Shows columns of figures in a place.
export function arrange(place, columns) {
  const children = columns.map((own) => new Bokeh.Column({ children: own.map(themed), sizing_mode: "stretch_both" }));
  put(place, new Bokeh.Row({ children, spacing: 8, sizing_mode: "stretch_both" }));
}

// A table of texts, its first row as head.
export function table(rows) {
  const made = element("table");
  rows.forEach((cells, k) => {
    const line = (k ? made.tBodies[0] ?? made.createTBody() : made.createTHead()).insertRow();
    for (const text of cells) line.append(element(k ? "td" : "th", text, { className: "figure" }));
  });
  const frame = element("div", undefined, { className: "scroll" });
  frame.append(made);
  return frame;
}
