// The picture: the body with its marks, the camera that is turned by hand, and the scale bar.
import { add, axes, normals, norm, projection, scale, sub } from "./algebra.js";
import { Renderer } from "./renderer.js";
import { arrows, balls, tube } from "./solids.js";

const INSET = 150; // CSS pixels of the compass
const NICE = [1, 2, 5];
const STILL = 250; // ms without a new picture, after which a slow machine draws it with smooth edges
export const rgb = (code) => [1, 3, 5].map((k) => parseInt(code.slice(k, k + 2), 16) / 255);
const paler = (color, share) => color.map((c) => c + (1 - c) * share);

export class Stage {
  constructor(about) {
    this.about = about;
    this.canvas = document.getElementById("view");
    this.marks = document.getElementById("marks");
    this.renderer = new Renderer(this.canvas);
    this.surface = "";
    this.lowest = 0;
    this.shapes = 0; // drawn so far
    this.field = [0, 0, 0];
    this.largest = 1e-3; // T, of the compass
    this.waiting = [];
    this.frame();
    this.byHand();
    this.still();
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
  }

  // The camera sees all that a held body can reach around its middle; a free one where it is.
  frame(points) {
    const { length, box } = this.about;
    const [low, high] = points ?? box;
    const middle = scale(add(low, high), 0.5), size = points ? Math.max(norm(sub(high, low)) * 0.62, 0.5 * length) : 0.78 * length;
    const back = this.camera ?? { azimuth: -1.12, elevation: 0.34 };
    this.camera = { azimuth: back.azimuth, elevation: back.elevation, center: middle, half: size, depth: 60 * length };
    this.reach = size;
    this.redraw();
  }

  // What does not move: the target, the floor's lines, the axes of the compass.
  still() {
    const { target, thickness, colors, ground } = this.about;
    if (target) this.renderer.put("target", balls(target, 0.15 * thickness), { color: rgb(colors.target), over: true });
    this.floor(ground ? ground.point[2] : this.camera.center[2] - 0.97 * this.reach);
    for (const [name, axis] of [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]) {
      this.renderer.put("axis " + name, arrows([0, 0, 0, ...scale(axis, 0.62)], 0.035), { color: [0.62, 0.62, 0.62], inset: true });
    }
  }

  floor(level) {
    const { ground } = this.about;
    this.level = !ground || Math.abs(ground.normal[2]) > 0.999 ? level : null;
    if (this.level === null) return;
    const [cx, cy] = this.camera.center, step = this.bar(), n = 6, y = step * Math.round(cy / step), x = step * Math.round(cx / step);
    const points = [], width = 0.0035 * this.reach, lines = [];
    for (let k = -n; k <= n; k++) {
      lines.push([[x - n * step, y + k * step], [x + n * step, y + k * step], [0, width]]);
      lines.push([[x + k * step, y - n * step], [x + k * step, y + n * step], [width, 0]]);
    }
    const triangles = [], z = level - 0.004 * this.reach;
    for (const [a, b, w] of lines) {
      const first = points.length / 3;
      points.push(a[0] - w[0], a[1] - w[1], z, b[0] - w[0], b[1] - w[1], z, b[0] + w[0], b[1] + w[1], z, a[0] + w[0], a[1] + w[1], z);
      triangles.push(first, first + 1, first + 2, first, first + 2, first + 3);
    }
    const mesh = { points: new Float32Array(points), normals: new Float32Array(points.length).fill(1), triangles: new Uint32Array(triangles) };
    this.renderer.put("floor", mesh, { color: rgb(this.about.ground ? "#C9BFA8" : "#E9E9E6"), lit: 0 });
  }

  // A length for the scale bar and the floor's squares, m: round, a third of the picture's half at most.
  bar() {
    const wanted = 0.42 * this.camera.half, power = 10 ** Math.floor(Math.log10(wanted));
    return Math.max(...NICE.filter((f) => f * power <= wanted).map((f) => f * power));
  }

