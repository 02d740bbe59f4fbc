// LiDAR against camera: the picture with the cloud projected into it, the cloud by direction for picking, pairs, the solvers.

import { ask, changed, drawn, frameNow, giveBack, isRadar, keep, model, move, stateOf } from "./calibmodel";
import { Drawer, type Look, type Places, type Rect } from "./calibgl";
import { button, CAMERA_FIELDS, figures, histogram, lensTable, notes, progress, saving, show, valueRow } from "./calibpanel";
import { byId, clamp, fill, h } from "./dom";
import { begin, cancelGesture, end } from "./gestures";
import { cameraOf, toPixel } from "./lens";
import type { CameraModel, CameraValues, PickRow } from "./protocol";
import { post } from "./post";
import { newId } from "./socket";
import { decode } from "./wire";

const SPLIT = [0.4, 0.72]; // of the height is the picture's, least and most
const NEAR_PX = 14;
const LOOK: Look = { colour: "range", size: 2, low: -1000, reach: 60, row: 0 };

export const picking = { on: false, pixel: null as [number, number] | null, chosen: null as number | null };

let cloud: { frame: number; places: Places } | null = null;
let heights: [number, number] = [-0.3, 0.1]; // elevations between which most of the cloud lies
let picture: { frame: number; image: ImageBitmap } | null = null;
let wanted = "";
let zoom = 0;
let centre: [number, number] = [0, 0];
let points = true;

function rects(): { top: Rect; strip: Rect } {
  const { clientWidth: width, clientHeight: height } = byId("main");
  const start = model.state?.start;
  const tall = start ? (width * start.height_px) / Math.max(1, start.width_px) + 28 : height;
  const split = Math.round(clamp(tall, height * SPLIT[0]!, height * SPLIT[1]!));
  return { top: { x: 0, y: 0, width, height: split }, strip: { x: 0, y: split + 3, width, height: height - split - 3 } };
}

export function camera(): CameraModel | null {
  const values = drawn();
  const start = model.state?.start;
  return values && start && !isRadar(values) ? cameraOf(values, start) : null;
}

/** Scale and place of the picture in its rectangle: a pixel's middle lies at offset + zoom * (u + 0.5). */
function laid(): { zoom: number; offset: [number, number] } {
  const { top } = rects();
  const [width, height] = [model.state?.start?.width_px || 1, model.state?.start?.height_px || 1];
  const least = Math.min(top.width / width, top.height / height);
  if (zoom === 0) centre = [width / 2, height / 2];
  const scale = Math.max(least, zoom);
  const middle = (at: number, size: number, room: number): number => (size * scale <= room ? size / 2 : clamp(at, room / 2 / scale, size - room / 2 / scale));
  centre = [middle(centre[0], width, top.width), middle(centre[1], height, top.height)];
  return { zoom: scale, offset: [top.width / 2 - centre[0] * scale, top.height / 2 - centre[1] * scale] };
}

export function pixelToScreen([u, v]: readonly number[]): [number, number] {
  const { zoom: scale, offset } = laid();
  return [offset[0] + (u! + 0.5) * scale, offset[1] + (v! + 0.5) * scale];
}

function screenToPixel([x, y]: readonly number[]): [number, number] {
  const { zoom: scale, offset } = laid();
  return [(x! - offset[0]) / scale - 0.5, (y! - offset[1]) / scale - 0.5];
}

/** Directions that the strip shows: left, top, right, bottom in radians; about what the camera sees, and a little more. */
function directions(): [number, number, number, number] {
  const found = model.state?.start;
  if (!found) return [0.9, 0.3, -0.9, -0.4];
  const m = found.camera_T_frame;
  const [fx, cx] = [found.matrix[0]!, found.matrix[2]!];
  const ahead = Math.atan2(m[9]!, m[8]!);
  const { strip } = rects();
  const left = ahead + Math.atan2(cx, fx) + 0.06;
  const right = ahead - Math.atan2(found.width_px - cx, fx) - 0.06;
  const tall = ((left - right) * strip.height) / strip.width;
  const [low, high] = heights;
  return [left, high, right, Math.max(low, high - tall)];
}

