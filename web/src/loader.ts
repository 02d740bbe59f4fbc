// Payloads and pictures by HTTP: a cache of the last frames, three prefetched ahead, what nobody waits for cancelled.

import { pointSet, type PointSet } from "./cloud";
import type { FrameState, Layer } from "./protocol";
import { unpack } from "./standalone";
import { decode, type Payload } from "./wire";

const KEEP = 30;

type Loaded = PointSet | Payload | ImageBitmap;

interface Entry {
  frame: number;
  promise: Promise<Loaded>;
  value: Loaded | null;
  abort: AbortController;
}

const entries = new Map<string, Entry>();

/** Every frame.state that came, by frame; kept for the frames of the cache. */
export const states = new Map<number, FrameState>();

let inFile: Record<string, string> | null = null;

/** Serve payloads from the file itself: base64 of gzip by link. */
export function hold(payloads: Record<string, string>): void {
  inFile = payloads;
}

/** Whether all there is stands in the file of the page itself. */
export const standing = (): boolean => inFile !== null;

async function get(layer: Layer, signal: AbortSignal): Promise<Loaded> {
  if (inFile) return opened(layer, await unpack(inFile[layer.url] ?? ""));
  const answer = await fetch(layer.url, { signal });
  if (!answer.ok) throw new Error(`${layer.title}: ${(await sentence(answer)) || answer.statusText}`);
  if (layer.kind === "image") return createImageBitmap(await answer.blob());
  return opened(layer, await answer.arrayBuffer());
}

async function opened(layer: Layer, bytes: ArrayBuffer): Promise<Loaded> {
  if (layer.kind === "image") return createImageBitmap(new Blob([bytes]));
  const payload = decode(bytes);
  return layer.kind === "points" ? pointSet(payload) : payload;
}

async function sentence(answer: Response): Promise<string> {
  return (await answer.text()).slice(0, 300);
}

function request(frame: number, layer: Layer): Entry {
  const known = entries.get(layer.url);
  if (known) {
    entries.delete(layer.url);
    entries.set(layer.url, known);
    return known;
  }
  const abort = new AbortController();
  const entry: Entry = { frame, promise: get(layer, abort.signal), value: null, abort };
  entry.promise.then(
    (value) => (entry.value = value),
    () => entries.get(layer.url) === entry && entries.delete(layer.url),
  );
  entries.set(layer.url, entry);
  return entry;
}

/** The layer's data; shared by all who wait for it. */
export function load(frame: number, layer: Layer): Promise<Loaded> {
  return request(frame, layer).promise;
}

/** The layer's data if they are here already. */
export function ready(layer: Layer): Loaded | null {
  return entries.get(layer.url)?.value ?? null;
}

export function prefetch(frame: number, layers: Layer[]): void {
  for (const layer of layers) request(frame, layer).promise.catch(() => undefined);
}

/** Cancel what is on its way for frames that nobody waits for; forget the oldest frames beyond the cache. */
export function tidy(wanted: Set<number>): void {
  const frames: number[] = [];
  for (const entry of [...entries.values()].reverse()) if (!frames.includes(entry.frame)) frames.push(entry.frame);
  const kept = new Set(frames.slice(0, KEEP));
  for (const [url, entry] of entries) {
    if (entry.value === null && !wanted.has(entry.frame)) {
      entry.abort.abort();
      entries.delete(url);
    } else if (!kept.has(entry.frame)) {
      if (entry.value instanceof ImageBitmap) entry.value.close();
      entries.delete(url);
    }
  }
  if (inFile) return;
  for (const frame of states.keys()) if (!kept.has(frame) && !wanted.has(frame)) states.delete(frame);
}

export const cached = (): number => entries.size;
