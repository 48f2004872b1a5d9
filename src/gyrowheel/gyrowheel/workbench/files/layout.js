// The panes: columns of stacks, a stack of tabs. Each of the four steps of the work has its own arrangement, which this
// browser keeps. Everything that the mouse does, the keys do: tabs with arrows, borders with arrows, a menu to move.

import { at, element, say } from "./shared.js";

const KEPT = "gyrowheel-layout-1"; // another number when older arrangements do not fit any more
const LEAST = 0.12; // of the room, for a column or a stack
const FINE = 0.03; // of the room, a step of a border by key
const STEPS = {
  look: [[3, [1, "signals", "live"]], [2, [1, "rotor"], [1, "holds"]]],
  where: [[1, [3, "where"], [2, "map"]], [1, [1, "signals"], [1, "chosen", "residual"]]],
  what: [[1, [1, "missing", "coefficients", "formula"]], [1, [1, "residual", "where", "map"], [1, "signals", "chosen"]]],
  proof: [[1, [1, "error"], [1, "holds", "coefficients"]], [1, [1, "residual"], [1, "where", "signals"]]],
};
const sections = Object.fromEntries([...at("store").children].map((pane) => [pane.id.slice("pane-".length), pane]));
const titles = Object.fromEntries(Object.entries(sections).map(([name, pane]) => [name, pane.dataset.title]));
const narrow = matchMedia("(max-width: 64rem)");

const fresh = (step) =>
  STEPS[step].map(([size, ...stacks]) => ({ size, stacks: stacks.map(([own, ...panes]) => ({ size: own, panes, active: panes[0] })) }));
let step = "look";
let layouts = {};
let front = {}; // in a narrow window, where a column is one stack: the pane of each that was looked at last

const columns = () => layouts[step];
const stackOf = (pane) => columns().flatMap((column) => column.stacks).find((stack) => stack.panes.includes(pane));
const open = () => columns().flatMap((column) => column.stacks).flatMap((stack) => stack.panes);

// --- kept in the browser; what does not fit this version is made again

function valid(kept) {
  const size = (own) => Number.isFinite(own.size) && own.size > 0;
  const stack = (own) => size(own) && own.panes.length > 0 && own.panes.every((pane) => pane in titles) && own.panes.includes(own.active);
  const all = kept.flatMap((column) => column.stacks.flatMap((own) => own.panes));
  return all.length > 0 && new Set(all).size === all.length && kept.every((column) => size(column) && column.stacks.length > 0 && column.stacks.every(stack));
}

function load() {
  let kept = {};
  try {
    kept = JSON.parse(localStorage.getItem(KEPT)) ?? {};
  } catch {
    // none, or none that can be read
  }
  for (const name of Object.keys(STEPS)) {
    layouts[name] = fresh(name);
    try {
      if (valid(kept.layouts[name])) layouts[name] = kept.layouts[name];
    } catch {
      // of another shape
    }
  }
  if (kept.step in STEPS) step = kept.step;
  if (Number.isFinite(kept.aside)) at("desk").style.setProperty("--aside", `${kept.aside}px`);
  at("desk").classList.toggle("alone", kept.alone === true);
}

function save() {
  const aside = parseFloat(at("desk").style.getPropertyValue("--aside"));
  try {
    localStorage.setItem(KEPT, JSON.stringify({ step, layouts, aside: aside || null, alone: at("desk").classList.contains("alone") }));
  } catch {
    // then not
  }
}

// --- what others ask for

export function go(name) {
  step = name;
  build();
}

// Shows a pane, in its stack or, where it is closed, in the last one.
export function reveal(pane) {
  const stack = stackOf(pane);
  if (stack) stack.active = pane;
  else put(pane, columns().at(-1).stacks.at(-1));
  front[columns().findIndex((column) => column.stacks.includes(stackOf(pane)))] = pane;
  build();
}

// Takes a pane away; the place that it leaves goes to its neighbours.
export function close(pane) {
  if (open().length === 1 || !stackOf(pane)) return;
  take(pane);
  build();
}

