// Edits: shown at once, sent in an order that none overtakes one it depends on, kept in the browser until the server has them on its disk.

import { report, withdraw } from "./bar";
import { fault, finite, type Box } from "./boxes";
import { refresh, show } from "./frames";
import { states } from "./loader";
import type {
  Ack, BoxAccept, BoxAdd, BoxDelete, BoxRow, BoxSet, BoxValue, Changed, Conflict, Redo, TrackInterpolate, TrackMerge, TrackPropagate, TrackRow, TrackSet, TrackSplit, Undo,
} from "./protocol";
import { beginAnew, drag, draggedByOther, forgetOther, onTop, place, redraw, remove, shownRows, stands, stored, withBox } from "./rows";
import { newId, onReply, send, windowName } from "./socket";
import { changed, on, shownFrame, state } from "./state";

type BoxEdit = BoxSet | BoxAdd | BoxDelete;
type TrackEdit = TrackSet | TrackMerge | TrackSplit | TrackInterpolate | TrackPropagate;
type Step = Undo | Redo;
type Edit = BoxEdit | BoxAccept | TrackEdit | Step;

interface Waiting {
  edit: Edit;
  change?: Partial<BoxValue>; // of box.set: what the gesture changed; the rest is as it is stored
  tracks: number[]; // that it concerns
  sent: number; // when; 0: not yet
  after: number; // not before this time
}

const SILENCE_MS = 4000; // without an answer it is sent again, under its own name
const RATE_MS = 1000;
const STEP = "step"; // the question about an undo: it concerns the last step only as long as nothing else is done

let queue: Waiting[] = [];
const settled = new Map<string, (taken: boolean) => void>();
let store = "";

/**
 * Take up the edits that other pages of this data set could not send. A window that lives holds the lock of its own: where one does,
 * this waits until it is closed.
 */
export async function open(data: string, annotation: string): Promise<void> {
  beginAnew();
  const viewed = state.welcome?.mode !== "annotate"; // nothing that was kept is taken here: it waits for a studio that does
  state.stopped = viewed && state.mode === "annotate" ? "The data set is served to be viewed only by now." : "";
  if (viewed) return;
  for (const entry of queue) entry.sent = entry.after = 0;
  if (!store) {
    const prefix = `farfield-edits ${annotation} `;
    const earlier = `farfield-edits ${data} `; // as versions named them that did not tell two data sets of one kind apart
    store = prefix + windowName;
    void navigator.locks?.request(store, () => new Promise(() => undefined));
    const held = ((await navigator.locks?.query())?.held ?? []).map((lock) => lock.name ?? "");
    const others = new Set([...Object.keys(localStorage), ...held].filter((one) => (one.startsWith(prefix) || one.startsWith(earlier)) && one !== store));
    for (const name of others) {
      if (held.includes(name)) void navigator.locks.request(name, () => { takeUp(name); pump(); });
      else takeUp(name);
    }
  }
  pump();
}

function takeUp(name: string): void {
  const found = JSON.parse(localStorage.getItem(name) ?? "[]") as (Waiting | Edit)[];
  localStorage.removeItem(name);
  const entries = found.map((one): Waiting => ("edit" in one ? { ...one, sent: 0, after: 0 } : { edit: one, tracks: [], sent: 0, after: 0 }));
  for (const { edit } of entries) if ("box" in edit && !edit.box.includes(":")) edit.box = `${frameOf(edit)}:${edit.box}`; // as earlier versions named boxes
  queue.push(...entries);
  if (found.length > 0) report("info", `Edits of before are sent again: ${found.length}.`);
}

const isStep = (edit: Edit): edit is Step => edit.op === "undo" || edit.op === "redo";
/** Whether an edit may concern any box, so that nothing overtakes it and it overtakes nothing. */
const isWide = (edit: Edit): edit is Step | BoxAccept => isStep(edit) || edit.op === "box.accept";
const isTrackEdit = (edit: Edit): edit is TrackEdit => edit.op.startsWith("track.");

function keep(): void {
  const kept = queue.filter(({ edit }) => !isStep(edit));
  state.unkept = false;
  try {
    if (kept.length > 0) localStorage.setItem(store, JSON.stringify(kept));
    else if (store) localStorage.removeItem(store);
  } catch {
    state.unkept = true;
  }
  state.pending = queue.length;
  changed("connection");
}

window.addEventListener("beforeunload", (event) => {
  if (state.unkept && state.pending > 0) event.preventDefault();
});

