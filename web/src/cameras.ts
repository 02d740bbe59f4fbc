// Camera pictures below the main view, with the points and boxes projected into them.

import { corners, EDGES } from "./boxes";
import type { PointSet } from "./cloud";
import { sample } from "./colours";
import { byId, fill, h } from "./dom";
import { toPixel } from "./lens";
import { load, standing } from "./loader";
import type { CameraModel, Layer } from "./protocol";
import type { Stage } from "./stage";
import type { Numbers } from "./wire";
import { boxOf, colourOf, lookOf, on, shownBoxes, shownPredictions, state } from "./state";

const POINTS = 5000; // drawn at most in a picture

interface Strip {
  layer: Layer;
  canvas: HTMLCanvasElement;
  picture: ImageBitmap;
}

let strips: Strip[] = [];
const options = { points: true, boxes: true, big: "" };

export function camerasPanel(stage: Stage): void {
  on("frame", () => void rebuild(stage));
  on(["boxes", "selection", "filters"], () => strips.forEach((strip) => draw(stage, strip)));
  on("looks", () => void rebuild(stage));
}

/** The enlarged picture is asked for as the file has it; the others may come as JPEG. */
function asked(layer: Layer): Layer {
  return options.big === layer.name && !standing() ? { ...layer, url: `${layer.url}?exact=1` } : layer;
}

async function rebuild(stage: Stage): Promise<void> {
  const frame = state.shown;
  const layers = (frame?.layers ?? []).filter((layer) => layer.kind === "image" && lookOf(layer.name, layer.kind).visible);
  if (layers.length === 0) {
    strips = [];
    fill(byId("cameras"));
    return;
  }
  const found = await Promise.allSettled(layers.map(async (layer) => ({ layer, picture: (await load(frame!.frame.index, asked(layer))) as ImageBitmap })));
  if (state.shown !== frame) return;
  strips = found.flatMap((one) => (one.status === "fulfilled" ? [{ ...one.value, canvas: h("canvas", { width: one.value.picture.width, height: one.value.picture.height }) }] : []));
  const before = byId("cameras").childElementCount;
  fill(byId("cameras"), ...strips.map((strip) => frameOf(stage, strip)));
  for (const strip of strips) draw(stage, strip);
  if (before !== strips.length) stage.request("all");
}

function frameOf(stage: Stage, strip: Strip): HTMLElement {
  const { layer, canvas } = strip;
  const lag = layer.lag_ms ? ` ${layer.lag_ms > 0 ? "+" : ""}${layer.lag_ms.toFixed(0)} ms` : "";
  const missing = layer.camera ? "" : " · no calibration: points and boxes are not drawn";
  const big = options.big === layer.name;
  Object.assign(canvas, { tabIndex: 0, role: "button", ariaLabel: `${layer.title}: ${big ? "smaller" : "larger"}` });
  canvas.style.aspectRatio = `${canvas.width} / ${canvas.height}`;
  const element = h("div", { class: `camera${big ? " big" : ""}`, "data-camera": layer.name, title: "click: larger; double click: points on or off" }, canvas, h("span", {}, `${layer.title}${lag}${missing}`));
  canvas.addEventListener("click", () => {
    options.big = big ? "" : layer.name;
    element.classList.toggle("big");
    void rebuild(stage);
    stage.request("all");
  });
  canvas.addEventListener("dblclick", () => { options.points = !options.points; strips.forEach((one) => draw(stage, one)); });
  return element;
}

function draw(stage: Stage, { layer, canvas, picture }: Strip): void {
  const paper = canvas.getContext("2d")!;
  paper.drawImage(picture, 0, 0);
  if (!layer.camera) return;
  const scale = Math.max(0.5, canvas.width / Math.max(200, canvas.getBoundingClientRect().width || 440));
  if (options.points) for (const { object, layer: cloud } of stage.clouds.values()) if (stage.inPane(cloud.name, cloud, 0)) points(paper, layer.camera, object.set, cloud, scale);
  if (state.showTruth) for (const row of shownBoxes()) box(paper, layer.camera, boxOf(row), row.id === state.selection ? "#ffffff" : colourOf(row.class_name), scale, []);
  for (const { set, rows } of shownPredictions(0)) for (const row of rows) box(paper, layer.camera, boxOf(row), set?.colour ?? "#e69f00", scale, [6 * scale, 4 * scale]);
}

function points(paper: CanvasRenderingContext2D, camera: CameraModel, set: PointSet, layer: Layer, scale: number): void {
  if (layer.frame_T_layer) return;
  const size = (layer.sensor === "radar" ? 3 : 1.2) * scale;
  let drawn = 0;
  const power = layer.sensor === "radar" && set.count > 5000 ? set.values.get("power_db")?.rows : undefined;
  const least = power ? quantile(power, 0.97) : 0;
  for (let i = 0, k = 0; i < set.count && drawn < POINTS; i += 1, k += 4) {
    if (power && power[i]! < least) continue;
    const at = toPixel(camera, [set.places[k]! * set.scale + set.offset[0], set.places[k + 1]! * set.scale + set.offset[1], set.places[k + 2]! * set.scale + set.offset[2]]);
    if (!at || at[0] < 0 || at[1] < 0 || at[0] > paper.canvas.width || at[1] > paper.canvas.height) continue;
    drawn += 1;
    const [r, g, b] = sample("viridis", 1 - at[2] / 70);
    paper.fillStyle = `rgba(${r | 0}, ${g | 0}, ${b | 0}, 0.8)`;
    paper.fillRect(at[0] - size / 2, at[1] - size / 2, size, size);
  }
}

function quantile(values: Numbers, part: number): number {
  return Float64Array.from(values.subarray(0, 4000)).sort()[Math.floor(part * Math.min(4000, values.length - 1))] ?? 0;
}

function box(paper: CanvasRenderingContext2D, camera: CameraModel, numbers: ReturnType<typeof boxOf>, colour: string, scale: number, dash: number[]): void {
  const eight = corners(numbers).map((corner) => toPixel(camera, corner));
  paper.strokeStyle = colour;
  paper.lineWidth = 1.6 * scale;
  paper.setLineDash(dash);
  paper.beginPath();
  for (const [i, j] of EDGES) {
    const [a, b] = [eight[i], eight[j]];
    if (!a || !b) continue;
    paper.moveTo(a[0], a[1]);
    paper.lineTo(b[0], b[1]);
  }
  paper.stroke();
  paper.setLineDash([]);
}
