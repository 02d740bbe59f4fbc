// The close-ups' room: each is as high and all are as wide as they were dragged; one or all lie over the main view while they are large. Remembered.

import { goesOn } from "./gestures";
import type { Name } from "./closeviews";
import { NAMES } from "./closeviews";
import { byId, h } from "./dom";
import { remember, remembered } from "./settings";

export type Large = "" | "all" | Name;

const USUAL_PX: Record<Name | "width", number> = { top: 144, side: 84, front: 96, radar: 112, width: 280 };
const LEAST_PX: Record<Name | "width", number> = { top: 60, side: 48, front: 48, radar: 60, width: 220 };
const MOST_PX = { height: 700, width: 900 };
const STEP_PX = 16;

const sizes = remembered<typeof USUAL_PX>("close-up sizes", { ...USUAL_PX }, (value) => Object.keys(USUAL_PX).every((name) => Number.isFinite((value as Record<string, unknown>)[name])));
let laid = (): void => undefined; // other views are shown than before
let large = remembered<Large>("close-ups large", "", (value) => ["", "all", ...NAMES].includes(value as string));

const titleOf: Record<Name, string> = { top: "from above", side: "from the right", front: "from behind", radar: "from the radar" };

/** What was chosen, as far as this screen has room for it. */
function sizeOf(name: Name | "width", chosen = sizes[name]): number {
  return Math.max(LEAST_PX[name], Math.min(Math.round(chosen), name === "width" ? MOST_PX.width : MOST_PX.height, (name === "width" ? window.innerWidth * 0.6 : window.innerHeight * 0.7) | 0));
}

function apply(): void {
  for (const name of NAMES) byId(`close-${name}`).style.setProperty("--high", `${sizeOf(name)}px`);
  document.body.style.setProperty("--right", `${sizeOf("width")}px`);
}

function resize(name: Name | "width", to: number): void {
  sizes[name] = sizeOf(name, to);
  apply();
  remember("close-up sizes", sizes);
}

/** An edge that is dragged, or moved with the arrows when it has the focus. */
function grip(name: Name | "width", title: string): HTMLElement {
  const upright = name === "width";
  const element = h("div", { class: `grip ${upright ? "upright" : "level"}`, role: "separator", tabIndex: 0, title, "aria-label": title, "aria-orientation": upright ? "vertical" : "horizontal" });
  const announce = (): void => element.setAttribute("aria-valuenow", String(sizeOf(name)));
  let start: [number, number] | null = null;
  element.addEventListener("pointerdown", (event) => {
    if (goesOn()) return; // of another finger, whose box would jump as its view changes its scale
    start = [upright ? -event.clientX : event.clientY, sizeOf(name)];
    element.setPointerCapture(event.pointerId);
    event.preventDefault();
    event.stopPropagation();
  });
  element.addEventListener("pointermove", (event) => {
    if (start) resize(name, start[1] + (upright ? -event.clientX : event.clientY) - start[0]), announce();
  });
  for (const end of ["pointerup", "lostpointercapture"]) element.addEventListener(end, () => (start = null));
  element.addEventListener("keydown", (event) => {
    const by = { ArrowUp: -1, ArrowDown: 1, ArrowLeft: 1, ArrowRight: -1 }[event.key];
    if (!by || (event.key === "ArrowLeft" || event.key === "ArrowRight") !== upright) return;
    event.preventDefault();
    event.stopPropagation();
    resize(name, sizeOf(name) + by * STEP_PX);
    announce();
  });
  element.addEventListener("dblclick", () => { resize(name, USUAL_PX[name]); announce(); });
  announce();
  return element;
}

/** Which close-ups lie over the main view. */
export const largeNow = (): Large => (byId("closeups").classList.contains("empty") ? "" : large);

export function setLarge(next: Large): void {
  large = next;
  remember("close-ups large", next);
  showLarge();
}

/** Lay the close-ups where they belong now; none is large while nothing is selected. */
export function showLarge(): void {
  const now = largeNow();
  const shown = now === "radar" && byId("close-radar").hidden ? "all" : now;
  if (document.body.dataset.close === shown) return;
  document.body.dataset.close = shown;
  laid();
}

/** The grips and buttons; `back` shows the whole object again, `draw` draws all anew where other views are shown than before. */
export function closeSizes(back: (name: Name) => void, draw: () => void): void {
  laid = draw;
  for (const name of NAMES) {
    const element = byId(`close-${name}`);
    const title = `The close-up ${titleOf[name]}`;
    element.append(
      h("div", { class: "tools" },
        h("button", { class: "quiet small", title: `${title}: the whole object again`, "aria-label": `${title}: the whole object again`, onclick: () => back(name) }, "◎"),
        h("button", { class: "quiet small", name: `large ${name}`, title: `${title}: over the main view, or back`, "aria-label": `${title}: over the main view, or back`, onclick: () => setLarge(largeNow() === name ? "" : name) }, "⤢")),
      grip(name, `Height of the close-up ${titleOf[name]}: drag, or the arrow keys; twice: as at first`));
  }
  document.body.append(h("section", { id: "grip-width", "aria-label": "Width of this column" }, grip("width", "Width of the close-ups and this column: drag, or the arrow keys; twice: as at first")));
  document.body.dataset.close = "";
  apply();
  window.addEventListener("resize", apply);
}
