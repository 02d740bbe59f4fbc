// What lies under the pointer: a box, a point of a cloud, or the ground.

import { corners, EDGES, type Box, type Vec3 } from "./boxes";
import type { PointSet } from "./cloud";
import type { Projector } from "./project";
import type { Stage } from "./stage";
import { boxOf, shownBoxes, state } from "./state";

function nearSegment(px: number, py: number, [ax, ay, bx, by]: [number, number, number, number]): number {
  const [dx, dy] = [bx - ax, by - ay];
  const t = Math.min(1, Math.max(0, ((px - ax) * dx + (py - ay) * dy) / Math.max(dx * dx + dy * dy, 1e-9)));
  return Math.hypot(px - ax - t * dx, py - ay - t * dy);
}

/** Distance in pixels from the box: 0 inside its outline on the screen. */
export function pixelsFrom(view: Projector, box: Box, x: number, y: number): number {
  const eight = corners(box).map((corner) => view.point(corner));
  if (eight.some((at) => at === null)) return Infinity;
  let near = Infinity;
  for (const [i, j] of EDGES) near = Math.min(near, nearSegment(x, y, [...eight[i]!, ...eight[j]!]));
  const faces = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
  return faces.some((face) => inside(face.map((i) => eight[i]!), x, y)) ? 0 : near;
}

function inside(polygon: [number, number][], x: number, y: number): boolean {
  let odd = false;
  polygon.forEach(([ax, ay], i) => {
    const [bx, by] = polygon[(i + 1) % polygon.length]!;
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) odd = !odd;
  });
  return odd;
}

/** The annotated box under the pointer (the smallest on the screen where several lie there). */
export function pickBox(view: Projector, x: number, y: number, reach = 6): string | null {
  let best: { id: string; rank: number } | null = null;
  for (const row of shownBoxes()) {
    const away = pixelsFrom(view, boxOf(row), x, y);
    if (away > reach) continue;
    const at = view.point([row.box[0]!, row.box[1]!, row.box[2]!]);
    const rank = away * 100 + (at ? Math.hypot(at[0] - x, at[1] - y) : 1e6);
    if (!best || rank < best.rank) best = { id: row.id, rank };
  }
  return best?.id ?? null;
}

/** The point of the shown clouds nearest to the pointer, within `reach` pixels. */
export function pickPoint(stage: Stage, view: Projector, pane: number, x: number, y: number, reach = 7): Vec3 | null {
  let best: { at: Vec3; away: number } | null = null;
  for (const [name, { layer, object }] of stage.clouds) {
    if (!stage.inPane(name, layer, pane) || (layer.frame_T_layer && !identity(layer.frame_T_layer))) continue;
    const found = nearest(object.set, view, x, y, best?.away ?? reach);
    if (found) best = found;
  }
  return best?.at ?? null;
}

const identity = (m: number[]): boolean => m.every((value, i) => Math.abs(value - (i % 5 === 0 ? 1 : 0)) < 1e-9);

function nearest(set: PointSet, view: Projector, x: number, y: number, reach: number): { at: Vec3; away: number } | null {
  let best: { at: Vec3; away: number } | null = null;
  for (let k = 0; k < set.count * 4; k += 4) {
    const p: Vec3 = [set.places[k]! * set.scale + set.offset[0], set.places[k + 1]! * set.scale + set.offset[1], set.places[k + 2]! * set.scale + set.offset[2]];
    const at = view.point(p);
    if (!at || Math.abs(at[0] - x) > reach || Math.abs(at[1] - y) > reach) continue;
    const away = Math.hypot(at[0] - x, at[1] - y);
    if (away < (best?.away ?? reach)) best = { at: p, away };
  }
  return best;
}

/** The height of the ground near a place (or the sensor): the lowest tenth of the points there. */
export function groundNear(stage: Stage, x = 0, y = 0, reach = 25): number {
  const heights: number[] = [];
  for (const { layer, object } of stage.clouds.values()) {
    if (layer.sensor === "radar") continue;
    const { places, scale, offset, count } = object.set;
    const step = 4 * Math.max(1, Math.floor(count / (reach < 10 ? 200_000 : 8000)));
    for (let k = 0; k < count * 4; k += step)
      if (Math.abs(places[k]! * scale + offset[0] - x) < reach && Math.abs(places[k + 1]! * scale + offset[1] - y) < reach)
        heights.push(places[k + 2]! * scale + offset[2]);
  }
  if (heights.length < 20) return x === 0 && y === 0 ? -1.7 : groundNear(stage);
  heights.sort((a, b) => a - b);
  return heights[Math.floor(heights.length * 0.1)]!;
}

/** A place on the ground under the pointer: that of the point seen there if there is one. */
export function groundUnder(stage: Stage, view: Projector, pane: number, x: number, y: number): Vec3 | null {
  return pickPoint(stage, view, pane, x, y) ?? view.ground(x, y, state.shown ? stageGround(stage) : -1.7);
}

let known: { frame: unknown; z: number } = { frame: null, z: -1.7 };

/** The ground at the sensor, once a frame. */
export function stageGround(stage: Stage): number {
  const frame = stage.clouds.values().next().value?.object ?? null;
  if (known.frame !== frame) known = { frame, z: groundNear(stage) };
  return known.z;
}
