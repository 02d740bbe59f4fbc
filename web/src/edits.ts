// Edits: shown at once, sent one after the other for each box, kept in the browser until the server has them on its disk.

import { report } from "./bar";
import { show } from "./frames";
import { states } from "./loader";
import type { Ack, BoxAdd, BoxDelete, BoxRow, BoxSet, BoxValue, Changed, Conflict, TrackInterpolate, TrackMerge, TrackPropagate, TrackRow, TrackSet, TrackSplit } from "./protocol";
import { newId, onReply, send, windowName } from "./socket";
import { changed, state } from "./state";

type BoxEdit = BoxSet | BoxAdd | BoxDelete;
type Edit = BoxEdit | TrackSet | TrackMerge | TrackSplit | TrackInterpolate | TrackPropagate;

let queue: Edit[] = [];
const sent = new Set<string>();
const settled = new Map<string, (row: BoxRow | null) => void>();
let store = "";

const keyOf = (edit: Edit): string => ("box" in edit ? `${edit.frame} ${edit.box}` : `track ${edit.track}`);

/**
 * Take up the edits that other pages of this data set could not send. A window that lives holds the lock of its own: where one does,
 * this waits until it is closed.
 */
export async function open(data: string): Promise<void> {
  sent.clear();
  if (!store) {
    const prefix = `farfield-edits ${data} `;
    store = prefix + windowName;
    void navigator.locks?.request(store, () => new Promise(() => undefined));
    const held = ((await navigator.locks?.query())?.held ?? []).map((lock) => lock.name ?? "");
    const others = new Set([...Object.keys(localStorage), ...held].filter((one) => one.startsWith(prefix) && one !== store));
    for (const name of others) {
      if (held.includes(name)) void navigator.locks.request(name, () => { takeUp(name); pump(); });
      else takeUp(name);
    }
  }
  pump();
}

function takeUp(name: string): void {
  const found = JSON.parse(localStorage.getItem(name) ?? "[]") as Edit[];
  localStorage.removeItem(name);
  queue.push(...found);
  if (found.length > 0) report("info", `${found.length} edits of before are sent again.`);
}

function keep(): void {
  if (queue.length > 0) localStorage.setItem(store, JSON.stringify(queue));
  else localStorage.removeItem(store);
  state.pending = queue.length;
  changed("connection");
}

/** Send what can go: of each box, only its oldest edit, with the version that the server last gave. */
function pump(): void {
  const busy = new Set<string>();
  for (const edit of queue) {
    const key = keyOf(edit);
    if (busy.has(key)) continue;
    busy.add(key);
    if (!sent.has(edit.id) && send(edit)) sent.add(edit.id);
  }
  keep();
}

function rows(frame: number): BoxRow[] {
  const found = states.get(frame);
  return found?.boxes ?? (state.shown?.frame.index === frame ? state.boxes : []);
}

function put(frame: number, list: BoxRow[]): void {
  const found = states.get(frame);
  if (found) found.boxes = list;
  changed("boxes");
  if (state.shown?.frame.index !== frame) return;
  state.shown.boxes = list;
  state.boxes = list;
  changed("boxes", "selection");
}

function write(frame: number, row: BoxRow): void {
  const list = rows(frame);
  put(frame, list.some((one) => one.id === row.id) ? list.map((one) => (one.id === row.id ? row : one)) : [...list, row]);
}

export const valueOf = (row: BoxRow): BoxValue => ({
  box: row.box, class_name: row.class_name, track: row.track, state: row.state, source: row.source, attributes: row.attributes,
});

/** Change a box of the frame shown. */
export function setBox(row: BoxRow, change: Partial<BoxValue>, group: string | null = null): void {
  addEditFor(state.frame, row, change, group);
}

/** Change a box of any frame that the page knows. A change that still waits for its turn is replaced, not repeated. */
export function addEditFor(frame: number, row: BoxRow, change: Partial<BoxValue>, group: string | null = null): void {
  const now = rows(frame).find((one) => one.id === row.id) ?? row;
  const value: BoxValue = { ...valueOf(now), ...(now.state === "accepted" || now.state === "proposed" ? { state: "edited" as const } : {}), ...change };
  write(frame, { ...now, ...value, distance_m: Math.hypot(value.box[0]!, value.box[1]!) } as BoxRow);
  const late = queue.findLast((edit) => keyOf(edit) === `${frame} ${row.id}`);
  if (late && "value" in late && !sent.has(late.id) && !group) late.value = value;
  else queue.push({ op: "box.set", id: newId(), frame, box: row.id, base: now.version, value, group });
  pump();
}

/** Show a box as it is dragged; the edit follows at the end. */
export function previewBox(row: BoxRow, box: number[]): void {
  write(state.frame, { ...row, box, distance_m: Math.hypot(box[0]!, box[1]!) });
  send({ op: "preview", frame: state.frame, box: row.id, value: box });
}

export function addBox(value: BoxValue, group: string | null = null, frame = state.frame): string {
  const box = newId();
  const row: BoxRow = {
    id: box, track: value.track ?? null, class_name: value.class_name, box: value.box, version: 0, state: value.state ?? "edited", source: value.source ?? "lidar",
    attributes: value.attributes ?? {}, score: null, points: null, radar_points: null, distance_m: Math.hypot(value.box[0]!, value.box[1]!), keyframe: true,
    visibility: null, moving: null, proposal: null,
  };
  write(frame, row);
  queue.push({ op: "box.add", id: newId(), frame, box, value, group });
  pump();
  return box;
}

