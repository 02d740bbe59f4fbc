// Keys that look and never change an annotation: frames, objects, colours, panes.

import { awaited, setClass, setTool } from "./annotate";
import { byId, fill } from "./dom";
import type { PointSet } from "./cloud";
import { show } from "./frames";
import { bind } from "./keys";
import { ready } from "./loader";
import { post } from "./post";
import { newId } from "./socket";
import type { Stage } from "./stage";
import { boxOf, changed, select, selected, shownBoxes, shownFrame, state } from "./state";

/** The colours that the shown layers can take. */
export function colours(): string[] {
  const fields = new Set<string>();
  for (const layer of state.shown?.layers ?? []) {
    const set = layer.kind === "points" ? (ready(layer) as PointSet | null) : null;
    for (const name of set?.values.keys() ?? []) fields.add(name);
  }
  return ["height", "range", "pattern", ...fields];
}

export const COLOUR_TITLES: Record<string, string> = {
  height: "height", range: "range", pattern: "pattern (layer)", intensity: "intensity", ring: "ring", lag_s: "age", age_s: "age", power_db: "power",
  doppler_m_s: "Doppler", rcs_dbsm: "cross-section", doppler_compensated_m_s: "Doppler over ground",
};

export const COLOUR_UNITS: Record<string, string> = { height: "m", range: "m", lag_s: "s", age_s: "s", doppler_m_s: "m/s", rcs_dbsm: "dBsm", power_db: "dB" };

export function setColour(name: string): void {
  state.colour = name;
  state.window = null;
  changed("looks");
}

function frames(): void {
  const go = (by: number) => () => show(state.frame + by);
  bind("frame.next", go(1));
  bind("frame.previous", go(-1));
  bind("frame.on10", go(10));
  bind("frame.back10", go(-10));
  bind("frame.first", () => show(0));
  bind("frame.last", () => show((state.welcome?.frames ?? 1) - 1));
  bind("bookmark", () => {
    const frame = shownFrame();
    if (frame < 0) return;
    const there = state.bookmarks.some((mark) => mark.frame === frame);
    post({ op: "bookmark.set", id: newId(), frame, note: there ? null : "" });
  });
}

function objects(stage: Stage): void {
  const next = (by: number) => () => {
    const rows = shownBoxes().sort((a, b) => a.distance_m - b.distance_m);
    if (rows.length === 0) return;
    const at = rows.findIndex((row) => row.id === state.selection);
    select(rows[(at < 0 ? (by > 0 ? 0 : rows.length - 1) : at + by + rows.length) % rows.length]!.id);
  };
  bind("object.next", next(1));
  bind("object.previous", next(-1));
  bind("view.frame", () => lookAt(stage));
  bind("view.follow", () => {
    state.follow = !state.follow;
    lookAt(stage);
  });
  bind("view.top", () => {
    stage.eye.top = !stage.eye.top;
    stage.touch();
  });
}

export function lookAt(stage: Stage): void {
  const row = selected();
  if (!row) {
    stage.eye.frame([22, 0, 0], 48);
  } else {
    const [x, y, z, l] = boxOf(row);
    stage.eye.frame([x, y, z], Math.max(12, l * 3.5));
  }
  stage.touch();
}

export function bindViewing(stage: Stage): void {
  frames();
  objects(stage);
  for (let i = 1; i <= 9; i += 1) bind(`class.${i}`, () => classKey(i));
  bind("colour.next", () => {
    const names = colours();
    setColour(names[(names.indexOf(state.colour) + 1) % names.length]!);
  });
  bind("layers", () => {
    document.body.classList.toggle("no-left");
    stage.request("all");
  });
  bind("cameras", () => {
    document.body.classList.toggle("no-cameras");
    stage.request("all");
  });
  bind("only", () => { state.onlySelection = !state.onlySelection; changed("filters"); });
  bind("trails", () => { state.showTrails = !state.showTrails; changed("filters"); });
  bind("sides", () => { state.sideBySide = !state.sideBySide; changed("looks"); });
  bind("size.up", () => pointSize(1.25));
  bind("size.down", () => pointSize(0.8));
  bind("measure", () => setTool(state.tool === "measure" ? "none" : "measure"));
}

/** A digit shows or hides a class while viewing, and sets it while annotating. */
function classKey(place: number): void {
  const classes = state.welcome?.classes ?? [];
  const spec = classes.find((one) => one.key === String(place)) ?? (classes.some((one) => one.key) ? undefined : classes[place - 1]);
  if (!spec) return;
  if (state.mode === "annotate") return setClass(spec.name);
  const { hidden } = state.filters;
  if (!hidden.delete(spec.name)) hidden.add(spec.name);
  changed("filters");
}

function pointSize(by: number): void {
  state.pointSize = Math.min(8, Math.max(0.8, state.pointSize * by));
  changed("looks");
}

/** A line under the main view that says what the pointer does now. */
export function hint(): void {
  const object = awaited();
  const known = object ? `Draw object ${object.track}, whose size is known` : "Draw";
  const text =
    state.tool === "draw"
      ? `${known}: press at the rear of the object and drag along its heading. A click fits there; Ctrl and drag draws a rectangle; Esc ends.`
      : state.tool === "measure"
        ? "Tape: click two places. Esc ends."
        : "";
  fill(byId("hint"), text);
  document.body.classList.toggle("tool", state.tool !== "none");
}
