// One cloud on the GPU: int16 places in a fixed shuffle, so that any prefix is a fair sample of the whole.

import { BufferAttribute, BufferGeometry, DataTexture, GLSL3, LinearFilter, Points, RGBAFormat, ShaderMaterial, Sphere, Vector2, Vector3 } from "three";
import { SCALE_ROWS, table, type Scale } from "./colours";
import { MODES, POINTS_FRAGMENT, POINTS_VERTEX } from "./shaders";
import { shuffled, type Field, type Numbers, type Payload } from "./wire";

const EVERYWHERE = new Sphere(new Vector3(), 1000); // never culled, and never computed

let shared: DataTexture | null = null;

export function colourTable(): DataTexture {
  if (!shared) {
    shared = new DataTexture(table(), 256, SCALE_ROWS.length, RGBAFormat);
    shared.magFilter = LinearFilter;
    shared.needsUpdate = true;
  }
  return shared;
}

export const scaleRow = (scale: Scale): number => (SCALE_ROWS.indexOf(scale) + 0.5) / SCALE_ROWS.length;

/** The decoded and shuffled points of one layer of one frame; kept in the cache, uploaded when shown. */
export interface PointSet {
  count: number;
  places: Int16Array;
  scale: number;
  offset: [number, number, number];
  values: Map<string, { rows: Numbers; low: number; high: number }>;
}

export function pointSet(payload: Payload): PointSet {
  const { header, arrays } = payload;
  const placeField = header.fields.find((field) => field.type === "int16" && field.items >= 3);
  if (!placeField) throw new Error(`layer ${header.layer}: the server sent no places`);
  const raw = arrays.get(placeField.name) as Int16Array;
  const four = placeField.items === 4 ? raw : padded(raw, header.count);
  const values = new Map<string, { rows: Numbers; low: number; high: number }>();
  for (const field of header.fields) {
    if (field === placeField || field.items !== 1 || field.type === "float32") continue;
    values.set(field.name, { rows: shuffled(arrays.get(field.name)!, 1), low: lowOf(field), high: highOf(field) });
  }
  return { count: header.count, places: shuffled(four, 4), scale: header.scale_m, offset: header.offset_m, values };
}

function padded(raw: Int16Array, count: number): Int16Array {
  const out = new Int16Array(count * 4);
  for (let i = 0; i < count; i += 1) for (let k = 0; k < 3; k += 1) out[i * 4 + k] = raw[i * 3 + k]!;
  return out;
}

const lowOf = (field: Field): number => field.low ?? 0;
const highOf = (field: Field): number => field.high ?? 1;

export interface Look {
  mode: string;
  window: [number, number] | null;
  size: number;
  grow: number;
  opacity: number;
  flat: string;
  gate: { name: string; least: number } | null;
  keep: [number, number];
}

export class CloudObject {
  readonly points: Points<BufferGeometry, ShaderMaterial>;
  private readonly geometry = new BufferGeometry();
  private uploaded = new Map<string, BufferAttribute>();

  constructor(readonly set: PointSet) {
    this.geometry.setAttribute("position", new BufferAttribute(set.places, 4));
    this.geometry.boundingSphere = EVERYWHERE;
    this.points = new Points(this.geometry, pointMaterial());
    this.points.frustumCulled = false;
    const { uniforms } = this.points.material;
    uniforms.u_scale!.value = set.scale;
    (uniforms.u_offset!.value as Vector3).set(...set.offset);
  }

  private attribute(name: string): BufferAttribute | null {
    const field = this.set.values.get(name);
    if (!field) return null;
    let found = this.uploaded.get(name);
    if (!found) this.uploaded.set(name, (found = new BufferAttribute(field.rows, 1, true)));
    return found;
  }

  private use(slot: "value" | "gate", name: string | null): boolean {
    const attribute = name === null ? null : this.attribute(name);
    if (attribute) this.geometry.setAttribute(slot, attribute);
    else if (this.geometry.getAttribute(slot)) this.geometry.deleteAttribute(slot);
    return attribute !== null;
  }

  /** Physical units to the 0..1 of a normalised byte. */
  private byte(name: string, physical: number): number {
    const field = this.set.values.get(name)!;
    return (physical - field.low) / Math.max(field.high - field.low, 1e-9);
  }