  // Show a shape: the header and arrays of a message of the server.
  show(message) {
    const { arrays } = message;
    if (arrays.triangles) {
      this.triangles = arrays.triangles;
      this.colors = arrays.colors;
      this.surface = message.surface;
    }
    if (message.obstacles) this.around(message.obstacles, arrays);
    if (this.normals?.length !== arrays.points.length) this.normals = new Float32Array(arrays.points.length);
    const mesh = { points: arrays.points, normals: normals(arrays.points, this.triangles, this.normals), triangles: this.triangles };
    this.points = arrays.points;
    this.renderer.put("body", mesh, { colors: this.colors, shadow: rgb("#E2E2DE"), color: [0.8, 0.8, 0.8] });
    const ink = rgb(this.about.colors.magnetization);
    this.renderer.put("arrows", arrows(arrays.arrows, message.arrow_width), { color: ink, over: true });
    this.lowest = Infinity;
    for (let k = 2; k < this.points.length; k += 3) this.lowest = Math.min(this.lowest, this.points[k]);
    this.setField(message.field ?? [0, 0, 0]);
    this.shapes += 1;
    this.redraw();
  }

  // A path, such as that of the tip, m.
  trace(path) {
    const mesh = tube(path, 0.02 * this.about.thickness + 0.0008 * this.about.length);
    this.renderer.put("trace", mesh, { color: rgb(this.about.colors.trace) });
  }

  around(obstacles, arrays) {
    for (const name of [...this.renderer.meshes.keys()]) if (name.startsWith("obstacle")) this.renderer.remove(name);
    for (const one of obstacles) {
      const points = arrays[one.id + ".points"], triangles = arrays[one.id + ".triangles"];
      const mesh = { points, triangles, normals: normals(points, triangles, new Float32Array(points.length)) };
      this.renderer.put(one.id, mesh, { color: rgb(one.color), hollow: one.hollow, alpha: one.hollow ? 0.55 : 1, lit: one.hollow ? 2 : 1 });
    }
    if (!this.obstacles) this.include(obstacles, arrays);
    this.obstacles = obstacles;
  }

  // Bring what stands near the body into view: magnets, as far as three lengths away.
  include(obstacles, arrays) {
    const { length } = this.about, low = sub(this.camera.center, [this.reach, this.reach, this.reach]);
    const high = add(this.camera.center, [this.reach, this.reach, this.reach]);
    let grown = false;
    for (const one of obstacles.filter((other) => /N, S|coil/.test(other.name))) {
      const points = arrays[one.id + ".points"], ends = [[0, 1, 2].map(() => Infinity), [0, 1, 2].map(() => -Infinity)];
      for (let k = 0; k < points.length; k++) {
        ends[0][k % 3] = Math.min(ends[0][k % 3], points[k]);
        ends[1][k % 3] = Math.max(ends[1][k % 3], points[k]);
      }
      if (norm(sub(scale(add(...ends), 0.5), this.camera.center)) > 3 * length) continue;
      for (let k = 0; k < 3; k++) {
        grown ||= ends[0][k] < low[k] || ends[1][k] > high[k];
        low[k] = Math.min(low[k], ends[0][k]);
        high[k] = Math.max(high[k], ends[1][k]);
      }
    }
    if (!grown) return;
    const back = { ...this.camera };
    Object.assign(this.camera, back, { center: scale(add(low, high), 0.5), half: 0.5 * norm(sub(high, low)) / Math.sqrt(2) });
    this.reach = this.camera.half;
    this.floor(this.about.ground ? this.about.ground.point[2] : low[2]);
  }

  setField(field) {
    this.field = field;
    const size = norm(field);
    this.largest = Math.max(this.largest, size);
    const arrow = size > 0 ? [...scale(field, -0.45 / this.largest), ...scale(field, 0.9 / this.largest)] : [];
    this.renderer.put("field", arrows([0, 0, 0, ...arrow.slice(3)], 0.085), { color: rgb(this.about.colors.field), inset: true });
  }

