// A table that is dropped on the page, or chosen: it is sent to the server, which suggests a map for it.

import { close, reveal } from "./layout.js";
import { at, element } from "./shared.js";

let sending = null;

at("table-file").addEventListener("change", () => {
  const [file] = at("table-file").files;
  if (file) upload(file);
  at("table-file").value = "";
});

const files = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
for (const name of ["dragover", "drop", "dragleave"]) {
  document.addEventListener(name, (event) => {
    if (!files(event)) return;
    event.preventDefault();
    at("drop").classList.toggle("over", name === "dragover");
    if (name !== "drop") return;
    const [file, ...others] = event.dataTransfer.files;
    if (!file) return;
    if (event.dataTransfer.items[0]?.webkitGetAsEntry?.()?.isDirectory) {
      return refuse(`${file.name} is a folder. A recording is opened from the list on the left: start the workbench with the folder that it is in.`);
    }
    upload(file);
    if (others.length) say("One table at a time: the first one is used.");
  });
}

// Said in the pane itself, which opens for it.
function say(sentence) {
  document.querySelector('[data-trouble="table"]').textContent = sentence;
  showTable();
}

function refuse(sentence) {
  say(sentence);
}

function upload(file) {
  const largest = Number(at("table-file").dataset.largest);
  if (file.size > largest) {
    return refuse(`${file.name} has ${(file.size / 2 ** 20).toFixed(0)} MB; allowed: ${largest / 2 ** 20} MB. gyrowheel import takes larger ones.`);
  }
  sending?.abort();
  const asked = (sending = new XMLHttpRequest());
  const show = (...parts) => {
    at("sending").replaceChildren(...parts);
    showTable();
  };
  const bar = element("progress", undefined, { value: 0, max: 1, ariaLabel: `sending ${file.name}` });
  const end = element("button", "End", { type: "button" });
  let ended = false;
  end.onclick = () => {
    ended = true;
    asked.abort();
  };
  say("");
  asked.upload.onprogress = (event) => {
    if (event.lengthComputable) bar.value = event.loaded / event.total;
  };
  asked.onloadend = () => {
    sending = null;
    show();
    let answer = {};
    try {
      answer = JSON.parse(asked.responseText);
    } catch {
      // nothing came
    }
    if (asked.status === 401) location.reload();
    const lost = ended ? "ended" : "not sent: the server does not answer";
    if (asked.status !== 200) say(asked.status === 0 ? lost : (answer.error ?? asked.statusText));
    showTable();
  };
  asked.open("POST", `/table?${new URLSearchParams({ name: file.name })}`);
  asked.setRequestHeader("Content-Type", "application/octet-stream");
  asked.send(file);
  show(element("span", `sending ${file.name}`), bar, end);
}

// The pane is there while there is a table, one is on its way, or something is to be said about one.
let there = false;
export function showTable() {
  const draft = at("part-table").childElementCount > 0;
  const said = document.querySelector('[data-trouble="table"]').textContent;
  const wanted = Boolean(draft || sending || said);
  if (wanted === there) return;
  there = wanted;
  at("pane-table").dataset.there = wanted ? "yes" : "";
  if (!wanted) return close("table");
  reveal("table");
  at("h-table").focus({ preventScroll: true });
}
