// One canvas, one WebGL context, views by scissor, drawn when something changed. While anything moves only the first
// points of the shuffle are drawn (software GL is vertex bound); the whole cloud follows 120 ms after the last input.

import { Matrix4, Scene, WebGLRenderer, type Camera, type Mesh } from "three";
import { report } from "./bar";
import { CloudObject, type Look, type PointSet } from "./cloud";
import { PATTERN_COLOURS } from "./colours";
import { byId } from "./dom";
import { Eye, type Rect } from "./eye";
import type { Layer } from "./protocol";
import { RadarMap } from "./radarmap";
import { changed, lookOf, state } from "./state";
import type { Payload } from "./wire";

export interface Pane {
  index: number;
  rect: Rect;
  camera: Camera;
}

/** A small view of some points, drawn by the close-ups. */
export interface SmallView {
  rect: Rect;
  seen: Rect; // what of it is on the screen
  camera: Camera;
  clouds: CloudObject[];
  under: Mesh | null; // what is drawn before the points
}

const NO_POINTS: PointSet = { count: 0, places: new Int16Array(4), scale: 1, offset: [0, 0, 0], values: new Map() };
const SETTLE_MS = 120;
const HELD_MS = 700; // while a button is held: a slow machine must not draw the whole cloud between two movements
const STEPPING_MS = 300; // a frame that comes so soon after the last one belongs to a key that is held
const AT_ONCE = 300_000;
const BACKGROUND = 0x0e1217;

export class Stage {
  readonly canvas = byId("gl") as HTMLCanvasElement;
  readonly lines = byId("lines") as HTMLCanvasElement;
  readonly eye = new Eye();
  readonly renderer: WebGLRenderer;
  readonly software: boolean;
  clouds = new Map<string, { layer: Layer; object: CloudObject }>();
  maps = new Map<string, { layer: Layer; object: RadarMap }>();
  smallViews: () => SmallView[] = () => [];
  /** Whether the close-ups lie over the main view. */
  covered: () => boolean = () => false;
  overlay: (what: { main: boolean; close: boolean }) => void = () => undefined;
  drawn = { frame: -1, points: 0, whole: true, ms: 0, count: 0 };
  private frame = -1;
  private readonly scene = new Scene();
  private readonly crop = new Scene();
  private readonly empty = new Scene();
  private dirty = { main: true, close: true, lines: true };
  private scheduled = 0;
  private settle = 0;
  private moving = false;
  private held = false;
  private stepped = -STEPPING_MS;

