// The right column: values with sliders, numbers and sigma; figures, histogram, what the data cannot tell; saving.

import { changed, isRadar, keep, model, move, onChange, type Values } from "./calibmodel";
import { degrees, fill, h, radians } from "./dom";
import { run } from "./keys";
import type { Bars, Known } from "./protocol";
import { post } from "./post";
import { newId } from "./socket";

export interface Field {
  key: string;
  title: string;
  unit: string;
  reach: number; // of the slider, to each side of the start
  step: number;
  digits: number;
  known?: string; // the solver's name of it
  get: (values: Values) => number; // in its unit
  set: (values: Values, value: number) => Values;
}

const plain = (key: string, title: string, unit: string, reach: number, step: number, digits: number, factor = 1, known = title): Field => ({
  key, title, unit, reach, step, digits, known,
  get: (values) => (values as unknown as Record<string, number>)[key]! * factor,
  set: (values, value) => ({ ...values, [key]: value / factor }),
});

export const RADAR_FIELDS: Field[] = [
  plain("x_m", "x", "m", 3, 0.01, 3),
  plain("y_m", "y", "m", 3, 0.01, 3),
  plain("z_m", "z", "m", 1.5, 0.01, 3),
  { ...plain("yaw_rad", "yaw", "°", 5, 0.05, 2), get: (values) => (isRadar(values) ? degrees(values.yaw_rad) : 0), set: (values, value) => ({ ...values, yaw_rad: radians(value) }) },
  plain("frames", "frames", "", 5, 1, 0),
  plain("time_offset_s", "time offset", "ms", 50, 1, 0, 1000),
];

const movedBy = (at: number, title: string): Field => {
  const turn = at < 3;
  const factor = turn ? 180 / Math.PI : 100;
  return {
    key: `moved${at}`, title, unit: turn ? "°" : "cm", reach: turn ? 3 : 50, step: turn ? 0.02 : 0.5, digits: turn ? 2 : 1, known: title,
    get: (values) => (isRadar(values) ? 0 : values.moved[at]! * factor),
    set: (values, value) => ({ ...values, moved: (values as { moved: number[] }).moved.map((one, i) => (i === at ? value / factor : one)) }),
  };
};

export const CAMERA_FIELDS: Field[] = ["pitch", "yaw", "roll", "x", "y", "z"].map((title, at) => movedBy(at, title));

const coefficient = (at: number, title: string): Field => ({
  key: title, title, unit: "", reach: 0.5, step: 0.001, digits: 5,
  get: (values) => (isRadar(values) ? 0 : values.distortion[at]!),
  set: (values, value) => ({ ...values, distortion: (values as { distortion: number[] }).distortion.map((one, i) => (i === at ? value : one)) }),
});

export const LENS_FIELDS: Field[] = [
  plain("fx", "fx", "px", 0, 1, 2), plain("fy", "fy", "px", 0, 1, 2), plain("cx", "cx", "px", 0, 1, 2), plain("cy", "cy", "px", 0, 1, 2),
  ...["k1", "k2", "p1", "p2", "k3"].map((title, at) => coefficient(at, title)),
];

const shows: (() => void)[] = [];

/** Redraw what shows values; elements stay, so that a hand on a slider keeps it. */
onChange(() => shows.forEach((show) => show()));

function numberOf(field: Field): HTMLInputElement {
  const input = h("input", { type: "number", step: String(field.step), name: field.key, "aria-label": `${field.title} ${field.unit}` });
  input.addEventListener("change", () => {
    const value = Number(input.value);
    if (input.value === "" || !Number.isFinite(value) || !model.values) return changed();
    keep(field.set(model.values, value));
  });
  shows.push(() => {
    if (model.values && document.activeElement !== input) input.value = shown(field.get(model.values), field.digits);
    input.disabled = !model.state?.ready || model.job !== null;
  });
  return input;
}

/** Never a minus zero. */
const shown = (value: number, digits: number): string => (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);

