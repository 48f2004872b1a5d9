// A table that is dropped on the page, or chosen: it is sent to the server, which suggests a map for it.

import { at, element, tell } from "./shared.js";

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
    upload(file);
    if (others.length) tell("table", "One table at a time: the first is taken.");
  });
}

function upload(file) {
  sending?.abort();
  const asked = (sending = new XMLHttpRequest());
  const show = (...parts) => {
    at("sending").replaceChildren(...parts);
    showTable();
  };
  const bar = element("progress", undefined, { value: 0, max: 1, ariaLabel: `sending ${file.name}` });
  const end = element("button", "End", { type: "button" });
  end.onclick = () => asked.abort();
  tell("table", "");
  asked.upload.onprogress = (event) => {
    if (event.lengthComputable) bar.value = event.loaded / event.total;
  };
  asked.onloadend = () => {
    sending = null;
    show();
    let said = {};
    try {
      said = JSON.parse(asked.responseText);
    } catch {
      // the server hung up, or the user ended it
    }
    if (asked.status === 401) location.reload();
    const failed = asked.status === 0 ? "not sent: it was ended, or is larger than the workbench takes (256 MB)" : said.error ?? asked.statusText;
    if (asked.status !== 200) tell("table", failed);
    showTable();
  };
  asked.open("POST", `/table?${new URLSearchParams({ name: file.name })}`);
  asked.setRequestHeader("Content-Type", "application/octet-stream");
  asked.send(file);
  show(element("span", `sending ${file.name}`), bar, end);
}

// The part is there while there is a table, one is on its way, or something is to be said about one.
let there = false;
export function showTable() {
  const draft = at("part-table").childElementCount > 0;
  const said = document.querySelector('[data-trouble="table"]').textContent;
  at("table").hidden = !(draft || sending || said);
  if (draft && !there) {
    at("table").scrollIntoView();
    at("h-table").focus({ preventScroll: true });
  }
  there = draft;
}
