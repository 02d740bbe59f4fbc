// All proposals from a score on, accepted at once: counted first, one undo for all.

import { report } from "./bar";
import { byId, fill, h } from "./dom";
import { acceptProposals, mayEdit } from "./edits";
import { bind, keyFor, run } from "./keys";
import type { Proposals } from "./protocol";
import { newId, onReply, send } from "./socket";
import { on, shownFrame, state } from "./state";

let score = 0.5;
let asked = "";

const here = (): number => state.boxes.filter((row) => row.state === "proposed" && (row.score ?? 1) >= score).length;
const some = (count: number): string => `${count} proposal${count === 1 ? "" : "s"}`;

function count(): void {
  if (!mayEdit()) return;
  asked = newId();
  if (!send({ op: "proposals.count", id: asked, frame: shownFrame(), score })) report("warning", "Not connected: proposals are counted when the studio is back.");
}

/** Say how many there are before any is accepted. */
onReply("proposals", (message: Proposals) => {
  if (message.id !== asked) return;
  asked = "";
  const { frame, seq } = message;
  const least = message.score.toFixed(2);
  const accept = (first: number, last: number, number: number): void => {
    if (frame !== shownFrame()) report("warning", "Another frame is shown by now: nothing was accepted.", "Count the proposals again.");
    else acceptProposals({ frame, first, last, score: message.score, count: number, base: seq });
  };
  if (message.count === 0) return void report("info", `No proposal of this drive has a score of ${least} or more.`);
  const choices = [{ title: "Leave them", act: (): void => undefined }];
  if (message.count > message.here) choices.unshift({ title: `Accept ${message.count} of the drive`, act: (): void => accept(message.first, message.last, message.count) });
  if (message.here > 0) choices.unshift({ title: `Accept ${message.here} of this frame`, act: (): void => accept(frame, frame, message.here) });
  report("info", `${some(message.count)} in ${message.frames} frame${message.frames === 1 ? "" : "s"} of this drive ${message.count === 1 ? "has" : "have"} a score of ${least} or more, ${message.here} in this frame.`, "One undo takes them all back.", choices, "proposals");
});

function draw(): void {
  const left = state.boxes.filter((row) => row.state === "proposed");
  const panel = byId("proposals");
  if (state.mode !== "annotate" || left.length === 0) return fill(panel);
  if (panel.querySelector("input") === null)
    fill(panel,
      h("label", {}, "accept proposals, score ≥ ", h("input", { type: "number", name: "accept score", min: 0, max: 1, step: 0.05, value: String(score), oninput: (event: Event) => {
        const value = (event.target as HTMLInputElement).valueAsNumber;
        if (value >= 0 && value <= 1) score = value;
        draw();
      } })),
      h("span", { class: "weak" }),
      h("button", { class: "small", title: keyFor("accept.all"), onclick: () => run("accept.all") }, "Accept all…"));
  fill(panel.querySelector("span")!, `${here()} of ${left.length} here`);
}

export function proposalsPanel(): void {
  bind("accept.all", count);
  on(["boxes", "frame", "welcome"], draw);
}
