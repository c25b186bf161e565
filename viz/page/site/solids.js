// Meshes of marks: arrows, balls and lines, as {points, triangles, normals}.
import { across, add, scale, norm, unit } from "./algebra.js";

class Builder {
  constructor() { this.points = []; this.normals = []; this.triangles = []; }
  ring(center, first, second, radius, slope, along, count) {
    const start = this.points.length / 3;
    for (let k = 0; k < count; k++) {
      const c = Math.cos(2 * Math.PI * k / count), s = Math.sin(2 * Math.PI * k / count);
      const out = add(scale(first, c), scale(second, s));
      this.points.push(...add(center, scale(out, radius)));
      this.normals.push(...add(out, scale(along, slope)));
    }
    return start;
  }
  join(a, b, count) {
    for (let k = 0; k < count; k++) {
      const n = (k + 1) % count;
      this.triangles.push(a + k, a + n, b + n, a + k, b + n, b + k);
    }
  }
  mesh() {
    return { points: new Float32Array(this.points), normals: new Float32Array(this.normals), triangles: new Uint32Array(this.triangles) };
  }
}

// Arrows from rows of start and vector (6 numbers each); width: of the shaft.
export function arrows(rows, width) {
  const builder = new Builder(), count = 18;
  for (let r = 0; r + 5 < rows.length; r += 6) {
    const start = Array.from(rows.slice(r, r + 3)), vector = Array.from(rows.slice(r + 3, r + 6));
    const length = norm(vector);
    if (!(length > 0)) continue;
    const along = unit(vector), [first, second] = across(along), radius = width / 2;
    const head = Math.min(0.45 * length, 3.4 * width), neck = add(start, scale(along, length - head));
    const none = [0, 0, 0];
    const foot = builder.ring(start, first, second, 0, -9, along, count);
    const base = builder.ring(start, first, second, radius, -9, along, count);
    const low = builder.ring(start, first, second, radius, 0, none, count);
    const high = builder.ring(neck, first, second, radius, 0, none, count);
    const under = builder.ring(neck, first, second, radius, -9, along, count);
    const rim = builder.ring(neck, first, second, 3 * radius, -9, along, count);
    const cone = builder.ring(neck, first, second, 3 * radius, 0.4, along, count);
    const tip = builder.ring(add(start, vector), first, second, 0, 0.4, along, count);
    for (const [a, b] of [[foot, base], [low, high], [under, rim], [cone, tip]]) builder.join(a, b, count);
  }
  return builder.mesh();
}

// Balls at points (3 numbers each).
export function balls(points, radius) {
  const builder = new Builder(), count = 16, rows = 9;
  for (const center of points) {
    let before = null;
    for (let i = 0; i <= rows; i++) {
      const angle = Math.PI * i / rows, s = Math.sin(angle), c = Math.cos(angle);
      const ring = builder.points.length / 3;
      for (let k = 0; k < count; k++) {
        const out = [s * Math.cos(2 * Math.PI * k / count), s * Math.sin(2 * Math.PI * k / count), c];
        builder.points.push(...add(center, scale(out, radius)));
        builder.normals.push(...out);
      }
      if (before !== null) builder.join(ring, before, count);
      before = ring;
    }
  }
  return builder.mesh();
}

// A tube along a path of points.
export function tube(path, radius) {
  const builder = new Builder(), count = 10;
  let before = null;
  for (let k = 0; k < path.length; k++) {
    const along = unit([0, 1, 2].map((i) => path[Math.min(k + 1, path.length - 1)][i] - path[Math.max(k - 1, 0)][i]));
    const [first, second] = across(along);
    const ring = builder.ring(path[k], first, second, radius, 0, along, count);
    if (before !== null) builder.join(before, ring, count);
    before = ring;
  }
  return builder.mesh();
}