/** Whether one of two edits has to wait for the other: their objects are the same, or one may change the other's. */
function clash(a: Waiting, b: Waiting): boolean {
  if (isWide(a.edit) || isWide(b.edit)) return true;
  if ("box" in a.edit && "box" in b.edit && a.edit.box === b.edit.box) return true;
  const shared = a.tracks.some((track) => b.tracks.includes(track));
  if (isTrackEdit(a.edit) || isTrackEdit(b.edit)) return shared;
  return shared && a.tracks.some((track) => state.tracks.get(track)?.size_locked);
}

/** Send what can go: nothing overtakes an edit on which it depends. */
function pump(): void {
  const now = performance.now();
  queue.forEach((entry, at) => {
    if (entry.sent > 0 || entry.after > now || state.stopped) return;
    for (let earlier = 0; earlier < at; earlier += 1) if (clash(queue[earlier]!, entry)) return;
    const { edit, change } = entry;
    if (edit.op === "box.set" && change) {
      const row = stored(edit.frame, edit.box);
      if (row && row.version === edit.base) edit.value = { ...valueOf(row), ...change };
    }
    if (send(edit)) entry.sent = now;
  });
  keep();
}

/** What got no answer is sent again: the server knows it by its name, and does nothing twice. */
window.setInterval(() => {
  if (!state.connected || queue.length === 0) return;
  const now = performance.now();
  for (const entry of queue) if (entry.sent > 0 && now - entry.sent > SILENCE_MS) entry.sent = 0;
  if (queue.some((entry) => entry.sent === 0)) pump();
}, RATE_MS);

on("connection", () => {
  if (!state.connected) for (const entry of queue) entry.sent = 0;
});

export const valueOf = (row: BoxRow): BoxValue => ({
  box: row.box, class_name: row.class_name, track: row.track, state: row.state, source: row.source, attributes: row.attributes,
});

onTop((frame, rows) => {
  let shown = rows;
  for (const { edit, change } of queue) {
    if (!("box" in edit) || !("frame" in edit) || edit.frame !== frame) continue;
    if (edit.op === "box.delete") shown = shown.filter((row) => row.id !== edit.box);
    else if (edit.op === "box.set") shown = shown.map((row) => (row.id === edit.box ? withBox({ ...row, ...(change ?? edit.value) } as BoxRow, (change ?? edit.value).box ?? row.box) : row));
    else if (edit.op === "box.add" && !shown.some((row) => row.id === edit.box)) shown = [...shown, rowOf(edit)];
  }
  return shown;
});

function rowOf(edit: BoxAdd): BoxRow {
  const { value } = edit;
  return {
    id: edit.box, track: value.track ?? null, class_name: value.class_name, box: value.box, version: 0, state: value.state ?? "edited", source: value.source ?? "lidar",
    attributes: value.attributes ?? {}, score: null, points: null, radar_points: null, distance_m: Math.hypot(value.box[0]!, value.box[1]!), keyframe: true,
    visibility: null, moving: null, proposal: null,
  };
}

const VIEWING = "Boxes are viewed only: nothing was changed.";
const STEPPING = "An undo is still on its way: nothing was changed.";

/** Whether an undo is still on its way, which is said: what is shown may not be what it leaves. */
export function stepping(): boolean {
  const found = queue.some(({ edit }) => isStep(edit));
  if (found) report("warning", STEPPING, "Do it again when it is there.");
  return found;
}

/** Why nothing of the frame can be changed now; empty: it can. An edit concerns what is shown, and nothing else. */
export function whyNot(): string {
  if (state.mode !== "annotate") return VIEWING;
  const frame = state.shown?.frame.index ?? -1;
  if (frame !== state.frame || state.drawnFrame !== frame) return `Frame ${state.frame + 1} is not shown yet: nothing was changed.`;
  if (state.shown!.unreadable) return `Frame ${frame + 1} cannot be read: nothing can be changed in it.`;
  if (queue.some(({ edit }) => isStep(edit))) return STEPPING;
  return "";
}

/** Whether what is shown can be changed; if not it is said why. */
export function mayEdit(): boolean {
  const reason = whyNot();
  if (reason) report("warning", reason, reason === VIEWING ? "Press Annotate first." : "Do it again when it is there.");
  return reason === "";
}

/** Change a box of the frame shown; whether that was possible. */
export function setBox(row: BoxRow, change: Partial<BoxValue>, group: string | null = null): boolean {
  return mayEdit() && addEditFor(shownFrame(), row, change, group);
}

