// What a person should look at: the findings of the frame and of the whole drive, which the server checks in passing; J goes from one to the next.

import { byId, fill, h } from "./dom";
import { report } from "./bar";
import { show } from "./frames";
import { bind, keyFor } from "./keys";
import type { CheckRow } from "./protocol";
import { newId, onReply } from "./socket";
import { post } from "./post";
import type { Stage } from "./stage";
import { changed, driveOf, on, select, shownFrame, shownPredictions, state } from "./state";
import { wrongFrames } from "./timeline";
import { send } from "./socket";
import { lookAt } from "./viewing";

const MOST_ROWS = 200;
const progress = { done: 0, total: 0 };
let followed: string | null = null; // the drive whose findings come
let whole = false; // the list shows the drive, not the frame only

interface Doubt {
  id: string;
  box: string | null;
  at: readonly number[] | null;
}

/** Ask for the findings of the drive that is shown, once. */
function follow(): void {
  if (state.welcome?.mode !== "annotate" || !state.connected || shownFrame() < 0) return;
  const drive = driveOf(shownFrame())?.name ?? "";
  if (drive === followed || !send({ op: "check.list", frame: shownFrame() })) return;
  followed = drive;
  Object.assign(progress, { done: 0, total: 0 });
  state.checks = state.checks.filter((row) => row.frame === shownFrame());
}

const open = (row: CheckRow): boolean => row.ignored === null && (state.hints || row.severity !== "info");

const ofFrame = (frame: number): CheckRow[] => state.checks.filter((row) => row.frame === frame && open(row));

/** What is worth a look in the frame shown: findings, missed truths, detections without a truth. */
function doubts(): Doubt[] {
  const rows: Doubt[] = ofFrame(shownFrame()).map(({ id, box, at }) => ({ id, box, at }));
  for (const { name, rows: boxes, missed } of shownPredictions(0)) {
    for (const box of missed) rows.push({ id: `missed ${name} ${box}`, box, at: null });
    for (const row of boxes.filter((one) => one.match === "false")) rows.push({ id: `false ${name} ${row.box.slice(0, 3).join()}`, box: null, at: row.box.slice(0, 3) });
  }
  return rows;
}

const visited = { frame: -1, id: "", at: -1 };
let arriving: { frame: number; id: string; by: number } | null = null; // the frame to which J went, and where in it

function visit(stage: Stage, at: number, rows: Doubt[]): void {
  const { id, box, at: where } = rows[at]!;
  Object.assign(visited, { frame: shownFrame(), id, at });
  if (box) {
    select(box);
    lookAt(stage);
  } else if (where) {
    select(null);
    stage.eye.frame([where[0]!, where[1]!, where[2] ?? 0], 18);
    stage.touch();
  }
  changed("checks");
}

/** The next doubt: in this frame, else in the next frame of the drive that has one; from the last one back to the first. */
function jump(stage: Stage, by: 1 | -1): void {
  if (arriving || state.drawnFrame !== state.frame || shownFrame() !== state.frame) return;
  const rows = doubts();
  const here = visited.frame === shownFrame();
  const found = here ? rows.findIndex((row) => row.id === visited.id) : -1;
  const next = found >= 0 ? found + by : !here ? (by > 0 ? 0 : rows.length - 1) : by > 0 ? visited.at : visited.at - 1; // one that was mended is no longer there
  if (next >= 0 && next < rows.length) return visit(stage, next, rows);
  const frames = [...new Set([...state.checks.filter(open).map((row) => row.frame), ...wrongFrames()])].filter((frame) => frame !== shownFrame()).sort((a, b) => a - b);
  const after = by > 0 ? frames.find((frame) => frame > shownFrame()) : frames.findLast((frame) => frame < shownFrame());
  const frame = after ?? (by > 0 ? frames[0] : frames[frames.length - 1]);
  if (after === undefined) report("info", frame === undefined && rows.length === 0 ? `Nothing is in doubt${unfinished() ? " so far: the drive is still being checked" : ""}.` : by > 0 ? "That was the last one: from the first." : "That was the first one: from the last.");
  if (frame === undefined) return rows.length > 0 ? visit(stage, by > 0 ? 0 : rows.length - 1, rows) : undefined;
  go(frame, "", by);
}

const unfinished = (): boolean => progress.done < progress.total;

