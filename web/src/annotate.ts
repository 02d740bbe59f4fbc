// What a person does to boxes: drawing gestures, one-click fits, nudges, states, tracks. Every action is one edit or one group.

import { report, withdraw } from "./bar";
import { faceMoved, finite, shifted, turned, type Box, type Vec3 } from "./boxes";
import { radians } from "./dom";
import { addBox, addEditFor, deleteBox, editTrack, freeTrack, mayEdit, redo, setBox, undo, valueOf, versionOf } from "./edits";
import { show } from "./frames";
import { bind, step } from "./keys";
import { groundNear, groundUnder } from "./picking";
import { dragAt, pointer, type Gesture } from "./pointer";
import { Projector } from "./project";
import type { BoxRow, BoxValue, Fit, Fitted } from "./protocol";
import { groundBelow } from "./radarblock";
import { post } from "./post";
import { newId, onReply } from "./socket";
import type { Stage } from "./stage";
import { stored } from "./rows";
import { boxOf, changed, driveOf, on, select, selected, shownFrame, state } from "./state";

const SMALL_M = 0.05;
const TURN = radians(1);
const DRAG_LEAST_M = 0.7;

interface Asked {
  frame: number;
  replaces: BoxRow | null;
  class_name: string;
  track: number; // of the drive in which it was drawn
  fresh: boolean; // a new object's, whose number is only proposed
  started: number;
}

const asked = new Map<string, Asked>();
/** Milliseconds from the gesture to the drawn box, the last ones first; the benchmarks read them. */
export const fitTimes: number[] = [];

/** The rectangle or line that a gesture draws, for the overlay. */
export const sketch = { points: [] as Vec3[], closed: false, box: null as Box | null };

function presetSize(name: string): [number, number, number] {
  const spec = state.welcome?.classes.find((one) => one.name === name);
  const type = spec?.types.find((one) => one.name === state.chosenType);
  return (type?.size ?? spec?.size ?? [4.5, 1.9, 1.7]) as [number, number, number];
}

/** The object that was selected in another frame and has no box in this one: what is drawn becomes its box. */
export function awaited(): { track: number; class_name: string } | null {
  const { carried } = state;
  return carried && state.selection === null && !state.boxes.some((row) => row.track === carried.track && row.state !== "rejected") ? carried : null;
}

function askFit(rest: Pick<Fit, "kind"> & Partial<Fit>, replaces: BoxRow | null): void {
  if (!mayEdit() || !finite(rest.at ?? [])) return;
  if (!state.connected) return report("warning", "The studio is not connected: boxes cannot be fitted now.", "Draw again when the connection is back.");
  const frame = shownFrame();
  const id = newId();
  const object = replaces === null ? awaited() : null;
  const class_name = object?.class_name ?? rest.class_name ?? state.chosenClass;
  const track = object?.track ?? rest.track ?? null;
  const free = freeTrack(...[...asked.values()].map((one) => one.track));
  asked.set(id, { frame, replaces, class_name, track: track ?? free, fresh: track === null, started: performance.now() });
  post({ op: "fit", id, frame, type_name: object ? "" : state.chosenType, ...rest, class_name, track });
}

onReply("fitted", (message: Fitted) => {
  const request = asked.get(message.id);
  asked.delete(message.id);
  if (!request) return;
  if (!message.box) {
    report("warning", message.sentence || "No object was found there.");
    return;
  }
  if (message.sentence) report("info", message.sentence);
  const { frame, replaces } = request;
  const value: BoxValue = { box: message.box, class_name: request.class_name, track: request.track, state: "edited", source: message.source, attributes: {} };
  if (replaces) {
    const now = stored(frame, replaces.id);
    if (now?.version === replaces.version) addEditFor(frame, now, { box: message.box });
    else report("warning", "The box was changed while it was fitted: it was left as it is.", "Press X to fit it again.");
  } else {
    const here = frame === shownFrame() && frame === state.frame;
    const made = addBox(value, null, frame, request.fresh);
    if (made && here) select(made);
    else if (made) report("info", `The box that was drawn in frame ${frame + 1} is there.`);
  }
  requestAnimationFrame(() => fitTimes.push(performance.now() - request.started));
});

onReply("refused", (message) => {
  if (message.id !== null) asked.delete(message.id);
});

