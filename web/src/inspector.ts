// The selected box in numbers: typed values are one edit at Enter (or on leaving the field).

import { awaited, setClass } from "./annotate";
import { report } from "./bar";
import { fault, FARTHEST_M, LONGEST_M, type Box } from "./boxes";
import { byId, counted, degrees, fill, h, radians, wrapped } from "./dom";
import { setBox } from "./edits";
import { keyFor, run } from "./keys";
import type { BoxRow } from "./protocol";
import { boxOf, changed, on, selected, shownFrame, state } from "./state";

const NAMES = ["x", "y", "z", "yaw", "l", "w", "h"] as const;
const TITLES = ["x", "y", "z", "Yaw", "Length", "Width", "Height"];
const PLACE = [0, 1, 2, 6, 3, 4, 5] as const;
const fields: HTMLInputElement[] = [];

/** The box of which the fields tell, in its frame: what is typed is meant for it, whatever is shown by then. */
let told: { id: string; frame: number } | null = null;

function meant(): BoxRow | null {
  const row = selected();
  if (row && told && row.id === told.id && shownFrame() === told.frame) return row;
  report("warning", "Another box is shown by now: what was typed was not taken.");
  return null;
}

function typed(i: number): void {
  const field = fields[i]!;
  const row = meant();
  const axis = PLACE[i]!;
  if (!row) return refreshNumbers();
  const value = Number(field.value);
  if (field.value === standing(i)) {
    field.classList.remove("bad");
    if (state.note?.id === row.id) state.note = null, changed("tool");
    return;
  }
  if (field.value === "" || !Number.isFinite(value)) return refuse(row, field, `${TITLES[i]}: expected a number.`);
  const box = [...boxOf(row)] as Box;
  if (axis === 6 && Math.abs(value) > 3600) return refuse(row, field, "Yaw: expected from -3600 to 3600 degrees.");
  const next = axis === 6 ? wrapped(radians(value)) : value;
  const unchanged = Math.abs(box[axis] - next) < 5e-5;
  if (!unchanged) box[axis] = next;
  const wrong = fault(box);
  if (wrong) return refuse(row, field, wrong);
  field.classList.remove("bad");
  if (state.note?.id === row.id) state.note = null, changed("tool");
  if (!unchanged && !setBox(row, { box })) refreshNumbers();
}

/** Say at the field what is wrong with what was typed; it stays there to be mended, and goes nowhere. */
function refuse(row: BoxRow, field: HTMLInputElement, text: string): void {
  field.classList.add("bad");
  state.note = { id: row.id, text };
  changed("tool");
}

function bounds(i: number): { min: number; max: number; title: string } {
  const axis = PLACE[i]!;
  if (axis === 6) return { min: -3600, max: 3600, title: "yaw in degrees, from -3600 to 3600" };
  if (axis < 3) return { min: -FARTHEST_M, max: FARTHEST_M, title: `${NAMES[i]} of the centre in metres, from -${FARTHEST_M} to ${FARTHEST_M}` };
  return { min: 0.01, max: LONGEST_M, title: `${TITLES[i]!.toLowerCase()} in metres, above 0 and up to ${LONGEST_M}` };
}

function numbers(): HTMLElement {
  fields.length = 0;
  return h("div", { class: "numbers" }, ...NAMES.map((name, i) => {
    const field = h("input", { type: "number", step: name === "yaw" ? 1 : 0.05, name, ...bounds(i), "aria-describedby": "field-note", disabled: state.mode !== "annotate", onchange: () => typed(i), onkeydown: (event: KeyboardEvent) => {
      if (event.key === "Enter") {
        typed(i);
        field.blur();
      } else if (event.key === "Escape") { // what was typed is given up
        field.classList.remove("bad");
        field.value = standing(i);
        field.blur();
      }
    } });
    fields.push(field);
    return h("label", {}, name, field);
  }));
}

function standing(i: number): string {
  const row = selected();
  const axis = PLACE[i]!;
  return !row ? "" : axis === 6 ? degrees(row.box[6]!).toFixed(1) : row.box[axis]!.toFixed(2);
}

function refreshNumbers(): void {
  const row = selected();
  if (!row) return;
  const same = told?.id === row.id && told.frame === shownFrame();
  told = { id: row.id, frame: shownFrame() };
  fields.forEach((field, i) => {
    if (same && (document.activeElement === field || (field.classList.contains("bad") && state.note?.id === row.id))) return;
    field.classList.remove("bad");
    field.value = standing(i);
  });
  const note = byId("field-note");
  fill(note, state.note?.id === row.id ? state.note.text : null);
}

function attribute(name: string, value: string | number | boolean | null): HTMLElement {
  const set = (next: string | number | boolean): void => {
    const now = meant();
    if (now) setBox(now, { attributes: { ...now.attributes, [name]: next } });
  };
  if (typeof value === "boolean") {
    const box = h("input", { type: "checkbox", checked: value, onchange: () => set(box.checked) });
    return h("label", {}, box, name);
  }
  const input = h("input", { value: value ?? "", size: 8, maxLength: 2000, onchange: () => set(typeof value === "number" && input.value !== "" && Number.isFinite(Number(input.value)) ? Number(input.value) : input.value) });
  return h("label", {}, `${name} `, input);
}