export function directionToScreen([x, y, z]: readonly number[]): [number, number] {
  const { strip } = rects();
  const [left, top, right, bottom] = directions();
  return [strip.x + ((Math.atan2(y!, x!) - left) / (right - left)) * strip.width, strip.y + ((Math.atan2(z!, Math.hypot(x!, y!)) - top) / (bottom - top)) * strip.height];
}

function span({ rows, count, scale }: Places): [number, number] {
  const found: number[] = [];
  for (let i = 0; i < count; i += Math.max(1, Math.floor(count / 5000))) {
    const [x, y, z] = [rows[i * 4]! * scale, rows[i * 4 + 1]! * scale, rows[i * 4 + 2]! * scale];
    if (Math.hypot(x, y) > 4) found.push(Math.atan2(z, Math.hypot(x, y)));
  }
  found.sort((a, b) => a - b);
  return [(found[0] ?? -0.3) - 0.01, (found[found.length - 1] ?? 0.1) + 0.02];
}

async function loaded(drawer: Drawer): Promise<void> {
  const { state } = model;
  if (!state?.frames.length) return;
  const frame = frameNow();
  if (wanted === String(frame)) return;
  wanted = String(frame);
  const found = await stateOf(frame);
  const image = found.layers.find((layer) => layer.kind === "image" && layer.name === state.sensor);
  const lidar = found.layers.find((layer) => layer.kind === "points" && layer.name === state.lidar);
  const [one, other] = await Promise.all([image && fetch(image.url).then((answer) => answer.blob()).then(createImageBitmap), lidar && fetch(lidar.url).then((answer) => answer.arrayBuffer())]);
  if (wanted !== String(frame)) return;
  if (one) picture = { frame, image: one };
  if (other) {
    drawer.forget(cloud?.places ?? null);
    cloud = { frame, places: drawer.upload(decode(other)) };
    heights = span(cloud.places);
  }
  changed();
}

function draw(drawer: Drawer): void {
  under();
  drawer.clear();
  const lens = camera();
  const { top, strip } = rects();
  if (cloud && lens) {
    const { zoom: scale, offset } = laid();
    const look = model.blink ? { ...LOOK, colour: [1, 0.4, 0.35, 0.9] as [number, number, number, number] } : LOOK;
    if (points) drawer.camera(top, cloud.places, { ...look, size: clamp(1.6 * scale, 1.5, 5) }, lens, scale, offset);
  }
  if (cloud) drawer.sphere(strip, cloud.places, { ...LOOK, size: 2.4 }, directions());
  lines(lens);
}

function under(): void {
  const canvas = byId("under") as HTMLCanvasElement;
  [canvas.width, canvas.height] = [canvas.clientWidth, canvas.clientHeight];
  const paper = canvas.getContext("2d")!;
  const { top, strip } = rects();
  paper.fillStyle = "#0a0d11";
  paper.fillRect(0, 0, canvas.width, canvas.height);
  if (picture) {
    const { zoom: scale, offset } = laid();
    paper.save();
    paper.beginPath();
    paper.rect(top.x, top.y, top.width, top.height);
    paper.clip();
    paper.imageSmoothingEnabled = scale < 3;
    paper.drawImage(picture.image, offset[0], offset[1], picture.image.width * scale, picture.image.height * scale);
    paper.restore();
  }
  paper.fillStyle = "#2a323c";
  paper.fillRect(0, strip.y - 3, canvas.width, 3);
}

function lines(lens: CameraModel | null): void {
  const canvas = byId("lines") as HTMLCanvasElement;
  [canvas.width, canvas.height] = [canvas.clientWidth, canvas.clientHeight];
  const paper = canvas.getContext("2d")!;
  paper.font = "11px system-ui, sans-serif";
  const { strip, top } = rects();
  const caption = "the cloud as the LiDAR sees it: near is bright";
  paper.fillStyle = "rgba(8, 11, 15, 0.8)";
  paper.fillRect(4, strip.y + strip.height - 20, paper.measureText(caption).width + 8, 18);
  paper.fillStyle = "#a9b5c2";
  paper.fillText(caption, 8, strip.y + strip.height - 7);
  for (const pick of model.state?.picks ?? []) if (pick.frame === frameNow()) drawPick(paper, pick, lens, top);
  if (picking.pixel) cross(paper, pixelToScreen(picking.pixel), "#7fffd4", 9);
}

