// The batch wall: one object over many frames, each a top view in the box's own axes; drag any, Enter accepts them all.

import { toBox, fromBox, shifted, type Box, type Vec3 } from "./boxes";
import { cropped, type PointSet } from "./cloud";
import { byId, counted, fill, h } from "./dom";
import { addEditFor, stepping } from "./edits";
import { begin, cancelGesture, end } from "./gestures";
import { show } from "./frames";
import { load, states } from "./loader";
import { run } from "./keys";
import type { BoxRow, FrameState } from "./protocol";
import { newId, send, onReply } from "./socket";
import { boxOf, on, selected, state, titleOf } from "./state";

const TILES = 24;
const WIDE_M = 12;
const HIGH_M = 8;
const COVERED = ["left", "main", "closeups", "right", "cameras", "grip-width"];

interface Tile {
  frame: number;
  canvas: HTMLCanvasElement;
  row: BoxRow | null;
  points: Vec3[];
}

let tiles: Tile[] = [];
let track = -1;
let first = 0;

export const wallOpen = (): boolean => byId("over").classList.contains("wall");

export function openWall(): void {
  const row = selected();
  if (!row || row.track === null) return;
  track = row.track;
  const frames = state.tracks.get(track)?.frames ?? [state.frame];
  const at = Math.max(0, frames.findIndex((frame) => frame >= state.frame));
  first = Math.max(0, Math.min(at - 2, frames.length - TILES));
  build();
  cover(true);
  byId("over").focus();
}

export function closeWall(): void {
  const over = byId("over");
  const focused = over.contains(document.activeElement);
  over.className = "";
  fill(over);
  cover(false);
  if (focused) byId("main").focus();
}

/** What lies under the wall takes neither pointer nor Tab. */
function cover(covered: boolean): void {
  for (const id of COVERED) byId(id).inert = covered;
}

function build(): void {
  const info = state.tracks.get(track);
  const frames = (info?.frames ?? [state.frame]).slice(first, first + TILES);
  const over = byId("over");
  over.className = "wall";
  tiles = frames.map((frame) => ({ frame, row: null, points: [], canvas: h("canvas", { "data-frame": frame, tabIndex: 0, role: "button" }) }));
  for (const tile of tiles) listen(tile);
  const row = selected();
  const size = info?.size ?? row?.box.slice(3, 6) ?? [];
  const page = (by: number) => () => { first = Math.max(0, Math.min(first + by, (info?.frames.length ?? 1) - 1)); build(); };
  fill(over,
    h("div", { class: "top" },
      h("strong", {}, `track ${track} ${titleOf(info?.class_name ?? row?.class_name ?? "")} ${size.map((value) => value.toFixed(2)).join(" × ")}${info?.size_locked ? " (locked)" : ""}`),
      h("span", { class: "weak" }, frames.length > 0 ? `frames ${frames[0]! + 1} to ${frames[frames.length - 1]! + 1}` : ""),
      h("button", { onclick: () => run("propagate.all") }, "Propagate (Shift+P)"), h("button", { onclick: () => run("interpolate") }, "Interpolate (I)"),
      h("button", { class: "main", onclick: acceptAll }, "Accept all (Enter)"), h("button", { onclick: page(-TILES), "aria-label": "earlier frames" }, "‹"), h("button", { onclick: page(TILES), "aria-label": "later frames" }, "›"),
      h("button", { onclick: closeWall }, "Close (Esc)"), h("span", { class: "weak" }, "drag: a keyframe; double click, or Tab and Enter: go there")),
    h("div", { class: "tiles" }, ...tiles.map((tile) => tile.canvas)));
  for (const tile of tiles) fetchTile(tile);
}

function fetchTile(tile: Tile): void {
  const known = states.get(tile.frame);
  if (known) void arrive(tile, known);
  else send({ op: "frame.open", frame: tile.frame, threshold: 0, sweeps: state.sweeps, purpose: "ahead" });
}

onReply("frame.state", (message) => {
  const tile = wallOpen() ? tiles.find((one) => one.frame === message.frame.index) : undefined;
  if (tile) void arrive(tile, message);
});

async function arrive(tile: Tile, found: FrameState): Promise<void> {
  tile.row = found.boxes.find((row) => row.track === track) ?? null;
  if (!tile.row) return draw(tile);
  const layers = found.layers.filter((layer) => layer.kind === "points" && layer.sensor === "lidar" && layer.frame_T_layer === null);
  const sets = await Promise.all(layers.map((layer) => load(tile.frame, layer).catch(() => null)));
  tile.points = [];
  for (const set of sets as (PointSet | null)[]) {
    if (!set) continue;
    const near = cropped(set, [tile.row.box[0]!, tile.row.box[1]!], WIDE_M * 0.75);
    for (let k = 0; k < near.count * 4; k += 4)
      tile.points.push([near.places[k]! * near.scale + near.offset[0], near.places[k + 1]! * near.scale + near.offset[1], near.places[k + 2]! * near.scale + near.offset[2]]);
  }
  draw(tile);
}

/** Distance of a box from where its neighbours in time put it: m. */
function residual(tile: Tile): number | null {
  const at = tiles.indexOf(tile);
  const [before, after] = [tiles[at - 1]?.row, tiles[at + 1]?.row];
  if (!tile.row || !before || !after) return null;
  const part = (tile.frame - tiles[at - 1]!.frame) / Math.max(1, tiles[at + 1]!.frame - tiles[at - 1]!.frame);
  return Math.hypot(...([0, 1] as const).map((i) => tile.row!.box[i]! - before.box[i]! - part * (after.box[i]! - before.box[i]!)));
}