/** Change a box of any frame; where the boxes of the frame are not here it is as `row` has it. A change that still waits for its turn is replaced, not repeated. */
export function addEditFor(frame: number, row: BoxRow, change: Partial<BoxValue>, group: string | null = null): boolean {
  const now = shownRows(frame).find((one) => one.id === row.id) ?? (stands(frame) ? undefined : row);
  if (!now) {
    report("warning", "This box is no longer there: nothing was changed.");
    return false;
  }
  const wrong = change.box ? fault(change.box as unknown as Box) : "";
  if (wrong) {
    state.note = { id: row.id, text: wrong };
    report("warning", wrong, "Nothing was changed.");
    changed("tool");
    return false;
  }
  if (state.note?.id === row.id) state.note = null;
  forgetOther(row.id); // an edit is drawn at once
  const whole: Partial<BoxValue> = { ...(now.state === "accepted" || now.state === "proposed" ? { state: "edited" as const } : {}), ...change };
  const late = queue.findLast(({ edit }) => "box" in edit && edit.box === row.id);
  const tracks = tracksOf(now.track, change.track);
  if (late && late.edit.op === "box.set" && late.sent === 0 && !group && !late.edit.group) {
    late.change = { ...late.change, ...whole };
    late.edit.value = { ...late.edit.value, ...whole };
    late.tracks = [...new Set([...late.tracks, ...tracks])];
  } else {
    const edit: BoxSet = { op: "box.set", id: newId(), frame, box: row.id, base: stored(frame, row.id)?.version ?? now.version, value: { ...valueOf(now), ...whole }, group };
    enqueue({ edit, change: whole, tracks, sent: 0, after: 0 });
  }
  redraw(frame);
  pump();
  return true;
}

function enqueue(entry: Waiting): void {
  withdraw(STEP);
  queue.push(entry);
}

const tracksOf = (...tracks: (number | null | undefined)[]): number[] => tracks.filter((track): track is number => track !== null && track !== undefined);

/** Show a box as it is dragged; the edit follows at the end. Null: the drag is over, or given up. */
export function previewBox(row: BoxRow, box: Box | null): void {
  const frame = shownFrame();
  if (box && !finite(box)) return;
  drag(box ? { frame, id: row.id, box } : null);
  const shown = box ?? shownRows(frame).find((one) => one.id === row.id)?.box;
  if (shown && !fault(shown as unknown as Box)) send({ op: "preview", frame, box: row.id, value: shown as number[] });
}

/**
 * Add a box to the frame shown, or to the one in which its gesture was made, whatever is shown by now; null where that is not possible.
 * `fresh`: a new object, whose number is only proposed: the server gives another where an object of the drive has it by now.
 */
export function addBox(value: BoxValue, group: string | null = null, at?: number, fresh = false): string | null {
  const frame = at ?? shownFrame();
  const wrong = fault(value.box as unknown as Box);
  if (wrong) report("warning", wrong, "No box was made.");
  if (wrong || (at === undefined && !mayEdit())) return null;
  const box = `${frame}:${newId()}`;
  enqueue({ edit: { op: "box.add", id: newId(), frame, box, value, group, fresh }, tracks: tracksOf(value.track), sent: 0, after: 0 });
  redraw(frame);
  pump();
  return box;
}

export function deleteBox(row: BoxRow, group: string | null = null): void {
  if (!mayEdit()) return;
  const frame = shownFrame();
  const base = stored(frame, row.id)?.version ?? 0;
  enqueue({ edit: { op: "box.delete", id: newId(), frame, box: row.id, base, group }, tracks: tracksOf(row.track), sent: 0, after: 0 });
  redraw(frame);
  pump();
}

type Rest<T> = T extends unknown ? Omit<T, "id"> : never;

/** Edit a track through its box in the frame shown; what happens when it is answered. */
export function editTrack(edit: Rest<TrackEdit>, then?: (taken: boolean) => void): void {
  if (!mayEdit()) return then?.(false);
  const id = newId();
  if (then) settled.set(id, then);
  const tracks = tracksOf(edit.track, "into" in edit ? edit.into : null, "new_track" in edit ? edit.new_track : null);
  enqueue({ edit: { ...edit, id } as TrackEdit, tracks, sent: 0, after: 0 });
  pump();
}

/** Accept the proposals that were counted. */
export function acceptProposals(rest: Omit<BoxAccept, "op" | "id">): void {
  if (!mayEdit()) return;
  enqueue({ edit: { op: "box.accept", id: newId(), ...rest }, tracks: [], sent: 0, after: 0 });
  pump();
}

/** The version of a box that is stored, as an edit of its track names it. */
export const versionOf = (row: BoxRow): number => stored(shownFrame(), row.id)?.version ?? row.version;

