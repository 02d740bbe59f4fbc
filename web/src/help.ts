// The keys of the present mode, from the table that drives them.

import { byId, fill, h } from "./dom";
import { bind, KEYS, nameOf, type Key } from "./keys";
import { setTool } from "./annotate";
import { select, state } from "./state";

const MOUSE: [string, string][] = [
  ["drag", "turn the view; from above: move it"], ["right drag, Shift+drag", "move the view"], ["wheel", "nearer, farther"], ["click", "select a box"],
];
const DRAWING: [string, string][] = [
  ["double click on the radar map", "a box for a radar peak"], ["drag an edge in a close-up", "move that face"], ["drag the middle, the handle", "move, turn"],
];

function merged(keys: Key[]): { names: string; title: string }[] {
  const digits = keys.filter((key) => key.id.startsWith("class."));
  const rest = keys.filter((key) => !key.id.startsWith("class.")).map((key) => ({ names: nameOf(key), title: key.title }));
  return digits.length > 0 ? [...rest, { names: "1 to 9", title: digits[0]!.title.replace(/ 1$/, "") }] : rest;
}

export function openHelp(): void {
  const keys = KEYS.filter((key) => key.modes.includes(state.mode));
  const groups = [...new Set(keys.map((key) => key.group))];
  const line = (names: string, title: string): HTMLElement => h("div", { class: "key" }, h("kbd", {}, names), h("span", {}, title));
  const over = byId("over");
  over.className = "open help";
  over.onclick = close;
  fill(over, h("h2", {}, state.mode === "annotate" ? "Keys while annotating" : "Keys while viewing"),
    h("p", { class: "weak" }, "Keys that move or size a box go ten times as far with Shift and a fifth with Alt; sizes with Shift and Alt move the near face."),
    h("div", { class: "groups" },
      ...groups.map((group) => h("section", {}, h("h3", {}, group), ...merged(keys.filter((key) => key.group === group)).map(({ names, title }) => line(names, title)))),
      h("section", {}, h("h3", {}, "Mouse"), ...[...MOUSE, ...(state.mode === "annotate" ? DRAWING : [])].map(([names, title]) => line(names, title)))));
}

export function close(): void {
  const over = byId("over");
  over.className = "";
  over.onclick = null;
  fill(over);
}

export function bindHelp(onCancel: () => boolean): void {
  bind("help", () => (byId("over").classList.contains("help") ? close() : openHelp()));
  bind("cancel", () => {
    if (byId("over").classList.contains("help")) close();
    else if (onCancel()) return;
    else if (state.tool !== "none") setTool("none");
    else if (state.tape.length > 0) setTool("none"), (state.tape = []);
    else select(null);
  });
}
