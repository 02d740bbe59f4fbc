// One HTML file that opens from disk: the same page, its data in the file, no server.

import type { FrameState, Welcome } from "./protocol";

export interface Held {
  welcome: Welcome;
  frames: FrameState[];
  payloads: Record<string, string>;
}

/** The data in the file, or null where the page is served. */
export function held(): Held | null {
  const text = document.getElementById("farfield-data")?.textContent;
  return text ? (JSON.parse(text) as Held) : null;
}

/** The bytes of a payload: base64 of gzip. */
export async function unpack(packed: string): Promise<ArrayBuffer> {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}
