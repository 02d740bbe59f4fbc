// Every colour mode lives in the shader: changing it uploads nothing but the one byte a point that it shows, once.

export const MODES = { height: 0, range: 1, value: 2, flat: 3 } as const;

export const POINTS_VERTEX = /* glsl */ `
precision highp float;
in float value;
in float gate;
uniform float u_scale;
uniform vec3 u_offset;
uniform int u_mode;
uniform vec2 u_window;
uniform vec2 u_gate;
uniform vec2 u_keep;
uniform vec3 u_flat;
uniform float u_row;
uniform float u_size;
uniform float u_grow;
uniform sampler2D u_table;
out vec3 v_colour;

void main() {
  vec3 p = position * u_scale + u_offset;
  float r = length(p.xy);
  float t = u_mode == 0 ? p.z : u_mode == 1 ? r : value;
  t = clamp((t - u_window.x) / max(u_window.y - u_window.x, 1e-6), 0.0, 1.0);
  v_colour = u_mode == 3 ? u_flat : texture(u_table, vec2(t * 255.0 / 256.0 + 0.5 / 256.0, u_row)).rgb;
  vec4 place = projectionMatrix * modelViewMatrix * vec4(p, 1.0);
  bool hidden = gate < u_gate.x || gate > u_gate.y || r < u_keep.x || r > u_keep.y;
  gl_Position = hidden ? vec4(2.0, 2.0, 2.0, 1.0) : place;
  gl_PointSize = clamp(u_size * (1.0 + u_grow * r / 60.0), 1.0, 12.0);
}`;

export const POINTS_FRAGMENT = /* glsl */ `
precision mediump float;
in vec3 v_colour;
uniform float u_opacity;
out vec4 colour;
void main() {
  colour = vec4(v_colour, u_opacity);
}`;

/** The radar's power over range and azimuth (or over y and x), looked up for every pixel of a plane on the ground. */
export const POLAR_VERTEX = /* glsl */ `
out vec2 v_place;
void main() {
  v_place = position.xy;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

export const POLAR_FRAGMENT = /* glsl */ `
precision highp float;
in vec2 v_place;
uniform sampler2D u_power;
uniform sampler2D u_table;
uniform vec2 u_rows;
uniform vec2 u_columns;
uniform bool u_polar;
uniform vec2 u_window;
uniform float u_row;
uniform float u_opacity;
out vec4 colour;
void main() {
  vec2 place = u_polar ? vec2(atan(v_place.y, v_place.x), length(v_place)) : v_place;
  vec2 at = vec2((place.x - u_columns.x) / (u_columns.y - u_columns.x), (place.y - u_rows.x) / (u_rows.y - u_rows.x));
  if (any(lessThan(at, vec2(0.0))) || any(greaterThan(at, vec2(1.0)))) discard;
  float t = clamp((texture(u_power, at).r - u_window.x) / max(u_window.y - u_window.x, 1e-6), 0.0, 1.0);
  colour = vec4(texture(u_table, vec2(t * 255.0 / 256.0 + 0.5 / 256.0, u_row)).rgb, u_opacity * (0.25 + 0.75 * t));
}`;

/** A slice of the radar's power; where there is no cell nothing is drawn. */
export const SLICE_VERTEX = /* glsl */ `
out vec2 v_at;
void main() {
  v_at = uv;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

export const SLICE_FRAGMENT = /* glsl */ `
precision highp float;
in vec2 v_at;
uniform sampler2D u_power;
uniform sampler2D u_table;
uniform vec2 u_window;
uniform float u_row;
uniform float u_opacity;
out vec4 colour;
void main() {
  float power = texture(u_power, v_at).r;
  if (power <= 0.002) discard;
  float t = clamp((power - u_window.x) / max(u_window.y - u_window.x, 1e-6), 0.0, 1.0);
  colour = vec4(texture(u_table, vec2(t * 255.0 / 256.0 + 0.5 / 256.0, u_row)).rgb, u_opacity);
}`;
