/* The shaders. Places are whole steps of the lattice: the view's origin is subtracted before they
   become floats, so that the deepest zoom is exact. */
const PLACE = `
uniform ivec2 origin; uniform vec2 rest; uniform mat2 turn;
vec2 placed(ivec2 step) { return turn * (vec2(step - origin) - rest); }`;

/** Triangles in colours or by value, one for each triangle ("flat") or between nodes ("smooth"). */
const trianglesVertex = (how) => `${PLACE}
layout(location=0) in ivec2 step; layout(location=1) in vec4 color; layout(location=2) in uint code;
layout(location=3) in float light;
uniform bool byValue; uniform vec2 cut;
${how} out vec3 shade; ${how} out vec2 value; out float lit;
void main() {
  gl_Position = vec4(placed(step), 0, 1);
  shade = color.rgb;
  lit = light;
  value = byValue ? vec2((float(code) - cut.x) * cut.y, code == 65535u) : vec2(0);
}`;
const trianglesFragment = (how) => `
${how} in vec3 shade; ${how} in vec2 value; in float lit; uniform bool byValue; uniform float gain, brightness;
uniform int classes;
uniform highp sampler2D ramp; out vec4 result;
void main() {
  vec3 color = min(shade * gain, 1.);
  if (byValue) {
    int place = classes > 0 ? int(value.x + .5) % classes : int(clamp(value.x, 0., 255.));
    color = value.y > 0. ? vec3(.6) : texelFetch(ramp, ivec2(place, 0), 0).rgb;
  }
  result = vec4(min(color * lit * brightness, 1.), 1);
}`;

/** Lines of a width in device pixels: a strip of four corners for each pair of ends. */
const LINES_VERTEX = `${PLACE}
layout(location=0) in ivec2 from; layout(location=1) in ivec2 to;
uniform vec2 size; uniform float width; out float away;
void main() {
  vec2 a = placed(from), b = placed(to), along = (b - a) * size;
  vec2 across = length(along) > 0. ? normalize(vec2(-along.y, along.x)) : vec2(0, 1);
  float side = (gl_VertexID & 1) == 0 ? -1. : 1.;
  away = side * (width * .5 + 1.);
  gl_Position = vec4((gl_VertexID < 2 ? a : b) + across * away * 2. / size, 0, 1);
}`;
const LINES_FRAGMENT = `
in float away; uniform float width; uniform vec4 color; out vec4 result;
void main() {
  float alpha = color.a * clamp(width * .5 + .5 - abs(away), 0., 1.);
  result = vec4(color.rgb * alpha, alpha);
}`;

const NODES_VERTEX = `${PLACE}
layout(location=0) in ivec2 step; uniform float width;
void main() { gl_Position = vec4(placed(step), 0, 1); gl_PointSize = width; }`;
const NODES_FRAGMENT = `
uniform vec4 color; uniform float width; out vec4 result;
void main() {
  float away = length(gl_PointCoord - .5) * width, alpha = color.a * clamp(width * .5 - away, 0., 1.);
  result = vec4(color.rgb * alpha, alpha);
}`;

/** Pictures: corners in the lattice or on the screen, and their places in the picture. */
const PICTURE_VERTEX = `
layout(location=0) in vec4 corner; out vec2 at;
void main() { gl_Position = vec4(corner.xy, 0, 1); at = corner.zw; }`;
const PICTURE_FRAGMENT = `
in vec2 at; uniform highp sampler2D image; uniform float opacity, gain; out vec4 result;
void main() {
  vec4 color = texture(image, at);
  result = vec4(min(color.rgb * gain, color.a), color.a) * opacity;
}`;

/** Return the programs by name, each compiled when it is first used: that takes a while. */
function makePrograms(gl) {
  const texts = {
    flat: [trianglesVertex("flat"), trianglesFragment("flat")],
    smooth: [trianglesVertex("smooth"), trianglesFragment("smooth")],
    lines: [LINES_VERTEX, LINES_FRAGMENT],
    nodes: [NODES_VERTEX, NODES_FRAGMENT],
    picture: [PICTURE_VERTEX, PICTURE_FRAGMENT],
  };
  const made = {};
  return new Proxy(texts, { get: (_, name) => (made[name] ??= makeProgram(gl, ...texts[name])) });
}