function draw(tile: Tile, shown: Box | null = tile.row && boxOf(tile.row)): void {
  const { canvas, row } = tile;
  const paper = canvas.getContext("2d")!;
  const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, Math.min(2, devicePixelRatio)];
  [canvas.width, canvas.height] = [width * ratio, height * ratio];
  paper.scale(ratio, ratio);
  const scale = width / WIDE_M;
  paper.font = "11px system-ui, sans-serif";
  paper.fillStyle = "#a9b5c2";
  const findings = state.checks.filter((one) => one.frame === tile.frame && one.ignored === null && (one.box === row?.id || one.track === track) && one.severity !== "info");
  canvas.className = `${row?.keyframe ? "key" : ""}${findings.length > 0 ? " bad" : ""}${tile.frame === state.frame ? " now" : ""}`;
  canvas.title = findings.map((one) => one.sentence).join(" ");
  const off = residual(tile);
  paper.fillText(`${tile.frame + 1}${row?.keyframe ? " K" : ""}${row ? ` · ${row.points === null ? "? points" : counted(row.points, "point")}` : " · no box"}${off === null ? "" : ` · ${off.toFixed(2)} m`}${row?.state === "accepted" ? " ✓" : ""}`, 6, 15);
  canvas.ariaLabel = [`frame ${tile.frame + 1}`, row ? row.state : "no box", row?.keyframe ? "keyframe" : "", canvas.title].filter(Boolean).join(", ");
  if (!row || !shown) return;
  const axes = boxOf(row);
  const pixel = (p: Vec3): [number, number] => { const q = toBox(axes, p); return [width / 2 + q[0] * scale, height / 2 - q[1] * scale]; };
  paper.fillStyle = "#7fc6b0";
  for (const p of tile.points) {
    const q = toBox(axes, p);
    if (Math.abs(q[0]) > WIDE_M / 2 || Math.abs(q[1]) > HIGH_M / 2 || Math.abs(q[2]) > axes[5] / 2 + 0.6) continue;
    paper.fillRect(width / 2 + q[0] * scale - 1, height / 2 - q[1] * scale - 1, 2, 2);
  }
  paper.strokeStyle = row.keyframe ? "#56b4e9" : "#ffffff";
  paper.lineWidth = 1.5;
  const outline = ([[1, 1], [1, -1], [-1, -1], [-1, 1]] as const).map(([a, b]) => pixel(fromBox(shown, [(a * shown[3]) / 2, (b * shown[4]) / 2, 0])));
  paper.beginPath();
  outline.forEach(([x, y], i) => (i ? paper.lineTo(x, y) : paper.moveTo(x, y)));
  paper.closePath();
  paper.moveTo(...pixel([shown[0], shown[1], 0]));
  paper.lineTo(...pixel(fromBox(shown, [shown[3] / 2 + 0.7, 0, 0])));
  paper.stroke();
}

function listen(tile: Tile): void {
  let start: { x: number; y: number; pointer: number } | null = null;
  const now = (event: PointerEvent): Box => {
    const scale = tile.canvas.clientWidth / WIDE_M;
    return shifted(boxOf(tile.row!), (event.clientX - start!.x) / scale, -(event.clientY - start!.y) / scale, 0);
  };
  tile.canvas.addEventListener("pointerdown", (event) => {
    if (!tile.row || start || event.button !== 0 || state.mode !== "annotate" || stepping()) return;
    begin(() => { start = null; draw(tile); });
    start = { x: event.clientX, y: event.clientY, pointer: event.pointerId };
    tile.canvas.setPointerCapture(event.pointerId);
  });
  tile.canvas.addEventListener("pointermove", (event) => start?.pointer === event.pointerId && draw(tile, now(event)));
  tile.canvas.addEventListener("pointerup", (event) => {
    if (start?.pointer !== event.pointerId) return;
    end();
    if (tile.row && Math.hypot(event.clientX - start.x, event.clientY - start.y) > 2)
      addEditFor(tile.frame, tile.row, { box: now(event), state: "edited", source: "lidar" });
    start = null;
  });
  for (const lost of ["pointercancel", "lostpointercapture"] as const)
    tile.canvas.addEventListener(lost, (event) => { if (start?.pointer === event.pointerId) cancelGesture(); });
  const go = (): void => { closeWall(); show(tile.frame); };
  tile.canvas.addEventListener("dblclick", go);
  tile.canvas.addEventListener("click", (event) => { if (event.detail === 0) go(); }); // by a key
}

/** Accept every box of the wall: one group, so one undo. */
export function acceptAll(): void {
  if (state.mode !== "annotate" || stepping()) return;
  const group = newId();
  for (const tile of tiles) if (tile.row && tile.row.state !== "accepted" && tile.row.state !== "rejected") addEditFor(tile.frame, tile.row, { state: "accepted" }, group);
}

export function wallPanel(): void {
  window.addEventListener("resize", () => tiles.forEach((tile) => wallOpen() && draw(tile)));
  on("tool", () => { if (wallOpen() && state.mode !== "annotate") closeWall(); });
  on("welcome", () => {
    if (!wallOpen()) return;
    cancelGesture();
    build(); // what it had asked for went with the connection
  });
  on(["boxes", "checks", "tracks"], () => {
    if (!wallOpen()) return;
    const frames = state.tracks.get(track)?.frames.slice(first, first + TILES) ?? [];
    if (frames.join() !== tiles.map((tile) => tile.frame).join()) return build();
    for (const tile of tiles) {
      tile.row = states.get(tile.frame)?.boxes.find((row) => row.track === track) ?? tile.row;
      draw(tile);
    }
  });
}

