// The keys of the present mode, from the table that drives them.

import { toggleKeys } from "./keybox";
import { bind, KEYS, nameOf, type Key } from "./keys";
import { setTool, stopCarrying } from "./annotate";
import { select, state } from "./state";

const MOUSE: [string, string][] = [
  ["drag", "turn the view; from above: move it"], ["right drag, Shift+drag", "move the view"], ["wheel", "nearer, farther"], ["click", "select a box"],
];
const DRAWING: [string, string][] = [
  ["double click on the radar map", "a box for a radar peak"], ["drag an edge in a close-up", "move that face"], ["drag the middle, the handle", "move, turn"],
  ["beside the box, right drag, Shift+drag", "move the close-up"], ["wheel in a close-up", "nearer, farther"],
];

function merged(keys: Key[]): [string, string][] {
  const digits = keys.filter((key) => key.id.startsWith("class."));
  const rest = keys.filter((key) => !key.id.startsWith("class.")).map((key): [string, string] => [nameOf(key), key.title]);
  return digits.length > 0 ? [...rest, ["1 to 9", digits[0]!.title.replace(/ 1$/, "")]] : rest;
}

function showHelp(): void {
  const keys = KEYS.filter((key) => key.modes.includes(state.mode));
  const groups = [...new Set(keys.map((key) => key.group))].map((group) => ({ title: group, rows: merged(keys.filter((key) => key.group === group)) }));
  toggleKeys(
    state.mode === "annotate" ? "Keys while annotating" : "Keys while viewing",
    "Tab goes through all that can be pressed. " + (state.mode === "annotate" ? "Keys that move or size a box go ten times as far with Shift and a fifth with Alt; sizes with Shift and Alt move the near face." : ""),
    [...groups, { title: "Mouse", rows: [...MOUSE, ...(state.mode === "annotate" ? DRAWING : [])] }],
  );
}

export function bindHelp(onCancel: () => boolean): void {
  bind("help", showHelp);
  bind("cancel", () => {
    if (onCancel() || stopCarrying()) return;
    else if (state.tool !== "none") setTool("none");
    else if (state.tape.length > 0) setTool("none"), (state.tape = []);
    else select(null);
  });
}
