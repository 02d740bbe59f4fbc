// Four views of the selected box: from above, from its right, from behind, and as the radar sees it; only points within 8 m.
// Edges are dragged, the middle moves the box, in the top view the heading's handle turns it. Beside the box a drag moves the view, the wheel zooms.

import type { Mesh } from "three";
import { faceMoved, finite, fromBox, same, shifted, toBox, turned, type Box, type Vec3 } from "./boxes";
import { drawEchoes, groundLine, scales } from "./closedraw";
import { closeSizes, largeNow, setLarge, showLarge } from "./closesizes";
import { CloseViews, directions, NAMES, VIEWS, viewBox, type Name } from "./closeviews";
import { CloudObject, cropped, type Look, type PointSet } from "./cloud";
import { byId, clamp, fill, h } from "./dom";
import { mayEdit, previewBox, setBox } from "./edits";
import type { Rect } from "./eye";
import { begin, cancelGesture, end } from "./gestures";
import { bind } from "./keys";
import { load, ready } from "./loader";
import { strokeBox } from "./overlay";
import { Projector } from "./project";
import type { BoxRow, Layer } from "./protocol";
import { blockAt, originOf, radarLayer, type Echo, type RadarBlock } from "./radarblock";
import { RadarSlice } from "./radarslice";
import { remember, remembered } from "./settings";
import { place, type SmallView, type Stage } from "./stage";
import { boxOf, colourOf, lookOf, on, selected, shownFrame, state } from "./state";

const REACH_M = 8;
const BESIDE_M = 1; // so far before and behind the box power and echoes are shown
const MOST_GATE_M = 30;
const GRAB_PX = 9;

type Part = { kind: "move" } | { kind: "turn" } | { kind: "face"; axis: 0 | 1 | 2; side: 1 | -1 };

export class CloseUps {
  private clouds: { object: CloudObject; set: PointSet; layer: Layer }[] = [];
  private cutAt: [number, number] | null = null;
  private object = ""; // whose views these are
  private anchor: Box | null = null; // the axes of the views: they stay while a box is dragged
  private block: RadarBlock | null = null;
  private over: Name | null = null;
  private gate = remembered("radar gate", BESIDE_M, (value) => typeof value === "number" && value >= 0 && value <= MOST_GATE_M);
  private readonly views = new CloseViews();
  private readonly slices = Object.fromEntries(NAMES.map((name) => [name, new RadarSlice(name)])) as Record<Name, RadarSlice>;

  constructor(private readonly stage: Stage) {
    for (const name of NAMES) this.listen(name);
    this.gateField();
    closeSizes((name) => { this.views.reset(name); stage.request("close"); }, () => stage.request("all"));
    bind("close.large", () => {
      const now = largeNow();
      setLarge(now === "all" && this.over ? this.over : now ? "" : (this.over ?? "all"));
    });
    new ResizeObserver(() => stage.request("all")).observe(byId("closeups"));
    const sized = new ResizeObserver(() => stage.request("close"));
    for (const name of NAMES) sized.observe(this.element(name));
    byId("closeups").addEventListener("scroll", () => stage.request("close"));
    on(["selection", "boxes", "frame", "looks", "filters"], () => this.refresh());
    stage.smallViews = () => this.pictures();
    stage.covered = () => largeNow() !== "";
  }

  private element = (name: Name): HTMLElement => byId(`close-${name}`);

  private rect(name: Name): Rect {
    const { x, y, width, height } = this.element(name).getBoundingClientRect();
    return { x, y, width, height };
  }

  /** What of a view's rectangle is on the screen: the close-ups are scrolled where they are higher than their room. */
  private seen(rect: Rect): Rect {
    const room = byId("closeups").getBoundingClientRect();
    const [x, y] = [Math.max(rect.x, room.x), Math.max(rect.y, room.y)];
    return { x, y, width: Math.min(rect.x + rect.width, room.right) - x, height: Math.min(rect.y + rect.height, room.bottom) - y };
  }

  /** The views of which something is on the screen. */
  private onScreen(): { name: Name; rect: Rect; seen: Rect }[] {
    return NAMES.map((name) => ({ name, rect: this.rect(name) })).map(({ name, rect }) => ({ name, rect, seen: this.seen(rect) })).filter(({ seen }) => seen.width >= 2 && seen.height >= 2);
  }