function drawPick(paper: CanvasRenderingContext2D, pick: PickRow, lens: CameraModel | null, top: Rect): void {
  const colour = !pick.used ? "#8b98a7" : (pick.residual_px ?? 99) > 8 ? "#ff6b5e" : "#7fffd4";
  const at = pixelToScreen(pick.pixel);
  cross(paper, at, colour, pick.pick === picking.chosen ? 9 : 6);
  const seen = lens && toPixel(lens, pick.point_m);
  if (seen) {
    const to = pixelToScreen(seen);
    paper.strokeStyle = colour;
    paper.beginPath();
    paper.moveTo(...at);
    paper.lineTo(...to);
    paper.stroke();
    if (to[1] < top.height) ring(paper, to, colour, 4);
  }
  paper.fillStyle = colour;
  paper.fillText(String(pick.pick), at[0] + 7, at[1] - 6);
  const below = directionToScreen(pick.point_m);
  ring(paper, below, colour, pick.pick === picking.chosen ? 7 : 5);
  paper.fillText(String(pick.pick), below[0] + 7, below[1] - 4);
}

function cross(paper: CanvasRenderingContext2D, [x, y]: [number, number], colour: string, size: number): void {
  paper.strokeStyle = colour;
  paper.lineWidth = 1.5;
  paper.beginPath();
  paper.moveTo(x - size, y);
  paper.lineTo(x + size, y);
  paper.moveTo(x, y - size);
  paper.lineTo(x, y + size);
  paper.stroke();
}

function ring(paper: CanvasRenderingContext2D, [x, y]: [number, number], colour: string, radius: number): void {
  paper.strokeStyle = colour;
  paper.lineWidth = 1.5;
  paper.beginPath();
  paper.arc(x, y, radius, 0, 2 * Math.PI);
  paper.stroke();
}

/** The point of the cloud nearest to a place of the screen, in the strip or among those projected into the picture. */
function pointAt(at: readonly number[]): [number, number, number] | null {
  const lens = camera();
  if (!cloud || !lens) return null;
  const { strip } = rects();
  const inStrip = at[1]! > strip.y;
  const { rows, count, scale } = cloud.places;
  let best: [number, number, number] | null = null;
  let least = NEAR_PX;
  for (let i = 0; i < count; i += 1) {
    const p: [number, number, number] = [rows[i * 4]! * scale, rows[i * 4 + 1]! * scale, rows[i * 4 + 2]! * scale];
    const seen = inStrip ? null : toPixel(lens, p);
    if (!inStrip && !seen) continue;
    const [x, y] = inStrip ? directionToScreen(p) : pixelToScreen(seen!);
    const away = Math.hypot(x - at[0]!, y - at[1]!);
    if (away < least) [least, best] = [away, p];
  }
  return best;
}

function clicked(at: [number, number]): void {
  const { top } = rects();
  if (!picking.on || !model.state?.ready || model.job) return;
  if (!picking.pixel) {
    const pixel = screenToPixel(at);
    const { width_px: width, height_px: height } = model.state.start!;
    if (at[1] < top.height && pixel[0] > -0.5 && pixel[1] > -0.5 && pixel[0] < width && pixel[1] < height) picking.pixel = pixel;
  } else {
    const point = pointAt(at);
    if (point) {
      post({ op: "calib.pick", id: newId(), frame: frameNow(), point_m: point, pixel: picking.pixel });
      picking.pixel = null;
    }
  }
  changed();
}

