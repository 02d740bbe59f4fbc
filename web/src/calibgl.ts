// Points and the radar's map by WebGL 2: a moved value is a uniform, so that nothing is uploaded while it moves.

import { table } from "./colours";
import { RADAR_MAP } from "./calibshaders";
import type { CameraModel } from "./protocol";
import type { Payload } from "./wire";
import { POINTS } from "./calibshaders";

export interface Rect { x: number; y: number; width: number; height: number }

/** Looking from above: ahead is up, left is left. */
export interface Above { x: number; y: number; scale: number }

export interface Places { count: number; buffer: WebGLBuffer; value: WebGLBuffer | null; scale: number; rows: Int16Array }

export interface Look { colour: [number, number, number, number] | "range" | "value"; size: number; low: number; reach: number; row: number }

const number = (gl: WebGL2RenderingContext, kind: number, source: string): WebGLShader => {
  const shader = gl.createShader(kind)!;
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "a shader was refused");
  return shader;
};

function program(gl: WebGL2RenderingContext, { vertex, fragment }: { vertex: string; fragment: string }): WebGLProgram {
  const made = gl.createProgram()!;
  gl.attachShader(made, number(gl, gl.VERTEX_SHADER, vertex));
  gl.attachShader(made, number(gl, gl.FRAGMENT_SHADER, fragment));
  gl.bindAttribLocation(made, 0, "place");
  gl.bindAttribLocation(made, 1, "value");
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) ?? "a program was refused");
  return made;
}

export class Drawer {
  private readonly gl: WebGL2RenderingContext;
  private readonly points: WebGLProgram;
  private readonly map: WebGLProgram;
  private readonly colours: WebGLTexture;
  private texture: WebGLTexture | null = null;

