// How the close-ups look at a box: from above, from its right, from behind, and along the radar's line of sight. Each has its zoom and place.

import { OrthographicCamera, Vector3 } from "three";
import { fromBox, type Box, type Vec3 } from "./boxes";
import { clamp } from "./dom";
import type { Rect } from "./eye";
import { remember, remembered } from "./settings";

export type Name = "top" | "side" | "front" | "radar";
export const NAMES: Name[] = ["top", "side", "front", "radar"];

/** Which axes of the view's box lie across and upright, and from where it is looked at. */
export const VIEWS: Record<Name, { right: 0 | 1; up: 0 | 2; from: Vec3 }> = {
  top: { right: 1, up: 0, from: [0, 0, 1] },
  side: { right: 0, up: 2, from: [0, -1, 0] },
  front: { right: 1, up: 2, from: [-1, 0, 0] },
  radar: { right: 1, up: 2, from: [-1, 0, 0] },
};

const MARGIN_M: Record<Name, number> = { top: 1.2, side: 1.2, front: 1.2, radar: 3 };

/** The box as a view has it: from the radar, the upright box about it whose sides lie along the line of sight. */
export function viewBox(name: Name, box: Box, eye: Vec3): Box {
  if (name !== "radar") return box;
  const yaw = Math.atan2(box[1] - eye[1], box[0] - eye[0]);
  const [c, s] = [Math.abs(Math.cos(box[6] - yaw)), Math.abs(Math.sin(box[6] - yaw))];
  return [box[0], box[1], box[2], c * box[3] + s * box[4], s * box[3] + c * box[4], box[5], yaw];
}

/** Directions in the frame: the screen's right and up, and into the screen. */
export function directions(name: Name, yaw: number): { right: Vec3; up: Vec3; ahead: Vec3 } {
  const forward: Vec3 = [Math.cos(yaw), Math.sin(yaw), 0];
  const left: Vec3 = [-Math.sin(yaw), Math.cos(yaw), 0];
  const aside: Vec3 = [-left[0], -left[1], 0];
  if (name === "top") return { right: aside, up: forward, ahead: [0, 0, -1] };
  return name === "side" ? { right: forward, up: [0, 0, 1], ahead: left } : { right: aside, up: [0, 0, 1], ahead: forward };
}

interface Look {
  zoom: number; // half of what is seen over half of what is usual
  pan: [number, number]; // metres, the screen's right and up
}

const numbers = (value: unknown): boolean => typeof value === "object" && Object.values(value as object).every((one) => typeof one === "number" && one > 0 && one < 1e4);

/** Zoom and place of each view, and its camera. The zoom is remembered; the place is the object's. */
export class CloseViews {
  private readonly cameras = Object.fromEntries(NAMES.map((name) => [name, new OrthographicCamera(-1, 1, 1, -1, 0.1, 60)])) as Record<Name, OrthographicCamera>;
  readonly looks: Record<Name, Look>;

  constructor() {
    const zooms = remembered<Partial<Record<Name, number>>>("close-up zoom", {}, numbers);
    this.looks = Object.fromEntries(NAMES.map((name) => [name, { zoom: clamp(zooms[name] ?? 1, 0.08, 8), pan: [0, 0] }])) as unknown as Record<Name, Look>;
  }

  /** Half of the height that is seen, metres. */
  private half(name: Name, box: Box, rect: Rect): number {
    const { right, up } = VIEWS[name];
    const margin = MARGIN_M[name];
    return Math.max((box[3 + right]! / 2 + margin) * (rect.height / Math.max(1, rect.width)), box[3 + up]! / 2 + margin) * this.looks[name].zoom;
  }

  metresPerPixel(name: Name, box: Box, rect: Rect): number {
    return (2 * this.half(name, box, rect)) / Math.max(1, rect.height);
  }

  /** Box: as the view has it. */
  camera(name: Name, box: Box, rect: Rect): OrthographicCamera {
    const camera = this.cameras[name];
    const half = this.half(name, box, rect);
    const wide = (half * rect.width) / Math.max(1, rect.height);
    const [x, y] = this.looks[name].pan;
    Object.assign(camera, { left: x - wide, right: x + wide, top: y + half, bottom: y - half });
    const { from } = VIEWS[name];
    camera.up.set(...directions(name, box[6]).up);
    camera.position.set(...fromBox(box, [from[0] * 25, from[1] * 25, from[2] * 25]));
    camera.lookAt(new Vector3(box[0], box[1], box[2]));
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld(true);
    return camera;
  }

  /** Nearer or farther, so that what lies at a pixel (from the view's middle, up is positive) stays there. */
  zoom(name: Name, factor: number, [x, y]: [number, number], box: Box, rect: Rect): void {
    const look = this.looks[name];
    const before = this.metresPerPixel(name, box, rect);
    look.zoom = clamp(look.zoom * factor, 0.08, 8);
    const after = this.metresPerPixel(name, box, rect);
    look.pan = [look.pan[0] + x * (before - after), look.pan[1] + y * (before - after)];
    remember("close-up zoom", Object.fromEntries(NAMES.map((one) => [one, this.looks[one].zoom])));
  }

  /** The whole object in the middle, as at first. */
  reset(name: Name): void {
    this.looks[name].pan = [0, 0];
    this.zoom(name, 1 / this.looks[name].zoom, [0, 0], [0, 0, 0, 4, 2, 2, 0], { x: 0, y: 0, width: 1, height: 1 });
  }

  /** Another object: it stands in the middle of every view. */
  centre(): void {
    for (const name of NAMES) this.looks[name].pan = [0, 0];
  }
}