  // Draw again with the browser's next picture; `then` is called when it has been drawn.
  redraw(then) {
    if (then) this.waiting.push(then);
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.draw(!this.renderer.slow);
      clearTimeout(this.later);
      if (this.renderer.slow) this.later = setTimeout(() => this.smoothly(), STILL);
      for (const told of this.waiting.splice(0)) told();
    });
  }

  // With smooth edges, for nothing moves; the first time it is seen how long that takes.
  smoothly() {
    if (this.shapes && !this.judged) { this.judged = true; this.renderer.judge(() => this.draw()); } else this.draw();
  }

  draw(fine = true) {
    const { clientWidth: w, clientHeight: h } = this.canvas, look = axes(this.camera);
    const small = { ...this.camera, center: [0, 0, 0], half: 1.12, depth: 4 };
    const inset = { matrix: projection(small, 1), x: w - INSET - 12, y: 18, size: INSET };
    const level = this.level !== null && this.level < this.lowest && look.back[2] > 0.03 ? this.level : null;
    const floor = this.renderer.meshes.get("floor");
    if (floor) floor.count = level === null ? 0 : floor.triangles.length;
    this.renderer.draw({ matrix: projection(this.camera, w / h), ...look }, level, inset, fine);
    this.label(w, h, look);
  }

  // The scale bar, the names of the axes and the strength of the field.
  label(w, h, look) {
    const bar = this.bar(), pixels = bar / this.camera.half * h / 2, x = w / 2 - pixels / 2, y = h - 30;
    const text = bar >= 1e-3 ? `${+(1e3 * bar).toPrecision(3)} mm` : `${+(1e6 * bar).toPrecision(3)} µm`;
    const middle = [w - INSET / 2 - 12, h - 18 - INSET / 2], unit = INSET / 2 / 1.12;
    const at = (v) => [middle[0] + unit * (v[0] * look.right[0] + v[1] * look.right[1] + v[2] * look.right[2]),
      middle[1] - unit * (v[0] * look.up[0] + v[1] * look.up[1] + v[2] * look.up[2])];
    const names = [["x", [0.8, 0, 0]], ["y", [0, 0.8, 0]], ["z", [0, 0, 0.8]]].map(([name, v]) => {
      const [a, b] = at(v);
      return `<text x="${a}" y="${b + 5}" text-anchor="middle" class="axis">${name}</text>`;
    });
    const size = norm(this.field), mT = (1e3 * size).toPrecision(3);
    const strength = `<text x="${middle[0]}" y="${middle[1] - INSET / 2 - 8}" text-anchor="middle" class="field">` +
      `${size > 0 ? `field ${+mT} mT` : "no field"}</text>`;
    const ink = this.about.colors.ink;
    this.marks.innerHTML = `<path d="M${x} ${y - 5}v10M${x} ${y}h${pixels}M${x + pixels} ${y - 5}v10" stroke="${ink}" stroke-width="2" fill="none"/>` +
      `<text x="${w / 2}" y="${y - 9}" text-anchor="middle">${text}</text>` + strength + names.join("");
  }

  byHand() {
    const { canvas } = this;
    let last = null;
    canvas.addEventListener("pointerdown", (event) => { last = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { last = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      const dx = event.clientX - last[0], dy = event.clientY - last[1], { camera } = this;
      last = [event.clientX, event.clientY];
      if (event.shiftKey || event.buttons === 4) {
        const { right, up } = axes(camera), m = 2 * camera.half / canvas.clientHeight;
        camera.center = add(camera.center, add(scale(right, -dx * m), scale(up, dy * m)));
      } else this.turn(-0.008 * dx, 0.008 * dy);
      this.redraw();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.camera.half *= Math.exp(0.0012 * Math.max(-200, Math.min(200, event.deltaY)));
      this.redraw();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const turns = { ArrowLeft: [0.08, 0], ArrowRight: [-0.08, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] }[event.key];
      if (turns) { this.turn(...turns); event.preventDefault(); this.redraw(); }
    });
  }

  turn(azimuth, elevation) {
    this.camera.azimuth += azimuth;
    this.camera.elevation = Math.max(-1.55, Math.min(1.55, this.camera.elevation + elevation));
  }
}
