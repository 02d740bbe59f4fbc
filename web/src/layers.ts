// The left column: layers, colours, boxes shown, filters.

import { byId, fill, h, type Child } from "./dom";
import { refresh, show } from "./frames";
import { defaultWindow, scaleOf } from "./cloud";
import { sample } from "./colours";
import type { Layer } from "./protocol";
import { refreshInference } from "./infer";
import type { Stage } from "./stage";
import { changed, lookOf, on, state } from "./state";
import { COLOUR_TITLES, COLOUR_UNITS, colours, setColour } from "./viewing";

const heading = (text: string): HTMLElement => h("h2", {}, text);

function check(title: Child, value: boolean, set: (value: boolean) => void, name = ""): HTMLElement {
  const box = h("input", { type: "checkbox", checked: value, onchange: () => set(box.checked), name: name || (typeof title === "string" ? title : "") });
  return h("label", {}, box, title);
}

function slider(title: string, value: number, low: number, high: number, step: number, set: (value: number) => void, show: (value: number) => string, name = ""): HTMLElement {
  const out = h("output", {}, show(value));
  const input = h("input", { type: "range", min: low, max: high, step, value, name: name || title, oninput: () => { out.textContent = show(Number(input.value)); set(Number(input.value)); } });
  input.value = String(value);
  return h("label", { class: "pair" }, title, input, out);
}

function count(stage: Stage, layer: Layer): string {
  const found = stage.clouds.get(layer.name)?.object.set.count;
  return found === undefined ? "" : found >= 10000 ? `${Math.round(found / 1000)} k` : String(found);
}

function layerRow(stage: Stage, layer: Layer): HTMLElement {
  const look = lookOf(layer.name, layer.kind);
  const box = h("input", { type: "checkbox", checked: look.visible, name: `layer ${layer.name}`, onchange: () => { look.visible = box.checked; changed("looks"); if (box.checked) show(state.frame); } });
  const fade = h("input", { type: "range", min: 0.1, max: 1, step: 0.05, value: look.opacity, title: "opacity", "aria-label": `opacity of ${layer.title}`, oninput: () => { look.opacity = Number(fade.value); changed("looks"); } });
  fade.value = String(look.opacity);
  const sides = ["both", "left", "right"];
  const side = h("button", { class: "quiet", title: "which pane", onclick: () => { look.side = ((look.side + 1) % 3) as 0 | 1 | 2; changed("looks"); } }, sides[look.side]!);
  const lag = layer.lag_ms ? `, ${layer.lag_ms > 0 ? "+" : ""}${layer.lag_ms.toFixed(0)} ms` : "";
  const title = `${layer.title}${layer.placed ? "" : ": place not known, drawn in its own axes"}${lag}`;
  return h("div", { class: "layer", title },
    h("label", { class: "name" }, box, h("span", {}, layer.title)), h("span", { class: "weak" }, count(stage, layer)),
    layer.kind === "image" ? null : fade, state.sideBySide && layer.kind !== "image" ? side : null);
}

function legend(): HTMLElement[] {
  if (state.colour === "pattern") return [];
  const canvas = h("canvas", { class: "legend", width: 64, height: 1 });
  const paper = canvas.getContext("2d")!;
  for (let i = 0; i < 64; i += 1) {
    const [r, g, b] = sample(scaleOf(state.colour), i / 63);
    paper.fillStyle = `rgb(${r | 0}, ${g | 0}, ${b | 0})`;
    paper.fillRect(i, 0, 1, 1);
  }
  const [low, high] = windowNow();
  const unit = COLOUR_UNITS[state.colour] ?? "";
  const round = (value: number): string => `${Math.abs(value) < 10 ? value.toFixed(1) : value.toFixed(0)} ${unit}`;
  return [canvas, h("div", { class: "ends" }, h("span", {}, round(low)), h("span", {}, round(high)))];
}

let stageForWindow: Stage | null = null;

function windowNow(): [number, number] {
  if (state.window) return state.window;
  for (const { object } of stageForWindow?.clouds.values() ?? [])
    if (object.set.values.has(state.colour)) return defaultWindow(state.colour, object.set);
  return defaultWindow(state.colour, null);
}

function colourPart(stage: Stage): HTMLElement[] {
  stageForWindow = stage;
  const choice = h("select", { name: "colour", "aria-label": "colour of the points", onchange: () => setColour(choice.value) },
    ...colours().map((name) => h("option", { value: name, selected: name === state.colour }, COLOUR_TITLES[name] ?? name)));
  const [low, high] = windowNow();
  const span = Math.max(high - low, 1e-3);
  const free = state.colour === "height" || state.colour === "range";
  return [
    heading("Colour"), choice, ...legend(),
    ...(free ? [slider("up to", high, low + span / 20, Math.max(high, state.colour === "range" ? 250 : 12), span / 50, (value) => { state.window = [low, value]; changed("looks"); }, (value) => value.toFixed(1))] : []),
    slider("size", state.pointSize, 0.8, 6, 0.1, (value) => { state.pointSize = value; changed("looks"); }, (value) => value.toFixed(1)),
    check("larger with range", state.grow, (value) => { state.grow = value; changed("looks"); }),
  ];
}

function sweeps(): HTMLElement | null {
  if (!state.shown?.frame.world_T_frame && state.sweeps === 1) return null;
  return slider("sweeps", state.sweeps, 1, 10, 1, (value) => { state.sweeps = value; refresh(); }, (value) => value.toFixed(0), "sweeps");
}

