// The radar's elevation slice (BFS-2D) at the selected box's range: where heights of objects without LiDAR points are read off.

import { sample } from "./colours";
import { byId, fill, h } from "./dom";
import { load } from "./loader";
import type { Layer } from "./protocol";
import { edges } from "./radarmap";
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
  const row = selected();
  if (row && canvas) mark(canvas, layer, boxOf(row));
  const title = row ? `radar from the front, ${low} to ${high} m` : "radar from the front, all ranges";
  last = url;
  fill(byId("slices"), h("div", { class: "close" }, canvas, h("span", {}, title)));
}

function axes(layer: Layer): { across: [number, number, number]; up: [number, number, number] } | null {
  if (layer.polar?.elevation_rad) return { across: edges(layer.polar.azimuth_rad), up: edges(layer.polar.elevation_rad) };
  return layer.grid?.y_m && layer.grid.z_m ? { across: edges(layer.grid.y_m), up: edges(layer.grid.z_m) } : null;
}

/** Rows upwards, left of the sensor on the left. */
function paint(payload: Payload, layer: Layer): HTMLCanvasElement | null {
  const field = payload.header.fields.find((one) => one.type === "uint8");
  const found = axes(layer);
  if (!field || !found) return null;
  const [columns, rows] = [found.across[2], found.up[2]];
  const level = payload.arrays.get(field.name) as Uint8Array;
  const canvas = h("canvas", { width: columns, height: rows, id: "slice" });
  const picture = new ImageData(columns, rows);
  const flipX = found.across[0] < found.across[1];
  const flipY = found.up[0] < found.up[1];
  const sorted = Uint8Array.from(level).sort();
  const [floor, top] = [sorted[Math.floor(sorted.length * 0.4)]!, sorted[sorted.length - 1]!];
  for (let j = 0; j < rows; j += 1)
    for (let i = 0; i < columns; i += 1) {
      const value = level[(flipY ? rows - 1 - j : j) * columns + (flipX ? columns - 1 - i : i)]!;
      const [r, g, b] = sample("inferno", (value - floor) / Math.max(1, top - floor));
      picture.data.set([r, g, b, 255], (j * columns + i) * 4);
    }
  const paper = canvas.getContext("2d")!;
  paper.putImageData(picture, 0, 0);
  const out = h("canvas", { width: 560, height: 180, id: "slice" });
  out.getContext("2d")!.drawImage(canvas, 0, 0, 560, 180);
  return out;
}

function mark(canvas: HTMLCanvasElement, layer: Layer, box: ReturnType<typeof boxOf>): void {
  const found = axes(layer)!;
  const r = Math.hypot(box[0], box[1]);
  const polar = layer.polar !== null;
  const m = layer.frame_T_layer;
  const height = (z: number): number => (polar ? Math.atan2(z - (m?.[11] ?? 0), r) : z - (m?.[11] ?? 0));
  const centre = polar ? Math.atan2(box[1] - (m?.[7] ?? 0), box[0] - (m?.[3] ?? 0)) : box[1] - (m?.[7] ?? 0);
  const half = (Math.abs(Math.sin(box[6])) * box[3] + Math.abs(Math.cos(box[6])) * box[4]) / 2;
  const wide = polar ? half / Math.max(1, r) : half;
  const x = (value: number): number => canvas.width * (1 - (value - Math.min(found.across[0], found.across[1])) / Math.abs(found.across[1] - found.across[0]));
  const y = (value: number): number => canvas.height * (1 - (value - Math.min(found.up[0], found.up[1])) / Math.abs(found.up[1] - found.up[0]));
  const paper = canvas.getContext("2d")!;
  paper.strokeStyle = "#ffffff";
  paper.lineWidth = 2;
  paper.strokeRect(x(centre + wide), y(height(box[2] + box[5] / 2)), x(centre - wide) - x(centre + wide), y(height(box[2] - box[5] / 2)) - y(height(box[2] + box[5] / 2)));
}

export const shownSlice = (): string => last;
