// The mouse over the main view: orbit, pan, zoom, select; draw and measure when asked.

import type { Vec3 } from "./boxes";
import { byId } from "./dom";
import { begin, cancelGesture, end } from "./gestures";
import { groundUnder, pickBox } from "./picking";
import { Projector } from "./project";
import type { Pane, Stage } from "./stage";
import { changed, select, state } from "./state";

export interface Gesture {
  /** Start at a place of the frame; return false to let the view move instead. */
  down(at: Vec3, event: PointerEvent, view: Projector): boolean;
  move(at: Vec3, event: PointerEvent): void;
  up(at: Vec3 | null, event: PointerEvent): void;
  /** It is given up: nothing of it may remain. */
  cancel(): void;
}

const CLICK_PX = 4;

/** Where the pointer last was over the main view, for keys that act there. */
export const pointer = { x: 0, y: 0, over: false };

export function listenToMain(stage: Stage, gesture: () => Gesture | null): void {
  const main = byId("main");
  let drag: { x: number; y: number; button: number; moved: number; pane: Pane; gesture: Gesture | null; pointer: number } | null = null;

  main.addEventListener("pointerdown", (event) => {
    if (drag) return; // one pointer draws, or moves the view
    const pane = stage.paneAt(event.clientX);
    const view = new Projector(pane.camera, pane.rect);
    const wanted = event.button === 0 ? gesture() : null;
    const at = wanted ? groundUnder(stage, view, pane.index, event.clientX, event.clientY) : null;
    const taken = wanted !== null && at !== null && wanted.down(at, event, view);
    drag = { x: event.clientX, y: event.clientY, button: event.button, moved: 0, pane, gesture: taken ? wanted : null, pointer: event.pointerId };
    if (taken) begin(() => { drag = null; wanted.cancel(); });
    main.setPointerCapture(event.pointerId);
    event.preventDefault();
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  });

  main.addEventListener("pointermove", (event) => {
    Object.assign(pointer, { x: event.clientX, y: event.clientY, over: true });
    if (drag?.pointer !== event.pointerId) return;
    const [dx, dy] = [event.clientX - drag.x, event.clientY - drag.y];
    if (drag.gesture) {
      const view = new Projector(drag.pane.camera, drag.pane.rect);
      const at = view.ground(event.clientX, event.clientY, dragLevel);
      if (at) drag.gesture.move(at, event);
      return;
    }
    drag.moved += Math.abs(dx) + Math.abs(dy);
    Object.assign(drag, { x: event.clientX, y: event.clientY });
    if (drag.moved < CLICK_PX) return;
    const pan = drag.button !== 0 || event.shiftKey || stage.eye.top;
    if (pan) stage.eye.pan(dx, dy, drag.pane.rect);
    else stage.eye.orbit(dx, dy);
    stage.touch();
  });

  main.addEventListener("pointerup", (event) => {
    const was = drag;
    if (was?.pointer !== event.pointerId) return;
    drag = null;
    if (was.gesture) end();
    const view = new Projector(was.pane.camera, was.pane.rect);
    if (was.gesture) was.gesture.up(view.ground(event.clientX, event.clientY, dragLevel), event);
    else if (was.moved < CLICK_PX && was.button === 0) clicked(stage, view, was.pane, event);
  });

  for (const lost of ["pointercancel", "lostpointercapture"] as const)
    main.addEventListener(lost, (event) => { if (drag?.pointer === event.pointerId) cancelGesture(), (drag = null); });
  main.addEventListener("pointerleave", () => (pointer.over = false));
  main.addEventListener("contextmenu", (event) => event.preventDefault());
  main.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomAt(stage, event);
  }, { passive: false });
}

let dragLevel = -1.7;
/** The height at which a drag goes on: that of the place where it began. */
export const dragAt = (z: number): void => void (dragLevel = z);

function zoomAt(stage: Stage, event: WheelEvent): void {
  const factor = Math.exp(Math.sign(event.deltaY) * Math.min(60, Math.abs(event.deltaY)) * 0.0025);
  const pane = stage.paneAt(event.clientX);
  const before = new Projector(pane.camera, pane.rect).ground(event.clientX, event.clientY, stage.eye.target[2]);
  stage.eye.zoom(factor);
  const [x, y, z] = stage.eye.target;
  if (before) stage.eye.target = [before[0] + (x - before[0]) * factor, before[1] + (y - before[1]) * factor, z];
  stage.touch();
}

function clicked(stage: Stage, view: Projector, pane: Pane, event: PointerEvent): void {
  if (state.tool === "measure") {
    const at = groundUnder(stage, view, pane.index, event.clientX, event.clientY);
    if (!at) return;
    state.tape = state.tape.length >= 2 ? [at] : [...state.tape, at];
    changed("tool");
    return;
  }
  select(pickBox(view, event.clientX, event.clientY));
}
