// The page of the workbench: shows the state of the server, and sends what the user asks for.
// All words and tables come from the server, which escapes them; pictures are made by the parts that are imported here.

import { ask, at, complete, dark, element, hear, now, remember, remembered, send, tell, troubleField } from "./shared.js";
import "./layout.js";
import { showLive } from "./live.js";
import { redraw, showFound, showSignals } from "./signals.js";
import { showPredicted } from "./predicted.js";
import { showWindows } from "./windows.js";
import { showWhere } from "./where.js";
import { showResidual } from "./residual.js";
import { showCoefficients } from "./coefficients.js";
import { showFall } from "./fall.js";
import { showTable } from "./tables.js";
import { show as showRotor } from "./rotor.js";

const SILENT = 40e3; // ms without a word from the server, which says something every 15 s

let shown = {}; // parts as they were written last
let waiting = {}; // by part: what had the focus until it could not be pressed
let pressed = false; // whether a pointer is down on what takes a click

// --- what the server says

let reading = false;
let again = false;
let heard = "[]"; // what of the running benches was taken
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
      const holds = JSON.stringify(now.state.heard);
      if (heard !== holds) now.live = await (await ask("/heard")).json();
      heard = holds;
      await show();
    } while (again);
  } catch (error) {
    console.warn(error.message);
  } finally {
    reading = false;
  }
}

let events = null;
let silence = 0;
function listen() {
  events?.close();
  clearTimeout(silence);
  if (document.hidden) return; // a browser keeps few connections to a server: a page that nobody sees leaves its own
  const own = (events = new EventSource("/events"));
  const hush = () => {
    clearTimeout(silence);
    silence = setTimeout(() => {
      at("lost").hidden = false;
      listen();
    }, SILENT);
  };
  hush();
  own.onmessage = () => {
    at("lost").hidden = true;
    hush();
    refresh();
  };
  own.onerror = () => {
    at("lost").hidden = false;
    if (own.readyState !== EventSource.CLOSED) return; // the browser tries again by itself
    refresh(); // asks for the token where the server wants one now
    setTimeout(listen, 2000);
  };
}

document.addEventListener("visibilitychange", listen);

// --- words and tables

async function show() {
  writeParts();
  showJob();
  await showSignals();
  showFound();
  showPredicted();
  showWindows();
  showWhere();
  showResidual();
  showCoefficients();
  showFall();
  showRotor();
  showLive();
}

// Writes the parts that have changed; not between the press and the release of a click, which would be lost.
function writeParts() {
  if (pressed || !now.state) return;
  for (const [name, html] of Object.entries(now.state.parts)) {
    if (shown[name] === html) continue;
    const place = at(`part-${name}`);
    const active = document.activeElement;
    const focus = place.contains(active) ? mark(active) : active === document.body ? waiting[name] : null;
    const range = focus && active.selectionStart != null ? [active.selectionStart, active.selectionEnd] : null;
    const open = [...place.querySelectorAll("details")].map((d) => d.open);
    const typed = [...place.querySelectorAll("[data-keep]")].map(({ id, value, dataset }) => [id, dataset.keep, value]);
    const said = new Map([...place.querySelectorAll("[data-trouble]")].map((own) => [own.dataset.trouble, own]));
    place.innerHTML = html;
    place.querySelectorAll("details").forEach((d, k) => (d.open = open[k] ?? d.open));
    for (const [id, keep, value] of typed) {
      const field = at(id);
      if (field?.dataset.keep !== keep) continue;
      field.value = value;
      if (field.selectedIndex < 0) field.selectedIndex = 0; // that choice is gone
    }
    for (const field of place.querySelectorAll("[data-trouble]")) {
      const before = said.get(field.dataset.trouble);
      if (before?.textContent) field.replaceWith(before);
    }
    const target = focus && place.querySelector(focus);
    target?.focus({ preventScroll: true });
    if (range) target?.setSelectionRange?.(...range); // what is typed next goes where it would have gone
    waiting[name] = target?.disabled ? focus : null;
    shown[name] = html;
  }
  filter();
  // a pane scrolls as a whole: its tables are no stops of their own for Tab
  for (const own of document.querySelectorAll(".scroll[tabindex]")) own.removeAttribute("tabindex");
  showTrouble();
  showTable();
}

