// The boxes of frames: as they are stored, and as they are shown, with the edits that wait and what is being dragged on top.

import type { Box } from "./boxes";
import { states } from "./loader";
import type { BoxRow } from "./protocol";
import { changed, shownFrame, state } from "./state";

const standing = new Map<number, BoxRow[]>();
const touched = new Map<number, number>(); // number of the last edit that is known of a frame
const gone = new Map<string, number>(); // by which edit a box went
let pending: (frame: number, rows: BoxRow[]) => BoxRow[] = (_, rows) => rows;
let dragged: { frame: number; id: string; box: Box } | null = null;
const others = new Map<string, { frame: number; box: number[]; timer: number }>(); // boxes that other windows drag
const OTHERS_MS = 1500; // without news of such a drag it counts as given up

/** How the edits that wait change what is stored. */
export function onTop(apply: typeof pending): void {
  pending = apply;
}

export const withBox = (row: BoxRow, box: readonly number[]): BoxRow => ({ ...row, box: [...box] as unknown as BoxRow["box"], distance_m: Math.hypot(box[0]!, box[1]!) });

/** The boxes of a frame as the server has them; false where later edits are known already: then they are to be asked for anew. */
export function stand(frame: number, rows: readonly BoxRow[], seq: number): boolean {
  if (seq < (touched.get(frame) ?? 0)) return false;
  for (const other of standing.keys()) if (!states.has(other) && other !== shownFrame()) standing.delete(other);
  standing.set(frame, [...rows]);
  return true;
}

/** The server begins anew: what was known of the order of its edits no longer counts. */
export function beginAnew(): void {
  touched.clear();
  gone.clear();
}

export const stored = (frame: number, id: string): BoxRow | null => standing.get(frame)?.find((row) => row.id === id) ?? null;

/** Whether the boxes of a frame are here. */
export const stands = (frame: number): boolean => standing.has(frame);

/** The boxes of a frame as they are shown. */
export function shownRows(frame: number): BoxRow[] {
  const rows = pending(frame, standing.get(frame) ?? []);
  return rows.map((row) => {
    if (dragged && dragged.frame === frame && dragged.id === row.id) return withBox(row, dragged.box);
    const other = others.get(row.id);
    return other ? withBox(row, other.box) : row;
  });
}

/** A box as it now stands on the server; what is older than what is known is left out. */
export function place(frame: number, row: BoxRow): void {
  touched.set(frame, Math.max(touched.get(frame) ?? 0, row.version));
  const rows = standing.get(frame);
  const known = rows?.find((one) => one.id === row.id);
  if (!rows || row.version <= (gone.get(row.id) ?? 0) || (known && known.version > row.version)) return;
  standing.set(frame, known ? rows.map((one) => (one === known ? row : one)) : [...rows, row]);
  forgetOther(row.id);
  redraw(frame);
}

/** A box that is no more since an edit. */
export function remove(frame: number, id: string, seq: number): void {
  touched.set(frame, Math.max(touched.get(frame) ?? 0, seq));
  gone.set(id, Math.max(gone.get(id) ?? 0, seq));
  const rows = standing.get(frame);
  if (!rows || (stored(frame, id)?.version ?? 0) > seq) return;
  standing.set(frame, rows.filter((row) => row.id !== id));
  redraw(frame);
}

/** Show a frame's boxes as they now are. */
export function redraw(frame: number): void {
  if (!standing.has(frame)) return;
  const rows = shownRows(frame);
  const known = states.get(frame);
  if (known) known.boxes = rows;
  if (state.shown && shownFrame() === frame) {
    state.shown.boxes = rows;
    state.boxes = rows;
    changed("selection");
  }
  changed("boxes");
}

/** What this window drags; null: nothing any more. */
export function drag(box: { frame: number; id: string; box: Box } | null): void {
  const frames = new Set([dragged, box].flatMap((one) => (one ? [one.frame] : [])));
  dragged = box;
  frames.forEach(redraw);
}

/** What another window drags. */
export function draggedByOther(frame: number, id: string, box: number[]): void {
  forgetOther(id);
  others.set(id, { frame, box, timer: window.setTimeout(() => { forgetOther(id); redraw(frame); }, OTHERS_MS) });
  redraw(frame);
}

/** What another window drags no longer covers a box: it was changed here, or stored. */
export function forgetOther(id: string): void {
  window.clearTimeout(others.get(id)?.timer);
  others.delete(id);
}
