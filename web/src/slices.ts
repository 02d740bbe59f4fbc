// The radar's elevation slice (BFS-2D) at the selected box's range: where heights of objects without LiDAR points are read off.

import { sample } from "./colours";
import { byId, fill, h } from "./dom";
import { load } from "./loader";
import type { Layer } from "./protocol";
import { edges } from "./radarlevels";
import { boxOf, on, selected, state } from "./state";
import type { Payload } from "./wire";

let last = "";
let wait = 0;

export function slicesPanel(): void {
  on(["frame", "selection", "boxes"], () => {
    window.clearTimeout(wait);
    wait = window.setTimeout(() => void draw(), 60);
  });
}

function near(layer: Layer): [number, number, string] {
  const row = selected();
  if (!row) return [0, 300, layer.url];
  const box = boxOf(row);
  const centre = layer.polar ? Math.hypot(box[0], box[1]) : box[0];
  const half = Math.max(box[3], 2) / 2 + 0.5;
  const [low, high] = [Math.max(0, Math.round((centre - half) * 2) / 2), Math.round((centre + half) * 2) / 2];
  return [low, high, `${layer.url}?low=${low}&high=${high}`];
}

async function draw(): Promise<void> {
  const layer = state.shown?.layers.find((one) => one.kind === "bfs");
  if (!layer) {
    fill(byId("slices"));
    last = "";
    return;
  }
  const [low, high, url] = near(layer);
  const frame = state.frame;
  const payload = (await load(frame, { ...layer, url }).catch(() => null)) as Payload | null;
  if (!payload || frame !== state.frame) return;
  const canvas = paint(payload, layer);
  const title = selected() ? `radar from the front, ${low} to ${high} m` : "radar from the front, all ranges";
  last = url;
  fill(byId("slices"), h("div", { class: "close" }, canvas, h("span", {}, title)));
}

function axes(layer: Layer): { across: [number, number, number]; up: [number, number, number] } | null {
  if (layer.polar?.elevation_rad) return { across: edges(layer.polar.azimuth_rad), up: edges(layer.polar.elevation_rad) };
  return layer.grid?.y_m && layer.grid.z_m ? { across: edges(layer.grid.y_m), up: edges(layer.grid.z_m) } : null;
}

/** The part of an axis that is shown: round the box, or all of it. */
function part(axis: [number, number, number], centre: number | null, half: number): [number, number] {
  const [low, high] = [Math.min(axis[0], axis[1]), Math.max(axis[0], axis[1])];
  if (centre === null || high - low < 2 * half) return [low, high];
  const from = Math.min(high - 2 * half, Math.max(low, centre - half));
  return [from, from + 2 * half];
}

const WIDE = 560;
const TALL = 168;

/** Up is up, and left of the sensor is on the left. */
function paint(payload: Payload, layer: Layer): HTMLCanvasElement | null {
  const field = payload.header.fields.find((one) => one.type === "uint8");
  const found = axes(layer);
  if (!field || !found) return null;
  const row = selected();
  const at = row ? mapped(layer, boxOf(row)) : null;
  const across = part(found.across, at?.across ?? null, layer.polar ? 0.35 : 14);
  const up = part(found.up, at ? at.up : layer.polar ? null : 1, layer.polar ? 0.32 : 5);
  const level = payload.arrays.get(field.name) as Uint8Array;
  const columns = found.across[2];
  const pick = (axis: [number, number, number], value: number): number => Math.min(axis[2] - 1, Math.max(0, Math.floor(((value - axis[0]) / (axis[1] - axis[0])) * axis[2])));
  const out = h("canvas", { width: WIDE, height: TALL, id: "slice" });
  const picture = new ImageData(WIDE, TALL);
  const seen: number[] = [];
  for (let j = 0; j < TALL; j += 1)
    for (let i = 0; i < WIDE; i += 1)
      seen.push(level[pick(found.up, up[1] - ((j + 0.5) / TALL) * (up[1] - up[0])) * columns + pick(found.across, across[1] - ((i + 0.5) / WIDE) * (across[1] - across[0]))]!);
  const sorted = Uint8Array.from(seen).sort();
  const [floor, top] = [sorted[Math.floor(sorted.length * 0.3)]!, sorted[sorted.length - 1]!];
  seen.forEach((value, k) => picture.data.set([...sample("inferno", (value - floor) / Math.max(1, top - floor)), 255], k * 4));
  const paper = out.getContext("2d")!;
  paper.putImageData(picture, 0, 0);
  if (at) {
    const x = (value: number): number => WIDE * (1 - (value - across[0]) / (across[1] - across[0]));
    const y = (value: number): number => TALL * (1 - (value - up[0]) / (up[1] - up[0]));
    paper.strokeStyle = "#ffffff";
    paper.lineWidth = 2;
    paper.strokeRect(x(at.across + at.wide), y(at.top), x(at.across - at.wide) - x(at.across + at.wide), y(at.bottom) - y(at.top));
  }
  return out;
}

/** The box on the slice's axes: radians from a polar radar, metres from a cube; the radar's own place taken off. */
function mapped(layer: Layer, box: ReturnType<typeof boxOf>): { across: number; wide: number; up: number; top: number; bottom: number } {
  const m = layer.frame_T_layer;
  const [x, y, z] = [box[0] - (m?.[3] ?? 0), box[1] - (m?.[7] ?? 0), box[2] - (m?.[11] ?? 0)];
  const r = Math.max(1, Math.hypot(x, y));
  const half = (Math.abs(Math.sin(box[6])) * box[3] + Math.abs(Math.cos(box[6])) * box[4]) / 2;
  const polar = layer.polar !== null;
  const height = (value: number): number => (polar ? Math.atan2(value, r) : value);
  return { across: polar ? Math.atan2(y, x) : y, wide: polar ? half / r : half, up: height(z), top: height(z + box[5] / 2), bottom: height(z - box[5] / 2) };
}

export const shownSlice = (): string => last;