// --- the list of recordings: those that are open stay, of the others those whose words are all in the filter

at("filter").addEventListener("input", filter);
function filter() {
  const words = at("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  const rows = [...document.querySelectorAll("#part-recordings li[data-words]")];
  let left = 0;
  for (const row of rows) {
    row.hidden = !words.every((word) => row.dataset.words.toLowerCase().includes(word));
    left += !row.hidden;
  }
  at("filter-line").hidden = rows.length < 6 && !words.length;
  at("filter-said").textContent = words.length ? `${left} of ${rows.length}` : "";
}

addEventListener("pointerdown", (event) => (pressed = event.button === 0 && Boolean(event.target.closest?.("button, a, summary"))), true);
for (const name of ["pointerup", "pointercancel", "blur"]) {
  const released = (event) => {
    if (!pressed || (name === "blur" && event.target !== window)) return; // the window, not something in it
    pressed = false;
    setTimeout(writeParts); // after the click
  };
  addEventListener(name, released, true);
}

// What the server says of an error, next to its cause; announced once to those who listen.
function showTrouble() {
  const { trouble, job } = now.state;
  const target = trouble && troubleField(trouble.place);
  for (const field of document.querySelectorAll("[data-trouble]")) {
    if (field === target) {
      if (field.textContent !== trouble.sentence) field.textContent = trouble.sentence;
      field.dataset.said = "by the server";
    } else if (field.dataset.said || (!trouble && job)) {
      field.textContent = "";
      delete field.dataset.said;
    }
  }
}

hear("shown", () => showPredicted());

function mark(element) {
  const data = Object.entries(element.dataset).map(([key, value]) => `[data-${key}="${CSS.escape(value)}"]`);
  return element.id ? `#${CSS.escape(element.id)}` : element.tagName.toLowerCase() + data.join("");
}

// Changed in place, so that End keeps the focus and takes a click at any time.
function showJob() {
  const place = at("job");
  const { job } = now.state;
  if (!job) {
    place.replaceChildren();
    return;
  }
  if (!place.childElementCount) {
    const end = element("button", "End", { type: "button" });
    end.dataset.do = "end";
    const bar = element("progress", undefined, { max: 1 });
    place.replaceChildren(element("span", undefined, { className: "turning" }), element("span"), bar, end);
  }
  const [, words, bar] = place.children;
  const text = job.line ? `${job.title}: ${job.line}` : job.title;
  if (words.textContent !== text) words.textContent = text;
  bar.hidden = job.part === null;
  bar.value = job.part ?? 0;
  bar.ariaLabel = job.line || job.title;
}

document.addEventListener("click", async (event) => {
  const button = event.target.closest("button[data-do]");
  if (!button) return;
  const { do: name, ...content } = button.dataset;
  const place = ["open", "close", "follow"].includes(name) ? `open ${content.key}` : { drop_table: "table", estimate: "coefficients", profile: "coefficients" }[name] ?? "page";
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
  const place = { map_table: "table", add_formula: "formula", use: "range", other: "residual", derive: "derive", walk: "live", setpoint: "setpoint" }[form.dataset.do] ?? "page";
  try {
    tell(place, "");
    await send(form.dataset.do, Object.fromEntries(new FormData(form, event.submitter)));
  } catch (error) {
    tell(place, error.message);
  }
});

let typing = 0;
at("formula").addEventListener("input", () => {
  remember("formula", at("formula").value);
  clearTimeout(typing);
  typing = setTimeout(checkFormula, 250);
  complete(at("formula"), at("formula-names"), JSON.parse(at("formula").dataset.names));
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
  showWindows(true);
  showWhere(true);
  showResidual(true);
  showCoefficients(true);
  showFall(true);
});

at("formula").value = remembered("formula") ?? "";
checkFormula();
listen();
