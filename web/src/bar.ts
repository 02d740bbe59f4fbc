// Errors and questions as a bar at the top: a cause and a cure, never a dialog in the way of the keys.

import { byId, fill, h } from "./dom";

export interface Choice {
  title: string;
  act: () => void;
}

let made = 0;
const shown: { text: string; element: HTMLElement; asks: boolean; subject: string }[] = [];

/**
 * Show a sentence; an info leaves by itself, others stay until closed, and one that asks until it is answered.
 * Of one subject there is one bar: a later one takes its place.
 */
export function report(kind: "info" | "warning" | "error", sentence: string, mend = "", choices: Choice[] = [], subject = ""): void {
  const text = `${kind} ${sentence}`;
  const old = shown.find((one) => one.text === text && !one.asks);
  if (old) remove(old.element);
  if (subject) withdraw(subject);
  const close = h("button", { class: "quiet", title: "Close", "aria-label": "Close", onclick: () => remove(element) }, "×");
  const buttons = choices.map((choice) =>
    h("button", { onclick: () => { remove(element); choice.act(); } }, choice.title),
  );
  const element = h("div", { class: `bar ${kind}`, "data-bar": (made += 1), role: kind === "error" ? "alert" : "status" }, h("span", {}, sentence, mend ? " " : "", mend ? h("em", {}, mend) : null), ...buttons, close);
  shown.push({ text, element, asks: choices.length > 0, subject });
  const told = shown.filter((one) => !one.asks);
  if (told.length > 4) remove(told[0]!.element);
  redraw();
  if (kind === "info" && choices.length === 0) setTimeout(() => remove(element), 4000);
}

/** Take the bars of a subject away, and of all that begin so. */
export function withdraw(subject: string): void {
  for (const one of shown.filter((each) => each.subject.startsWith(subject))) remove(one.element);
}

const held = new Map<string, HTMLElement>();

/** A bar that stays as long as what it says holds; empty: it no longer does. */
export function holdBar(name: string, sentence: string): void {
  if (sentence === (held.get(name)?.textContent ?? "")) return;
  if (sentence) held.set(name, h("div", { class: "bar error", role: "alert", id: `bar-${name}` }, h("span", {}, sentence)));
  else held.delete(name);
  redraw();
}

function remove(element: HTMLElement): void {
  const at = shown.findIndex((one) => one.element === element);
  if (at >= 0) shown.splice(at, 1);
  redraw();
}

function redraw(): void {
  fill(byId("bars"), ...held.values(), ...shown.map((one) => one.element));
}