  constructor(readonly canvas: HTMLCanvasElement) {
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("no WebGL 2");
    this.gl = gl;
    this.points = program(gl, POINTS);
    this.map = program(gl, RADAR_MAP);
    this.colours = this.bytes(table(), 256, 4, gl.RGBA, gl.RGBA);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  private bytes(data: Uint8Array, width: number, height: number, inner: number, format: number, smooth = false): WebGLTexture {
    const { gl } = this;
    const made = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, gl.UNSIGNED_BYTE, data);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, smooth ? gl.LINEAR : gl.NEAREST);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    return made;
  }

  /** Upload a cloud; `field` gives a byte a point to colour by. */
  upload(payload: Payload, field = ""): Places {
    const { gl } = this;
    const rows = payload.arrays.get("place") as Int16Array;
    const buffer = gl.createBuffer()!;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, rows, gl.STATIC_DRAW);
    const bytes = payload.arrays.get(field);
    const value = bytes ? gl.createBuffer()! : null;
    if (bytes) {
      gl.bindBuffer(gl.ARRAY_BUFFER, value);
      gl.bufferData(gl.ARRAY_BUFFER, bytes as Uint8Array, gl.STATIC_DRAW);
    }
    return { count: payload.header.count, buffer, value, scale: payload.header.scale_m, rows };
  }

  forget(places: Places | null): void {
    if (!places) return;
    this.gl.deleteBuffer(places.buffer);
    if (places.value) this.gl.deleteBuffer(places.value);
  }

  setMap(data: Uint8Array, columns: number, rows: number): void {
    if (this.texture) this.gl.deleteTexture(this.texture);
    this.texture = this.bytes(data, columns, rows, this.gl.R8, this.gl.RED, true);
  }

  clear(): void {
    const { gl, canvas } = this;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  private into({ x, y, width, height }: Rect): void {
    const { gl, canvas } = this;
    const below = canvas.height - y - height;
    gl.viewport(x, below, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(x, below, width, height);
  }

  private set(of: WebGLProgram, name: string, ...values: number[]): void {
    const at = this.gl.getUniformLocation(of, name);
    if (values.length === 1) this.gl.uniform1f(at, values[0]!);
    else if (values.length === 2) this.gl.uniform2f(at, values[0]!, values[1]!);
    else this.gl.uniform4f(at, values[0]!, values[1]!, values[2]!, values[3]!);
  }

  private start(rect: Rect, places: Places, look: Look, mode: number): void {
    const { gl, points } = this;
    this.into(rect);
    gl.useProgram(points);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.bindBuffer(gl.ARRAY_BUFFER, places.buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 4, gl.SHORT, false, 8, 0);
    if (places.value) {
      gl.bindBuffer(gl.ARRAY_BUFFER, places.value);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(1, 1, gl.UNSIGNED_BYTE, true, 1, 0);
    } else gl.disableVertexAttribArray(1);
    this.set(points, "u_mode", mode);
    this.set(points, "u_scale", places.scale);
    this.set(points, "u_size", look.size);
    this.set(points, "u_low", look.low);
    this.set(points, "u_reach", look.reach);
    this.set(points, "u_by", look.colour === "range" ? 1 : look.colour === "value" ? 2 : 0);
    this.set(points, "u_row", look.row);
    this.set(points, "u_flat", ...(typeof look.colour === "string" ? [1, 1, 1, 1] : look.colour));
    this.set(points, "u_screen", rect.width, rect.height);
  }

  above(rect: Rect, places: Places, look: Look, pose: readonly number[], view: Above): void {
    this.start(rect, places, look, 0);
    this.set(this.points, "u_pose", Math.cos(pose[2]!), Math.sin(pose[2]!), pose[0]!, pose[1]!);
    this.set(this.points, "u_view", view.x, view.y, view.scale, 0);
    this.gl.drawArrays(this.gl.POINTS, 0, places.count);
  }

  /** Into a picture whose pixel (u, v) lies at `offset + zoom * (u, v)` of the rectangle. */
  camera(rect: Rect, places: Places, look: Look, camera: CameraModel, zoom: number, offset: readonly [number, number]): void {
    const { gl, points } = this;
    this.start(rect, places, look, 1);
    gl.uniformMatrix4fv(gl.getUniformLocation(points, "u_camera"), true, camera.camera_T_frame);
    this.set(points, "u_lens", camera.matrix[0]!, camera.matrix[4]!, camera.matrix[2]!, camera.matrix[5]!);
    this.set(points, "u_bent", camera.distortion[0]!, camera.distortion[1]!, camera.distortion[2]!, camera.distortion[3]!);
    this.set(points, "u_k3", camera.distortion[4]!);
    this.set(points, "u_view", zoom, offset[0], offset[1], 0);
    gl.drawArrays(gl.POINTS, 0, places.count);
  }

  /** By direction: azimuth and elevation from (left, top) to (right, bottom), radians. */
  sphere(rect: Rect, places: Places, look: Look, window: readonly number[]): void {
    this.start(rect, places, look, 2);
    this.set(this.points, "u_view", ...window);
    this.gl.drawArrays(this.gl.POINTS, 0, places.count);
  }

  /** The radar's map under all: polar (range, azimuth) or in metres (y, x); axes as first edge, last edge. */
  radar(rect: Rect, polar: boolean, rows: readonly number[], columns: readonly number[], view: Above, window: readonly [number, number]): void {
    const { gl, map } = this;
    if (!this.texture) return;
    this.into(rect);
    gl.useProgram(map);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.uniform1i(gl.getUniformLocation(map, "u_map"), 0);
    gl.uniform1i(gl.getUniformLocation(map, "u_table"), 1);
    gl.disableVertexAttribArray(0);
    gl.disableVertexAttribArray(1);
    this.set(map, "u_polar", polar ? 1 : 0);
    this.set(map, "u_rows", rows[0]!, rows[1]!);
    this.set(map, "u_columns", columns[0]!, columns[1]!);
    this.set(map, "u_view", view.x, view.y, view.scale, 0);
    this.set(map, "u_screen", rect.width, rect.height);
    this.set(map, "u_window", window[0], window[1]);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** How many colours the middle of the drawing has; a blank one has one. */
  colourCount(): number {
    const { gl, canvas } = this;
    const data = new Uint8Array(canvas.width * canvas.height * 4);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, data);
    return new Set(new Uint32Array(data.buffer)).size;
  }
}
