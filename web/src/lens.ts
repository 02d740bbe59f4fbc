// A pinhole camera with distortion (k1 k2 p1 p2 k3 as OpenCV has them), and small rigid motions.

import type { CameraModel, CameraValues } from "./protocol";

/** A point of the frame in pixels of the picture and its depth, or null behind the camera. */
export function toPixel(camera: CameraModel, p: readonly number[]): [number, number, number] | null {
  const m = camera.camera_T_frame;
  const along = (row: number): number => m[row * 4]! * p[0]! + m[row * 4 + 1]! * p[1]! + m[row * 4 + 2]! * p[2]! + m[row * 4 + 3]!;
  const depth = along(2);
  if (depth < 0.3) return null;
  let [x, y] = [along(0) / depth, along(1) / depth];
  const [k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0] = camera.distortion;
  if (k1 || k2 || p1 || p2 || k3) {
    const r2 = x * x + y * y;
    if (r2 > 4) return null;
    const radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
    [x, y] = [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y];
  }
  const k = camera.matrix;
  return [k[0]! * x + k[1]! * y + k[2]!, k[4]! * y + k[5]!, depth];
}

/** The rotation of a vector of turns (radians), row by row (Rodrigues). */
export function turned([a, b, c]: readonly number[]): number[] {
  const angle = Math.hypot(a!, b!, c!);
  if (angle < 1e-12) return [1, 0, 0, 0, 1, 0, 0, 0, 1];
  const [x, y, z] = [a! / angle, b! / angle, c! / angle];
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  const rest = 1 - cos;
  return [
    cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin,
    y * x * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin,
    z * x * rest - y * sin, z * y * rest + x * sin, cos + z * z * rest,
  ];
}

/** The camera of some values: `exp(moved) start`, as the server has it. */
export function cameraOf(values: CameraValues, start: CameraModel): CameraModel {
  const r = turned(values.moved.slice(0, 3));
  const from = start.camera_T_frame;
  const out = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1];
  for (let i = 0; i < 3; i += 1) {
    for (let j = 0; j < 4; j += 1) out[i * 4 + j] = r[i * 3]! * from[j]! + r[i * 3 + 1]! * from[4 + j]! + r[i * 3 + 2]! * from[8 + j]!;
    out[i * 4 + 3]! += values.moved[3 + i]!;
  }
  return { ...start, matrix: [values.fx, 0, values.cx, 0, values.fy, values.cy, 0, 0, 1], distortion: [...values.distortion], camera_T_frame: out };
}