function put(pane, stack, place = stack.panes.length) {
  stack.panes.splice(place, 0, pane);
  stack.active = pane;
}

function take(pane) {
  const stack = stackOf(pane);
  if (!stack) return;
  stack.panes = stack.panes.filter((own) => own !== pane);
  if (stack.active === pane) stack.active = stack.panes[0];
  for (const column of columns()) column.stacks = column.stacks.filter((own) => own.panes.length);
  layouts[step] = columns().filter((column) => column.stacks.length);
}

// Moves a pane next to a stack, above or below it, or among its tabs.
function move(pane, stack, side) {
  const whole = stackOf(pane);
  const column = columns().find((own) => own.stacks.includes(stack));
  const aside = side === "left" || side === "right";
  if (whole === stack && (side === "in" || (stack.panes.length === 1 && !(aside && column.stacks.length > 1)))) return;
  if (side === "in") {
    take(pane);
    put(pane, stack);
  } else {
    const alone = () => ({ size: 1, panes: [pane], active: pane });
    take(pane);
    if (side === "above" || side === "below") {
      const made = { ...alone(), size: stack.size / 2 };
      stack.size /= 2;
      column.stacks.splice(column.stacks.indexOf(stack) + (side === "below"), 0, made);
    } else {
      const made = { size: column.size / 2, stacks: [alone()] };
      column.size /= 2;
      columns().splice(columns().indexOf(column) + (side === "right"), 0, made);
    }
  }
  build();
  tab(pane)?.focus();
}

// --- drawing

const tab = (pane) => document.querySelector(`[role="tab"][data-pane="${pane}"]`);

function build() {
  const focused = document.activeElement;
  const root = at("panes");
  for (const pane of root.querySelectorAll("section.pane")) at("store").append(pane);
  root.replaceChildren();
  const upright = narrow.matches;
  columns().forEach((column, c) => {
    if (c) root.append(border(upright ? "horizontal" : "vertical", columns(), c, root, "of the columns"));
    const place = element("div", undefined, { className: "column" });
    place.style.flexGrow = column.size;
    root.append(place);
    // a narrow window has the stacks of a column as one
    const panes = column.stacks.flatMap((own) => own.panes);
    const shown = panes.includes(front[c]) ? front[c] : column.stacks[0].active;
    const stacks = upright ? [{ size: 1, panes, active: shown, column: c }] : column.stacks;
    stacks.forEach((stack, s) => {
      if (s) place.append(border("horizontal", stacks, s, place, "of the panes"));
      place.append(draw(stack));
    });
  });
  for (const button of at("steps").children) button.setAttribute("aria-pressed", String(button.dataset.step === step));
  save();
  if (focused && document.contains(focused) && focused !== document.activeElement) focused.focus({ preventScroll: true });
  say("layout");
}

function draw(stack) {
  const place = element("div", undefined, { className: "stack" });
  place.style.flexGrow = stack.size;
  const head = element("div", undefined, { className: "tabs" });
  const list = element("div");
  list.setAttribute("role", "tablist");
  list.setAttribute("aria-label", "Panes");
  for (const pane of stack.panes) {
    const own = element("button", titles[pane], { type: "button", id: `tab-${pane}`, draggable: true });
    own.dataset.pane = pane;
    own.setAttribute("role", "tab");
    own.setAttribute("aria-controls", `pane-${pane}`);
    own.addEventListener("click", () => choose(stack, pane));
    own.addEventListener("dragstart", (event) => {
      event.dataTransfer.setData("text/x-pane", pane);
      event.dataTransfer.effectAllowed = "move";
    });
    list.append(own);
    const section = sections[pane];
    section.setAttribute("role", "tabpanel");
    section.setAttribute("aria-labelledby", own.id);
    section.tabIndex = 0; // it may have to be scrolled by key
    place.append(section);
  }
  list.addEventListener("keydown", (event) => walk(event, stack));
  head.append(list, menu(stack));
  place.prepend(head);
  dropping(place, stack);
  mark(place, stack);
  return place;
}

