// A whole track: its class, one that is two objects, two that are one.

import { shownAs, withTrack } from "./annotate";
import { report } from "./bar";
import { byId, fill, h } from "./dom";
import { editTrack, freeTrack } from "./edits";
import { keyFor, bind, run } from "./keys";
import type { BoxRow } from "./protocol";
import { changed, driveOf, on, shownFrame, state, titleOf } from "./state";

/** The track that is to take another one in; it is chosen first, in any frame. */
let into: { track: number; base: number; drive: string; class_name: string } | null = null;

const version = (track: number): number => state.tracks.get(track)?.version ?? 0;

function take(track: number, row: BoxRow): void {
  into = { track, base: version(track), drive: driveOf(shownFrame())?.name ?? "", class_name: row.class_name };
  changed("tracks");
}

/** Nothing is merged any more; whether something was to be. */
export function stopMerging(): boolean {
  const was = into !== null;
  into = null;
  changed("tracks");
  return was;
}

function merge(track: number, row: BoxRow): void {
  if (!into || into.drive !== (driveOf(shownFrame())?.name ?? "")) return take(track, row);
  if (into.track === track) return void report("info", `Track ${track} is the one that was chosen first: select a box of the other one, in any frame.`);
  const first = into;
  into = null;
  changed("tracks");
  editTrack({ op: "track.merge", ...shownAs(row), track, into: first.track, base: version(track), into_base: first.base }, (taken) => {
    if (taken) report("info", `Tracks ${first.track} and ${track} are one now: ${first.track}.`);
  });
}

function split(track: number, row: BoxRow): void {
  const frames = state.tracks.get(track)?.frames ?? [];
  if (!frames.some((frame) => frame < shownFrame())) return void report("info", `Track ${track} begins in this frame: go to the first frame of the other object, then split.`);
  editTrack({ op: "track.split", ...shownAs(row), track, new_track: freeTrack(), base: version(track) });
}

function setClassOfTrack(track: number, row: BoxRow): void {
  const frames = state.tracks.get(track)?.frames.length ?? 0;
  editTrack({ op: "track.set", ...shownAs(row), track, base: version(track), class_name: row.class_name }, (taken) => {
    if (taken) report("info", `Track ${track}: ${titleOf(row.class_name)} in ${frames === 1 ? "its frame" : `all ${frames} frames`}.`);
  });
}

function draw(): void {
  const panel = byId("merging");
  if (!into || state.mode !== "annotate") return fill(panel);
  fill(panel, h("span", {}, `Merge into track ${into.track} (${titleOf(into.class_name)}): select a box of the other track, in any frame, and press ${keyFor("track.merge")}. `),
    h("button", { class: "small", onclick: () => run("track.merge") }, "Merge"), h("button", { class: "small", onclick: () => void stopMerging() }, "Leave them"));
}

export function bindWholeTracks(): void {
  bind("track.class", () => withTrack(setClassOfTrack));
  bind("track.split", () => withTrack(split));
  bind("track.merge", () => withTrack(merge));
  on(["tracks", "welcome", "tool"], draw);
}
