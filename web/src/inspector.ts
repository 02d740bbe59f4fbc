// The selected box in numbers: typed values are one edit at Enter (or on leaving the field).

import { setClass } from "./annotate";
import type { Box } from "./boxes";
import { byId, degrees, fill, h, radians, wrapped } from "./dom";
import { setBox } from "./edits";
import { keyFor, run } from "./keys";
import type { BoxRow } from "./protocol";
import { boxOf, changed, on, selected, state } from "./state";

const NAMES = ["x", "y", "z", "yaw", "l", "w", "h"] as const;
const PLACE = [0, 1, 2, 6, 3, 4, 5] as const;
const fields: HTMLInputElement[] = [];

function typed(i: number): void {
  const row = selected();
  const value = Number(fields[i]!.value);
  const axis = PLACE[i]!;
  if (!row || !Number.isFinite(value) || fields[i]!.value === "" || (axis > 2 && axis < 6 && value <= 0)) return refreshNumbers();
  const box = [...boxOf(row)] as Box;
  const next = axis === 6 ? wrapped(radians(value)) : value;
  if (Math.abs(box[axis] - next) < 5e-5) return;
  box[axis] = next;
  setBox(row, { box });
}

function numbers(): HTMLElement {
  fields.length = 0;
  return h("div", { class: "numbers" }, ...NAMES.map((name, i) => {
    const field = h("input", { type: "number", step: name === "yaw" ? 1 : 0.05, name, disabled: state.mode !== "annotate", onchange: () => typed(i), onkeydown: (event: KeyboardEvent) => { if (event.key === "Enter") field.blur(); } });
    fields.push(field);
    return h("label", {}, name, field);
  }));
}

function refreshNumbers(): void {
  const row = selected();
  if (!row) return;
  fields.forEach((field, i) => {
    if (document.activeElement === field) return;
    const axis = PLACE[i]!;
    field.value = axis === 6 ? degrees(row.box[6]!).toFixed(1) : row.box[axis]!.toFixed(2);
  });
}

function attribute(row: BoxRow, name: string, value: string | number | boolean | null): HTMLElement {
  const set = (next: string | number | boolean): void => setBox(row, { attributes: { ...selected()!.attributes, [name]: next } });
  if (typeof value === "boolean") {
    const box = h("input", { type: "checkbox", checked: value, onchange: () => set(box.checked) });
    return h("label", {}, box, name);
  }
  const input = h("input", { value: value ?? "", size: 8, onchange: () => set(typeof value === "number" && Number.isFinite(Number(input.value)) ? Number(input.value) : input.value) });
  return h("label", {}, `${name} `, input);
}

function classes(row: BoxRow): HTMLElement {
  const list = state.welcome?.classes ?? [];
  const choice = h("select", { name: "class", disabled: state.mode !== "annotate", onchange: () => setClass(choice.value) },
    ...list.map((spec) => h("option", { value: spec.name, selected: spec.name === row.class_name }, spec.title || spec.name)),
    list.some((spec) => spec.name === row.class_name) ? null : h("option", { value: row.class_name, selected: true }, row.class_name));
  return choice;
}

function trackPart(row: BoxRow): HTMLElement {
  const field = h("input", { type: "number", name: "track", min: 0, step: 1, value: row.track ?? "", title: "track number", disabled: state.mode !== "annotate", onchange: () => setBox(row, { track: field.value === "" ? null : Math.max(0, Math.round(Number(field.value))) }) });
  field.style.width = "62px";
  const info = row.track === null ? undefined : state.tracks.get(row.track);
  return h("span", {}, "track ", field, info?.size_locked ? " size locked" : "", info?.ends !== null && info?.ends !== undefined ? ` ends at ${info.ends + 1}` : "");
}

function tools(row: BoxRow): HTMLElement | null {
  if (state.mode !== "annotate") return null;
  const act = (title: string, id: string): HTMLElement => h("button", { class: "small", title: keyFor(id), onclick: () => run(id) }, title);
  if (row.state === "proposed") return h("div", { class: "row" }, act("Accept", "accept"), act("Reject", "delete"), act("Fit", "refit"));
  return h("div", { class: "row" }, act("Fit", "refit"), act("Ground", "ground"), act("Turn", "turn.half"), act("Propagate", "propagate"), act("Interpolate", "interpolate"), act("Wall", "wall"), act("Lock", "lock"), act("End", "end"), act("Remove", "delete"));
}

function chooser(): HTMLElement {
  const list = state.welcome?.classes ?? [];
  const choice = h("select", { name: "new class", onchange: () => setClass(choice.value) }, ...list.map((spec) => h("option", { value: spec.name, selected: spec.name === state.chosenClass }, spec.title || spec.name)));
  const types = list.find((spec) => spec.name === state.chosenClass)?.types ?? [];
  const type = h("select", { name: "new type", onchange: () => { state.chosenType = type.value; changed("tool"); } }, h("option", { value: "" }, "usual size"), ...types.map((one) => h("option", { value: one.name, selected: one.name === state.chosenType }, `${one.name} ${one.size.join(" × ")}`)));
  return h("div", { class: "row" }, h("button", { class: state.tool === "draw" ? "main" : "", title: keyFor("draw"), onclick: () => run("draw") }, "Draw"), choice, types.length > 0 ? type : null);
}

let built = "";

function draw(): void {
  const row = selected();
  const panel = byId("inspector");
  if (!row) {
    built = "";
    fill(panel, state.mode === "annotate" && state.welcome ? chooser() : null);
    return;
  }
  const info = row.track === null ? undefined : state.tracks.get(row.track);
  const key = JSON.stringify([row.id, row.class_name, row.track, row.state, row.source, row.attributes, state.mode, state.tool, state.chosenType, info?.size_locked, info?.ends]);
  if (key !== built) {
    built = key;
    fill(panel,
      numbers(),
      h("div", { class: "row" }, classes(row), trackPart(row)),
      h("div", { class: "row weak", id: "facts" }),
      ...(Object.keys(row.attributes).length > 0 ? [h("div", { class: "row" }, ...Object.entries(row.attributes).map(([name, value]) => attribute(row, name, value)))] : []),
      tools(row));
  }
  refreshNumbers();
  fill(byId("facts"), [`${row.distance_m.toFixed(1)} m`, row.points === null ? "" : `${row.points} points`, row.radar_points ? `${row.radar_points} radar` : "", row.state, row.source, row.score === null ? "" : `score ${row.score.toFixed(2)}`, row.visibility ?? "", row.moving === null ? "" : row.moving ? "moving" : "standing", row.keyframe ? "" : "not a keyframe"].filter(Boolean).join(" · "));
}

export function inspectorPanel(): void {
  on(["selection", "boxes", "tool", "tracks", "welcome"], draw);
  fill(byId("close-none"), "Select a box: click it, or press Tab.");
}

