// What is kept where, in three words: not kept (in this browser only), in the journal (on the studio's disk), in the labels (written to label files).
// Where those are written to, in which format and when is chosen here.

import { report } from "./bar";
import { byId, counted, fill, h } from "./dom";
import { bind, keyFor } from "./keys";
import { post } from "./post";
import { newId, onReply } from "./socket";
import { changed, on, state } from "./state";

let open = false;
let wrongFolder = ""; // what was typed and cannot be a folder's name
let writing = false; // labels are to be written once the edits before are in the journal

const edits = (count: number): string => counted(count, "edit");
const clock = (ns: string): string => new Date(Number(BigInt(ns) / 1_000_000n)).toTimeString().slice(0, 8);

/** The state of the work in a few words. */
export function stateOfWork(): string {
  if (document.body.classList.contains("file")) return "a file: nothing can be changed here";
  if (state.pending > 0 && (!state.connected || state.stopped)) return `not kept: ${edits(state.pending)}`;
  if (state.stopped) return "stopped";
  if (!state.connected) return state.everConnected ? "connection lost, trying again" : "connecting";
  if (state.pending > 0) return "keeping";
  const labels = state.labels;
  if (!labels) return "";
  if (labels.unwritten > 0) return `in the journal: ${edits(labels.unwritten)}`;
  const left = labels.left > 0 ? `, ${counted(labels.left, "box", "boxes")} left out` : ""; // that the format cannot hold
  return labels.written_ns === null ? "nothing changed" : `in the labels ${clock(labels.written_ns)}${left}`;
}

/** The state of the work as a button that opens what is behind it. */
export function workButton(): HTMLElement {
  const bad = state.pending > 0 && (!state.connected || state.stopped !== "");
  const menu = state.mode === "annotate" && state.labels !== null;
  return h("button", { id: "saved", class: `quiet${bad ? " error" : ""}`, "aria-live": "polite", "aria-expanded": String(open), disabled: !menu, title: menu ? "What is kept where; where labels are written to" : "", onclick: () => toggle() }, stateOfWork());
}

function toggle(to = !open): void {
  open = to;
  wrongFolder = "";
  changed("saved");
}

function choose(change: { format?: string; folder?: string | null; at_exit?: boolean }): void {
  const labels = state.labels!;
  post({ op: "save.choose", id: newId(), format: labels.next_format, folder: labels.name, at_exit: labels.at_exit, ...change });
}

const FOLDER = /^[A-Za-z0-9._-]{1,64}$/; // FileName in the messages

function chooseFolder(typed: string): void {
  wrongFolder = typed === "" || FOLDER.test(typed) ? "" : typed;
  if (wrongFolder) changed("saved");
  else choose({ folder: typed || null });
}

/** Write the label files, once all edits before are in the journal. */
export function write(): void {
  writing = true;
  if (!state.connected) report("info", "The studio does not answer: the labels are written when it is back.");
  go();
}

function go(): void {
  if (!writing || state.pending > 0 || !state.connected) return;
  writing = false;
  post({ op: "save", id: newId() });
}

function draw(): void {
  let panel = document.getElementById("work");
  const labels = state.labels;
  if (!open || !labels || state.mode !== "annotate") return panel?.remove();
  if (panel?.contains(document.activeElement) && document.activeElement instanceof HTMLInputElement && document.activeElement.type === "text") return; // a hand that writes keeps its field
  if (!panel) document.body.append((panel = h("div", { id: "work", role: "dialog", "aria-label": "What is kept where" })));
  const format = h("select", { name: "labels format", "aria-label": "format", onchange: () => choose({ format: format.value }) },
    ...(state.welcome?.formats ?? []).map((name) => h("option", { value: name, selected: name === labels.next_format }, name)));
  const folder = h("input", { type: "text", name: "labels folder", "aria-label": "folder", "aria-describedby": "folder-note", "aria-invalid": String(wrongFolder !== ""), class: wrongFolder ? "bad" : "", placeholder: "the usual one", value: wrongFolder || (labels.name ?? ""), onchange: () => chooseFolder(folder.value.trim()),
    onkeydown: (event: KeyboardEvent) => { if (event.key === "Enter") folder.blur(); } });
  const exit = h("input", { type: "checkbox", name: "labels at exit", checked: labels.at_exit, onchange: () => choose({ at_exit: exit.checked }) });
  const line = (word: string, text: string): HTMLElement => h("p", {}, h("strong", {}, word), " ", text);
  const last = labels.written_ns === null ? "never written" : `written ${clock(labels.written_ns)} to ${labels.folder} as ${labels.format}`;
  fill(panel,
    line("not kept", state.pending === 0 ? "nothing: all edits are on the studio's disk" : `${edits(state.pending)}, in this browser only`),
    line("in the journal", labels.unwritten === 0 ? "nothing that the labels do not have" : `${edits(labels.unwritten)} on the studio's disk, in no label file yet${labels.itself ? "; written every half minute" : ""}`),
    line("in the labels", `${last}${labels.left > 0 ? `; ${counted(labels.left, "box", "boxes")} could not be written` : ""}`),
    h("div", { class: "row" }, h("label", {}, "Folder ", folder), h("label", {}, "as ", format)),
    h("p", { class: "field-note", id: "folder-note", role: "status" }, wrongFolder ? `A folder's name has 1 to 64 of a to z, A to Z, 0 to 9, dot, hyphen and underscore, got ${wrongFolder.length > 64 ? `${wrongFolder.length} characters` : `"${wrongFolder}"`}: labels go to ${labels.next_folder} as before.` : ""),
    h("div", { class: "row" }, h("label", {}, exit, " also when the studio ends"), h("span", { class: "grow" }),
      h("button", { class: "main", title: `(${keyFor("save")})`, onclick: write }, `Write to ${labels.next_folder}`)));
}

export function labelsMenu(): void {
  bind("save", write);
  onReply("labels", (message) => { state.labels = message; changed("saved"); });
  onReply("ack", (message) => { if (state.labels) state.labels = { ...state.labels, unwritten: message.unwritten }; });
  onReply("changed", (message) => { if (state.labels) state.labels = { ...state.labels, unwritten: message.unwritten }; changed("saved"); });
  on(["saved", "connection", "tool", "welcome"], draw);
  on(["saved", "connection"], go);
  window.addEventListener("pointerdown", (event) => { if (open && event.target instanceof Node && !byId("header").contains(event.target) && !document.getElementById("work")?.contains(event.target)) toggle(false); });
}

/** Close the menu; whether it was open. */
export function closeWork(): boolean {
  const was = open;
  if (was) toggle(false);
  return was;
}