  private box(name: Name, box: Box): Box {
    const layer = radarLayer();
    return viewBox(name, box, layer ? originOf(layer) : [0, 0, 0]);
  }

  /** Cut the points near the selection anew if it moved out of the old cut or the frame changed. */
  refresh(): void {
    const row = selected();
    const source = row ? this.sources() : [];
    const stale = source.length !== this.clouds.length || source.some(({ set }, i) => this.clouds[i]!.set !== set);
    const far = row && this.cutAt ? Math.hypot(row.box[0]! - this.cutAt[0], row.box[1]! - this.cutAt[1]) > 2 : true;
    if (stale || far || !row) this.cut(row, source);
    this.clouds.forEach(({ object, set, layer }, i) => {
      object.show(this.look(layer, set, i));
      object.points.visible = !this.stage.clouds.has(layer.name) || this.stage.inPane(layer.name, layer, 0);
    });
    if (this.dragging && row?.id !== this.dragging.row.id) cancelGesture(); // another box is selected, or this one is gone
    const object = row ? `${row.track ?? row.id}` : "";
    if (object !== this.object) this.views.centre();
    this.object = object;
    if (row && !this.dragging) this.anchor = boxOf(row);
    if (!row) this.anchor = null;
    this.block = row && this.radarShown() ? blockAt(this.anchor!, () => this.refresh()) : null;
    byId("close-radar").hidden = !radarLayer();
    byId("closeups").classList.toggle("empty", !row);
    showLarge();
    this.stage.request(this.dragging ? "lines" : "close");
  }

  private radarShown(): boolean {
    const map = state.shown?.layers.find((layer) => layer.kind === "bev");
    return map !== undefined && lookOf(map.name, map.kind).visible;
  }

  /** The clouds of the main view, and the radar's points, which that leaves out where it draws the radar's map. */
  private sources(): { layer: Layer; set: PointSet }[] {
    const out = [...this.stage.clouds.values()].map(({ layer, object }) => ({ layer, set: object.set }));
    for (const layer of state.shown?.layers ?? []) {
      if (layer.kind !== "points" || layer.sensor !== "radar" || this.stage.clouds.has(layer.name) || !this.radarShown()) continue;
      const set = ready(layer) as PointSet | null;
      if (set) out.push({ layer, set });
      else load(shownFrame(), layer).then(() => this.refresh(), () => undefined);
    }
    return out;
  }

  private look(layer: Layer, set: PointSet, row: number): Look {
    const look = { ...this.stage.look(layer.name, layer, row, set), size: 2, grow: 0, opacity: 1 };
    if (layer.sensor !== "radar") return look;
    const mode = [state.colour, "doppler_m_s", "power_db", "rcs_dbsm"].find((name) => set.values.has(name)) ?? look.mode;
    return { ...look, mode, window: mode === state.colour ? state.window : null, size: largeNow() ? 5 : 3, gate: null };
  }

  private cut(row: BoxRow | null, sources: { layer: Layer; set: PointSet }[]): void {
    for (const { object } of this.clouds) object.dispose();
    this.clouds = [];
    this.cutAt = row ? [row.box[0]!, row.box[1]!] : null;
    if (!row) return;
    const reach = Math.max(REACH_M, Math.hypot(row.box[3]!, row.box[4]!) / 2 + 4) + 2;
    this.clouds = sources.map(({ layer, set }) => {
      const object = new CloudObject(cropped(set, inLayer(layer, this.cutAt!), reach));
      place(object.points, layer);
      return { object, set, layer };
    });
  }

  /** How far before and behind the middle of the box a view shows power and echoes. */
  private depth(name: Name, box: Box): number {
    const along = name === "top" ? box[5] : name === "side" ? box[4] : box[3];
    return along / 2 + (name === "radar" ? this.gate : BESIDE_M);
  }

  private under(name: Name, box: Box): Mesh | null {
    const map = state.shown?.layers.find((layer) => layer.kind === "bev");
    return this.block && map ? this.slices[name].show(this.block, box, this.depth(name, box), lookOf(map.name, map.kind).opacity) : null;
  }