export function valueRow(field: Field): HTMLElement {
  const slider = h("input", { type: "range", name: `slide ${field.key}`, "aria-label": field.title });
  let middle = 0;
  const value = (): Values => field.set(model.values!, Number(slider.value));
  slider.addEventListener("input", () => model.values && move(value()));
  slider.addEventListener("change", () => model.values && keep(value()));
  const sigma = h("span", { class: "sigma" });
  const bar = h("i", {});
  shows.push(() => {
    if (!model.state || !model.values) return;
    middle = field.get(model.state.before);
    const now = field.get(model.values);
    const reach = Math.max(field.reach, Math.ceil(Math.abs(now - middle)));
    [slider.min, slider.max, slider.step] = [String(middle - reach), String(middle + reach), String(field.key === "frames" ? 1 : field.step / 2)];
    slider.disabled = !model.state.ready || model.job !== null;
    if (document.activeElement !== slider || !model.moving) slider.value = String(now);
    const known = model.residuals?.known.find((one) => one.name === field.known);
    fill(sigma, sigmaWords(known));
    sigma.title = known ? `one sigma; ${(100 * known.observed).toFixed(0)} % of what is known comes from the data` : "";
    bar.style.width = `${known ? 100 * known.observed : 0}%`;
    bar.className = !known ? "" : known.observed > 0.8 ? "good" : known.observed > 0.4 ? "half" : "weak";
  });
  return h("div", { class: "value" }, h("label", {}, field.title), slider, numberOf(field), h("span", { class: "weak" }, field.unit), sigma, h("div", { class: "observed", title: "how much of what is known comes from the data" }, bar));
}

function sigmaWords(known: Known | undefined): string {
  if (!known) return "";
  if (known.sigma === null) return "± ?";
  return `± ${known.sigma < 1 ? known.sigma.toFixed(2) : known.sigma.toFixed(1)} ${known.unit === "deg" ? "°" : known.unit}`;
}

export function lensTable(): HTMLElement {
  return h("div", { class: "lens" }, ...LENS_FIELDS.map((field) => h("label", {}, h("span", {}, field.title), numberOf(field))));
}

export function button(title: string, id: string, show: (element: HTMLButtonElement) => void, kind = ""): HTMLButtonElement {
  const element = h("button", { class: kind, onclick: () => run(id), "data-key": id }, title);
  shows.push(() => show(element));
  return element;
}

export function figures(): HTMLElement {
  const element = h("div", { class: "figures" });
  shows.push(() => {
    const { residuals } = model;
    element.classList.toggle("old", !model.fresh);
    if (!residuals) return fill(element);
    if (residuals.lacking) return fill(element, h("p", { class: "lacking" }, residuals.lacking));
    fill(element, ...residuals.figures.map((one) => h("div", { "data-figure": `${one.name} ${one.unit}`.trim() }, h("span", {}, one.name), h("b", {}, one.value === null ? "none" : number(one.value, one.unit)), h("span", { class: "weak" }, one.unit === "deg" ? "°" : one.unit))));
  });
  return element;
}

const number = (value: number, unit: string): string => (unit === "" ? String(value) : Math.abs(value) < 10 ? value.toFixed(2) : value.toFixed(1));

/** A canvas that is drawn with every change, sharp at any pixel ratio. */
export function chart(height: number, draw: (paper: CanvasRenderingContext2D, width: number, height: number) => void, title = ""): HTMLCanvasElement {
  const canvas = h("canvas", { class: "chart", title });
  canvas.style.height = `${height}px`;
  shows.push(() => {
    const width = canvas.clientWidth;
    if (width === 0) return;
    const ratio = Math.min(2, devicePixelRatio);
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    const paper = canvas.getContext("2d")!;
    paper.scale(ratio, ratio);
    paper.font = "10px system-ui, sans-serif";
    draw(paper, width, height);
  });
  return canvas;
}

