// A few lines in place of a framework: make an element, fill it, find it.

export type Child = Node | string | number | null | undefined | false;

type Props = Record<string, unknown>;

/** Make an element; `on…` props are listeners, `class` and `data-…` attributes, everything else is set as a property. */
export function h<K extends keyof HTMLElementTagNameMap>(tag: K, props: Props = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value as EventListener);
    else if (name === "class") element.className = String(value);
    else if (name.includes("-") || name === "role" || name === "for") element.setAttribute(name, String(value));
    else (element as unknown as Props)[name] = value;
  }
  fill(element, ...children);
  return element;
}

/** Put children into an element. A control that has the focus keeps it, or leaves it to the one that takes its place: that of its name in its row. */
export function fill(element: Element, ...children: Child[]): void {
  const nodes = children.filter((child) => child !== null && child !== undefined && child !== false);
  const active = document.activeElement instanceof HTMLElement && element.contains(document.activeElement) && document.activeElement !== element ? document.activeElement : null;
  const name = active && !typing(active) ? callName(active) : "";
  element.replaceChildren(...nodes.map((child) => (child instanceof Node ? child : String(child))));
  if (!active) return;
  const next = element.contains(active) ? active : name && [...element.querySelectorAll<HTMLElement>("button, input, [tabindex]")].find((one) => callName(one) === name);
  if (next) next.focus({ preventScroll: true });
}

const ROWS = ["data-bar", "data-check", "data-box", "data-camera", "data-frame"];

/** What tells a control from all others of a part: its row, and its name in that. */
function callName(element: Element): string {
  const row = element.closest(ROWS.map((name) => `[${name}]`).join());
  const key = row ? ROWS.map((name) => row.getAttribute(name)).join() : "";
  if (row === element) return key;
  return `${key} ${["name", "aria-label", "title"].map((name) => element.getAttribute(name)).find((one) => one) ?? element.textContent ?? ""}`;
}

/** A number of things in words: 1 frame, 2 frames. */
export const counted = (count: number, one: string, more = `${one}s`): string => `${count.toLocaleString("en")} ${count === 1 ? one : more}`;

export function byId(id: string): HTMLElement {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element #${id}`);
  return found;
}

export function typing(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement) return !["checkbox", "range", "button", "radio"].includes(target.type);
  return target.isContentEditable || target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement;
}

export const degrees = (radians: number): number => (radians * 180) / Math.PI;
export const radians = (value: number): number => (value * Math.PI) / 180;
export const clamp = (value: number, low: number, high: number): number => Math.min(high, Math.max(low, value));

/** Radians in [-pi, pi). */
export function wrapped(angle: number): number {
  const turn = 2 * Math.PI;
  return angle - turn * Math.floor((angle + Math.PI) / turn);
}
