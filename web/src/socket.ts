// The WebSocket: JSON, one object a message. Lost connections come back with growing pauses; nothing is lost by them (see edits.ts).

import type { Reply, Request } from "./protocol";
import { VERSION } from "./protocol";
import { changed, state } from "./state";

type Handler<K extends Reply["op"]> = (message: Extract<Reply, { op: K }>) => void;

const handlers = new Map<string, Set<(message: Reply) => void>>();
let socket: WebSocket | null = null;
let pause = 500;
let ended = "";

export const windowName = `w${crypto.getRandomValues(new Uint32Array(2)).join("").slice(0, 12)}`;

let made = 0;
/** An identity that no other window makes. */
export const newId = (): string => `${windowName}-${(made += 1)}-${Date.now().toString(36)}`;

export function onReply<K extends Reply["op"]>(op: K, handler: Handler<K>): void {
  if (!handlers.has(op)) handlers.set(op, new Set());
  handlers.get(op)!.add(handler as (message: Reply) => void);
}

/** Send if connected; says whether it went out. */
export function send(message: Request): boolean {
  if (!socket || socket.readyState !== WebSocket.OPEN || (!state.connected && message.op !== "hello")) return false;
  socket.send(JSON.stringify(message));
  return true;
}

export function connect(annotator: string): void {
  const address = new URL("socket", document.baseURI);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(address);
  socket.onopen = () => send({ op: "hello", window: windowName, annotator, version: VERSION });
  socket.onmessage = (event: MessageEvent<string>) => receive(JSON.parse(event.data) as Reply);
  socket.onclose = (event) => closed(event, annotator);
}

function receive(message: Reply): void {
  if (message.op === "welcome") {
    pause = 500;
    state.connected = true;
    changed("connection");
  }
  if (message.op === "bye") ended = message.reason;
  handlers.get(message.op)?.forEach((handler) => handler(message));
}

function closed(event: CloseEvent, annotator: string): void {
  state.connected = false;
  changed("connection");
  if (ended && event.code !== 1001) return;
  setTimeout(() => connect(annotator), pause);
  pause = Math.min(8000, pause * 2);
}