  private pictures(): SmallView[] {
    const { anchor } = this;
    return this.onScreen().map(({ name, rect, seen }) => {
      const box = this.box(name, anchor ?? [0, 0, 0, 4, 2, 2, 0]);
      return { rect, seen, camera: this.views.camera(name, box, rect), clouds: anchor ? this.clouds.map(({ object }) => object) : [], under: anchor ? this.under(name, box) : null };
    });
  }

  projector(name: Name): Projector {
    const rect = this.rect(name);
    return new Projector(this.views.camera(name, this.box(name, this.anchor ?? [0, 0, 0, 4, 2, 2, 0]), rect), rect);
  }

  drawLines(paper: CanvasRenderingContext2D): void {
    const row = selected();
    if (!row || !this.anchor) return;
    for (const { name, rect, seen } of this.onScreen()) {
      const view = this.projector(name);
      const box = this.box(name, this.anchor);
      paper.save();
      paper.beginPath();
      paper.rect(seen.x, seen.y, seen.width, seen.height);
      paper.clip();
      scales(paper, name, rect, box, this.views.looks[name].pan, this.views.metresPerPixel(name, box, rect));
      if (this.block && this.block.ground !== null && name !== "top") groundLine(paper, rect, view, box, this.block.ground);
      for (const other of state.boxes)
        if (other.id !== row.id && Math.hypot(other.box[0]! - row.box[0]!, other.box[1]! - row.box[1]!) < 15)
          strokeBox(paper, view, boxOf(other), { colour: colourOf(other.class_name), width: 1, dash: [] });
      if (this.block) drawEchoes(paper, view, this.near(name, box));
      strokeBox(paper, view, this.box(name, boxOf(row)), { colour: "#ffffff", width: 1.5, dash: [] });
      if (row.proposal) strokeBox(paper, view, row.proposal as unknown as Box, { colour: "#e69f00", width: 1, dash: [5, 4] });
      if (state.mode === "annotate") this.handles(paper, name, view, boxOf(row));
      paper.restore();
    }
    this.caption(row);
  }

  /** The echoes that a view shows: between its depths. */
  private near(name: Name, box: Box): Echo[] {
    const { ahead } = directions(name, box[6]);
    const depth = this.depth(name, box);
    return (this.block?.echoes ?? []).filter(({ at }) => Math.abs(at.reduce((sum, value, i) => sum + (value - box[i]!) * ahead[i]!, 0)) <= depth);
  }

  /** What the radar's view shows: its range gate, and the strongest echo on the box. */
  private caption(row: BoxRow): void {
    const layer = radarLayer();
    if (!layer) return;
    const box = this.box("radar", boxOf(row));
    const eye = originOf(layer);
    const range = Math.hypot(box[0] - eye[0], box[1] - eye[1]);
    const depth = this.depth("radar", box);
    const on_it = this.near("radar", box).find(({ at }) => Math.abs(toBox(box, at)[1]) < box[4] / 2 + 1.5);
    const echo = on_it ? ` · echo ${on_it.over_db.toFixed(0)} dB${on_it.doppler_m_s === null ? "" : ` ${on_it.doppler_m_s.toFixed(1)} m/s`}` : "";
    const text = `RADAR ${Math.max(0, range - depth).toFixed(1)} to ${(range + depth).toFixed(1)} m${echo}`;
    const title = this.element("radar").querySelector("span")!;
    if (title.textContent !== text) fill(title, text);
  }

  private gateField(): void {
    const field = h("input", {
      type: "number", name: "gate", min: 0, max: MOST_GATE_M, step: 0.5, value: this.gate, title: "how far before and behind the box the radar's power is shown, metres", "aria-label": "range gate: metres before and behind the box",
      onchange: () => {
        this.gate = clamp(Number.isFinite(Number(field.value)) && field.value !== "" ? Number(field.value) : this.gate, 0, MOST_GATE_M);
        field.value = String(this.gate);
        remember("radar gate", this.gate);
        this.stage.request("close");
      },
    });
    this.element("radar").append(h("label", { class: "gate" }, "±", field, "m"));
  }