/** Go to a finding of any frame; empty: the first one, or backwards the last. */
function go(frame: number, id: string, by: 1 | -1 = 1): void {
  arriving = { frame, id, by };
  if (frame !== state.frame) show(frame);
  changed("drawn");
}

function arrived(stage: Stage): void {
  if (!arriving) return;
  if (state.frame !== arriving.frame) return void (arriving = null); // a person went elsewhere meanwhile
  if (shownFrame() !== arriving.frame || state.drawnFrame !== arriving.frame) return;
  const { id, by } = arriving;
  arriving = null;
  const rows = doubts();
  if (rows.length === 0) return;
  const at = rows.findIndex((row) => row.id === id);
  visit(stage, at >= 0 ? at : by > 0 ? 0 : rows.length - 1, rows);
}

function rowOf(row: CheckRow, named: boolean): HTMLElement {
  const current = visited.frame === shownFrame() && visited.id === row.id ? " chosen" : "";
  return h("div", { class: `finding ${row.severity}${current}`, "data-frame": String(row.frame), "data-check": row.id, onclick: () => go(row.frame, row.id) },
    h("span", { role: "button", tabIndex: 0 }, named ? `${row.frame + 1}: ` : "", row.sentence),
    state.mode === "annotate" ? h("button", { class: "quiet", title: "Let it stand, with a reason", onclick: (event: Event) => { event.stopPropagation(); ignore(event.currentTarget as HTMLElement, row); } }, "ignore") : null);
}

function draw(): void {
  const panel = byId("checks");
  if (state.welcome?.mode !== "annotate") return void fill(panel);
  if (panel.querySelector("input:focus") instanceof HTMLInputElement && (document.activeElement as HTMLInputElement).placeholder === "reason") return; // a hand that writes keeps its field
  const all = state.checks.filter(open);
  const rows = whole ? [...all].sort((a, b) => a.frame - b.frame) : ofFrame(shownFrame());
  const here = all.filter((row) => row.frame === shownFrame()).length;
  const hints = h("input", { type: "checkbox", checked: state.hints, onchange: () => { state.hints = hints.checked; changed("checks"); } });
  const count = unfinished() ? `, ${progress.done} of ${progress.total} frames checked` : "";
  panel.classList.toggle("whole", whole);
  const top = panel.scrollTop;
  fill(panel,
    h("div", { class: "summary" },
      h("span", { class: "count", role: "status", title: `${keyFor("check.next")}: the next one of the drive` }, `${here} here, ${all.length} in the drive${count}`),
      h("label", { title: "also what is only worth a look" }, hints, "hints"),
      h("button", { class: `small${whole ? " on" : ""}`, "aria-pressed": String(whole), onclick: () => { whole = !whole; draw(); } }, "whole drive")),
    ...rows.slice(0, MOST_ROWS).map((row) => rowOf(row, whole)),
    rows.length > MOST_ROWS ? h("p", { class: "weak" }, `and ${rows.length - MOST_ROWS} more`) : null);
  panel.scrollTop = top;
}

function ignore(button: HTMLElement, row: CheckRow): void {
  const input = h("input", { placeholder: "reason", maxLength: 2000, onkeydown: (event: KeyboardEvent) => {
    if (event.key !== "Enter" || !input.value.trim()) return;
    post({ op: "check.ignore", id: newId(), check: row.id, reason: input.value.trim() });
    state.checks = state.checks.map((one) => (one.id === row.id ? { ...one, ignored: input.value.trim() } : one));
    input.blur();
    changed("checks");
  } });
  input.addEventListener("click", (event) => event.stopPropagation());
  button.replaceWith(input);
  input.focus();
}

function take(frames: readonly number[], rows: readonly CheckRow[]): void {
  const replaced = new Set(frames);
  state.checks = [...state.checks.filter((row) => !replaced.has(row.frame)), ...rows];
  changed("checks");
}

export function findingsPanel(stage: Stage): void {
  bind("check.next", () => jump(stage, 1));
  bind("check.previous", () => jump(stage, -1));
  on("connection", () => { if (!state.connected) followed = null; });
  on(["frame", "connection"], follow);
  on(["checks", "frame", "tool", "welcome"], draw);
  on(["drawn", "play"], () => arrived(stage));
  onReply("checks", (message) => take([message.frame], message.rows));
  onReply("drive.checks", (message) => {
    if (message.drive !== followed) return;
    Object.assign(progress, { done: message.done, total: message.total });
    take(message.frames, message.rows);
  });
}
