// The radar seen from above (BEV-2D): power over range and azimuth, looked up for every pixel of a plane on the ground.

import { BufferAttribute, BufferGeometry, CustomBlending, DataTexture, GLSL3, LinearFilter, Mesh, OneMinusSrcAlphaFactor, RedFormat, ShaderMaterial, SrcAlphaFactor, Vector2 } from "three";
import { colourTable, scaleRow } from "./cloud";
import type { Layer } from "./protocol";
import { levelled, radarPicture, spread, type RadarPicture } from "./radarlevels";
import { POLAR_FRAGMENT, POLAR_VERTEX } from "./shaders";
import type { Payload } from "./wire";

/** The corner of the plane that a map covers: least x, least y, most x, most y. */
function reach({ polar, rows, columns }: RadarPicture): [number, number, number, number] {
  const most = (axis: number[]): number => Math.max(axis[0]!, axis[1]!);
  const least = (axis: number[]): number => Math.min(axis[0]!, axis[1]!);
  if (!polar) return [least(columns), least(rows), most(columns), most(rows)];
  const r = most(rows);
  const back = Math.max(Math.abs(columns[0]), Math.abs(columns[1])) > Math.PI / 2 ? -r : 0;
  return [back, -r, r, r];
}

export class RadarMap {
  readonly mesh: Mesh<BufferGeometry, ShaderMaterial>;
  readonly picture: RadarPicture;
  private readonly texture: DataTexture;

  constructor(payload: Payload, layer: Layer) {
    this.picture = radarPicture(payload, layer);
    const { rows, columns, polar } = this.picture;
    const power = levelled(this.picture);
    this.texture = new DataTexture(power, columns[2], rows[2], RedFormat);
    this.texture.magFilter = LinearFilter;
    this.texture.unpackAlignment = 1;
    this.texture.needsUpdate = true;
    const geometry = new BufferGeometry();
    const [x0, y0, x1, y1] = reach(this.picture);
    geometry.setAttribute("position", new BufferAttribute(new Float32Array([x0, y0, 0, x1, y0, 0, x1, y1, 0, x0, y0, 0, x1, y1, 0, x0, y1, 0]), 3));
    this.mesh = new Mesh(geometry, material());
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -1;
    const u = this.mesh.material.uniforms;
    u.u_power!.value = this.texture;
    u.u_polar!.value = polar;
    (u.u_rows!.value as Vector2).set(rows[0], rows[1]);
    (u.u_columns!.value as Vector2).set(columns[0], columns[1]);
    const [low, high] = spread(power, polar ? 0.99 : 0.999);
    (u.u_window!.value as Vector2).set(low, high);
  }

  show(opacity: number): void {
    this.mesh.material.uniforms.u_opacity!.value = opacity;
  }

  dispose(): void {
    this.texture.dispose();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}

function material(): ShaderMaterial {
  return new ShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: POLAR_VERTEX,
    fragmentShader: POLAR_FRAGMENT,
    blending: CustomBlending, // with "transparent" off it is drawn before the points, which then stand on it
    blendSrc: SrcAlphaFactor,
    blendDst: OneMinusSrcAlphaFactor,
    depthWrite: false,
    depthTest: false,
    uniforms: {
      u_power: { value: null }, u_table: { value: colourTable() }, u_rows: { value: new Vector2() }, u_columns: { value: new Vector2() }, u_polar: { value: true },
      u_window: { value: new Vector2(0, 1) }, u_row: { value: scaleRow("inferno") }, u_opacity: { value: 0.7 },
    },
  });
}
