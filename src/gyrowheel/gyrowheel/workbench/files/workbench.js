// The page of the workbench: shows the state of the server, and sends what the user asks for.
// All words and tables come from the server, which escapes them; pictures are made by the parts that are imported here.

import { ask, at, dark, element, hear, now, send, tell } from "./shared.js";
import { redraw, showFound, showSignals } from "./signals.js";
import { showPredicted } from "./predicted.js";
import { showWhere } from "./where.js";
import { showFall } from "./fall.js";
import { showTable } from "./tables.js";
import { show as showRotor } from "./rotor.js";

let shown = {}; // parts as they were written last

// --- what the server says

let reading = false;
let again = false;
let heard = 0; // what of the running benches was taken
async function refresh() {
  if (reading) {
    again = true;
    return;
  }
  reading = true;
  try {
    do {
      again = false;
      now.state = await (await ask("/state")).json();
      if (now.found?.facts !== now.state.facts) now.found = await (await ask("/found")).json();
      if (heard !== now.state.heard) now.live = await (await ask("/heard")).json();
      heard = now.state.heard;
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
  for (const [name, html] of Object.entries(now.state.parts)) {
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
    const own = now.state.trouble && now.state.trouble.place === field.dataset.trouble;
    if (own) field.textContent = now.state.trouble.sentence;
    else if (!now.state.trouble && now.state.job) field.textContent = "";
  }
  showJob();
  showTable();
  await showSignals();
  showFound();
  showPredicted();
  showWhere();
  showFall();
  at("rotor-section").hidden = !now.state.signals.length;
  showRotor();
}

hear("shown", () => showPredicted());

function mark(element) {
  const data = Object.entries(element.dataset).map(([key, value]) => `[data-${key}="${CSS.escape(value)}"]`);
  return element.id ? `#${element.id}` : element.tagName.toLowerCase() + data.join("");
}

function showJob() {
  const place = at("job");
  if (!now.state.job) {
    place.replaceChildren();
    return;
  }
  const turning = element("span", undefined, { className: "turning" });
  const { title, line, part } = now.state.job;
  const text = element("span", line ? `${title}: ${line}` : title);
  const end = element("button", "End", { type: "button" });
  end.dataset.do = "end";
  const bar = part === null ? [] : [element("progress", undefined, { value: part, max: 1, ariaLabel: line })];
  place.replaceChildren(turning, text, ...bar, end);
}

document.addEventListener("click", async (event) => {
  const button = event.target.closest("button[data-do]");
  if (!button) return;
  const { do: name, ...content } = button.dataset;
  const place = { open: "recordings", close: "recordings", undo: "model", demonstrate: "recordings", test: "test", drop_table: "table" }[name] ?? "missing";
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
  const place = { save: "save", map_table: "table" }[form.dataset.do] ?? "formula";
  try {
    tell(place, "");
    await send(form.dataset.do, Object.fromEntries(new FormData(form, event.submitter)));
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

dark.addEventListener("change", () => {
  redraw();
  showPredicted(true);
  showWhere(true);
  showFall(true);
});

listen();
