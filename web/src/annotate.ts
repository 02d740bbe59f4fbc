// What a person does to boxes: drawing gestures, one-click fits, nudges, states, tracks. Every action is one edit or one group.

import { report } from "./bar";
import { faceMoved, shifted, turned, type Box, type Vec3 } from "./boxes";
import { degrees, radians } from "./dom";
import { addBox, deleteBox, editTrack, freeTrack, redo, setBox, undo, valueOf } from "./edits";
import { bind, run, step } from "./keys";
import { groundNear, groundUnder } from "./picking";
import { dragAt, pointer, type Gesture } from "./pointer";
import { Projector } from "./project";
import type { BoxRow, BoxValue, Fit, Fitted } from "./protocol";
import { newId, onReply, send } from "./socket";
import type { Stage } from "./stage";
import { boxOf, changed, select, selected, state } from "./state";

const SMALL_M = 0.05;
const TURN = radians(1);
const DRAG_LEAST_M = 0.7;

interface Asked {
  frame: number;
  replaces: string | null;
  class_name: string;
  track: number | null;
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

function askFit(rest: Pick<Fit, "kind"> & Partial<Fit>, replaces: string | null): void {
  const id = newId();
  const class_name = rest.class_name ?? state.chosenClass;
  asked.set(id, { frame: state.frame, replaces, class_name, track: rest.track ?? null, started: performance.now() });
  const sent = send({ op: "fit", id, frame: state.frame, class_name, type_name: state.chosenType, ...rest });
  if (!sent) {
    asked.delete(id);
    report("warning", "The studio is not connected: boxes cannot be fitted now.", "Draw again when the connection is back.");
  }
}

onReply("fitted", (message: Fitted) => {
  const request = asked.get(message.id);
  asked.delete(message.id);
  if (!request || message.frame !== state.frame) return;
  if (!message.box) {
    report("warning", message.sentence || "No object was found there.");
    return;
  }
  if (message.sentence) report("info", message.sentence);
  const row = request.replaces ? state.boxes.find((one) => one.id === request.replaces) : undefined;
  if (row) setBox(row, { box: message.box });
  else select(addBox({ box: message.box, class_name: request.class_name, track: request.track ?? freeTrack(), state: "edited", source: message.source, attributes: {} }));
  requestAnimationFrame(() => fitTimes.push(performance.now() - request.started));
});

/** Press at the object's rear and drag along its heading; with Ctrl the corners of a rectangle. */
export function drawGesture(stage: Stage): Gesture | null {
  if (state.tool !== "draw" || state.mode !== "annotate") return null;
  let from: Vec3 = [0, 0, 0];
  let rectangle = false;
  return {
    down(at, event) {
      if (event.shiftKey) return false;
      from = at;
      rectangle = event.ctrlKey;
      dragAt(at[2]);
      sketch.points = [at];
      return true;
    },
    move(at) {
      sketch.closed = rectangle;
      sketch.points = rectangle ? screenRectangle(stage, from, at) : [from, at];
      sketch.box = rectangle ? null : along(from, at);
      stage.request("lines");
    },
    up(at) {
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
  const [l, w, h] = presetSize(state.chosenClass);
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
  else report("info", "Select a box first: click it, or press Tab.");
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
  nudge("ground", (box) => [box[0], box[1], groundNear(stage, box[0], box[1], 4) + box[5] / 2, box[3], box[4], box[5], box[6]]);
}

let copied: BoxValue | null = null;

function bindBoxes(stage: Stage): void {
  bind("draw", () => setTool(state.tool === "draw" ? "none" : "draw"));
  bind("fit.click", () => {
    const at = underPointer(stage);
    if (at) askFit({ kind: "click", at: [at[0], at[1]] }, null);
    else report("info", "Put the pointer on the object, then press C.");
  });
  bind("refit", () => refit(false));
  bind("refit.size", () => refit(true));
  bind("delete", () => withBox((row) => (row.state === "proposed" ? setBox(row, { state: "rejected" }) : deleteBox(row))));
  bind("accept", () => withBox((row) => { setBox(row, { state: "accepted" }); nextProposal(row); }));
  bind("copy", () => withBox((row) => { copied = valueOf(row); report("info", "Copied."); }));
  bind("paste", () => {
    if (!copied) return;
    const taken = state.boxes.some((row) => row.track !== null && row.track === copied!.track);
    select(addBox({ ...copied, track: taken ? freeTrack() : copied.track ?? null, state: "edited" }));
  });
  bind("duplicate", () => withBox((row, box) => select(addBox({ ...valueOf(row), box: shifted(box, 0, -row.box[4]! - 0.5, 0), track: freeTrack(), state: "edited" }))));
}

function refit(keep: boolean): void {
  withBox((row) => askFit({ kind: "refit", around: row.box, class_name: row.class_name, track: row.track, keep_size: keep }, row.id));
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

function withTrack(act: (track: number, row: BoxRow) => void): void {
  withBox((row) => (row.track === null ? report("info", "This box has no track number: type one beside its class.") : act(row.track, row)));
}

function bindTracks(): void {
  const last = (): number => (state.welcome?.frames ?? 1) - 1;
  bind("propagate", () => withTrack((track) => {
    if (state.frame >= last()) return;
    editTrack({ op: "track.propagate", track, first: state.frame, last: state.frame + 1, fit: true });
    run("frame.next");
  }));
  bind("propagate.all", () => withTrack((track) => editTrack({ op: "track.propagate", track, first: state.frame, last: driveEnd(), fit: true })));
  bind("interpolate", () => withTrack((track) => {
    const keys = state.tracks.get(track)?.keyframes ?? [];
    if (keys.length < 2) report("info", "Interpolation needs two keyframes of the object: press K in two frames.");
    else editTrack({ op: "track.interpolate", track, first: keys[0]!, last: keys[keys.length - 1]! });
  }));
  bind("keyframe", () => withBox((row) => setBox(row, { source: row.source === "interpolated" || row.source === "propagated" ? "lidar" : row.source, state: "edited" })));
  bind("end", () => withTrack((track) => {
    const info = state.tracks.get(track);
    editTrack({ op: "track.set", track, base: info?.version ?? 0, ends: info?.ends === state.frame ? -1 : state.frame });
  }));
  bind("lock", () => withTrack((track, row) => {
    const info = state.tracks.get(track);
    editTrack({ op: "track.set", track, base: info?.version ?? 0, size_locked: !info?.size_locked, size: row.box.slice(3, 6) });
  }));
}

export function driveEnd(): number {
  const drive = state.welcome?.drives.find((one) => one.frames.includes(state.frame));
  return drive ? drive.frames[drive.frames.length - 1]! : (state.welcome?.frames ?? 1) - 1;
}

export function setClass(name: string): void {
  state.chosenClass = name;
  state.chosenType = "";
  const row = selected();
  if (row && row.class_name !== name) setBox(row, { class_name: name });
  changed("tool");
}

export function bindAnnotation(stage: Stage): void {
  bindNudges(stage);
  bindBoxes(stage);
  bindTracks();
  bind("undo", () => void (undo() || report("warning", "Not connected: undo again when the connection is back.")));
  bind("redo", () => void redo());
  bind("save", () => void (send({ op: "save", id: newId() }) || report("warning", "Not connected: the edits are kept here and are sent later.")));
  onReply("saved", (message) => report("info", message.sentence || `${message.files} files written to ${message.folder}`));
}

export const describe = (box: Box): string => `${box.slice(0, 6).map((value) => value.toFixed(2)).join(" ")} ${degrees(box[6]).toFixed(1)}°`;
