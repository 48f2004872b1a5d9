// The windows of steady motion: one choice of them, which all panes show, and what the residual looks like in them.

import { at, element, fixed, hear, now, say, send, table, tell } from "./shared.js";
import { choose } from "./signals.js";

let seen = null; // what was found, as it was shown
let drawn = null;
let picked = []; // numbers of windows, in the order in which they were chosen
let turn = 0;
let mirroring = false; // while a source takes the choice of another one
const linked = new Map(); // sources of pictures of the windows, a row a window

export let channel = ""; // whose χ²/N is drawn
export const chosen = () => picked;
export const windows = () => now.found?.windows ?? null;

// A new result takes the choice away, and shows the channel that is worst; where none fails any more, the one shown before.
export function showWindows(again = false) {
  if (now.found === seen && !again) return;
  seen = now.found;
  const w = windows();
  const text = JSON.stringify([w, now.found?.maps]);
  if (text === drawn && !again) return;
  const other = text !== drawn;
  drawn = text;
  if (!other) return;
  linked.clear();
  if (w && (w.fails || !(channel in w.chi2))) setChannel(w.worst);
  pick([]);
}

export function setChannel(name) {
  channel = name;
  say("channel", name);
}

// Windows of a recording that lie within a span, at least by half.
export function within(key, start, end) {
  const w = windows();
  if (!w) return [];
  return [...w.start.keys()].filter((k) => {
    const middle = w.start[k] + 0.5 * w.duration[k];
    return w.recording[k] === key && middle >= start && middle <= end;
  });
}

// Has a picture take part in the choice; a picture of the same name gives way. `order` has the window of each of its rows.
export function link(name, source, order) {
  linked.set(name, [source, order]);
  mirror(source, order);
  source.selected.properties.indices.change.connect(() => {
    if (!mirroring) pick(source.selected.indices.map((row) => order[row]));
  });
}

function mirror(source, order) {
  const rows = new Map(order.map((window, row) => [window, row]));
  mirroring = true;
  source.selected.indices = picked.map((k) => rows.get(k)).filter((row) => row !== undefined);
  mirroring = false;
}

// Chooses windows: the samples of the worst are shown, the others marked. `view` is another span to show.
export async function pick(indices, view = null) {
  const w = windows();
  const mine = ++turn;
  picked = w ? indices : [];
  for (const [source, order] of linked.values()) mirror(source, order);
  say("picked", picked);
  at("chosen").replaceChildren();
  at("chosen-help").hidden = picked.length > 0;
  tell("where", "");
  if (!w || !picked.length) {
    say("windows", {});
    if (view) await choose(...view);
    return;
  }
  const chi2 = w.chi2[channel].values;
  const sorted = [...picked].sort((a, b) => chi2[b] - chi2[a]);
  const spans = {};
  for (const k of picked) (spans[w.recording[k]] ??= []).push([w.start[k], w.start[k] + w.duration[k]]);
  const [start, length] = [w.start[sorted[0]], w.duration[sorted[0]]];
  const margin = 0.25 * length + 0.1;
  await choose(...(view ?? [w.recording[sorted[0]], start - margin, start + length + margin]));
  say("windows", spans);
  let said;
  try {
    said = await send("region", { windows: picked.join(",") });
  } catch (error) {
    return tell("where", error.message);
  }
  if (mine === turn) describe(w, sorted, spans, said);
}

function describe(w, sorted, spans, said) {
  const place = at("chosen");
  const percent = (share) => `${(100 * share).toFixed(share < 0.1 ? 1 : 0)} %`;
  place.append(
    element("p", `${sorted.length} of ${w.start.length} windows chosen; they have ${percent(said.share)} of the whole χ². What the residual looks like in them:`),
    table([["share of χ²", "where", "shape of the residual"], ...said.said.map((own) => [percent(own.share), own.where, own.looks])]),
  );
  place.lastChild.classList.add("said");
  const kinds = Object.values(w.chi2);
  const several = Object.keys(spans).length > 1;
  const name = (k) => now.state.signals.find((each) => each.key === w.recording[k])?.name ?? "";
  place.append(
    element("p", sorted.length > 12 ? "The twelve worst windows:" : "Window by window:"),
    table([
      [...(several ? ["recording"] : []), "time, s", "tilt x, °", "tilt y, °", "rpm", ...(w.of_coils ? [`residual x, ${w.unit}`, `residual y, ${w.unit}`] : []), ...kinds.map((c) => `χ²/N ${c.title}`)],
      ...sorted.slice(0, 12).map((k) => [
        ...(several ? [name(k)] : []), w.start[k].toFixed(2), fixed(w.tilt_x[k], 2), fixed(w.tilt_y[k], 2), w.speed[k].toFixed(0),
        ...(w.of_coils ? [fixed(w.residual_x[k], 3), fixed(w.residual_y[k], 3)] : []), ...kinds.map((c) => c.values[k].toFixed(1)),
      ]),
    ]),
  );
}

// Windows one by one, in any picture of them: in time, or from the worst on.
export function walk(event) {
  const chi2 = windows()?.chi2[channel].values;
  if (!chi2) return;
  if (event.key === "Escape") return void pick([]);
  const inTime = event.key === "ArrowRight" || event.key === "ArrowLeft";
  const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (step === undefined && event.key !== "Home") return;
  event.preventDefault();
  const worstFirst = [...chi2.keys()].sort((a, b) => chi2[b] - chi2[a]);
  const order = inTime ? [...chi2.keys()] : worstFirst;
  const last = picked.at(-1); // the one that was chosen last
  const k = step === undefined || last === undefined ? 0 : Math.min(Math.max(order.indexOf(last) + step, 0), order.length - 1);
  pick([...(event.shiftKey ? picked.filter((own) => own !== order[k]) : []), order[k]]);
}

// The window at the cursor, for the pictures to mark; -1 where there is none.
export let current = -1;
hear("cursor", ({ key, time }) => {
  const w = windows();
  const k = w ? w.start.findIndex((start, i) => w.recording[i] === key && start <= time && time <= start + w.duration[i]) : -1;
  if (k === current) return;
  current = k;
  say("current", k);
});
