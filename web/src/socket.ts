// The WebSocket: JSON, one object a message. Lost connections come back with growing pauses; nothing is lost by them (see edits.ts).

import { report } from "./bar";
import type { Reply, Request } from "./protocol";
import { VERSION } from "./protocol";
import { changed, state } from "./state";

type Handler<K extends Reply["op"]> = (message: Extract<Reply, { op: K }>) => void;

const handlers = new Map<string, Set<(message: Reply) => void>>();
let socket: WebSocket | null = null;
let pause = 500;
let ended = "";
let store: string | null = null; // of the data set whose page this is

export const windowName = `w${crypto.getRandomValues(new Uint32Array(2)).join("").slice(0, 12)}`;

let made = 0;
/** An identity that no other window makes. */
export const newId = (): string => `${windowName}-${(made += 1)}-${Date.now().toString(36)}`;

export function onReply<K extends Reply["op"]>(op: K, handler: Handler<K>): void {
  if (!handlers.has(op)) handlers.set(op, new Set());
  handlers.get(op)!.add(handler as (message: Reply) => void);
}

const listeners = new Set<(message: Reply) => void>();
/** Hear every reply, before those who handle it. */
export const onAny = (listener: (message: Reply) => void): void => void listeners.add(listener);

/** Send if connected; says whether it went out. */
export function send(message: Request): boolean {
  if (!socket || socket.readyState !== WebSocket.OPEN || (!state.connected && message.op !== "hello")) return false;
  socket.send(JSON.stringify(message, numbers));
  return true;
}

/** No number that is none leaves the page: JSON would make null of it. */
function numbers(name: string, value: unknown): unknown {
  if (typeof value === "number" && !Number.isFinite(value)) throw new RangeError(`${name}: expected a finite number, got ${value}`);
  return value;
}

export function connect(annotator: string): void {
  const address = new URL("socket", document.baseURI);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  const opened = (socket = new WebSocket(address));
  let count = 0;
  socket.onopen = () => send({ op: "hello", window: windowName, annotator, version: VERSION });
  socket.onmessage = (event: MessageEvent<string>) => {
    if (opened !== socket) return;
    const message = JSON.parse(event.data) as Reply & { n: number };
    if (message.n <= count) return; // it came before
    if (message.n > count + 1) return opened.close(); // one was lost: with a new connection all is asked for anew
    count = message.n;
    receive(message);
  };
  socket.onclose = (event) => { if (opened === socket) closed(event, annotator); };
}

function receive(message: Reply): void {
  if (message.op === "welcome") {
    if (store !== null && message.store !== store) return otherData();
    store = message.store;
    pause = 500;
    state.connected = true;
    changed("connection");
  }
  if (message.op === "bye") ended = message.reason;
  listeners.forEach((listener) => listener(message));
  handlers.get(message.op)?.forEach((handler) => handler(message));
}

/** Another data set is served here by now: nothing of this page is meant for it, so that it counts as not connected until its page is there. */
function otherData(): void {
  socket?.close();
  socket = null;
  report("warning", "Another data set is served at this address by now.", "Its page comes.");
  location.reload();
}

function closed(event: CloseEvent, annotator: string): void {
  state.connected = false;
  changed("connection");
  const final = ended !== "" && event.code !== 1001; // 1001: the studio ends, and may be started again
  ended = "";
  if (final) return;
  setTimeout(() => connect(annotator), pause);
  pause = Math.min(8000, pause * 2);
}
