// Errors and questions as a bar at the top: a cause and a cure, never a dialog in the way of the keys.

import { byId, fill, h } from "./dom";

export interface Choice {
  title: string;
  act: () => void;
}

const shown: { text: string; element: HTMLElement }[] = [];

/** Show a sentence; an info leaves by itself, others stay until closed. */
export function report(kind: "info" | "warning" | "error", sentence: string, mend = "", choices: Choice[] = []): void {
  const text = `${kind} ${sentence}`;
  const old = shown.findIndex((one) => one.text === text);
  if (old >= 0) remove(shown[old]!.element);
  const close = h("button", { class: "quiet", title: "Close", onclick: () => remove(element) }, "×");
  const buttons = choices.map((choice) =>
    h("button", { onclick: () => { remove(element); choice.act(); } }, choice.title),
  );
  const element = h("div", { class: `bar ${kind}`, role: kind === "error" ? "alert" : "status" }, h("span", {}, sentence, mend ? " " : "", mend ? h("em", {}, mend) : null), ...buttons, close);
  shown.push({ text, element });
  if (shown.length > 4) remove(shown[0]!.element);
  redraw();
  if (kind === "info") setTimeout(() => remove(element), 4000);
}

function remove(element: HTMLElement): void {
  const at = shown.findIndex((one) => one.element === element);
  if (at >= 0) shown.splice(at, 1);
  redraw();
}

function redraw(): void {
  fill(byId("bars"), ...shown.map((one) => one.element));
}
