// Vectors and matrices (column by column, as WebGL takes them).
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
export const unit = (a) => { const n = norm(a); return n > 0 ? scale(a, 1 / n) : [0, 0, 1]; };

// Two directions across a third.
export function across(direction) {
  const d = unit(direction);
  const helper = Math.abs(d[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const first = unit(cross(helper, d));
  return [first, cross(d, first)];
}

// A parallel projection: what is `half` (m) above `center` is at the top of the picture.
export function projection(camera, aspect) {
  const { right, up, back } = axes(camera);
  const h = camera.half, w = h * aspect, d = camera.depth, c = camera.center;
  return new Float32Array([
    right[0] / w, up[0] / h, -back[0] / d, 0,
    right[1] / w, up[1] / h, -back[1] / d, 0,
    right[2] / w, up[2] / h, -back[2] / d, 0,
    -dot(right, c) / w, -dot(up, c) / h, dot(back, c) / d, 1,
  ]);
}

// Where the camera's own axes point: to the right, up, and toward who looks.
export function axes(camera) {
  const { azimuth: a, elevation: e } = camera;
  const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
  const right = [-Math.sin(a), Math.cos(a), 0];
  return { right, up: cross(back, right), back };
}

// The normals of a surface: means of the triangles around each point, weighted by their areas.
export function normals(points, triangles, out) {
  out.fill(0);
  for (let t = 0; t < triangles.length; t += 3) {
    const i = 3 * triangles[t], j = 3 * triangles[t + 1], k = 3 * triangles[t + 2];
    const ax = points[j] - points[i], ay = points[j + 1] - points[i + 1], az = points[j + 2] - points[i + 2];
    const bx = points[k] - points[i], by = points[k + 1] - points[i + 1], bz = points[k + 2] - points[i + 2];
    const x = ay * bz - az * by, y = az * bx - ax * bz, z = ax * by - ay * bx;
    for (const corner of [i, j, k]) { out[corner] += x; out[corner + 1] += y; out[corner + 2] += z; }
  }
  return out; // the shader makes them units
}
