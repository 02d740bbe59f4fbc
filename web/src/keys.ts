// Keys by their physical place (event.code), from the one table that also makes the help and docs/studio.md.

import table from "./keys.json";
import { typing } from "./dom";
import { cancelGesture } from "./gestures";
import { state } from "./state";

export interface Key {
  id: string;
  code: string;
  modes: string[];
  group: string;
  title: string;
  shift?: boolean;
  ctrl?: boolean;
  alt?: boolean;
  scaled?: boolean; // with Shift ten times as far, with Alt a fifth
  name?: string; // the character that it writes, wherever a keyboard has it
}

export const KEYS = table as Key[];

type Action = (event: KeyboardEvent) => void;

const actions = new Map<string, Action>();

export function bind(id: string, action: Action): void {
  if (!KEYS.some((key) => key.id === id)) throw new Error(`no key for ${id} in keys.json`);
  actions.set(id, action);
}

/** Every combination of a key, as text; two equal ones in a mode are a fault of the table. */
export function chords(key: Key): string[] {
  const one = (shift: boolean, alt: boolean): string => `${key.ctrl ? "Ctrl+" : ""}${shift ? "Shift+" : ""}${alt ? "Alt+" : ""}${key.code}`;
  if (key.scaled) return [one(false, false), one(true, false), one(false, true), one(true, true)];
  return [one(!!key.shift, !!key.alt)];
}

const byChord = new Map<string, Key>();
for (const key of KEYS) for (const mode of key.modes) for (const chord of chords(key)) byChord.set(`${mode} ${chord}`, key);

/** x10 with Shift, x0.2 with Alt. */
export const step = (event: KeyboardEvent): number => (event.shiftKey && !event.altKey ? 10 : event.altKey && !event.shiftKey ? 0.2 : 1);

/** By the key's place; with Ctrl by its letter, as everywhere else, and by its character where the table names one. */
export function find(event: KeyboardEvent): Key | undefined {
  const ctrl = event.ctrlKey || event.metaKey;
  const written = ctrl ? undefined : KEYS.find((key) => key.name === event.key && key.modes.includes(state.mode));
  if (written) return written;
  const code = ctrl && /^[a-z]$/i.test(event.key) ? `Key${event.key.toUpperCase()}` : event.code;
  const chord = `${ctrl ? "Ctrl+" : ""}${event.shiftKey ? "Shift+" : ""}${event.altKey ? "Alt+" : ""}${code}`;
  return byChord.get(`${state.mode} ${chord}`);
}

export function run(id: string, event: KeyboardEvent = new KeyboardEvent("keydown")): void {
  actions.get(id)?.(event);
}

let tabbed = false; // Tab moved the focus: the control that has it keeps the keys that work it
window.addEventListener("pointerdown", () => (tabbed = false), true);

/** Whether a key works the control that Tab went to: then it is not the page's. */
function works(target: EventTarget | null, event: KeyboardEvent): boolean {
  if (!tabbed || !(target instanceof HTMLElement) || event.ctrlKey || event.metaKey || event.altKey) return false;
  if (target instanceof HTMLInputElement && target.type === "range") return /^(Arrow|Page|Home|End)/.test(event.code);
  if (event.code !== "Enter" && event.code !== "Space") return false;
  if (target.matches("[role=button], tr")) event.preventDefault(), target.click();
  return target.matches("button, summary, a[href], input, [role=button], tr");
}

export function listen(): void {
  window.addEventListener("keydown", (event) => {
    if (event.key === "Tab") tabbed = true;
    const key = find(event);
    if (document.querySelector("dialog[open]")) { // what lies behind it waits
      if (key?.id === "help" || key?.id === "cancel") event.preventDefault(), actions.get("help")?.(event);
      return;
    }
    if (works(event.target, event)) return;
    if (typing(event.target)) {
      if (key?.id === "cancel") (event.target as HTMLElement).blur();
      if (key?.id !== "save") return;
    }
    const action = key && actions.get(key.id);
    if (!action) return;
    event.preventDefault();
    if (cancelGesture() && key.id === "cancel") return; // a gesture is given up whole, before anything else happens
    if (!tabbed && (event.target instanceof HTMLButtonElement || event.target instanceof HTMLInputElement)) event.target.blur();
    action(event);
  });
}

const NAMES: Record<string, string> = {
  ArrowLeft: "←", ArrowRight: "→", BracketLeft: "[", BracketRight: "]", Semicolon: ";", Quote: "'", Comma: ",", Period: ".", Backslash: "\\", Backquote: "`", Slash: "/", ArrowUp: "↑", ArrowDown: "↓", Escape: "Esc",
};

let layout = new Map<string, string>();

/** Ask the browser how this keyboard writes the keys (Chromium only); others show the United States' layout. */
export async function readLayout(): Promise<void> {
  const keyboard = (navigator as unknown as { keyboard?: { getLayoutMap(): Promise<Map<string, string>> } }).keyboard;
  if (keyboard) layout = await keyboard.getLayoutMap().catch(() => layout);
}

export function nameOf(key: Key): string {
  if (key.name) return key.name;
  const plain = (key.ctrl ? undefined : layout.get(key.code))?.toUpperCase() ?? NAMES[key.code] ?? key.code.replace(/^(Key|Digit)/, "");
  return `${key.ctrl ? "Ctrl+" : ""}${key.shift ? "Shift+" : ""}${key.alt ? "Alt+" : ""}${plain}`;
}

export function keyFor(id: string): string {
  const key = KEYS.find((one) => one.id === id && one.modes.includes(state.mode));
  return key ? nameOf(key) : "";
}
