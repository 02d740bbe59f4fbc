// What the calibration page knows: the server's state, the values as they move, residuals as they come.

import { report } from "./bar";
import type { CalibResidual, CalibState, CameraValues, FrameState, Job, RadarValues, Residuals } from "./protocol";
import { post } from "./post";
import { newId, onReply, send } from "./socket";

export type Values = RadarValues | CameraValues;

export const model = {
  state: null as CalibState | null,
  values: null as Values | null, // as they move; the state's at rest
  moving: false,
  blink: false, // the values at the start are shown
  residuals: null as Residuals | null,
  answered: 0, // residuals that came
  milliseconds: 0,
  place: 0, // of the frame among those that serve
  job: null as Job | null,
  fresh: false, // the residuals are those of the values
};

const listeners = new Set<() => void>();
let waiting = false;

export const onChange = (listener: () => void): void => void listeners.add(listener);

/** Say that something changed; listeners run once, in the next frame. */
export function changed(): void {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    listeners.forEach((listener) => listener());
  });
}

export const isRadar = (values: Values): values is RadarValues => "x_m" in values;

/** The values that are drawn: those at the start while blinking. */
export const drawn = (): Values | null => (model.blink ? (model.state?.before ?? null) : model.values);

export const frameNow = (): number => model.state?.frames[model.place]?.index ?? 0;

const as = (values: Values): { radar?: RadarValues; camera?: CameraValues } => (isRadar(values) ? { radar: values } : { camera: values });

let asked: string | null = null;
let again = false;
let timer = 0;

/** Ask for the residuals of the values: one question at a time, the last one with sigma. */
export function ask(full = false): void {
  const { state, values } = model;
  if (!state?.ready || !values) return;
  model.fresh = false;
  clearTimeout(timer);
  if (asked) {
    again = true;
    return;
  }
  const id = newId();
  if (send({ op: "calib.match", id, frame: frameNow(), full, ...as(values) })) asked = id;
  if (!full) timer = window.setTimeout(() => ask(true), 250);
}

function residual(message: CalibResidual): void {
  if (message.id !== asked) return;
  asked = null;
  const known = model.residuals?.known ?? [];
  const bare = message.residuals.known.length === 0 && !message.residuals.lacking;
  model.residuals = bare ? { ...message.residuals, known } : message.residuals;
  model.answered += 1;
  model.milliseconds = message.milliseconds;
  model.fresh = !again;
  if (again) {
    again = false;
    ask();
  }
  changed();
}

/** Move: drawn at once, residuals follow. */
export function move(values: Values): void {
  Object.assign(model, { values, moving: true, blink: false });
  ask();
  changed();
}

/** A drag is given up: the values are as they were before it. */
export function giveBack(values: Values | null): void {
  if (!values || !model.moving) return;
  Object.assign(model, { values, moving: false, blink: false });
  ask();
  changed();
}

let sent = ""; // a change that is not yet acknowledged
let sentValues: Values | null = null;
let next: Values | null = null; // the one after it

/** Keep what was moved: one step of undo. A change waits for the one before, for it counts from the state that this makes. */
export function keep(values: Values): void {
  Object.assign(model, { values, moving: false, blink: false });
  if (sent) next = values;
  else put(values);
  ask(); // the residuals on the screen are those of the values before
  changed();
}

function put(values: Values): void {
  const id = newId();
  if (model.state && send({ op: "calib.set", id, base: model.state.seq, ...as(values) })) [sent, sentValues] = [id, values];
  else next = values; // until the connection is back
}

let opening = "";

/** Ask for the calibration as it stands, at the start and after a lost connection. */
export function openCalibration(): void {
  opening = newId();
  asked = null; // its answer went with the connection
  send({ op: "calib.open", id: opening });
}

interface Work {
  values: Values;
  picks: CalibState["picks"];
}

let lost: Work | null = null; // what a studio that began anew does not have
let picksDue: CalibState["picks"] = [];

