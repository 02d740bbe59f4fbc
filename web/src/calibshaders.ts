// Shaders of the calibration page.

export const POINTS = {
  vertex: `#version 300 es
in vec4 place;
in float value;
uniform float u_mode, u_scale, u_size, u_low, u_reach, u_by, u_row, u_k3;
uniform vec4 u_pose, u_view, u_lens, u_bent, u_flat;
uniform vec2 u_screen;
uniform mat4 u_camera;
uniform sampler2D u_table;
out vec4 v_colour;
vec2 fromAbove(vec3 p) {
  vec2 q = vec2(u_pose.x * p.x - u_pose.y * p.y, u_pose.y * p.x + u_pose.x * p.y) + u_pose.zw;
  return vec2(-(q.y - u_view.y), q.x - u_view.x) * u_view.z * 2.0 / u_screen;
}
vec2 intoPicture(vec3 p, out bool seen) {
  vec3 q = (u_camera * vec4(p, 1.0)).xyz;
  seen = q.z > 0.3;
  vec2 n = q.xy / max(q.z, 0.01);
  float r2 = dot(n, n);
  seen = seen && r2 < 4.0;
  float radial = 1.0 + r2 * (u_bent.x + r2 * (u_bent.y + r2 * u_k3));
  vec2 bent = n * radial + vec2(2.0 * u_bent.z * n.x * n.y + u_bent.w * (r2 + 2.0 * n.x * n.x), u_bent.z * (r2 + 2.0 * n.y * n.y) + 2.0 * u_bent.w * n.x * n.y);
  vec2 at = (bent * u_lens.xy + u_lens.zw + 0.5) * u_view.x + u_view.yz;
  return vec2(at.x / u_screen.x * 2.0 - 1.0, 1.0 - at.y / u_screen.y * 2.0);
}
vec2 byDirection(vec3 p) {
  vec2 at = (vec2(atan(p.y, p.x), atan(p.z, length(p.xy))) - u_view.xy) / (u_view.zw - u_view.xy);
  return vec2(at.x * 2.0 - 1.0, 1.0 - at.y * 2.0);
}
void main() {
  vec3 p = place.xyz * u_scale;
  bool seen = true;
  vec2 at = u_mode < 0.5 ? fromAbove(p) : u_mode < 1.5 ? intoPicture(p, seen) : byDirection(p);
  float range = length(p);
  seen = seen && p.z > u_low && range < 1000.0;
  float t = u_by > 1.5 ? value : 1.0 - range / u_reach;
  v_colour = u_by > 0.5 ? texture(u_table, vec2(clamp(t, 0.0, 1.0), (u_row + 0.5) / 4.0)) : u_flat;
  if (u_by > 1.5 && value < 0.35) seen = false;
  gl_Position = seen ? vec4(at, 0.0, 1.0) : vec4(9.0, 9.0, 9.0, 1.0);
  gl_PointSize = u_by > 1.5 ? u_size * (0.5 + value) : u_size;
}`,
  fragment: `#version 300 es
precision mediump float;
in vec4 v_colour;
out vec4 colour;
void main() { colour = v_colour; }`,
};

export const RADAR_MAP = {
  vertex: `#version 300 es
out vec2 v_at;
void main() {
  v_at = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(v_at, 0.0, 1.0);
}`,
  fragment: `#version 300 es
precision highp float;
in vec2 v_at;
out vec4 colour;
uniform sampler2D u_map, u_table;
uniform float u_polar;
uniform vec2 u_rows, u_columns, u_screen, u_window;
uniform vec4 u_view;
void main() {
  vec2 p = u_view.xy + vec2(v_at.y * u_screen.y, -v_at.x * u_screen.x) * 0.5 / u_view.z;
  vec2 cell = u_polar > 0.5 ? vec2(atan(p.y, p.x), length(p)) : vec2(p.x, p.y);
  vec2 uv = vec2((cell.x - u_columns.x) / (u_columns.y - u_columns.x), (cell.y - u_rows.x) / (u_rows.y - u_rows.x));
  if (any(lessThan(uv, vec2(0.0))) || any(greaterThan(uv, vec2(1.0)))) discard;
  float level = texture(u_map, uv).r;
  if (level == 0.0) discard;
  float t = clamp((level - u_window.x) / (u_window.y - u_window.x), 0.0, 1.0);
  colour = vec4(texture(u_table, vec2(t, 2.5 / 4.0)).rgb, 1.0);
}`,
};
