// Boxes as seven numbers: centre x y z (m), length width height (m), yaw (rad, counter-clockwise from +x).

import { wrapped } from "./dom";

export type Box = [number, number, number, number, number, number, number];
export type Vec3 = [number, number, number];

export function corners(box: Box): Vec3[] {
  const [x, y, z, l, w, hgt, yaw] = box;
  const c = Math.cos(yaw);
  const s = Math.sin(yaw);
  const out: Vec3[] = [];
  for (const dz of [-hgt / 2, hgt / 2])
    for (const [dx, dy] of [[l / 2, w / 2], [l / 2, -w / 2], [-l / 2, -w / 2], [-l / 2, w / 2]] as const)
      out.push([x + c * dx - s * dy, y + s * dx + c * dy, z + dz]);
  return out;
}

/** The twelve edges, as pairs of rows of `corners`. */
export const EDGES: readonly (readonly [number, number])[] = [
  [0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7],
];

/** Where the heading is drawn: from the middle of the top of the front face, forward. */
export function heading(box: Box): [Vec3, Vec3] {
  const [x, y, z, l, , , yaw] = box;
  const c = Math.cos(yaw);
  const s = Math.sin(yaw);
  return [[x, y, z], [x + c * (l / 2 + 0.8), y + s * (l / 2 + 0.8), z]];
}

/** A point of the frame in the box's own axes (forward, left, up). */
export function toBox(box: Box, p: Vec3): Vec3 {
  const c = Math.cos(box[6]);
  const s = Math.sin(box[6]);
  const dx = p[0] - box[0];
  const dy = p[1] - box[1];
  return [c * dx + s * dy, -s * dx + c * dy, p[2] - box[2]];
}

export function fromBox(box: Box, p: Vec3): Vec3 {
  const c = Math.cos(box[6]);
  const s = Math.sin(box[6]);
  return [box[0] + c * p[0] - s * p[1], box[1] + s * p[0] + c * p[1], box[2] + p[2]];
}

/** Move one face of the box by `by` metres along its outward normal; the opposite face stays. axis 0 length, 1 width, 2 height; side +1 or -1. */
export function faceMoved(box: Box, axis: 0 | 1 | 2, side: 1 | -1, by: number, least = 0.1): Box {
  const out = [...box] as Box;
  const size = Math.max(least, box[3 + axis]! + by);
  const grown = size - box[3 + axis]!;
  out[3 + axis] = size;
  const shift: Vec3 = [0, 0, 0];
  shift[axis] = (side * grown) / 2;
  [out[0], out[1], out[2]] = fromBox(box, shift);
  return out;
}

export function shifted(box: Box, forward: number, left: number, up: number): Box {
  const out = [...box] as Box;
  [out[0], out[1], out[2]] = fromBox(box, [forward, left, up]);
  return out;
}

export function turned(box: Box, by: number): Box {
  const out = [...box] as Box;
  out[6] = wrapped(box[6] + by);
  return out;
}

export const range = (box: Box): number => Math.hypot(box[0], box[1]);

/** True when the point (frame axes) lies in the box grown by `margin` metres. */
export function holds(box: Box, p: Vec3, margin = 0): boolean {
  const q = toBox(box, p);
  return Math.abs(q[0]) <= box[3] / 2 + margin && Math.abs(q[1]) <= box[4] / 2 + margin && Math.abs(q[2]) <= box[5] / 2 + margin;
}

export const FARTHEST_M = 1000;
export const LONGEST_M = 60;

export const finite = (box: readonly number[]): boolean => box.every(Number.isFinite);

/** What is wrong with a box, in words; empty: nothing. The server has the same bounds. */
export function fault(box: readonly number[]): string {
  if (box.length !== 7 || !finite(box)) return "A box needs seven finite numbers.";
  const size = (["length", "width", "height"] as const).findIndex((_, i) => !(box[3 + i]! > 0 && box[3 + i]! <= LONGEST_M));
  if (size >= 0) return `${["Length", "Width", "Height"][size]}: expected above 0 and up to ${LONGEST_M} m, got ${Number(box[3 + size]!.toPrecision(6))} m.`;
  const place = [0, 1, 2].find((i) => Math.abs(box[i]!) > FARTHEST_M);
  if (place !== undefined) return `${"xyz"[place]}: expected from -${FARTHEST_M} to ${FARTHEST_M} m, got ${Number(box[place]!.toPrecision(6))} m.`;
  return Math.abs(box[6]!) <= 10 ? "" : "Yaw: expected a heading within ten radians.";
}

export const same = (a: Box, b: Box): boolean => a.every((value, i) => value === b[i]);
