// From the frame's metres to pixels and back, on the CPU: labels, picking and the lines of boxes use it.

import { Matrix4, Vector3, type Camera } from "three";
import type { Vec3 } from "./boxes";
import type { Rect } from "./eye";

const NEAR = 0.05;

export class Projector {
  private readonly e: number[];
  private readonly inverse: Matrix4;

  constructor(camera: Camera, readonly rect: Rect) {
    const matrix = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    this.e = matrix.elements;
    this.inverse = matrix.clone().invert();
  }

  private clip([x, y, z]: Vec3): [number, number, number] {
    const e = this.e;
    return [
      e[0]! * x + e[4]! * y + e[8]! * z + e[12]!,
      e[1]! * x + e[5]! * y + e[9]! * z + e[13]!,
      e[3]! * x + e[7]! * y + e[11]! * z + e[15]!,
    ];
  }

  private pixel(cx: number, cy: number, w: number): [number, number] {
    return [this.rect.x + ((cx / w + 1) / 2) * this.rect.width, this.rect.y + ((1 - cy / w) / 2) * this.rect.height];
  }

  /** The pixel of a point, or null behind the eye. */
  point(p: Vec3): [number, number] | null {
    const [x, y, w] = this.clip(p);
    return w < NEAR ? null : this.pixel(x, y, w);
  }

  /** The pixels of a segment, cut at the eye's plane. */
  segment(a: Vec3, b: Vec3): [number, number, number, number] | null {
    let [ax, ay, aw] = this.clip(a);
    let [bx, by, bw] = this.clip(b);
    if (aw < NEAR && bw < NEAR) return null;
    if (aw < NEAR || bw < NEAR) {
      const t = (NEAR - aw) / (bw - aw);
      const [mx, my] = [ax + t * (bx - ax), ay + t * (by - ay)];
      if (aw < NEAR) [ax, ay, aw] = [mx, my, NEAR];
      else [bx, by, bw] = [mx, my, NEAR];
    }
    return [...this.pixel(ax, ay, aw), ...this.pixel(bx, by, bw)];
  }

  /** The ray through a pixel: where it starts and its unit direction. */
  ray(x: number, y: number): { from: Vec3; to: Vec3 } {
    const nx = ((x - this.rect.x) / this.rect.width) * 2 - 1;
    const ny = 1 - ((y - this.rect.y) / this.rect.height) * 2;
    const near = new Vector3(nx, ny, -1).applyMatrix4(this.inverse);
    const far = new Vector3(nx, ny, 1).applyMatrix4(this.inverse);
    const d = far.sub(near).normalize();
    return { from: [near.x, near.y, near.z], to: [d.x, d.y, d.z] };
  }

  /** Where the pixel's ray meets the level z, or null when it does not (or beyond 600 m). */
  ground(x: number, y: number, z: number): Vec3 | null {
    const { from, to } = this.ray(x, y);
    if (Math.abs(to[2]) < 1e-6) return null;
    const t = (z - from[2]) / to[2];
    if (t < 0) return null;
    const at: Vec3 = [from[0] + t * to[0], from[1] + t * to[1], z];
    return Math.hypot(at[0], at[1]) > 600 ? null : at;
  }
}