function mark(place, stack) {
  for (const own of place.querySelectorAll('[role="tab"]')) {
    const chosen = own.dataset.pane === stack.active;
    own.setAttribute("aria-selected", String(chosen));
    own.tabIndex = chosen ? 0 : -1;
    sections[own.dataset.pane].hidden = !chosen;
  }
}

function choose(stack, pane) {
  if (stack.column !== undefined) front[stack.column] = pane;
  stack.active = pane;
  const real = stackOf(pane);
  real.active = pane;
  mark(tab(pane).closest(".stack"), stack);
  save();
  say("layout");
}

function walk(event, stack) {
  const k = stack.panes.indexOf(event.target.dataset.pane);
  const to = { ArrowRight: k + 1, ArrowLeft: k - 1, Home: 0, End: stack.panes.length - 1 }[event.key];
  if (k < 0 || event.altKey || event.ctrlKey) return;
  if (event.key === "Delete") return void close(event.target.dataset.pane);
  if (to === undefined) return;
  event.preventDefault();
  const pane = stack.panes[(to + stack.panes.length) % stack.panes.length];
  choose(stack, pane);
  tab(pane).focus();
}

// A menu of a stack: panes to open here, and ways to move the one in front.
let menus = 0;
function menu(stack) {
  const id = `menu-${++menus}`;
  const button = element("button", "⋯", { type: "button", className: "plain", ariaLabel: `Arrange ${titles[stack.active]}` });
  const list = element("div", undefined, { className: "menu", id, popover: "auto" });
  button.popoverTargetElement = list;
  list.addEventListener("beforetoggle", (event) => {
    if (event.newState !== "open") return;
    const pane = stack.active;
    const home = stackOf(pane); // in a narrow window the stack that is shown is not the one that is kept
    const column = columns().find((own) => own.stacks.includes(home));
    const entry = (text, act) => {
      const own = element("button", text, { type: "button", className: "plain" });
      own.addEventListener("click", () => {
        list.hidePopover();
        act();
      });
      return own;
    };
    const ways = [["left", "to a new column at the left"], ["right", "to a new column at the right"], ["above", "above the others here"], ["below", "below the others here"]];
    const others = columns().flatMap((column) => column.stacks).filter((own) => own !== home);
    list.replaceChildren(
      element("p", titles[pane], { className: "kicker" }),
      ...ways.slice(0, home.panes.length > 1 ? 4 : column.stacks.length > 1 ? 2 : 0).map(([side, words]) => entry(`Move ${words}`, () => move(pane, home, side))),
      ...others.map((own) => entry(`Move to ${own.panes.map((each) => titles[each]).join(", ")}`, () => move(pane, own, "in"))),
      ...(open().length > 1 ? [entry("Close", () => close(pane))] : []),
      element("p", "Open here", { className: "kicker" }),
      ...Object.keys(titles)
        .filter((own) => !home.panes.includes(own) && (own !== "table" || sections.table.dataset.there))
        .map((own) => entry(titles[own], () => {
          take(own);
          put(own, columns().flatMap((column) => column.stacks).includes(home) ? home : columns().at(-1).stacks.at(-1));
          front[columns().findIndex((column) => column.stacks.includes(home))] = own;
          build();
          tab(own).focus();
        })),
      entry("Restore this step's arrangement", () => {
        layouts[step] = fresh(step);
        front = {};
        build();
        tab(open()[0]).focus();
      }),
    );
    const box = button.getBoundingClientRect();
    list.style.right = `${innerWidth - box.right}px`;
    list.style.top = `${box.bottom}px`;
    list.style.maxHeight = `${innerHeight - box.bottom - 8}px`;
  });
  const place = element("span", undefined, { className: "arrange" });
  place.append(button, list);
  return place;
}