function step(op: "undo" | "redo", force: boolean): boolean {
  if (!state.connected) return false;
  enqueue({ edit: { op, id: newId(), scope: "mine", force }, tracks: [], sent: 0, after: 0 });
  pump();
  return true;
}

export const undo = (force = false): boolean => step("undo", force);
export const redo = (force = false): boolean => step("redo", force);

/** An edit that was not taken: an undo that waited for it would take back another one. */
function failed(id: string): Waiting | undefined {
  const at = queue.findIndex(({ edit }) => edit.id === id);
  const steps = at < 0 ? [] : queue.slice(at + 1).filter(({ edit }) => isStep(edit));
  if (steps.length > 0) report("info", "What was to be undone was not taken: nothing else was undone.");
  for (const { edit } of steps) finished(edit.id, false);
  return finished(id, false);
}

function finished(id: string, taken: boolean): Waiting | undefined {
  const at = queue.findIndex(({ edit }) => edit.id === id);
  const entry = at < 0 ? undefined : queue.splice(at, 1)[0];
  const then = settled.get(id);
  settled.delete(id);
  if (then) queueMicrotask(() => then(taken));
  return entry;
}

const frameOf = (edit: Edit): number => ("frame" in edit ? edit.frame : "first" in edit ? edit.first : -1);

/** The edits that wait behind one of this window's own start from the version that it made, not from what others have made of that. */
function rebase(frame: number, box: string, version: number): void {
  for (const { edit } of queue) {
    if (!("box" in edit) || edit.box !== box || frameOf(edit) !== frame) continue;
    if ("box_base" in edit) edit.box_base = version; // its base is the track's
    else if ("base" in edit) edit.base = version;
  }
}

function rebaseTrack({ track, version }: TrackRow): void {
  for (const { edit } of queue) {
    if (!isTrackEdit(edit)) continue;
    if (edit.track === track && "base" in edit) edit.base = version;
    if ("into" in edit && edit.into === track) edit.into_base = version;
  }
}

/** The server gave a new object another number than this window thought to be free: what waits behind it concerns that number. */
function renumber(added: BoxAdd, track: number | null): void {
  const proposed = added.value.track ?? null;
  if (!added.fresh || proposed === null || track === null || track === proposed) return;
  for (const entry of queue) {
    if (!("box" in entry.edit) || entry.edit.box !== added.box) continue;
    if ("track" in entry.edit) entry.edit.track = track;
    entry.tracks = entry.tracks.map((one) => (one === proposed ? track : one));
  }
}

onReply("ack", (message: Ack) => {
  const entry = finished(message.id, true);
  state.undo = message.undo;
  state.redo = message.redo;
  const edit = entry?.edit;
  if (edit && "box" in edit) {
    const frame = frameOf(edit);
    if (message.row) {
      if (edit.op === "box.add") renumber(edit, message.row.track);
      place(frame, message.row);
      rebase(frame, edit.box, message.version);
    } else if (edit.op === "box.delete") remove(frame, edit.box, message.version);
    redraw(frame);
  }
  changed("saved", "tracks");
  pump();
});

onReply("refused", (message) => {
  const entry = message.id === null ? undefined : queue.find(({ edit }) => edit.id === message.id);
  if (entry && message.code === "journal") { // the server takes no more: what waits stays here until it is back
    state.stopped = message.sentence;
    for (const one of queue) one.sent = 0;
    beginAnew();
    refresh();
    keep();
    return;
  }
  if (entry && message.code === "rate") {
    Object.assign(entry, { sent: 0, after: performance.now() + RATE_MS });
    return;
  }
  if (entry) {
    failed(entry.edit.id);
    const { edit } = entry;
    if (edit.op === "box.add") for (const later of queue.filter((one) => "box" in one.edit && one.edit.box === edit.box)) finished(later.edit.id, false);
    if ("box" in edit) {
      state.note = { id: edit.box, text: message.sentence };
      redraw(frameOf(edit));
      changed("tool");
    }
  }
  report("error", message.sentence, message.mend);
  pump();
});

