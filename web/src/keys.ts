// Keys by their physical place (event.code), from the one table that also makes the help and docs/studio.md.

import table from "./keys.json";
import { typing } from "./dom";
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

export function find(event: KeyboardEvent): Key | undefined {
  const ctrl = event.ctrlKey || event.metaKey;
  const chord = `${ctrl ? "Ctrl+" : ""}${event.shiftKey ? "Shift+" : ""}${event.altKey ? "Alt+" : ""}${event.code}`;
  return byChord.get(`${state.mode} ${chord}`);
}

export function run(id: string, event: KeyboardEvent = new KeyboardEvent("keydown")): void {
  actions.get(id)?.(event);
}

export function listen(): void {
  window.addEventListener("keydown", (event) => {
    const key = find(event);
    if (typing(event.target)) {
      if (key?.id === "cancel") (event.target as HTMLElement).blur();
      if (key?.id !== "save") return;
    }
    const action = key && actions.get(key.id);
    if (!action) return;
    event.preventDefault();
    if (event.target instanceof HTMLButtonElement || event.target instanceof HTMLInputElement) event.target.blur();
    action(event);
  });
}

const NAMES: Record<string, string> = {
  ArrowLeft: "←", ArrowRight: "→", BracketLeft: "[", BracketRight: "]", Semicolon: ";", Quote: "'", Comma: ",", Period: ".", Backslash: "\\", Backquote: "`", Slash: "/", Escape: "Esc",
};

let layout = new Map<string, string>();

/** Ask the browser how this keyboard writes the keys (Chromium only); others show the United States' layout. */
export async function readLayout(): Promise<void> {
  const keyboard = (navigator as unknown as { keyboard?: { getLayoutMap(): Promise<Map<string, string>> } }).keyboard;
  if (keyboard) layout = await keyboard.getLayoutMap().catch(() => layout);
}

export function nameOf(key: Key): string {
  const plain = layout.get(key.code)?.toUpperCase() ?? NAMES[key.code] ?? key.code.replace(/^(Key|Digit)/, "");
  return `${key.ctrl ? "Ctrl+" : ""}${key.shift ? "Shift+" : ""}${key.alt ? "Alt+" : ""}${plain}`;
}

export function keyFor(id: string): string {
  const key = KEYS.find((one) => one.id === id && one.modes.includes(state.mode));
  return key ? nameOf(key) : "";
}