// A tab that is dropped in the middle of a stack joins it; near an edge it splits it.
function dropping(place, stack) {
  const side = (event) => {
    const box = place.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    if (narrow.matches) return "in";
    if (y < 0.12) return "in"; // the tabs
    const [near, name] = [[x, "left"], [1 - x, "right"], [y, "above"], [1 - y, "below"]].sort(([a], [b]) => a - b)[0];
    return near < 0.25 ? name : "in";
  };
  place.addEventListener("dragover", (event) => {
    if (!event.dataTransfer.types.includes("text/x-pane")) return;
    event.preventDefault();
    place.dataset.drop = side(event);
  });
  place.addEventListener("dragleave", (event) => {
    if (!place.contains(event.relatedTarget)) delete place.dataset.drop;
  });
  place.addEventListener("drop", (event) => {
    const pane = event.dataTransfer.getData("text/x-pane");
    if (!(pane in titles)) return;
    event.preventDefault();
    delete place.dataset.drop;
    move(pane, stackOf(stack.active), side(event));
  });
}

// --- borders between two neighbours

function border(way, list, k, place, what) {
  const own = element("div", undefined, { className: `border ${way}`, tabIndex: 0 });
  own.setAttribute("role", "separator");
  own.setAttribute("aria-orientation", way);
  own.setAttribute("aria-label", `Border ${k} ${what}`);
  const whole = () => list.reduce((sum, each) => sum + each.size, 0);
  const before = () => list.slice(0, k).reduce((sum, each) => sum + each.size, 0) / whole();
  const show = () => own.setAttribute("aria-valuenow", String(Math.round(100 * before())));
  const shift = (part) => {
    const [one, other] = [list[k - 1], list[k]];
    const both = one.size + other.size;
    const least = Math.min(LEAST * whole(), 0.4 * both);
    one.size = Math.min(Math.max(one.size + part * whole(), least), both - least);
    other.size = both - one.size;
    own.previousElementSibling.style.flexGrow = one.size;
    own.nextElementSibling.style.flexGrow = other.size;
    show();
    save();
  };
  dragged(own, way, (moved) => shift(moved / (way === "vertical" ? place.clientWidth : place.clientHeight)), (steps) => shift(FINE * steps));
  show();
  return own;
}

// Calls `by` with the distance in pixels that a border is dragged, and `key` with the steps that it is moved by key.
function dragged(own, way, by, key) {
  const along = (event) => (way === "vertical" ? event.clientX : event.clientY);
  let last = 0;
  own.addEventListener("pointerdown", (event) => {
    own.setPointerCapture(event.pointerId);
    last = along(event);
    event.preventDefault();
    own.focus();
  });
  own.addEventListener("pointermove", (event) => {
    if (!own.hasPointerCapture(event.pointerId)) return;
    by(along(event) - last);
    last = along(event);
  });
  own.addEventListener("keydown", (event) => {
    const steps = { vertical: { ArrowLeft: -1, ArrowRight: 1 }, horizontal: { ArrowUp: -1, ArrowDown: 1 } }[way][event.key];
    if (!steps) return;
    event.preventDefault();
    key(steps);
  });
}

const beside = at("aside-border");
const wide = (moved) => {
  const size = Math.min(Math.max(at("aside").clientWidth + moved, 190), Math.max(0.45 * innerWidth, 190));
  at("desk").style.setProperty("--aside", `${size}px`);
  beside.setAttribute("aria-valuenow", String(Math.round((100 * size) / innerWidth)));
  save();
};
dragged(beside, "vertical", wide, (steps) => wide(24 * steps));

at("aside-toggle").addEventListener("click", () => {
  const alone = at("desk").classList.toggle("alone");
  at("aside-toggle").setAttribute("aria-expanded", String(!alone));
  save();
});
at("steps").addEventListener("click", (event) => event.target.dataset.step && go(event.target.dataset.step));
document.addEventListener("click", (event) => {
  const name = event.target.closest("[data-focus]")?.dataset.focus;
  if (!name) return;
  const pane = at(name).closest("section.pane");
  if (pane) reveal(pane.id.slice("pane-".length));
  at(name).focus();
});
narrow.addEventListener("change", build);

load();
at("aside-toggle").setAttribute("aria-expanded", String(!at("desk").classList.contains("alone")));
build();
