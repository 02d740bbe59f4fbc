// Where the main view is seen from: an orbit round a target, or straight down from above with forward up.

import { OrthographicCamera, PerspectiveCamera, Vector3, type Camera } from "three";
import type { Vec3 } from "./boxes";
import { clamp } from "./dom";

export interface Rect {
  x: number;
  y: number;
  width: number;
  height: number;
}

const FIELD = 50;
const HALF = Math.tan((FIELD * Math.PI) / 360);

export class Eye {
  target: Vec3 = [22, 0, 0];
  distance = 48;
  azimuth = Math.PI;
  elevation = 0.5;
  top = false;
  private readonly perspective = new PerspectiveCamera(FIELD, 1, 0.3, 900);
  private readonly plan = new OrthographicCamera(-1, 1, 1, -1, 0.1, 2000);

  get position(): Vec3 {
    const flat = Math.cos(this.elevation) * this.distance;
    const [x, y, z] = this.target;
    return [x + flat * Math.cos(this.azimuth), y + flat * Math.sin(this.azimuth), z + Math.sin(this.elevation) * this.distance];
  }

  camera(rect: Rect): Camera {
    const aspect = rect.width / Math.max(1, rect.height);
    if (!this.top) {
      this.perspective.aspect = aspect;
      this.perspective.far = Math.max(900, this.distance * 4);
      this.perspective.up.set(0, 0, 1);
      this.perspective.position.set(...this.position);
      this.perspective.lookAt(new Vector3(...this.target));
      this.perspective.updateProjectionMatrix();
      this.perspective.updateMatrixWorld(true);
      return this.perspective;
    }
    const half = this.distance * HALF;
    Object.assign(this.plan, { left: -half * aspect, right: half * aspect, top: half, bottom: -half });
    const back = this.azimuth;
    this.plan.up.set(-Math.cos(back), -Math.sin(back), 0);
    this.plan.position.set(this.target[0], this.target[1], 500);
    this.plan.lookAt(new Vector3(this.target[0], this.target[1], 0));
    this.plan.updateProjectionMatrix();
    this.plan.updateMatrixWorld(true);
    return this.plan;
  }

  orbit(dx: number, dy: number): void {
    this.azimuth -= dx * 0.006;
    if (!this.top) this.elevation = clamp(this.elevation + dy * 0.006, -0.1, 1.55);
  }

  /** Move the target so that the ground follows the pointer. */
  pan(dx: number, dy: number, rect: Rect): void {
    const metres = (2 * this.distance * HALF) / Math.max(1, rect.height);
    const stretch = this.top ? 1 : 1 / Math.max(0.3, Math.sin(this.elevation));
    const c = Math.cos(this.azimuth);
    const s = Math.sin(this.azimuth);
    const forward = dy * metres * stretch;
    const left = dx * metres;
    this.target = [this.target[0] - c * forward - s * left * 1, this.target[1] - s * forward + c * left * 1, this.target[2]];
  }

  zoom(factor: number): void {
    this.distance = clamp(this.distance * factor, 2, 800);
  }

  frame(at: Vec3, reach: number): void {
    this.target = [...at];
    this.distance = reach;
  }
}