export function deleteBox(row: BoxRow, group: string | null = null): void {
  const frame = state.frame;
  put(frame, rows(frame).filter((one) => one.id !== row.id));
  queue.push({ op: "box.delete", id: newId(), frame, box: row.id, base: row.version, group });
  pump();
}

type Rest<T> = T extends unknown ? Omit<T, "id"> : never;

export function editTrack(edit: Rest<TrackSet | TrackMerge | TrackSplit | TrackInterpolate | TrackPropagate>): void {
  queue.push({ ...edit, id: newId() } as Edit);
  pump();
}

export const undo = (force = false): boolean => send({ op: "undo", id: newId(), scope: "mine", force });
export const redo = (force = false): boolean => send({ op: "redo", id: newId(), scope: "mine", force });

/** Wait until the box's last edit is acknowledged. */
export function whenSettled(id: string): Promise<BoxRow | null> {
  return new Promise((resolve) => settled.set(id, resolve));
}

function finished(id: string): Edit | undefined {
  const at = queue.findIndex((edit) => edit.id === id);
  sent.delete(id);
  return at < 0 ? undefined : queue.splice(at, 1)[0];
}

/** The edits of the same box that wait behind give the new version as their base. */
function rebase(edit: Edit, version: number): void {
  for (const later of queue) if (keyOf(later) === keyOf(edit) && "base" in later) later.base = version;
}

onReply("ack", (message: Ack) => {
  const edit = finished(message.id);
  state.savedAt = new Date(Number(BigInt(message.saved_ns) / 1_000_000n)).toTimeString().slice(0, 8);
  state.undo = message.undo;
  state.redo = message.redo;
  if (edit) {
    rebase(edit, message.version);
    const waits = queue.some((later) => keyOf(later) === keyOf(edit));
    if ("box" in edit && message.row) write(edit.frame, waits ? { ...message.row, ...latest(edit) } : message.row);
    if ("box" in edit) settled.get(edit.box)?.(message.row);
    if (edit.op === "track.set") {
      const track = state.tracks.get(edit.track);
      if (track) state.tracks.set(edit.track, { ...track, version: message.version });
    }
  }
  changed("saved", "tracks");
  pump();
});

function latest(edit: BoxEdit): Partial<BoxRow> {
  const row = rows(edit.frame).find((one) => one.id === edit.box);
  return row ? { box: row.box, class_name: row.class_name, attributes: row.attributes, state: row.state } : {};
}

onReply("refused", (message) => {
  const edit = message.id ? finished(message.id) : undefined;
  if (edit && "box" in edit) {
    queue = queue.filter((later) => keyOf(later) !== keyOf(edit));
    send({ op: "frame.open", frame: edit.frame, threshold: 0, sweeps: state.sweeps });
  }
  report("error", message.sentence, message.mend);
  pump();
});

onReply("conflict", (message: Conflict) => {
  const edit = finished(message.id);
  if (!edit) {
    report("warning", message.sentence, "", [{ title: "Undo it all the same", act: () => undo(true) }]);
    return;
  }
  queue = queue.filter((later) => keyOf(later) !== keyOf(edit));
  const theirs = (): void => {
    if ("box" in edit) {
      if (message.present) write(edit.frame, message.present);
      else put(edit.frame, rows(edit.frame).filter((row) => row.id !== edit.box));
    }
    if (message.track) state.tracks.set(message.track.track, message.track);
    changed("tracks");
  };
  const mine = (): void => {
    if ("box" in edit && !message.present && edit.op !== "box.delete") addBox(edit.value, null, edit.frame);
    else if (message.present && "base" in edit) queue.push({ ...edit, id: newId(), base: message.present.version });
    else if (message.track && "base" in edit) queue.push({ ...edit, id: newId(), base: message.track.version });
    if ("box" in edit && message.present && edit.op === "box.set") write(edit.frame, { ...message.present, ...edit.value } as BoxRow);
    pump();
  };
  theirs();
  report("warning", message.sentence, "", [{ title: "Keep mine", act: mine }, { title: "Keep theirs", act: theirs }]);
  pump();
});

/** For tests: leave what other windows did unread, as a slow line would. */
export const late = { held: [] as Changed[], on: false };

onReply("changed", (message: Changed) => {
  if (late.on) late.held.push(message);
  else take(message);
});

export function hold(on: boolean): void {
  late.on = on;
  if (!on) late.held.splice(0).forEach(take);
}

function take(message: Changed): void {
  state.undo = message.undo;
  state.redo = message.redo;
  const mine = finished(message.id);
  if (mine) keep();
  for (const { frame, row } of message.rows) if (states.has(frame) || state.shown?.frame.index === frame) write(frame, row);
  for (const { frame, id } of message.removed) put(frame, rows(frame).filter((row) => row.id !== id));
  for (const track of message.tracks) setTrack(track);
  if (message.sentence) report("info", message.sentence);
  if (message.show !== null) {
    state.takenBack += 1;
    if (message.show !== state.frame) show(message.show);
  }
  changed("saved", "tracks", "boxes");
  pump();
}

function setTrack(track: TrackRow): void {
  if (track.frames.length === 0) state.tracks.delete(track.track);
  else state.tracks.set(track.track, track);
}

onReply("previewed", (message) => {
  const row = rows(message.frame).find((one) => one.id === message.box);
  if (row && message.frame === state.frame) write(message.frame, { ...row, box: message.value });
});

/** A track number that no object has. */
export function freeTrack(): number {
  let most = 0;
  for (const track of state.tracks.keys()) most = Math.max(most, track);
  for (const row of state.boxes) most = Math.max(most, row.track ?? 0);
  return most + 1;
}

