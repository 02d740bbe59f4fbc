// Which frame is shown: asking for its state, waiting for its layers, looking ahead while playing.

import { report } from "./bar";
import { cancelGesture } from "./gestures";
import { load, prefetch, ready, states, tidy } from "./loader";
import type { FrameState, Layer } from "./protocol";
import { shownRows, stand } from "./rows";
import { changed, lookOf, on, shownFrame, state } from "./state";
import { onReply, send } from "./socket";

const AHEAD = 3;
const ANEW_MS = 250; // before a frame is asked for anew whose answer an edit overtook
let wanted = -1;
const asked = new Set<number>();
let whenShown: ((frame: number) => void) | null = null;
let arriving = 0;

/** Whether the frame that is asked for, or a layer of it, is still on its way. */
export function awaited(): boolean {
  return arriving > 0 || asked.has(wanted);
}

/** Called with every frame whose data are here: the stage draws it. */
export function onShown(draw: (frame: number) => void): void {
  whenShown = draw;
}

/** Ask for a frame's state; what is asked ahead of its time leaves the server's idea of where this window is. */
function ask(frame: number, purpose: "show" | "ahead" | "here" = "show"): void {
  if (purpose === "ahead" && asked.has(frame)) return;
  if (send({ op: "frame.open", frame, threshold: 0, sweeps: state.sweeps, purpose }) && purpose !== "here") asked.add(frame);
}

export function neededLayers(found: FrameState): Layer[] {
  return found.layers.filter((layer) => layer.kind !== "image" && lookOf(layer.name, layer.kind).visible);
}

/** Go to a frame; its picture changes when all of its visible layers are here. */
export function show(frame: number): void {
  const count = state.welcome?.frames ?? 0;
  if (count === 0) return;
  wanted = Math.min(count - 1, Math.max(0, frame));
  if (wanted !== state.frame) cancelGesture();
  if (wanted !== state.frame) state.direction = wanted > state.frame ? 1 : -1;
  state.frame = wanted;
  const ahead = upcoming();
  tidy(new Set([wanted, ...ahead]));
  changed("play");
  if (states.get(wanted)?.unreadable) states.delete(wanted); // perhaps it can be read by now
  const known = states.get(wanted);
  if (!state.playing) ask(wanted, known || asked.has(wanted) ? "here" : "show");
  else if (!known) ask(wanted, "ahead"); // no checks of frames that fly past
  if (known) void arrive(known);
  else prefetch(wanted, expected(wanted));
}

/** The layers that a frame will most likely have, those of the frame that is shown: a slow link is crossed once less. */
function expected(frame: number): Layer[] {
  if (!state.shown) return [];
  return neededLayers(state.shown).map((layer) => ({ ...layer, url: layer.url.replace(/^(layer|radar)\/\d+/, `$1/${frame}`) }));
}

/** Ask the server for the frame's state anew. */
export function refresh(): void {
  asked.clear();
  states.clear();
  if (wanted >= 0) ask(wanted);
}

function upcoming(): number[] {
  const count = state.welcome?.frames ?? 0;
  return Array.from({ length: AHEAD }, (_, i) => wanted + state.direction * (i + 1)).filter((frame) => frame >= 0 && frame < count);
}

async function arrive(found: FrameState): Promise<void> {
  const frame = found.frame.index;
  const layers = neededLayers(found);
  const waiting = layers.filter((layer) => ready(layer) === null);
  if (waiting.length > 0) {
    arriving += 1;
    const results = await Promise.allSettled(waiting.map((layer) => load(frame, layer)));
    arriving -= 1;
    if (wanted !== frame || states.get(frame) !== found) return;
    for (const result of results)
      if (result.status === "rejected" && (result.reason as Error).name !== "AbortError") report("error", (result.reason as Error).message);
  }
  if (shownFrame() !== frame) cancelGesture(); // what is dragged goes on where only facts of the frame came anew
  state.shown = found;
  state.boxes = found.boxes = shownRows(frame);
  if (found.unreadable) report("error", `Frame ${frame + 1} cannot be read: ${found.unreadable}`);
  changed("frame", "boxes", "selection");
  whenShown?.(frame);
  for (const next of upcoming()) {
    const known = states.get(next);
    if (known) prefetch(next, neededLayers(known));
    else ask(next, "ahead");
  }
}

/** How layers are first seen: a radar's points are off where its map is there, and so are clouds that others hold. */
function firstLooks({ layers }: FrameState): void {
  const map = layers.some((layer) => layer.kind === "bev");
  const held = new Set(layers.flatMap((layer) => layer.holds));
  for (const layer of layers) {
    const unplaced = layer.kind === "points" && !layer.placed && layers.some((other) => other.kind === "points" && other.placed);
    const hidden = layer.kind === "points" && ((map && layer.sensor === "radar") || held.has(layer.name) || unplaced);
    lookOf(layer.name, layer.kind, !hidden);
  }
}

onReply("frame.state", (message) => {
  const frame = message.frame.index;
  asked.delete(frame);
  states.set(frame, message);
  if (!stand(frame, message.boxes, message.seq)) { // an edit that is known overtook it
    states.delete(frame);
    asked.add(frame);
    setTimeout(() => { asked.delete(frame); ask(frame, frame === wanted ? "show" : "ahead"); }, ANEW_MS);
    return;
  }
  message.boxes = shownRows(frame);
  firstLooks(message);
  if (frame === wanted) void arrive(message);
  else prefetch(frame, neededLayers(message));
});

let counted = "";

/** Boxes that came without their points, of an edit in many frames, are asked for anew where they are shown: once for what they are. */
on(["frame", "boxes"], () => {
  const frame = state.shown?.frame.index ?? -1;
  const uncounted = state.boxes.filter((row) => row.points === null && row.radar_points === null && row.version > 0);
  const boxes = [frame, ...uncounted.map((row) => `${row.id} ${row.version}`)].join();
  if (uncounted.length === 0 || boxes === counted || frame !== wanted || state.playing || state.shown!.unreadable) return;
  counted = boxes;
  ask(frame);
});

onReply("refused", (message) => {
  if (message.id === null) asked.clear();
});

const SILENCE_MS = 4000;
let silent = 0;

/** A frame whose state does not come is asked for again. */
window.setInterval(() => {
  silent = state.connected && asked.has(wanted) ? silent + 1 : 0;
  if (silent * 1000 < SILENCE_MS) return;
  silent = 0;
  asked.delete(wanted);
  ask(wanted);
}, 1000);
