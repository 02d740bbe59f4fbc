// The radar's cells about the selected box in three dimensions: what the close-ups show of the radar is cut out of them.

import type { Box, Vec3 } from "./boxes";
import { load, standing } from "./loader";
import type { Layer } from "./protocol";
import { state } from "./state";
import type { Payload } from "./wire";

const REACH_M = 10;
const AWAY_M = 2; // a box that is farther from the middle of the cells gets others
const OVER_DB = 3;
const MOST_ECHOES = 12;

type Axis = [first: number, step: number, count: number];

/** A peak of the power: its place in the frame, by how much it stands out (dB), and its wrapped velocity. */
export interface Echo {
  at: Vec3;
  over_db: number;
  doppler_m_s: number | null;
}

export class RadarBlock {
  readonly polar: boolean;
  readonly ground: number | null;
  readonly echoes: Echo[];
  private readonly axes: [Axis, Axis, Axis];
  private readonly level: Uint8Array;
  private readonly db: number; // of one step of the bytes

  constructor(readonly frame: number, readonly middle: [number, number], private readonly layer: Layer, payload: Payload) {
    const { header, arrays } = payload;
    const named = header.axes as Record<string, Axis>;
    this.polar = "range_m" in named;
    this.axes = (this.polar ? [named.range_m, named.azimuth_rad, named.elevation_rad] : [named.z_m, named.y_m, named.x_m]) as [Axis, Axis, Axis];
    this.ground = typeof header.ground_z_m === "number" ? header.ground_z_m : null;
    this.level = arrays.get("level") as Uint8Array;
    const field = header.fields.find((one) => one.name === "level")!;
    this.db = (field.high! - field.low!) / 254;
    this.echoes = this.peaks(payload);
  }

  /** Where the radar stands in the frame. */
  get origin(): Vec3 {
    return originOf(this.layer);
  }

  /** The power at a place of the frame as a byte, between the cells by their neighbours; 0 outside of them. */
  at(px: number, py: number, pz: number): number {
    const m = this.layer.frame_T_layer;
    let [x, y, z] = [px, py, pz];
    if (m) {
      const dx = px - m[3]!;
      const dy = py - m[7]!;
      const dz = pz - m[11]!;
      x = m[0]! * dx + m[4]! * dy + m[8]! * dz;
      y = m[1]! * dx + m[5]! * dy + m[9]! * dz;
      z = m[2]! * dx + m[6]! * dy + m[10]! * dz;
    }
    if (!this.polar) return this.between(z, y, x);
    const flat = Math.sqrt(x * x + y * y);
    return this.between(Math.sqrt(flat * flat + z * z), Math.atan2(y, x), Math.atan2(z, flat));
  }

  private between(a: number, b: number, c: number): number {
    const [A, B, C] = this.axes;
    const i = (a - A[0]) / A[1];
    const j = (b - B[0]) / B[1];
    const k = (c - C[0]) / C[1];
    if (i < 0 || j < 0 || k < 0 || i > A[2] - 1 || j > B[2] - 1 || k > C[2] - 1) return 0;
    const i0 = Math.min(A[2] - 2, i | 0);
    const j0 = Math.min(B[2] - 2, j | 0);
    const k0 = Math.min(C[2] - 2, k | 0);
    const [u, v, w] = [i - i0, j - j0, k - k0];
    const row = C[2];
    const page = row * B[2];
    const n = i0 * page + j0 * row + k0;
    const q = this.level;
    const near = (q[n]! * (1 - w) + q[n + 1]! * w) * (1 - v) + (q[n + row]! * (1 - w) + q[n + row + 1]! * w) * v;
    const o = n + page;
    const far = (q[o]! * (1 - w) + q[o + 1]! * w) * (1 - v) + (q[o + row]! * (1 - w) + q[o + row + 1]! * w) * v;
    return near * (1 - u) + far * u;
  }

  /** The strongest power along a depth, for every pixel of a plane through a place: rows from below, columns from the left. */
  slice(middle: Vec3, right: Vec3, up: Vec3, ahead: Vec3, reach: [number, number], depth: number, size: [number, number]): Uint8Array<ArrayBuffer> {
    const [wide, tall] = size;
    const out = new Uint8Array(wide * tall);
    const steps = Math.min(14, Math.max(3, Math.ceil((2 * depth) / 0.5)));
    for (let j = 0; j < tall; j += 1)
      for (let i = 0; i < wide; i += 1) {
        const u = ((i + 0.5) / wide - 0.5) * 2 * reach[0];
        const v = ((j + 0.5) / tall - 0.5) * 2 * reach[1];
        let most = 0;
        for (let n = 0; n < steps; n += 1) {
          const d = depth * ((2 * n) / (steps - 1) - 1);
          const value = this.at(
            middle[0] + right[0] * u + up[0] * v + ahead[0] * d,
            middle[1] + right[1] * u + up[1] * v + ahead[1] * d,
            middle[2] + right[2] * u + up[2] * v + ahead[2] * d,
          );
          if (value > most) most = value;
        }
        out[j * wide + i] = most;
      }
    return out;
  }