export function histogram(): HTMLCanvasElement {
  return chart(56, (paper, width, height) => {
    const found = model.residuals?.histogram;
    if (found) bars(paper, found, width, height);
  }, "Residuals: how many lie how far off");
}

function bars(paper: CanvasRenderingContext2D, { limits, counts, unit }: Bars, width: number, height: number): void {
  const most = Math.max(1, ...counts);
  const wide = width / counts.length;
  const floor = height - 13;
  counts.forEach((count, i) => {
    paper.fillStyle = limits[i]! < 0 && limits[i + 1]! > 0 ? "#7cc4ee" : "#56b4e9";
    const tall = (count / most) * (floor - 2);
    paper.fillRect(i * wide + 0.5, floor - tall, wide - 1, tall);
  });
  const zero = (-limits[0]! / (limits[limits.length - 1]! - limits[0]!)) * width;
  paper.strokeStyle = "#d8dee6";
  paper.beginPath();
  paper.moveTo(zero, 0);
  paper.lineTo(zero, floor);
  paper.stroke();
  paper.fillStyle = "#8b98a7";
  paper.textAlign = "left";
  paper.fillText(`${limits[0]!.toFixed(0)}`, 1, height - 2);
  paper.textAlign = "center";
  paper.fillText(`0 ${unit}`, zero, height - 2);
  paper.textAlign = "right";
  paper.fillText(`+${limits[limits.length - 1]!.toFixed(0)}`, width - 1, height - 2);
}

export function notes(): HTMLElement {
  const element = h("div", { class: "notes", "aria-label": "What the data cannot tell" });
  shows.push(() => {
    const rows = [...new Set(model.state?.solved ? model.state.notes : (model.residuals?.notes ?? []))];
    fill(element, model.state?.solved ? h("p", { class: "solved" }, `${model.state.solved}`) : null, ...rows.map((row) => h("p", {}, row)));
  });
  return element;
}

export function progress(): HTMLElement {
  const element = h("div", { class: "job" });
  shows.push(() => {
    const { job, state } = model;
    if (!job) return fill(element, state && !state.ready ? h("span", { class: "weak" }, "the frames are about to be read") : null);
    const left = job.eta_s === null ? "" : ` ${job.eta_s.toFixed(0)} s left`;
    const bar = h("progress", { max: Math.max(1, job.total), value: job.done });
    fill(element, h("span", {}, `${job.message || (state?.ready ? "solving" : "reading the frames")}${left}`), bar, state?.ready ? h("button", { class: "small", onclick: () => run("cancel") }, "Stop") : null);
  });
  return element;
}

export function saving(): HTMLElement {
  const words = h("div", { class: "places" });
  const data = h("button", { class: "main", "data-save": "data", onclick: () => run("save") }, "Save");
  const folder = h("button", { "data-save": "folder", onclick: () => post({ op: "calib.save", id: newId(), to: "folder" }) }, "Save to results");
  const back = h("button", { "data-save": "restore", onclick: () => post({ op: "calib.restore", id: newId() }), title: "Put back, byte for byte, what the last save replaced" }, "Put back");
  shows.push(() => {
    const { state } = model;
    if (!state) return;
    const busy = !state.ready || model.job !== null;
    [data.disabled, folder.disabled, back.disabled] = [busy || state.saves_to.length === 0, busy, busy || !state.restorable];
    data.title = `into ${state.saves_to.join(", ") || "nothing"}; what was there is copied first`;
    folder.title = `into ${state.folder}`;
    const into = state.saves_to.length > 2 ? `${state.saves_to[0]} and ${state.saves_to.length - 1} more` : state.saves_to.join(", ");
    fill(words, state.not_saved ? h("p", { class: "lost" }, state.not_saved) : null, into ? h("p", { class: "weak" }, `saves into ${into}; what was there is copied first`) : null);
  });
  return h("div", { class: "saving" }, h("div", { class: "row" }, data, folder, back), words);
}

export const show = (act: () => void): void => void shows.push(act);
