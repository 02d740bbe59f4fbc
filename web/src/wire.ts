// FFP1: "FFP1", uint32 length of a JSON header, the header, then arrays at 8-byte boundaries; all little-endian.

export interface Field {
  name: string;
  type: "int16" | "uint8" | "int8" | "uint16" | "float32" | "uint32" | "int32";
  offset: number;
  items: number;
  low?: number | null;
  high?: number | null;
}

export interface Header {
  frame: number;
  layer: string;
  count: number;
  scale_m: number;
  offset_m: [number, number, number];
  fields: Field[];
  time_ns?: string | null;
  version?: number;
  [name: string]: unknown;
}

export type Numbers = Int16Array | Uint8Array | Int8Array | Uint16Array | Float32Array | Uint32Array | Int32Array;

export interface Payload {
  header: Header;
  arrays: Map<string, Numbers>;
}

const TYPES = {
  int16: Int16Array,
  uint8: Uint8Array,
  int8: Int8Array,
  uint16: Uint16Array,
  float32: Float32Array,
  uint32: Uint32Array,
  int32: Int32Array,
} as const;

/** Read one payload. Throws with what is wrong when the bytes are not FFP1 or end early. */
export function decode(buffer: ArrayBuffer): Payload {
  const view = new DataView(buffer);
  if (buffer.byteLength < 8 || view.getUint32(0, false) !== 0x46465031) throw new Error("the server sent bytes that are not a frame (FFP1)");
  const length = view.getUint32(4, true);
  if (8 + length > buffer.byteLength) throw new Error("a frame arrived cut short: its header is incomplete");
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length))) as Header;
  const arrays = new Map<string, Numbers>();
  for (const field of header.fields) {
    const make = TYPES[field.type];
    const count = header.count * field.items;
    if (!make || field.offset + count * make.BYTES_PER_ELEMENT > buffer.byteLength)
      throw new Error(`a frame arrived cut short: field ${field.name} is incomplete`);
    arrays.set(field.name, new make(buffer, field.offset, count));
  }
  return { header, arrays };
}

function common(a: number, b: number): number {
  while (b) [a, b] = [b, a % b];
  return a;
}

/** A step coprime to n near n / golden ratio: walking by it visits every row once, and any prefix is a fair sample. */
export function stride(n: number): number {
  if (n < 3) return 1;
  let step = Math.round(n * 0.6180339887);
  while (common(step, n) !== 1) step += 1;
  return step % n || 1;
}

/** The rows of an array of `items` numbers each, in the order of the fixed stride. */
export function shuffled<T extends Numbers>(rows: T, items: number): T {
  const out = new (rows.constructor as new (length: number) => T)(rows.length);
  const bytes = items * rows.BYTES_PER_ELEMENT;
  if (items === 1) walk(rows, out, 1);
  else if (bytes % 4 === 0 && rows.byteOffset % 4 === 0)
    walk(new Int32Array(rows.buffer, rows.byteOffset, rows.byteLength / 4), new Int32Array(out.buffer), bytes / 4);
  else walk(rows, out, items);
  return out;
}

function walk(rows: Numbers, out: Numbers, items: number): void {
  const n = rows.length / items;
  const step = stride(n);
  if (items === 1) {
    for (let i = 0, from = 0; i < n; i += 1) {
      out[i] = rows[from]!;
      from += step;
      if (from >= n) from -= n;
    }
    return;
  }
  for (let to = 0, from = 0; to < out.length; to += items) {
    const at = from * items;
    for (let k = 0; k < items; k += 1) out[to + k] = rows[at + k]!;
    from += step;
    if (from >= n) from -= n;
  }
}