  show(look: Look): void {
    const u = this.points.material.uniforms;
    const known = look.mode === "height" || look.mode === "range" || look.mode === "flat" || look.mode === "pattern";
    const found = !known && this.use("value", look.mode);
    u.u_mode!.value = look.mode === "range" ? MODES.range : look.mode === "flat" || look.mode === "pattern" ? MODES.flat : found ? MODES.value : MODES.height;
    u.u_row!.value = scaleRow(scaleOf(look.mode));
    const window = look.window ?? defaultWindow(found ? look.mode : known ? look.mode : "height", this.set);
    const shown = found ? window.map((v) => this.byte(look.mode, v)) : window;
    (u.u_window!.value as Vector2).set(shown[0]!, shown[1]!);
    const gated = look.gate !== null && this.use("gate", look.gate.name);
    (u.u_gate!.value as Vector2).set(gated ? this.byte(look.gate!.name, look.gate!.least) : -1, 2);
    if (!gated) this.use("gate", null);
    (u.u_keep!.value as Vector2).set(...look.keep);
    u.u_size!.value = look.size;
    u.u_grow!.value = look.grow;
    u.u_opacity!.value = look.opacity;
    this.points.material.transparent = look.opacity < 1;
    const flat = Number.parseInt(look.flat.slice(1), 16);
    (u.u_flat!.value as Vector3).set(((flat >> 16) & 255) / 255, ((flat >> 8) & 255) / 255, (flat & 255) / 255);
  }

  /** Draw only the first `share` of the shuffle. */
  limit(share: number): number {
    const count = Math.min(this.set.count, Math.ceil(this.set.count * share));
    this.geometry.setDrawRange(0, count);
    return count;
  }

  dispose(): void {
    this.geometry.dispose();
    this.points.material.dispose();
  }
}

export function scaleOf(mode: string): Scale {
  if (mode === "doppler_m_s" || mode === "doppler") return "signed";
  if (mode === "power_db" || mode === "rcs_dbsm") return "inferno";
  return mode === "age" || mode === "lag_s" ? "cividis" : "viridis";
}

export function defaultWindow(mode: string, set: PointSet | null): [number, number] {
  if (mode === "height") return [-2.5, 4];
  if (mode === "range") return [0, 120];
  const field = set?.values.get(mode);
  return field ? [field.low, field.high] : [0, 1];
}

function pointMaterial(): ShaderMaterial {
  return new ShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: POINTS_VERTEX,
    fragmentShader: POINTS_FRAGMENT,
    uniforms: {
      u_scale: { value: 1 }, u_offset: { value: new Vector3() }, u_mode: { value: 0 }, u_window: { value: new Vector2(-2, 4) },
      u_gate: { value: new Vector2(-1, 2) }, u_keep: { value: new Vector2(0, 1e4) }, u_flat: { value: new Vector3(1, 1, 1) },
      u_row: { value: 0 }, u_size: { value: 2 }, u_grow: { value: 1 }, u_opacity: { value: 1 }, u_table: { value: colourTable() },
    },
  });
}

/** The places (metres) of the points within `reach` of a centre in the plane: what the close-ups and the count show. */
export function cropped(set: PointSet, centre: [number, number], reach: number): PointSet {
  const { places, scale, offset } = set;
  const lowX = (centre[0] - reach - offset[0]) / scale;
  const highX = (centre[0] + reach - offset[0]) / scale;
  const lowY = (centre[1] - reach - offset[1]) / scale;
  const highY = (centre[1] + reach - offset[1]) / scale;
  const rows: number[] = [];
  for (let i = 0, k = 0; i < set.count; i += 1, k += 4) {
    const x = places[k]!;
    const y = places[k + 1]!;
    if (x > lowX && x < highX && y > lowY && y < highY) rows.push(i);
  }
  const out = new Int16Array(rows.length * 4);
  rows.forEach((row, i) => out.set(places.subarray(row * 4, row * 4 + 4), i * 4));
  const values = new Map<string, { rows: Numbers; low: number; high: number }>();
  for (const [name, field] of set.values) {
    const kept = new (field.rows.constructor as new (n: number) => Numbers)(rows.length);
    rows.forEach((row, i) => (kept[i] = field.rows[row]!));
    values.set(name, { ...field, rows: kept });
  }
  return { count: rows.length, places: out, scale, offset, values };
}