/** What a lost connection may have cost: changes that got no answer, or all that was not saved where the studio began anew. */
function recover(message: CalibState): void {
  const before = model.state;
  if (!before || !model.values) return;
  const theirs = message.radar ?? message.camera;
  if (message.seq < before.seq) {
    lost ??= { values: model.values, picks: before.picks };
    [sent, next] = ["", null];
  } else if (message.answers === opening && (sent || next)) {
    const values = next ?? sentValues!;
    const ours = [before.radar ?? before.camera, sentValues, values];
    [sent, next] = ["", null];
    if (!ours.some((one) => same(one, theirs))) report("warning", "Another window changed the calibration meanwhile.", "Change it again.");
    else if (!same(values, theirs)) next = values;
  }
  if (!lost || !message.ready) return;
  const there = new Set(message.picks.map((pick) => JSON.stringify([pick.frame, pick.point_m])));
  picksDue = lost.picks.filter((pick) => !there.has(JSON.stringify([pick.frame, pick.point_m])));
  next = same(lost.values, theirs) ? null : lost.values;
  lost = null;
  report("info", "The studio was started again: what was not saved is set anew.");
}

const same = (a: Values | null, b: Values | null): boolean => JSON.stringify(a) === JSON.stringify(b);

function told(message: CalibState): void {
  recover(message);
  const first = !model.state?.ready && message.ready;
  const other = JSON.stringify([message.radar, message.camera, message.picks]) !== JSON.stringify([model.state?.radar, model.state?.camera, model.state?.picks]);
  model.state = message;
  if (message.answers === sent) sent = "";
  if (!sent && next) {
    const waiting = next;
    next = null;
    put(waiting);
  }
  for (const pick of picksDue) post({ op: "calib.pick", id: newId(), frame: pick.frame, point_m: pick.point_m, pixel: pick.pixel });
  picksDue = [];
  if (!model.moving && !sent && !next) model.values = message.radar ?? message.camera;
  model.place = Math.min(model.place, message.frames.length - 1);
  if (first || other) ask();
  changed();
}

function job(message: Job): void {
  if (message.kind !== "calibrate") return;
  const over = message.state !== "running" && message.state !== "queued";
  model.job = over ? null : message;
  if (message.state === "failed") report("error", message.message, "Nothing was changed.");
  if (message.state === "cancelled") report("info", "Stopped; nothing was changed.");
  if (message.state === "done" && message.message) report("info", `${message.message}.`);
  changed();
}

const states = new Map<number, FrameState>();
const wanted = new Map<number, ((state: FrameState) => void)[]>();

/** A frame's state, asked for once. */
export function stateOf(frame: number): Promise<FrameState> {
  const known = states.get(frame);
  if (known) return Promise.resolve(known);
  return new Promise((resolve) => {
    const others = wanted.get(frame);
    if (others) return void others.push(resolve);
    wanted.set(frame, [resolve]);
    send({ op: "frame.open", frame, purpose: "ahead" });
  });
}

export function go(place: number): void {
  const count = model.state?.frames.length ?? 0;
  const to = Math.max(0, Math.min(count - 1, place));
  if (to === model.place) return;
  model.place = to;
  ask();
  changed();
}

export function listenToServer(): void {
  onReply("calib.state", told);
  onReply("calib.residual", residual);
  onReply("job", job);
  onReply("frame.state", (message) => {
    states.set(message.frame.index, message);
    wanted.get(message.frame.index)?.forEach((resolve) => resolve(message));
    wanted.delete(message.frame.index);
  });
  onReply("calib.saved", (message) => {
    const copies = message.copies.length > 0 ? ` What was there is kept in ${message.copies.length} cop${message.copies.length > 1 ? "ies" : "y"} beside.` : "";
    report("info", `${message.restored ? "Put back" : "Saved"}: ${message.files.slice(0, 3).join(", ")}${message.files.length > 3 ? ` and ${message.files.length - 3} more` : ""}.${copies}`);
  });
  onReply("refused", (message) => {
    if (message.id === asked) asked = null;
    const undone = message.id === sent;
    if (undone) [sent, next] = ["", null];
    if (model.state && !model.moving) model.values = model.state.radar ?? model.state.camera;
    if (undone) ask();
    report("warning", message.sentence, message.mend);
    changed();
  });
}
