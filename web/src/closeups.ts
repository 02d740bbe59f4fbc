// Three views of the selected box in its own axes (from above, from its right, from behind), only points within 8 m.
// Edges are dragged, the middle moves the box, in the top view the heading's handle turns it.

import { OrthographicCamera, Vector3 } from "three";
import { faceMoved, fromBox, same, shifted, toBox, turned, type Box, type Vec3 } from "./boxes";
import { CloudObject, cropped } from "./cloud";
import { byId } from "./dom";
import { previewBox, setBox } from "./edits";
import type { Rect } from "./eye";
import { strokeBox } from "./overlay";
import { Projector } from "./project";
import type { BoxRow } from "./protocol";
import type { SmallView, Stage } from "./stage";
import { boxOf, colourOf, on, selected, state } from "./state";

type Name = "top" | "side" | "front";

/** Which box axes lie across and upright in a view, and from where it looks. */
const VIEWS: Record<Name, { right: 0 | 1; up: 0 | 2; from: Vec3 }> = {
  top: { right: 1, up: 0, from: [0, 0, 1] },
  side: { right: 0, up: 2, from: [0, -1, 0] },
  front: { right: 1, up: 2, from: [-1, 0, 0] },
};
const NAMES: Name[] = ["top", "side", "front"];
const REACH_M = 8;
const GRAB_PX = 9;

type Part = { kind: "move" } | { kind: "turn" } | { kind: "face"; axis: 0 | 1 | 2; side: 1 | -1 };

export class CloseUps {
  private clouds: { object: CloudObject; source: CloudObject }[] = [];
  private cutAt: [number, number] | null = null;
  private zoom = 1;
  private anchor: Box | null = null; // the axes of the views: they stay while a box is dragged
  private readonly cameras: Record<Name, OrthographicCamera>;

  constructor(private readonly stage: Stage) {
    const camera = (): OrthographicCamera => new OrthographicCamera(-1, 1, 1, -1, 0.1, 60);
    this.cameras = { top: camera(), side: camera(), front: camera() };
    for (const name of NAMES) this.listen(name);
    on(["selection", "boxes", "frame", "looks", "filters"], () => this.refresh());
    stage.smallViews = () => this.views();
  }

  private element = (name: Name): HTMLElement => byId(`close-${name}`);

  private rect(name: Name): Rect {
    const { x, y, width, height } = this.element(name).getBoundingClientRect();
    return { x, y, width, height };
  }

  /** Cut the points near the selection anew if it moved out of the old cut or the frame changed. */
  refresh(): void {
    const row = selected();
    const source = [...this.stage.clouds.values()].filter(({ layer }) => layer.frame_T_layer === null || layer.placed);
    const stale = source.length !== this.clouds.length || source.some(({ object }, i) => this.clouds[i]!.source !== object);
    const far = row && this.cutAt ? Math.hypot(row.box[0]! - this.cutAt[0], row.box[1]! - this.cutAt[1]) > 2 : true;
    if (stale || far || !row) this.cut(row, source.map(({ object }) => object));
    let i = 0;
    for (const { object } of this.clouds) {
      const entry = source[i]!;
      object.show({ ...this.stage.look(entry.layer.name, entry.layer, i), size: 2, grow: 0, opacity: 1 });
      object.points.visible = this.stage.inPane(entry.layer.name, entry.layer, 0);
      i += 1;
    }
    if (row && !this.dragging) this.anchor = boxOf(row);
    if (!row) this.anchor = null;
    byId("closeups").classList.toggle("empty", !row);
    this.stage.request(this.dragging ? "lines" : "close");
  }

  private cut(row: BoxRow | null, sources: CloudObject[]): void {
    for (const { object } of this.clouds) object.dispose();
    this.clouds = [];
    this.cutAt = row ? [row.box[0]!, row.box[1]!] : null;
    if (!row) return;
    const reach = Math.max(REACH_M, Math.hypot(row.box[3]!, row.box[4]!) / 2 + 4) + 2;
    this.clouds = sources.map((source) => ({ object: new CloudObject(cropped(source.set, this.cutAt!, reach)), source }));
  }

  private camera(name: Name): OrthographicCamera {
    const camera = this.cameras[name];
    const rect = this.rect(name);
    const box = this.anchor ?? ([0, 0, 0, 4, 2, 2, 0] as Box);
    const { right, up, from } = VIEWS[name];
    const half = Math.max((box[3 + right]! / 2 + 1.2) * (rect.height / Math.max(1, rect.width)), box[3 + up]! / 2 + 1.2) * this.zoom;
    const wide = (half * rect.width) / Math.max(1, rect.height);
    Object.assign(camera, { left: -wide, right: wide, top: half, bottom: -half });
    const ahead = up === 0 ? fromBox([0, 0, 0, 0, 0, 0, box[6]], [1, 0, 0]) : ([0, 0, 1] as Vec3);
    camera.up.set(...ahead);
    const away: Vec3 = [from[0] * 25, from[1] * 25, from[2] * 25];
    camera.position.set(...fromBox(box, away));
    camera.lookAt(new Vector3(box[0], box[1], box[2]));
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld(true);
    return camera;
  }

  private views(): SmallView[] {
    if (!this.anchor) return NAMES.map((name) => ({ rect: this.rect(name), camera: this.cameras[name], clouds: [] }));
    return NAMES.map((name) => ({ rect: this.rect(name), camera: this.camera(name), clouds: this.clouds.map(({ object }) => object) }));
  }

  projector(name: Name): Projector {
    return new Projector(this.camera(name), this.rect(name));
  }

