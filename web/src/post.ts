// Messages whose loss would lose work, edits of boxes aside (edits.ts): they are sent again after a lost connection until they are answered. The server
// knows each by its name and does nothing twice.

import { report } from "./bar";
import type { Reply, Request } from "./protocol";
import { onAny, send } from "./socket";
import { on, state } from "./state";

export type Posted = Extract<Request, { id: string }>;

const MOST_TRIES = 3; // what is never answered may be what ends the connection
const waiting = new Map<string, { message: Posted; tries: number }>();
const LEFT = "farfield left"; // what a page of this window was left with, for the next one to say
let joined = false;

/** What waits goes with its page: it is meant for the data set of that one only. */
window.addEventListener("pagehide", () => {
  const left = new Set([...waiting.values()].map(({ message }) => message.op));
  if (left.size > 0) sessionStorage.setItem(LEFT, [...left].join(", "));
});

function tellLeft(): void {
  const left = sessionStorage.getItem(LEFT);
  sessionStorage.removeItem(LEFT);
  if (left) report("warning", `The page was loaded anew before the studio had answered: ${left} may not have been done.`, "Look, and do it again where it is lacking.");
}
if (location.protocol !== "file:") tellLeft();

/** Send a message, now or when the connection is back. */
export function post(message: Posted): void {
  waiting.set(message.id, { message, tries: 0 });
  if (state.connected) attempt(message.id);
}

function attempt(id: string): void {
  const one = waiting.get(id)!;
  if (one.tries === MOST_TRIES) {
    waiting.delete(id);
    report("error", `The studio did not answer: ${one.message.op} was not done.`, "Do it again.");
  } else if (send(one.message)) one.tries += 1;
}

on("connection", () => {
  if (state.connected && !joined) for (const id of [...waiting.keys()]) attempt(id);
  joined = state.connected;
});

onAny((message: Reply) => {
  if (message.op === "job" && message.kind === "export" && (message.state === "running" || message.state === "queued")) return; // its file is still to come
  if (message.op === "refused" && message.code === "journal") return;
  if ("id" in message && message.id !== null) waiting.delete(message.id);
  if ("answers" in message) waiting.delete(message.answers);
});