  private place(i: number, j: number, k: number): Vec3 {
    const [a, b, c] = this.axes.map(([first, step], n) => first + step * [i, j, k][n]!) as Vec3;
    const [x, y, z] = this.polar ? [a * Math.cos(c) * Math.cos(b), a * Math.cos(c) * Math.sin(b), a * Math.sin(c)] : [c, b, a];
    const m = this.layer.frame_T_layer;
    if (!m) return [x, y, z];
    return [0, 4, 8].map((row) => m[row]! * x + m[row + 1]! * y + m[row + 2]! * z + m[row + 3]!) as Vec3;
  }

  /** Cells that none of their neighbours excels and that stand out of what is usual at their range, the strongest first. */
  private peaks({ header, arrays }: Payload): Echo[] {
    const [A, B, C] = this.axes.map(([, , count]) => count) as Vec3;
    const page = B * C;
    const steps = [page, C, 1];
    const field = header.fields.find((one) => one.name === "doppler_m_s");
    const doppler = field ? (arrays.get("doppler_m_s") as Uint8Array) : null;
    const out: { n: number; over: number; where: Vec3 }[] = [];
    for (let i = 1; i < A - 1; i += 1) {
      const usual = this.level.slice(i * page, (i + 1) * page).sort()[page >> 1]!;
      for (let j = 1; j < B - 1; j += 1)
        for (let k = 1; k < C - 1; k += 1) {
          const n = i * page + j * C + k;
          const here = this.level[n]!;
          if ((here - usual) * this.db < OVER_DB || !this.excels(n, page, C)) continue;
          const vertex = steps.map((step) => {
            const [before, after] = [this.level[n - step]!, this.level[n + step]!];
            const curve = before - 2 * here + after;
            return curve >= 0 ? 0 : Math.min(0.5, Math.max(-0.5, (before - after) / (2 * curve)));
          });
          out.push({ n, over: (here - usual) * this.db, where: [i + vertex[0]!, j + vertex[1]!, k + vertex[2]!] });
        }
    }
    return out.sort((a, b) => b.over - a.over).slice(0, MOST_ECHOES).map(({ n, over, where }) => ({
      at: this.place(...where), over_db: over, doppler_m_s: doppler && field ? field.low! + (doppler[n]! / 255) * (field.high! - field.low!) : null,
    }));
  }

  private excels(n: number, page: number, row: number): boolean {
    const here = this.level[n]!;
    for (const i of [-page, 0, page])
      for (const j of [-row, 0, row])
        for (const k of [-1, 0, 1]) {
          const other = this.level[n + i + j + k]!;
          if (other > here || (other === here && i + j + k < 0)) return false; // of equal ones the first counts
        }
    return true;
  }
}

export const radarLayer = (): Layer | undefined => state.shown?.layers.find((one) => one.kind === "bfs");

export function originOf(layer: Layer): Vec3 {
  const m = layer.frame_T_layer;
  return m ? [m[3]!, m[7]!, m[11]!] : [0, 0, 0];
}

let block: RadarBlock | null = null;
let asked = "";

/** The cells about a box of the frame shown, null until they are here; `then` is called when they have come. */
export function blockAt(box: Box, then: () => void): RadarBlock | null {
  const layer = radarLayer();
  const frame = state.shown?.frame.index ?? -1;
  if (!layer || standing()) return null;
  const away = block && block.frame === frame ? Math.hypot(box[0] - block.middle[0], box[1] - block.middle[1]) : Infinity;
  if (away <= AWAY_M) return block;
  const middle: [number, number] = [Math.round(box[0]), Math.round(box[1])];
  const url = `${layer.url.replace(/bfs$/, "near")}?x=${middle[0]}&y=${middle[1]}&reach=${REACH_M}`;
  if (url === asked) return null;
  asked = url;
  load(frame, { ...layer, url }).then(
    (payload) => {
      if (asked !== url) return;
      asked = "";
      if (state.shown?.frame.index !== frame) return;
      block = new RadarBlock(frame, middle, layer, payload as Payload);
      then();
    },
    () => { if (asked === url) asked = ""; },
  );
  return null;
}

/** The height of the ground under a box by what the LiDAR sees before it, as the server has it; null where that is not known. */
export function groundBelow(box: Box): number | null {
  const here = block !== null && block.frame === state.shown?.frame.index && Math.hypot(box[0] - block.middle[0], box[1] - block.middle[1]) <= AWAY_M;
  return here ? block!.ground : null;
}