/** Press at the object's rear and drag along its heading; with Ctrl the corners of a rectangle. */
export function drawGesture(stage: Stage): Gesture | null {
  if (state.tool !== "draw" || state.mode !== "annotate") return null;
  let from: Vec3 = [0, 0, 0];
  let aside: [number, number] = [0, 0]; // of the point that was pressed from where the pointer was: else it would turn the drag
  let rectangle = false;
  return {
    cancel() {
      Object.assign(sketch, { points: [], closed: false, box: null });
      stage.request("lines");
      setTool("none");
    },
    down(at, event, view) {
      if (event.shiftKey || !mayEdit()) return false;
      const here = view.ground(event.clientX, event.clientY, at[2]) ?? at;
      rectangle = event.ctrlKey;
      from = rectangle ? here : at;
      aside = [from[0] - here[0], from[1] - here[1]];
      dragAt(at[2]);
      sketch.points = [from];
      return true;
    },
    move(pointed) {
      const at: Vec3 = [pointed[0] + aside[0], pointed[1] + aside[1], pointed[2]];
      sketch.closed = rectangle;
      sketch.points = rectangle ? screenRectangle(stage, from, at) : [from, at];
      sketch.box = rectangle ? null : along(from, at);
      stage.request("lines");
    },
    up(pointed) {
      const at = pointed && [pointed[0] + aside[0], pointed[1] + aside[1]];
      const points = sketch.points;
      Object.assign(sketch, { points: [], closed: false, box: null });
      stage.request("lines");
      setTool("none");
      if (!at) return;
      const reach = Math.hypot(at[0] - from[0], at[1] - from[1]);
      if (rectangle && points.length === 4) askFit({ kind: "rectangle", at: points.flatMap(([x, y]) => [x, y]) }, null);
      else if (reach < DRAG_LEAST_M) askFit({ kind: "click", at: [from[0], from[1]] }, null);
      else askFit({ kind: "drag", at: [from[0], from[1], at[0], at[1]] }, null);
    },
  };
}

function along(from: Vec3, to: Vec3): Box {
  const object = awaited();
  const known = object && state.tracks.get(object.track)?.size;
  const [l, w, h] = (known as [number, number, number] | null) ?? presetSize(object?.class_name ?? state.chosenClass);
  const yaw = Math.atan2(to[1] - from[1], to[0] - from[0]);
  return [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2, from[2] + h / 2, l, w, h, yaw];
}

/** Four corners of a rectangle whose sides lie along the screen's. */
function screenRectangle(stage: Stage, a: Vec3, b: Vec3): Vec3[] {
  const c = Math.cos(stage.eye.azimuth);
  const s = Math.sin(stage.eye.azimuth);
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const forward = dx * c + dy * s;
  return [a, [a[0] + c * forward, a[1] + s * forward, a[2]], b, [b[0] - c * forward, b[1] - s * forward, a[2]]];
}

export function setTool(tool: typeof state.tool): void {
  state.tool = tool;
  if (tool === "measure") state.tape = [];
  changed("tool");
}

function withBox(act: (row: BoxRow, box: Box) => void): void {
  const row = selected();
  if (row) act(row, boxOf(row));
  else report("info", "Select a box first: click it, or press ↓.");
}

const nudge = (id: string, change: (box: Box, by: number, near: boolean) => Box): void =>
  bind(id, (event) => withBox((row, box) => setBox(row, { box: change(box, step(event), event.altKey && event.shiftKey) })));

function sizeKey(id: string, axis: 0 | 1 | 2, sign: 1 | -1): void {
  nudge(id, (box, by, near) => {
    const side = axis === 2 ? 1 : farSide(box, axis);
    return faceMoved(box, axis, (near ? -side : side) as 1 | -1, sign * SMALL_M * by);
  });
}

/** The side of an axis that points away from the sensor: that face moves, the one that was seen stays. */
function farSide(box: Box, axis: 0 | 1): 1 | -1 {
  const angle = box[6] + (axis === 1 ? Math.PI / 2 : 0);
  return Math.cos(angle) * box[0] + Math.sin(angle) * box[1] >= 0 ? 1 : -1;
}

