// Seconds that a person spends on a box: from its selection to the next, pauses over 60 s left out.

import { send } from "./socket";
import { on, shownFrame, state } from "./state";

const PAUSE_MS = 60_000;

export function timeBoxes(): void {
  let box: string | null = null;
  let frame = 0;
  let spent = 0;
  let last = performance.now();
  let edits = 0;
  const act = (): void => {
    const now = performance.now();
    if (now - last < PAUSE_MS) spent += now - last;
    last = now;
  };
  for (const kind of ["pointerdown", "keydown", "wheel"]) window.addEventListener(kind, act, { passive: true });
  on("saved", () => (edits += 1));
  on("selection", () => {
    if (state.selection === box) return;
    act();
    if (box && state.mode === "annotate" && edits > 0) send({ op: "timing", frame, box, seconds: Math.min(3600, spent / 1000), edits });
    [box, frame, spent, edits] = [state.selection, shownFrame(), 0, 0];
  });
}
