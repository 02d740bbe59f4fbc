// The radar from the front (BFS-2D) over all ranges, while nothing is selected: a selected box has a close-up of it.

import { sample } from "./colours";
import { byId, fill, h } from "./dom";
import { load } from "./loader";
import type { Layer } from "./protocol";
import { edges } from "./radarlevels";
import { on, selected, state } from "./state";
import type { Payload } from "./wire";

let wait = 0;

export function slicesPanel(): void {
  on(["frame", "selection", "boxes"], () => {
    window.clearTimeout(wait);
    wait = window.setTimeout(() => void draw(), 60);
  });
}

async function draw(): Promise<void> {
  const layer = state.shown?.layers.find((one) => one.kind === "bfs");
  if (!layer || selected()) {
    fill(byId("slices"));
    return;
  }
  const frame = state.frame;
  const payload = (await load(frame, layer).catch(() => null)) as Payload | null;
  if (!payload || frame !== state.frame || selected()) return;
  fill(byId("slices"), h("div", { class: "slice" }, paint(payload, layer), h("span", {}, "radar from the front, all ranges")));
}

function axes(layer: Layer): { across: [number, number, number]; up: [number, number, number] } | null {
  if (layer.polar?.elevation_rad) return { across: edges(layer.polar.azimuth_rad), up: edges(layer.polar.elevation_rad) };
  return layer.grid?.y_m && layer.grid.z_m ? { across: edges(layer.grid.y_m), up: edges(layer.grid.z_m) } : null;
}

const WIDE = 560;
const TALL = 168;

/** Up is up, and left of the sensor is on the left. */
function paint(payload: Payload, layer: Layer): HTMLCanvasElement | null {
  const field = payload.header.fields.find((one) => one.type === "uint8");
  const found = axes(layer);
  if (!field || !found) return null;
  const across = found.across;
  const up = layer.polar ? found.up : ([-4, 6, 0] as const); // of a cube the heights of what stands on the ground
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
  return out;
}