function bindNudges(stage: Stage): void {
  nudge("move.forward", (box, by) => shifted(box, SMALL_M * by, 0, 0));
  nudge("move.back", (box, by) => shifted(box, -SMALL_M * by, 0, 0));
  nudge("move.left", (box, by) => shifted(box, 0, SMALL_M * by, 0));
  nudge("move.right", (box, by) => shifted(box, 0, -SMALL_M * by, 0));
  nudge("move.up", (box, by) => shifted(box, 0, 0, SMALL_M * by));
  nudge("move.down", (box, by) => shifted(box, 0, 0, -SMALL_M * by));
  nudge("turn.left", (box, by) => turned(box, TURN * by));
  nudge("turn.right", (box, by) => turned(box, -TURN * by));
  nudge("turn.half", (box) => turned(box, Math.PI));
  nudge("turn.quarter", (box) => turned(box, Math.PI / 2));
  (["length", "width", "height"] as const).forEach((name, axis) => {
    sizeKey(`${name}.less`, axis as 0 | 1 | 2, -1);
    sizeKey(`${name}.more`, axis as 0 | 1 | 2, 1);
  });
  nudge("ground", (box) => [box[0], box[1], (groundBelow(box) ?? groundNear(stage, box[0], box[1], 4)) + box[5] / 2, box[3], box[4], box[5], box[6]]);
}

let copied: { value: BoxValue; drive: string } | null = null; // track numbers are those of a drive

const driveShown = (): string => driveOf(shownFrame())?.name ?? `frame ${shownFrame()}`;

function bindBoxes(stage: Stage): void {
  bind("draw", () => setTool(state.tool === "draw" ? "none" : "draw"));
  bind("fit.click", () => {
    const at = underPointer(stage);
    if (at) askFit({ kind: "click", at: [at[0], at[1]] }, null);
    else report("info", "Put the pointer on the object, then press C.");
  });
  bind("refit", () => refit(false));
  bind("refit.size", () => refit(true));
  bind("delete", () => withBox((row) => {
    if (row.state !== "proposed") return deleteBox(row);
    if (setBox(row, { state: "rejected" })) nextProposal(row);
  }));
  bind("accept", () => withBox((row) => { if (setBox(row, { state: "accepted" })) nextProposal(row); }));
  bind("copy", () => withBox((row) => { copied = { value: valueOf(row), drive: driveShown() }; report("info", "Copied."); }));
  bind("paste", () => {
    if (!copied) return;
    const { value, drive } = copied;
    const other = drive !== driveShown() || state.boxes.some((row) => row.track !== null && row.track === value.track); // another object than the one that was copied
    const fresh = other && value.track !== null && value.track !== undefined;
    const made = addBox({ ...value, track: fresh ? freeTrack() : value.track ?? null, state: "edited" }, null, undefined, fresh);
    if (made) select(made);
  });
  bind("duplicate", () => withBox((row, box) => {
    const made = addBox({ ...valueOf(row), box: shifted(box, 0, -row.box[4]! - 0.5, 0), track: freeTrack(), state: "edited" }, null, undefined, true);
    if (made) select(made);
  }));
}

function refit(keep: boolean): void {
  withBox((row) => askFit({ kind: "refit", around: row.box, class_name: row.class_name, track: row.track, keep_size: keep }, stored(shownFrame(), row.id)));
}

function nextProposal(after: BoxRow): void {
  const left = state.boxes.filter((row) => row.state === "proposed" && row.id !== after.id);
  const near = left.sort((a, b) => Math.hypot(a.box[0]! - after.box[0]!, a.box[1]! - after.box[1]!) - Math.hypot(b.box[0]! - after.box[0]!, b.box[1]! - after.box[1]!))[0];
  if (near) select(near.id);
}

export function underPointer(stage: Stage): Vec3 | null {
  if (!pointer.over) return null;
  const pane = stage.paneAt(pointer.x);
  return groundUnder(stage, new Projector(pane.camera, pane.rect), pane.index, pointer.x, pointer.y);
}

/** A box for a peak of the radar that no LiDAR point shows: near face at the peak, preset size. */
export function fromRadar(at: Vec3): void {
  askFit({ kind: "peak", at: [at[0], at[1]] }, null);
}

export function withTrack(act: (track: number, row: BoxRow) => void): void {
  withBox((row) => (row.track === null ? report("info", "This box has no track number: type one beside its class.") : act(row.track, row)));
}

/** The box through which a track is edited, as it is shown. */
export const shownAs = (row: BoxRow): { frame: number; box: string; box_base: number } => ({ frame: shownFrame(), box: row.id, box_base: versionOf(row) });

/** Carrying on goes from frame to frame: each waits for the box that the one before gave. */
const carrying = { frame: -1, track: -1, more: 0 };