/** A click picks; a drag in the picture moves what is seen of it, the wheel enlarges; with Ctrl a drag turns the camera. */
function listen(main: HTMLElement): void {
  let start: [number, number] | null = null;
  let last: [number, number] = [0, 0];
  let turns = false;
  const here = (event: PointerEvent | WheelEvent): [number, number] => {
    const box = main.getBoundingClientRect();
    return [event.clientX - box.x, event.clientY - box.y];
  };
  main.addEventListener("contextmenu", (event) => event.preventDefault());
  main.addEventListener("pointerdown", (event) => {
    start = last = here(event);
    turns = (event.ctrlKey || event.metaKey) && !!model.state?.ready && !model.job;
    const before = model.values;
    if (turns) begin(() => { start = null; giveBack(before); });
    main.setPointerCapture(event.pointerId);
  });
  main.addEventListener("pointermove", (event) => {
    if (!start) return;
    const now = here(event);
    const { zoom: scale } = laid();
    const [across, down] = [now[0] - last[0], now[1] - last[1]];
    last = now;
    const { values } = model;
    if (turns && values && !isRadar(values)) move(turnedBy(values, across / scale, down / scale));
    else if (!turns && Math.hypot(now[0] - start[0], now[1] - start[1]) > 4) {
      if (zoom === 0) zoom = scale;
      centre = [centre[0] - across / scale, centre[1] - down / scale];
      changed();
    }
  });
  main.addEventListener("pointercancel", () => { cancelGesture(); start = null; });
  main.addEventListener("pointerup", (event) => {
    end();
    const at = here(event);
    if (start && turns && model.moving && model.values) keep(model.values);
    else if (start && event.button === 0 && Math.hypot(at[0] - start[0], at[1] - start[1]) <= 4) clicked(at);
    start = null;
  });
  main.addEventListener("wheel", (event) => {
    event.preventDefault();
    const at = here(event);
    if (at[1] > rects().top.height) return;
    const before = screenToPixel(at);
    const now = laid().zoom;
    zoom = clamp(now * Math.exp(-event.deltaY / 500), 0.05, 16);
    const after = screenToPixel(at);
    centre = [centre[0] + before[0] - after[0], centre[1] + before[1] - after[1]];
    changed();
  }, { passive: false });
}

/** Turn so that what is projected moves by so many pixels. */
const turnedBy = (values: CameraValues, across: number, down: number): CameraValues => {
  const moved = [...values.moved];
  moved[1]! += across / values.fx;
  moved[0]! -= down / values.fy;
  return { ...values, moved };
};

function pairsTable(): HTMLElement {
  const element = h("div", { class: "pairs" });
  show(() => {
    const rows = model.state?.picks ?? [];
    const body = rows.map((row) => h("tr", { class: row.pick === picking.chosen ? "chosen" : row.used ? "" : "out", "data-pick": String(row.pick), onclick: () => { picking.chosen = row.pick; changed(); } },
      h("td", {}, h("input", { type: "checkbox", checked: row.used, title: "counts", "aria-label": `pair ${row.pick} counts`, onchange: (event: Event) => post({ op: "calib.unpick", id: newId(), pick: row.pick, used: (event.target as HTMLInputElement).checked }) })),
      h("td", {}, row.pick), h("td", {}, `${row.pixel[0]!.toFixed(0)}, ${row.pixel[1]!.toFixed(0)}`), h("td", {}, `${row.range_m.toFixed(1)} m`),
      h("td", { class: (row.residual_px ?? 99) > 8 ? "far" : "" }, row.residual_px === null ? "behind" : `${row.residual_px.toFixed(1)} px`),
      h("td", {}, h("button", { class: "quiet small", title: "Remove (Delete)", onclick: () => post({ op: "calib.unpick", id: newId(), pick: row.pick }) }, "×"))));
    fill(element, rows.length ? h("table", {}, h("tr", {}, ...["counts", "pair", "pixel", "range", "off", "remove"].map((name) => h("th", { class: ["counts", "pair", "remove"].includes(name) ? "unseen" : "" }, h("span", {}, name)))), ...body) : h("p", { class: "weak" }, "Pick (N): a pixel of the picture, then its point in the cloud or among those drawn. Six pairs solve; spread them over the picture and over ranges."));
  });
  return element;
}

let focal = false;

