// A slice of the radar's power under the points of a close-up: a small picture on a plane through the box.

import { BufferAttribute, BufferGeometry, CustomBlending, DataTexture, GLSL3, LinearFilter, Mesh, OneMinusSrcAlphaFactor, RedFormat, ShaderMaterial, SrcAlphaFactor, Vector2 } from "three";
import type { Box, Vec3 } from "./boxes";
import { directions, type Name } from "./closeviews";
import { colourTable, scaleRow } from "./cloud";
import type { RadarBlock } from "./radarblock";
import { SLICE_FRAGMENT, SLICE_VERTEX } from "./shaders";

const WIDE_M = 9;
const TALL_M = 6;
const CELLS_A_METRE = 4;
const LEAST_BYTES = 8; // between the darkest and the brightest: noise alone is not stretched over all colours

export class RadarSlice {
  readonly mesh: Mesh<BufferGeometry, ShaderMaterial>;
  private drawn: { block: RadarBlock; box: Box; depth: number } | null = null;
  private texture: DataTexture | null = null;

  constructor(private readonly name: Name) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(18), 3));
    geometry.setAttribute("uv", new BufferAttribute(new Float32Array([0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1]), 2));
    const material = new ShaderMaterial({
      glslVersion: GLSL3, vertexShader: SLICE_VERTEX, fragmentShader: SLICE_FRAGMENT, depthTest: false, depthWrite: false,
      blending: CustomBlending, blendSrc: SrcAlphaFactor, blendDst: OneMinusSrcAlphaFactor,
      uniforms: { u_power: { value: null }, u_table: { value: colourTable() }, u_row: { value: scaleRow("inferno") }, u_window: { value: new Vector2(0, 1) }, u_opacity: { value: 0.7 } },
    });
    this.mesh = new Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -1;
  }

  /** The slice through a box as its view has it, with all power up to a depth before and behind its middle. */
  show(block: RadarBlock, box: Box, depth: number, opacity: number): Mesh {
    this.mesh.material.uniforms.u_opacity!.value = opacity;
    const { drawn } = this;
    if (drawn?.block === block && drawn.depth === depth && drawn.box.every((value, i) => value === box[i])) return this.mesh;
    this.drawn = { block, box: [...box] as Box, depth };
    const tall = this.name === "top" ? WIDE_M : TALL_M;
    const { right, up, ahead } = directions(this.name, box[6]);
    const middle: Vec3 = [box[0], box[1], box[2]];
    const size: [number, number] = [2 * WIDE_M * CELLS_A_METRE, 2 * tall * CELLS_A_METRE];
    const power = block.slice(middle, right, up, ahead, [WIDE_M, tall], depth, size);
    this.texture?.dispose();
    this.texture = new DataTexture(power, ...size, RedFormat);
    this.texture.magFilter = LinearFilter;
    this.texture.unpackAlignment = 1;
    this.texture.needsUpdate = true;
    const { uniforms } = this.mesh.material;
    uniforms.u_power!.value = this.texture;
    const shown = power.filter((value) => value > 0).sort();
    const [low, high] = [shown[shown.length >> 1] ?? 0, shown[shown.length - 1] ?? 0];
    (uniforms.u_window!.value as Vector2).set(low / 255, Math.max(low + LEAST_BYTES, high) / 255);
    const corner = (u: number, v: number): number[] => middle.map((value, i) => value + right[i]! * u * WIDE_M + up[i]! * v * tall);
    const places = this.mesh.geometry.getAttribute("position") as BufferAttribute;
    places.set([corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, -1), corner(1, 1), corner(-1, 1)].flat());
    places.needsUpdate = true;
    return this.mesh;
  }
}