function boxPart(): HTMLElement[] {
  const flag = (title: string, name: "showTruth" | "showMissed" | "showTrails" | "showRings" | "showLabels"): HTMLElement =>
    check(title, state[name], (value) => { state[name] = value; changed("filters"); }, name);
  const sets = state.predictions.map((set) => {
    const dot = h("span", { class: "dot" });
    dot.style.background = set.colour;
    const side = state.setSides.get(set.name) ?? 0;
    const pane = h("button", { class: "quiet", onclick: () => { state.setSides.set(set.name, ((side + 1) % 3) as 0 | 1 | 2); changed("filters"); } }, ["both", "left", "right"][side]!);
    const row = check(h("span", {}, dot, `${set.title || set.name}`), !state.hiddenSets.has(set.name), (value) => { value ? state.hiddenSets.delete(set.name) : state.hiddenSets.add(set.name); changed("filters"); }, `set ${set.name}`);
    row.title = `${set.kind === "tracks" ? "tracked, dotted" : "detected, dashed"}${set.protocol ? `; matched by ${set.protocol}` : ""}`;
    return h("div", { class: "layer" }, row, state.sideBySide ? pane : null);
  });
  return [
    heading("Boxes"), flag("annotated (solid)", "showTruth"), ...sets,
    ...(sets.length > 0 ? [flag("missed, with an ×", "showMissed")] : []),
    flag("labels", "showLabels"), flag("trails", "showTrails"), flag("range rings", "showRings"),
    check("side by side", state.sideBySide, (value) => { state.sideBySide = value; changed("looks"); }, "sideBySide"),
  ];
}

function toggle<T>(set: Set<T>, value: T, on: boolean): void {
  if (on) set.add(value);
  else set.delete(value);
  changed("filters");
}

function filterPart(): HTMLElement[] {
  const { filters } = state;
  const classes = (state.welcome?.classes ?? []).map((spec) => {
    const dot = h("span", { class: "dot" });
    dot.style.background = spec.colour;
    return check(h("span", {}, dot, spec.title || spec.name, spec.key ? h("span", { class: "weak" }, `  ${spec.key}`) : null), !filters.hidden.has(spec.name), (value) => toggle(filters.hidden, spec.name, !value), `class ${spec.name}`);
  });
  const words = [...new Set(state.boxes.map((row) => row.visibility).filter((word): word is string => !!word))].sort();
  const far = Math.min(filters.range[1], 400);
  return [
    heading("Filters"), ...classes,
    ...(state.predictions.length > 0 ? [slider("score ≥", filters.score, 0, 1, 0.05, (value) => { filters.score = value; changed("filters"); }, (value) => value.toFixed(2), "score")] : []),
    slider("from", filters.range[0], 0, 250, 5, (value) => { filters.range[0] = value; changed("filters", "looks"); }, (value) => `${value} m`, "from"),
    slider("to", far, 5, 400, 5, (value) => { filters.range[1] = value >= 400 ? 1e4 : value; changed("filters", "looks"); }, (value) => (value >= 400 ? "all" : `${value} m`), "to"),
    ...(words.length > 0 ? [h("span", { class: "weak" }, "visibility"), ...words.map((word) => check(word, !filters.visibility.has(word), (value) => toggle(filters.visibility, word, !value), `visibility ${word}`))] : []),
  ];
}

function draw(stage: Stage): void {
  const left = byId("left");
  if (left.contains(document.activeElement) && document.activeElement instanceof HTMLInputElement && document.activeElement.type === "range" && sliding) return;
  const all = state.shown?.layers ?? [];
  const hasRadarPower = [...stage.clouds.values()].some(({ layer, object }) => layer.sensor === "radar" && (object.set.values.has("power_db") || object.set.values.has("rcs_dbsm")));
  const top = left.scrollTop;
  fill(left,
    heading("Layers"), ...all.filter((layer) => layer.kind !== "bfs").map((layer) => layerRow(stage, layer)),
    sweeps(),
    hasRadarPower ? slider("strongest", 1 - (state.powerGate ?? 0.9), 0.01, 1, 0.01, (value) => { state.powerGate = 1 - value; changed("looks"); }, (value) => (state.powerGate === null ? "auto" : `${(value * 100).toFixed(0)} %`), "power") : null,
    ...colourPart(stage), ...boxPart(), ...filterPart(), refreshInference());
  left.scrollTop = top;
}

let sliding = false;
let drawnFor = "";

/** What of a frame the column shows: while playing it is built anew only when this changes. */
function signature(): string {
  const fields = colours().join();
  const words = [...new Set(state.boxes.map((row) => row.visibility))].sort().join();
  return `${state.playing} ${fields} ${words} ${(state.shown?.layers ?? []).map((layer) => `${layer.kind} ${layer.title} ${layer.placed}`).join()}`;
}

export function layersPanel(stage: Stage): void {
  const left = byId("left");
  left.addEventListener("pointerdown", () => (sliding = true));
  window.addEventListener("pointerup", () => { sliding = false; });
  on(["welcome", "looks", "filters", "jobs", "connection", "tool"], () => draw(stage));
  on("frame", () => {
    const now = signature();
    if (now !== drawnFor || !state.playing) draw(stage);
    drawnFor = now;
  });
}