  private handles(paper: CanvasRenderingContext2D, name: Name, view: Projector, box: Box): void {
    paper.fillStyle = "#ffffff";
    for (const { at } of this.parts(name, box)) {
      const p = view.point(at);
      if (p) paper.fillRect(p[0] - 3, p[1] - 3, 6, 6);
    }
  }

  /** The faces that are moved in a view: from the radar only bottom and top, for its box is not the object's. */
  private axes(name: Name): (0 | 1 | 2)[] {
    return name === "radar" ? [2] : [VIEWS[name].right, VIEWS[name].up];
  }

  private parts(name: Name, box: Box): { part: Part; at: Vec3 }[] {
    const seen = this.box(name, box);
    const out: { part: Part; at: Vec3 }[] = [];
    for (const axis of this.axes(name))
      for (const side of [1, -1] as const) {
        const local: Vec3 = [0, 0, 0];
        local[axis] = (side * seen[3 + axis]!) / 2;
        out.push({ part: { kind: "face", axis, side }, at: fromBox(seen, local) });
      }
    if (name === "top") out.push({ part: { kind: "turn" }, at: fromBox(box, [box[3] / 2 + 0.8, 0, 0]) });
    return out;
  }

  /** What is grabbed at a pixel: a turning handle, the nearest edge, or the middle. */
  private grabbed(name: Name, box: Box, x: number, y: number): Part | null {
    const view = this.projector(name);
    const turn = this.parts(name, box).find(({ part }) => part.kind === "turn");
    const handle = turn && view.point(turn.at);
    if (handle && Math.hypot(handle[0] - x, handle[1] - y) < GRAB_PX) return { kind: "turn" };
    const seen = this.box(name, box);
    const at = this.local(name, box, x, y);
    const { right, up } = VIEWS[name];
    const scale = this.views.metresPerPixel(name, this.box(name, this.anchor!), this.rect(name)) * GRAB_PX;
    let best: { part: Part; away: number } | null = null;
    for (const axis of this.axes(name))
      for (const side of [1, -1] as const) {
        const other = axis === right ? up : right;
        const away = Math.abs(at[axis]! - (side * seen[3 + axis]!) / 2);
        if (away < scale && Math.abs(at[other]!) < seen[3 + other]! / 2 + scale && away < (best?.away ?? scale)) best = { part: { kind: "face", axis, side }, away };
      }
    if (best) return best.part;
    return [right, up].every((axis) => Math.abs(at[axis]!) < seen[3 + axis]! / 2) ? { kind: "move" } : null;
  }

  /** The pixel in the axes of the box as the view has it (the one along the view is 0). */
  private local(name: Name, box: Box, x: number, y: number): Vec3 {
    const { from } = this.projector(name).ray(x, y);
    const at = toBox(this.box(name, box), from);
    const depth = VIEWS[name].from.findIndex((part) => part !== 0);
    at[depth] = 0;
    return at;
  }

  private dragging: { name: Name; part: Part; start: Box; at: Vec3; row: BoxRow; pointer: number } | null = null; // by one finger: others do nothing meanwhile
  private panning: { name: Name; x: number; y: number; pan: [number, number]; scale: number; pointer: number } | null = null;