function classes(row: BoxRow): HTMLElement {
  const list = state.welcome?.classes ?? [];
  const choice = h("select", { name: "class", "aria-label": "class", disabled: state.mode !== "annotate", onchange: () => { if (meant()) setClass(choice.value); } },
    ...list.map((spec) => h("option", { value: spec.name, selected: spec.name === row.class_name }, spec.title || spec.name)),
    list.some((spec) => spec.name === row.class_name) ? null : h("option", { value: row.class_name, selected: true }, row.class_name));
  return choice;
}

function trackPart(row: BoxRow): HTMLElement {
  const field = h("input", { type: "number", name: "track", min: 0, step: 1, value: row.track ?? "", title: "track number", "aria-label": "track number", disabled: state.mode !== "annotate", onchange: () => {
    const now = meant();
    const number = Number(field.value);
    if (now && field.value !== "" && !(Number.isInteger(number) && number >= 0 && number < 2 ** 31)) refuse(now, field, "Track: expected a whole number, or nothing.");
    else if (now) field.classList.remove("bad"), setBox(now, { track: field.value === "" ? null : number });
  } });
  field.style.width = "62px";
  const info = row.track === null ? undefined : state.tracks.get(row.track);
  return h("span", {}, "track ", field, info?.size_locked ? " size locked" : "", info?.ends !== null && info?.ends !== undefined ? ` ends at ${info.ends + 1}` : "");
}

function tools(row: BoxRow): HTMLElement | null {
  if (state.mode !== "annotate") return null;
  const act = (title: string, id: string): HTMLElement => h("button", { class: "small", title: keyFor(id), onclick: () => run(id) }, title);
  if (row.state === "proposed") return h("div", { class: "row" }, act("Accept", "accept"), act("Reject", "delete"), act("Fit", "refit"));
  return h("div", { class: "row" }, act("Fit", "refit"), act("Ground", "ground"), act("Turn", "turn.half"), act("Propagate", "propagate"), act("Interpolate", "interpolate"), act("Wall", "wall"), act("Lock", "lock"), act("End", "end"), act("Class to track", "track.class"), act("Split", "track.split"), act("Merge", "track.merge"), act("Remove", "delete"));
}

function chooser(): HTMLElement {
  const list = state.welcome?.classes ?? [];
  const choice = h("select", { name: "new class", "aria-label": "class of the next box", onchange: () => setClass(choice.value) }, ...list.map((spec) => h("option", { value: spec.name, selected: spec.name === state.chosenClass }, spec.title || spec.name)));
  const types = list.find((spec) => spec.name === state.chosenClass)?.types ?? [];
  const type = h("select", { name: "new type", "aria-label": "size of the next box", onchange: () => { state.chosenType = type.value; changed("tool"); } }, h("option", { value: "" }, "usual size"), ...types.map((one) => h("option", { value: one.name, selected: one.name === state.chosenType }, `${one.name} ${one.size.join(" × ")}`)));
  const chosen = list.find((spec) => spec.name === state.chosenClass);
  const usual = chosen && !state.chosenType ? h("div", { class: "row weak", id: "usual-size" }, `${chosen.size.join(" × ")} m${chosen.source ? `: ${chosen.source}` : ""}`) : null;
  const object = awaited();
  const carried = object ? h("div", { class: "row weak" }, `Object ${object.track} has no box in this frame: draw it (N), or Esc for another one.`) : null;
  return h("div", {}, carried, h("div", { class: "row" }, h("button", { class: state.tool === "draw" ? "main" : "", title: keyFor("draw"), onclick: () => run("draw") }, "Draw"), choice, types.length > 0 ? type : null), usual);
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
  const key = JSON.stringify([shownFrame(), row.id, row.class_name, row.track, row.state, row.source, row.attributes, state.mode, state.tool, state.chosenType, info?.size_locked, info?.ends]);
  if (key !== built) told = null;
  if (key !== built) {
    built = key;
    fill(panel,
      numbers(),
      h("div", { class: "field-note", id: "field-note", role: "status" }),
      h("div", { class: "row" }, classes(row), trackPart(row)),
      h("div", { class: "row weak", id: "facts" }),
      ...(Object.keys(row.attributes).length > 0 ? [h("div", { class: "row" }, ...Object.entries(row.attributes).map(([name, value]) => attribute(name, value)))] : []),
      tools(row));
  }
  refreshNumbers();
  fill(byId("facts"), [`${row.distance_m.toFixed(1)} m`, row.points === null ? "" : counted(row.points, "point"), row.radar_points ? `${row.radar_points} radar` : "", row.state, row.source, row.score === null ? "" : `score ${row.score.toFixed(2)}`, row.visibility ?? "", row.moving === null ? "" : row.moving ? "moving" : "standing", row.keyframe ? "" : "not a keyframe"].filter(Boolean).join(" · "));
}

export function inspectorPanel(): void {
  on(["selection", "frame", "boxes", "tool", "tracks", "welcome"], draw);
  fill(byId("close-none"), "Select a box: click it, or press ↓.");
}