export const solvePairs = (): void => void post({ op: "calib.solve", id: newId(), how: "pairs", focal });
export const togglePoints = (): void => { points = !points; changed(); };

export function cameraPage(): Drawer {
  const main = byId("main");
  const drawer = new Drawer(byId("gl") as HTMLCanvasElement);
  const busy = (): boolean => !model.state?.ready || model.job !== null;
  const used = (): number => (model.state?.picks ?? []).filter((row) => row.used).length;
  fill(byId("right"),
    h("h2", {}, "camera: turns and shifts from its start"),
    ...CAMERA_FIELDS.map(valueRow), lensTable(),
    h("div", { class: "row" },
      button("Pick", "calib.pick", (one) => { one.disabled = busy(); one.classList.toggle("on", picking.on); }),
      button("Solve pairs", "calib.pairs", (one) => { one.disabled = busy() || used() < (focal ? 12 : 6); one.title = focal ? "takes 12 pairs" : "takes 6 pairs"; }, "main"),
      h("label", { title: "solve for the focal length too: takes 12 pairs" }, h("input", { type: "checkbox", name: "focal", onchange: (event: Event) => { focal = (event.target as HTMLInputElement).checked; changed(); } }), "focal"),
      button("Align edges", "calib.refine", (one) => (one.disabled = busy()), "main"),
    ),
    h("div", { class: "row" },
      button("Undo", "undo", (one) => (one.disabled = !model.state?.undo || model.job !== null)),
      button("Redo", "redo", (one) => (one.disabled = !model.state?.redo || model.job !== null)),
      button("Before", "calib.blink", (one) => { one.classList.toggle("on", model.blink); one.textContent = model.blink ? "After" : "Before"; }),
    ),
    progress(), h("h2", {}, "residual: across the edges of the picture"), figures(), histogram(),
    h("h2", {}, "picked pairs"), pairsTable(), h("h2", {}, "what the data cannot tell"), notes(), saving());
  show(() => {
    draw(drawer);
    void loaded(drawer);
    const words = !picking.on ? "" : picking.pixel ? "now its point: in the cloud below, or among those drawn" : "click a pixel of the picture; Esc ends";
    fill(byId("hint"), words);
    main.classList.toggle("picking", picking.on);
    fill(byId("corner"), model.blink ? "BEFORE: as it was at the start" : "");
  });
  listen(main);
  new ResizeObserver(() => changed()).observe(main);
  ask();
  return drawer;
}

export const cameraLoaded = (): boolean => cloud?.frame === frameNow() && picture?.frame === frameNow();
/** The point of the cloud nearest to a given one: what a click on it picks. */
export const nearestPoint = (to: readonly number[]): number[] | null => {
  if (!cloud) return null;
  const { rows, count, scale } = cloud.places;
  let [best, least] = [null as number[] | null, Infinity];
  for (let i = 0; i < count; i += 1) {
    const p = [rows[i * 4]! * scale, rows[i * 4 + 1]! * scale, rows[i * 4 + 2]! * scale];
    const away = Math.hypot(p[0]! - to[0]!, p[1]! - to[1]!, p[2]! - to[2]!);
    if (away < least) [best, least] = [p, away];
  }
  return best;
};

/** Some points that the picture shows, far apart in it, with their pixels. */
export const spread = (most: number): [number[], number[]][] => {
  const lens = camera();
  if (!cloud || !lens) return [];
  const { rows, count, scale } = cloud.places;
  const out: [number[], number[]][] = [];
  for (let i = 0; i < count && out.length < most; i += 7) {
    const p = [rows[i * 4]! * scale, rows[i * 4 + 1]! * scale, rows[i * 4 + 2]! * scale];
    const seen = toPixel(lens, p);
    if (!seen || seen[2] > 40 || p[2]! < -1 || seen[0] < 40 || seen[1] < 20 || seen[0] > lens.width_px - 40 || seen[1] > lens.height_px - 20) continue;
    if (out.every(([, pixel]) => Math.hypot(pixel[0]! - seen[0], pixel[1]! - seen[1]) > lens.width_px / (most + 2))) out.push([p, [seen[0], seen[1]]]);
  }
  return out;
};