  private listen(name: Name): void {
    const element = this.element(name);
    element.addEventListener("pointerenter", () => (this.over = name));
    element.addEventListener("pointerleave", () => { if (this.over === name) this.over = null; });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("pointerdown", (event) => {
      if (event.target !== element) return; // a button, a field or an edge that sizes the view
      const row = selected();
      if (!row || !this.anchor || this.dragging || this.panning) return;
      const start = boxOf(row);
      const part = state.mode === "annotate" && event.button === 0 && !event.shiftKey ? this.grabbed(name, start, event.clientX, event.clientY) : null;
      if (part && !mayEdit()) return;
      begin(() => this.giveUp(element, event.pointerId));
      const pointer = event.pointerId;
      if (part) {
        this.dragging = { name, part, start, at: this.local(name, start, event.clientX, event.clientY), row, pointer };
      } else {
        const scale = this.views.metresPerPixel(name, this.box(name, this.anchor), this.rect(name));
        this.panning = { name, x: event.clientX, y: event.clientY, pan: [...this.views.looks[name].pan], scale, pointer };
      }
      element.setPointerCapture(event.pointerId);
      event.preventDefault();
      if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
    });
    element.addEventListener("pointermove", (event) => {
      const pointer = (this.dragging ?? this.panning)?.pointer;
      if (pointer !== undefined && pointer !== event.pointerId) return;
      if (this.dragging) this.drag(event);
      else if (this.panning) this.pan(event);
      else this.hover(name, event);
    });
    element.addEventListener("pointerup", (event) => {
      const was = this.dragging;
      if (this.panning?.pointer === event.pointerId) this.panning = null, end();
      if (was?.pointer !== event.pointerId) return;
      const box = this.dragged(event);
      this.dragging = null;
      end();
      const changes = finite(box) && !same(box, was.start);
      previewBox(was.row, null);
      if (changes) setBox(was.row, { box });
      this.refresh();
    });
    for (const lost of ["pointercancel", "lostpointercapture"] as const)
      element.addEventListener(lost, (event) => {
        const held = this.dragging ?? this.panning;
        if (held?.name === name && held.pointer === event.pointerId) cancelGesture();
      });
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (!this.anchor || this.dragging || this.panning) return;
      const rect = this.rect(name);
      const from: [number, number] = [event.clientX - rect.x - rect.width / 2, rect.y + rect.height / 2 - event.clientY];
      this.views.zoom(name, Math.exp(clamp(event.deltaY, -240, 240) * 0.0015), from, this.box(name, this.anchor), rect);
      this.stage.request("close");
    }, { passive: false });
  }

  /** The box stands again where it stood, and so does the view. */
  private giveUp(element: HTMLElement, pointer: number): void {
    const row = this.dragging?.row;
    if (this.panning) this.views.looks[this.panning.name].pan = this.panning.pan;
    this.dragging = this.panning = null;
    if (element.hasPointerCapture(pointer)) element.releasePointerCapture(pointer);
    if (row) previewBox(row, null);
    this.refresh();
  }

  private dragged(event: PointerEvent): Box {
    const { name, part, start, at } = this.dragging!;
    const now = this.local(name, start, event.clientX, event.clientY);
    if (part.kind === "move") return name === "radar" ? shifted(start, 0, 0, now[2] - at[2]) : shifted(start, now[0] - at[0], now[1] - at[1], now[2] - at[2]);
    if (part.kind === "turn") return turned(start, Math.atan2(now[1], now[0]));
    return faceMoved(start, part.axis, part.side, part.side * (now[part.axis]! - at[part.axis]!));
  }

  private drag(event: PointerEvent): void {
    previewBox(this.dragging!.row, this.dragged(event));
    this.stage.request("lines");
  }

  private pan(event: PointerEvent): void {
    const { name, x, y, pan, scale } = this.panning!;
    this.views.looks[name].pan = [pan[0] - (event.clientX - x) * scale, pan[1] + (event.clientY - y) * scale];
    this.stage.request("close");
  }

  private hover(name: Name, event: PointerEvent): void {
    const row = selected();
    const part = row && this.anchor && state.mode === "annotate" && event.target === this.element(name) ? this.grabbed(name, boxOf(row), event.clientX, event.clientY) : null;
    const upright = part?.kind === "face" ? part.axis === VIEWS[name].up : part?.kind === "move" && name === "radar";
    this.element(name).style.cursor = !part ? "default" : part.kind === "turn" ? "grab" : upright ? "ns-resize" : part.kind === "move" ? "move" : "ew-resize";
  }

  /** Pixel of a place of the frame in a close-up, for tests. */
  pixel(name: Name, p: Vec3): [number, number] | null {
    return this.projector(name).point(p);
  }

  get count(): number {
    return this.clouds.reduce((sum, { object }) => sum + object.set.count, 0);
  }

  /** The radar's cells and echoes about the selection, for tests. */
  get radar(): RadarBlock | null {
    return this.block;
  }
}

/** A place of the frame in the axes of a layer, in the plane. */
function inLayer(layer: Layer, [x, y]: [number, number]): [number, number] {
  const m = layer.frame_T_layer;
  if (!m) return [x, y];
  const [dx, dy] = [x - m[3]!, y - m[7]!];
  return [m[0]! * dx + m[4]! * dy, m[1]! * dx + m[5]! * dy];
}