onReply("conflict", (message: Conflict) => {
  const entry = failed(message.id);
  const edit = entry?.edit;
  if (!edit) return; // it was answered before: this is what a repeated one gets
  if (isStep(edit)) {
    report("warning", message.sentence, "", [{ title: `${edit.op === "undo" ? "Undo" : "Redo"} it all the same`, act: () => void step(edit.op, true) }], STEP);
    pump();
    return;
  }
  const frame = frameOf(edit);
  if (edit.op === "box.accept") { // what was counted is no longer what is there
    if (message.frame !== null && message.present) place(message.frame, message.present);
    report("warning", `Nothing was accepted: ${message.sentence}.`, "Count the proposals again.");
    pump();
    return;
  }
  let mineValue = edit.op === "box.set" ? edit.value : null;
  if ("box" in edit) {
    const later = isTrackEdit(edit) ? [] : queue.filter((one) => "box" in one.edit && one.edit.box === edit.box && !isTrackEdit(one.edit));
    queue = queue.filter((one) => !later.includes(one));
    for (const one of later) if (one.edit.op === "box.set") mineValue = { ...(mineValue ?? one.edit.value), ...(one.change ?? one.edit.value) };
    if (message.present) place(frame, message.present);
    else if (message.frame !== null) remove(frame, edit.box, stored(frame, edit.box)?.version ?? 0);
    redraw(frame);
  }
  if (message.track) setTrack(message.track);
  changed("tracks");
  const mine = (): void => {
    if (edit.op === "box.set" && mineValue && !message.present) addBox(mineValue, null, frame);
    else if (edit.op === "box.set" && mineValue && message.present) addEditFor(frame, message.present, mineValue);
    else if (edit.op === "box.delete" && message.present) enqueue({ ...entry!, edit: { ...edit, id: newId(), base: message.present.version }, sent: 0 });
    else if (message.present && "box_base" in edit) enqueue({ ...entry!, edit: { ...edit, id: newId(), box_base: message.present.version }, sent: 0 });
    else if (message.track && edit.op === "track.merge" && message.track.track === edit.into) enqueue({ ...entry!, edit: { ...edit, id: newId(), into_base: message.track.version }, sent: 0 });
    else if (message.track && "base" in edit) enqueue({ ...entry!, edit: { ...edit, id: newId(), base: message.track.version }, sent: 0 });
    else if (message.present && "base" in edit) enqueue({ ...entry!, edit: { ...edit, id: newId(), base: message.present.version } as Edit, sent: 0 });
    redraw(frame);
    pump();
  };
  const where = "box" in edit ? `Frame ${frame + 1}, box ${edit.box}: ` : "";
  report("warning", where + message.sentence, "", [{ title: "Keep mine", act: mine }, { title: "Keep theirs", act: () => undefined }]);
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

let counted = 0; // the last edit whose tracks are known

function take(message: Changed): void {
  state.undo = message.undo;
  state.redo = message.redo;
  const mine = finished(message.id, true);
  for (const { frame, row } of message.rows) {
    place(frame, row);
    if (mine && !isStep(mine.edit)) rebase(frame, row.id, message.seq);
  }
  for (const { frame, id } of message.removed) remove(frame, id, message.seq);
  if (mine && "box" in mine.edit) redraw(frameOf(mine.edit));
  if (message.id === "" && message.drive !== state.drive) { // this window came to another drive
    state.drive = message.drive;
    state.tracks = new Map();
    counted = 0;
  }
  if (mine && !isStep(mine.edit)) message.tracks.forEach(rebaseTrack);
  if (message.drive === state.drive && message.seq >= counted) {
    for (const track of message.tracks) setTrack(track);
    counted = message.seq;
  }
  if (message.sentence && message.window === state.welcome?.window) report("info", message.sentence);
  if (mine && isStep(mine.edit)) {
    state.takenBack += 1;
    if (message.show !== null && message.show !== state.frame) show(message.show); // null: no box was changed by it
  }
  changed("saved", "tracks", "boxes");
  pump();
}

/** The tracks of a drive, as a welcome has them. */
export function setTracks(rows: readonly TrackRow[], drive: string, seq: number): void {
  state.drive = drive;
  state.tracks = new Map(rows.map((row) => [row.track, row]));
  counted = seq;
}

function setTrack(track: TrackRow): void {
  if (track.frames.length === 0) state.tracks.delete(track.track);
  else state.tracks.set(track.track, track);
}

onReply("previewed", (message) => {
  if (states.has(message.frame) || message.frame === shownFrame()) draggedByOther(message.frame, message.box, [...message.value]);
});

/** A track number that no object has, as far as this window knows, nor any that is on its way; `addBox` takes it as a proposal. */
export function freeTrack(...coming: number[]): number {
  let most = Math.max(0, ...coming);
  for (const track of state.tracks.keys()) most = Math.max(most, track);
  for (const row of state.boxes) most = Math.max(most, row.track ?? 0);
  for (const { tracks } of queue) most = Math.max(most, ...tracks);
  return most + 1;
}