  constructor() {
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: false, preserveDrawingBuffer: true, powerPreference: "high-performance" });
    this.renderer.autoClear = false;
    this.renderer.debug.checkShaderErrors = false;
    this.begin();
    this.software = /swiftshader|llvmpipe|softpipe|software/i.test(this.rendererName());
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      report("warning", "The graphics driver dropped the page's picture.", "It is drawn again as soon as the driver is back.");
    });
    this.canvas.addEventListener("webglcontextrestored", () => { this.begin(); this.request("all"); });
    window.addEventListener("pointerdown", () => (this.held = true), true);
    for (const end of ["pointerup", "pointercancel"])
      window.addEventListener(end, () => {
        this.held = false;
        if (this.moving) this.rest(SETTLE_MS);
      }, true);
    new ResizeObserver(() => this.resize()).observe(document.documentElement);
    new ResizeObserver(() => this.request("all")).observe(byId("main"));
    this.scene.add(new CloudObject(NO_POINTS).points); // keeps the compiled program when a frame's clouds go
    this.resize();
  }

  /** What a context does not keep when it is lost: without scissors every view would clear all others. */
  private begin(): void {
    this.renderer.setScissorTest(true);
    this.renderer.setClearColor(BACKGROUND, 1);
  }

  private rendererName(): string {
    const gl = this.renderer.getContext();
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    return String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  }

  /** Points drawn while something moves, and at first of a new frame. */
  get budget(): number {
    return this.software ? (state.playing ? 40_000 : 20_000) : 600_000;
  }

  resize(): void {
    const ratio = this.software ? 1 : Math.min(2, window.devicePixelRatio);
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(window.innerWidth, window.innerHeight, false);
    this.lines.width = window.innerWidth * ratio;
    this.lines.height = window.innerHeight * ratio;
    this.lines.getContext("2d")!.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.request("all");
  }

  /** Draw in the next animation frame: all, the close-ups, or only the lines (boxes, labels). */
  request(what: "all" | "main" | "close" | "lines"): void {
    if (what === "all" || what === "main") this.dirty.main = true;
    if (what === "all" || what === "close") this.dirty.close = true;
    this.dirty.lines = true;
    if (!this.scheduled) this.scheduled = requestAnimationFrame(() => this.render());
  }

  /** The main view moves: a sample now, the whole cloud when it rests. */
  touch(): void {
    this.moving = true;
    this.rest(this.held ? HELD_MS : SETTLE_MS);
    this.request("main");
  }

  private rest(after: number): void {
    window.clearTimeout(this.settle);
    this.settle = window.setTimeout(() => {
      this.moving = false;
      this.request("main");
    }, after);
  }

  get idle(): boolean {
    return !this.scheduled && !this.moving;
  }

  panes(): Pane[] {
    const box = byId("main").getBoundingClientRect();
    const n = state.sideBySide ? 2 : 1;
    return Array.from({ length: n }, (_, index) => {
      const rect = { x: box.x + (index * box.width) / n, y: box.y, width: box.width / n - (n - 1), height: box.height };
      return { index, rect, camera: this.eye.camera(rect) };
    });
  }

  paneAt(x: number): Pane {
    const panes = this.panes();
    return panes.find((pane) => x < pane.rect.x + pane.rect.width) ?? panes[panes.length - 1]!;
  }

  setFrame(frame: number, points: { layer: Layer; set: PointSet }[], radar: { layer: Layer; payload: Payload }[]): void {
    this.frame = frame;
    const before = this.clouds;
    this.clouds = new Map();
    for (const { layer, set } of points) {
      const old = before.get(layer.name);
      const object = old?.object.set === set ? old.object : new CloudObject(set);
      if (object !== old?.object) this.scene.add(object.points);
      place(object.points, layer);
      this.clouds.set(layer.name, { layer, object });
    }
    for (const [name, { object }] of before) {
      if (this.clouds.get(name)?.object === object) continue;
      this.scene.remove(object.points);
      object.dispose();
    }
    for (const { object } of this.maps.values()) this.scene.remove(object.mesh), object.dispose();
    this.maps = new Map(radar.map(({ layer, payload }) => [layer.name, { layer, object: new RadarMap(payload, layer) }]));
    for (const { object, layer } of this.maps.values()) this.scene.add(object.mesh), place(object.mesh, layer);
    this.applyLooks();
    this.request("all");
    if (this.software && this.count > 3 * this.budget) this.arrived();
  }

  /** A frame has come: its whole cloud at once, but a sample first where frames follow each other or it is very large. */
  private arrived(): void {
    const now = performance.now();
    if (state.playing || now - this.stepped < STEPPING_MS || this.count > AT_ONCE) this.touch();
    this.stepped = now;
  }

  private get count(): number {
    let total = 0;
    for (const { object } of this.clouds.values()) total += object.set.count;
    return total;
  }

  applyLooks(): void {
    let row = 0;
    for (const [name, { layer, object }] of this.clouds) {
      object.show(this.look(name, layer, row));
      row += 1;
    }
    for (const [name, { object }] of this.maps) object.show(lookOf(name, "bev").opacity);
  }

  look(name: string, layer: Layer, row: number, set = this.clouds.get(name)?.object.set): Look {
    const radar = layer.sensor === "radar";
    const power = set ? (["power_db", "rcs_dbsm"].find((field) => set.values.has(field)) ?? null) : null;
    const own = radar && power !== null && ["height", "intensity", "ring", "lag_s", "age_s"].includes(state.colour);
    return {
      mode: own ? power! : state.colour,
      window: own ? powerWindow(set!, power!) : state.window,
      size: state.pointSize * (radar ? 2.2 : 1),
      grow: state.grow ? 1 : 0,
      opacity: lookOf(name, layer.kind).opacity,
      flat: PATTERN_COLOURS[row % PATTERN_COLOURS.length]!,
      gate: radar && power ? { name: power, least: gateOf(set!, power) } : null,
      keep: state.filters.range,
    };
  }

  private render(): void {
    this.scheduled = 0;
    const started = performance.now();
    const { main, close } = this.dirty;
    this.dirty = { main: false, close: false, lines: false };
    const covered = this.covered();
    if (main && close) this.draw({ x: 0, y: 0, width: window.innerWidth, height: window.innerHeight }, this.empty, this.eye.camera({ x: 0, y: 0, width: 1, height: 1 })); // nothing stays of views that are gone
    if (main) this.renderMain(covered);
    if (close || (main && covered)) this.renderSmall();
    this.overlay({ main: true, close: true });
    this.drawn.ms = performance.now() - started;
    this.drawn.count += 1;
  }

  private renderMain(covered: boolean): void {
    const panes = this.panes();
    let drawn = 0;
    for (const pane of panes) {
      const visible: CloudObject[] = [];
      for (const [name, { layer, object }] of this.clouds) {
        object.points.visible = this.inPane(name, layer, pane.index);
        if (object.points.visible) visible.push(object);
      }
      for (const [name, { layer, object }] of this.maps) object.mesh.visible = this.inPane(name, layer, pane.index);
      const total = visible.reduce((sum, object) => sum + object.set.count, 0) * panes.length;
      const share = this.moving ? Math.min(1, this.budget / Math.max(1, total)) : 1;
      for (const object of visible) drawn += object.limit(share);
      this.draw(pane.rect, covered ? this.empty : this.scene, pane.camera);
    }
    this.drawn = { ...this.drawn, frame: this.frame, points: drawn, whole: !this.moving };
    if (state.drawnFrame !== this.frame) changed("drawn");
    state.drawnFrame = this.frame;
  }

  inPane(name: string, layer: Layer, pane: number): boolean {
    const look = lookOf(name, layer.kind);
    return look.visible && (!state.sideBySide || look.side === 0 || look.side === pane + 1);
  }

  private renderSmall(): void {
    for (const view of this.smallViews()) {
      this.crop.clear();
      if (view.under) this.crop.add(view.under);
      for (const cloud of view.clouds) this.crop.add(cloud.points);
      this.draw(view.rect, this.crop, view.camera, view.seen);
    }
  }

  private draw(rect: Rect, scene: Scene, camera: Camera, seen = rect): void {
    if (rect.width < 2 || rect.height < 2) return;
    const bottom = (of: Rect): number => window.innerHeight - of.y - of.height;
    this.renderer.setViewport(rect.x, bottom(rect), rect.width, rect.height);
    this.renderer.setScissor(seen.x, bottom(seen), seen.width, seen.height);
    this.renderer.clear();
    this.renderer.render(scene, camera);
  }

  /** Draw everything now. */
  whole(): void {
    window.clearTimeout(this.settle);
    this.moving = false;
    this.dirty = { main: true, close: true, lines: true };
    this.render();
  }

  /** Draw everything now and count the canvas's distinct colours: a blank one has one. */
  coloursNow(): number {
    this.whole();
    const gl = this.renderer.getContext();
    const bytes = new Uint8Array(this.canvas.width * this.canvas.height * 4);
    gl.readPixels(0, 0, this.canvas.width, this.canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return new Set(new Uint32Array(bytes.buffer)).size;
  }

  /** The page's picture (points and lines) as a PNG of the main view. */
  async picture(): Promise<Blob> {
    this.whole();
    const box = byId("main").getBoundingClientRect();
    const ratio = this.canvas.width / window.innerWidth;
    const out = new OffscreenCanvas(Math.round(box.width * ratio), Math.round(box.height * ratio));
    const paper = out.getContext("2d")!;
    for (const canvas of [this.canvas, this.lines])
      paper.drawImage(canvas, box.x * ratio, box.y * ratio, out.width, out.height, 0, 0, out.width, out.height);
    return out.convertToBlob({ type: "image/png" });
  }
}

/** Put what is drawn of a layer where the layer stands. */
export function place(object: { matrixAutoUpdate: boolean; matrix: Matrix4; matrixWorldNeedsUpdate: boolean }, layer: Layer): void {
  object.matrixAutoUpdate = false;
  if (layer.frame_T_layer) object.matrix.fromArray(layer.frame_T_layer).transpose();
  else object.matrix.identity();
  object.matrixWorldNeedsUpdate = true;
}

/** The weakest shown point is not black. */
function powerWindow(set: PointSet, name: string): [number, number] {
  const low = gateOf(set, name);
  const high = set.values.get(name)!.high;
  return [low - 0.35 * (high - low), high];
}

const FEW = 9000;

/** The byte below which a radar's points are left out, in physical units; memorised with the points. */
function gateOf(set: PointSet, name: string): number {
  const field = set.values.get(name)!;
  const share = state.powerGate ?? Math.max(0, 1 - FEW / Math.max(1, set.count));
  const counts = new Uint32Array(256);
  for (const value of field.rows) counts[value]! += 1;
  let left = share * set.count;
  let byte = 0;
  while (byte < 255 && (left -= counts[byte]!) > 0) byte += 1;
  return field.low + (byte / 255) * (field.high - field.low);
}
