// A radar map's bytes as they are shown: where its cells lie, and the power over what is usual.

import type { Layer } from "./protocol";
import type { Payload } from "./wire";

/** A map's bytes and where the outer edges of its cells lie: rows of range and columns of azimuth, or rows of y and columns of x. */
export interface RadarPicture {
  polar: boolean;
  power: Uint8Array<ArrayBuffer>;
  rows: [number, number, number];
  columns: [number, number, number];
}

/** First edge, last edge and count of an axis given by its first value, step and count. */
export const edges = ([first, step, count]: number[]): [number, number, number] => [first! - step! / 2, first! + step! * (count! - 0.5), count!];

export function radarPicture(payload: Payload, layer: Layer): RadarPicture {
  const field = payload.header.fields.find((one) => one.type === "uint8");
  const [rows, columns] = layer.polar ? [layer.polar.range_m, layer.polar.azimuth_rad] : [layer.grid?.y_m, layer.grid?.x_m];
  if (!field || !rows || !columns) throw new Error(`layer ${layer.title}: the server sent no radar map`);
  return { polar: layer.polar !== null, power: Uint8Array.from(payload.arrays.get(field.name) as Uint8Array), rows: edges(rows), columns: edges(columns) };
}

const FLOOR = 48;

/**
 * Polar power over what is usual at its range (the median over azimuth), so that echoes stand out near and far alike: the ground near by is tens of
 * decibels above everything beyond it. Maps in metres stay as they are.
 */
export function levelled({ polar, power, rows, columns }: RadarPicture): Uint8Array<ArrayBuffer> {
  if (!polar) return power;
  const [wide, count] = [columns[2], rows[2]];
  const usual = Array.from({ length: count }, (_, r) => power.slice(r * wide, (r + 1) * wide).sort()[wide >> 1]!);
  return power.map((value, i) => Math.min(255, Math.max(0, value - usual[Math.floor(i / wide)]! + FLOOR)));
}

/** From the 60 % quantile of the bytes to a high one, as 0..1. */
export function spread(power: Uint8Array, most: number): [number, number] {
  const counts = new Uint32Array(256);
  for (const value of power) counts[value]! += 1;
  const at = (part: number): number => {
    let left = part * power.length;
    for (let value = 0; value < 256; value += 1) if ((left -= counts[value]!) <= 0) return value;
    return 255;
  };
  const low = at(0.6);
  return [low / 255, Math.max(low + 8, at(most)) / 255];
}