  drawLines(paper: CanvasRenderingContext2D): void {
    const row = selected();
    if (!row || !this.anchor) return;
    for (const name of NAMES) {
      const rect = this.rect(name);
      const view = this.projector(name);
      paper.save();
      paper.beginPath();
      paper.rect(rect.x, rect.y, rect.width, rect.height);
      paper.clip();
      for (const other of state.boxes)
        if (other.id !== row.id && Math.hypot(other.box[0]! - row.box[0]!, other.box[1]! - row.box[1]!) < 15)
          strokeBox(paper, view, boxOf(other), { colour: colourOf(other.class_name), width: 1, dash: [] });
      strokeBox(paper, view, boxOf(row), { colour: "#ffffff", width: 1.5, dash: [] });
      if (row.proposal) strokeBox(paper, view, row.proposal as unknown as Box, { colour: "#e69f00", width: 1, dash: [5, 4] });
      if (state.mode === "annotate") this.handles(paper, name, view, boxOf(row));
      paper.restore();
    }
  }

  private handles(paper: CanvasRenderingContext2D, name: Name, view: Projector, box: Box): void {
    paper.fillStyle = "#ffffff";
    for (const { at } of this.parts(name, box)) {
      const p = view.point(at);
      if (p) paper.fillRect(p[0] - 3, p[1] - 3, 6, 6);
    }
  }

  private parts(name: Name, box: Box): { part: Part; at: Vec3 }[] {
    const { right, up } = VIEWS[name];
    const out: { part: Part; at: Vec3 }[] = [];
    for (const axis of [right, up])
      for (const side of [1, -1] as const) {
        const local: Vec3 = [0, 0, 0];
        local[axis] = (side * box[3 + axis]!) / 2;
        out.push({ part: { kind: "face", axis, side }, at: fromBox(box, local) });
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
    const at = this.local(name, box, x, y);
    const { right, up } = VIEWS[name];
    const scale = this.metresPerPixel(name) * GRAB_PX;
    let best: { part: Part; away: number } | null = null;
    for (const axis of [right, up])
      for (const side of [1, -1] as const) {
        const other = axis === right ? up : right;
        const away = Math.abs(at[axis]! - (side * box[3 + axis]!) / 2);
        if (away < scale && Math.abs(at[other]!) < box[3 + other]! / 2 + scale && away < (best?.away ?? scale)) best = { part: { kind: "face", axis, side }, away };
      }
    if (best) return best.part;
    return [right, up].every((axis) => Math.abs(at[axis]!) < box[3 + axis]! / 2) ? { kind: "move" } : null;
  }

  private metresPerPixel(name: Name): number {
    const camera = this.camera(name);
    return (camera.top - camera.bottom) / Math.max(1, this.rect(name).height);
  }

  /** The pixel in the box's axes (the one along the view is 0). */
  private local(name: Name, box: Box, x: number, y: number): Vec3 {
    const { from } = this.projector(name).ray(x, y);
    const at = toBox(box, from);
    const depth = VIEWS[name].from.findIndex((part) => part !== 0);
    at[depth] = 0;
    return at;
  }

  private dragging: { name: Name; part: Part; start: Box; at: Vec3; row: BoxRow; zero: number } | null = null;

  private listen(name: Name): void {
    const element = this.element(name);
    element.addEventListener("pointerdown", (event) => {
      const row = selected();
      if (!row || state.mode !== "annotate" || event.button !== 0) return;
      const start = boxOf(row);
      const part = this.grabbed(name, start, event.clientX, event.clientY);
      if (!part) return;
      this.dragging = { name, part, start, at: this.local(name, start, event.clientX, event.clientY), row, zero: 0 };
      element.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    element.addEventListener("pointermove", (event) => {
      if (this.dragging) this.drag(event);
      else this.hover(name, event);
    });
    element.addEventListener("pointerup", (event) => {
      const was = this.dragging;
      if (!was) return;
      const box = this.dragged(event);
      this.dragging = null;
      if (!same(box, was.start)) setBox(was.row, { box });
      this.refresh();
    });
    element.addEventListener("pointercancel", () => (this.dragging = null));
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom = Math.min(6, Math.max(0.3, this.zoom * Math.exp(event.deltaY * 0.0015)));
      this.stage.request("close");
    }, { passive: false });
  }

  private dragged(event: PointerEvent): Box {
    const { name, part, start, at } = this.dragging!;
    const now = this.local(name, start, event.clientX, event.clientY);
    if (part.kind === "move") return shifted(start, now[0] - at[0], now[1] - at[1], now[2] - at[2]);
    if (part.kind === "turn") return turned(start, Math.atan2(now[1], now[0]));
    return faceMoved(start, part.axis, part.side, part.side * (now[part.axis]! - at[part.axis]!));
  }

  private drag(event: PointerEvent): void {
    previewBox(this.dragging!.row, this.dragged(event));
    this.stage.request("lines");
  }

  private hover(name: Name, event: PointerEvent): void {
    const row = selected();
    const part = row && state.mode === "annotate" ? this.grabbed(name, boxOf(row), event.clientX, event.clientY) : null;
    const upright = part?.kind === "face" && part.axis === VIEWS[name].up;
    this.element(name).style.cursor = !part ? "default" : part.kind === "turn" ? "grab" : part.kind === "move" ? "move" : upright ? "ns-resize" : "ew-resize";
  }

  /** Pixel of a place of the frame in a close-up, for tests. */
  pixel(name: Name, p: Vec3): [number, number] | null {
    return this.projector(name).point(p);
  }

  get count(): number {
    return this.clouds.reduce((sum, { object }) => sum + object.set.count, 0);
  }
}