function carryOn(track: number, row: BoxRow): void {
  const frame = shownFrame();
  if (frame >= driveEnd()) {
    carrying.more = 0;
    return report("info", "This is the last frame of the drive: the object cannot be carried on.");
  }
  Object.assign(carrying, { frame: frame + 1, track });
  editTrack({ op: "track.propagate", track, first: frame, last: frame + 1, box: row.id, base: versionOf(row), fit: true }, (taken) => {
    if (!taken || carrying.frame !== frame + 1 || state.frame !== frame) return void stopCarrying(); // refused, or a person went elsewhere meanwhile
    show(frame + 1);
  });
}

export const stopCarrying = (): boolean => {
  const was = carrying.frame >= 0;
  Object.assign(carrying, { frame: -1, track: -1, more: 0 });
  return was;
};

/** The frame that an object was carried to stands: its new box is selected, and goes on if P was pressed again. */
function carried(): void {
  const { frame, track } = carrying;
  if (frame < 0) return;
  if (state.frame !== frame && state.frame !== frame - 1) return void stopCarrying();
  if (shownFrame() !== frame || state.drawnFrame !== frame) return;
  const row = state.boxes.find((one) => one.track === track && one.state !== "rejected");
  carrying.frame = -1;
  if (!row) return void stopCarrying();
  select(row.id);
  if (carrying.more === 0) return;
  carrying.more -= 1;
  carryOn(track, row);
}

function bindTracks(stage: Stage): void {
  on("frame", () => { if (carrying.frame >= 0 && shownFrame() === carrying.frame) stage.request("all"); });
  on("drawn", carried);
  on("play", carried);
  const through = (row: BoxRow): { frame: number; box: string; base: number } => ({ frame: shownFrame(), box: row.id, base: versionOf(row) });
  bind("propagate", () => {
    if (carrying.frame >= 0) carrying.more += 1;
    else withTrack(carryOn);
  });
  bind("propagate.all", () => withTrack((track, row) => editTrack({ op: "track.propagate", track, first: shownFrame(), last: driveEnd(), box: row.id, base: versionOf(row), fit: true })));
  bind("interpolate", () => withTrack((track, row) => {
    const keys = state.tracks.get(track)?.keyframes ?? [];
    if (keys.length < 2) report("info", "Interpolation needs two keyframes of the object: press K in two frames.");
    else editTrack({ op: "track.interpolate", ...through(row), track, first: keys[0]!, last: keys[keys.length - 1]! });
  }));
  bind("keyframe", () => withBox((row) => setBox(row, { source: row.keyframe ? row.source : "lidar", state: "edited" })));
  bind("end", () => withTrack((track, row) => {
    const info = state.tracks.get(track);
    editTrack({ op: "track.set", ...shownAs(row), track, base: info?.version ?? 0, ends: info?.ends === shownFrame() ? -1 : shownFrame() });
  }));
  bind("lock", () => withTrack((track, row) => {
    const info = state.tracks.get(track);
    editTrack({ op: "track.set", ...shownAs(row), track, base: info?.version ?? 0, size_locked: !info?.size_locked, size: row.box.slice(3, 6) });
  }));
}

export function driveEnd(): number {
  const drive = driveOf(shownFrame());
  return drive ? drive.frames[drive.frames.length - 1]! : (state.welcome?.frames ?? 1) - 1;
}

export function setClass(name: string): void {
  state.chosenClass = name;
  state.chosenType = "";
  if (awaited()) state.carried = null; // another object is meant
  const row = selected();
  if (row && row.class_name !== name) setBox(row, { class_name: name });
  changed("tool");
}

export function bindAnnotation(stage: Stage): void {
  bindNudges(stage);
  bindBoxes(stage);
  bindTracks(stage);
  bind("undo", () => void (undo() || report("warning", "Not connected: undo again when the connection is back.")));
  bind("redo", () => void redo());
  onReply("saved", (message) => {
    withdraw("unwritten");
    if (message.unwritten.length === 0) return report("info", message.sentence || `${message.files} label file${message.files === 1 ? "" : "s"} written to ${message.folder}`);
    for (const { frame, box, sentence } of message.unwritten.slice(0, 3)) {
      const go = (): void => {
        show(frame);
        if (box) state.jump = { frame, box };
        changed("drawn");
      };
      report("error", `Frame ${frame + 1}${box ? `, box ${box}` : ""} was not written: ${sentence}`, `${message.files} other files were written; this one stays as it was, and the edit in the journal.`, [{ title: "Go there", act: go }], `unwritten ${frame} ${box ?? ""}`);
    }
  });
  on("drawn", () => {
    if (!state.jump || shownFrame() !== state.jump.frame) return;
    select(state.jump.box);
    state.jump = null;
  });
}
