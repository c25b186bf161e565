// Draws meshes with WebGL 2: lit surfaces, flat shadows, and nothing else.
const VERTEX = `#version 300 es
in vec3 point; in vec3 normal; in vec3 color;
uniform mat4 view; uniform float flatten; uniform float level;
out vec3 n; out vec3 c;
void main() {
  n = normal; c = color;
  vec3 p = flatten > 0.5 ? vec3(point.xy, level) : point;
  gl_Position = view * vec4(p, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 n; in vec3 c;
uniform vec3 back; uniform vec3 up; uniform vec3 right; uniform float lit; uniform float alpha;
out vec4 pixel;
void main() {
  vec3 m = normalize(n + vec3(1e-30));
  if (dot(m, back) < 0.0 && lit > 1.5) m = -m;
  float key = max(dot(m, normalize(back + 0.8 * up - 0.5 * right)), 0.0);
  float fill = max(dot(m, normalize(back - 0.3 * up + 0.9 * right)), 0.0);
  float shine = pow(max(dot(m, normalize(2.0 * back + 0.8 * up - 0.5 * right)), 0.0), 40.0);
  vec3 shaded = c * (0.46 + 0.46 * key + 0.16 * fill) + 0.10 * shine;
  pixel = vec4(lit > 0.5 ? shaded : c, alpha);
}`;

export class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = this.gl = canvas.getContext("webgl2", { antialias: false, alpha: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL 2, which draws the body. Use a current Firefox, Chrome, Edge or Safari, and allow " +
      "hardware acceleration; or draw the scene with: magmpm run SCENE --render");
    this.program = this.linked();
    this.place = Object.fromEntries(["view", "flatten", "level", "back", "up", "right", "lit", "alpha"].map(
      (name) => [name, gl.getUniformLocation(this.program, name)]));
    this.meshes = new Map();
    this.smooth = gl.createFramebuffer();
    this.layers = [gl.createRenderbuffer(), gl.createRenderbuffer()];
    this.slow = true; // whether smooth edges cost so much that they are drawn only when nothing moves
  }

  // A frame buffer with several samples a pixel, as large as the canvas.
  sampled() {
    const gl = this.gl, { width, height } = this.canvas, samples = Math.min(4, gl.getParameter(gl.MAX_SAMPLES));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.smooth);
    if (this.size === `${width} ${height}`) return;
    this.size = `${width} ${height}`;
    const kinds = [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]];
    kinds.forEach(([kind, place], k) => {
      gl.bindRenderbuffer(gl.RENDERBUFFER, this.layers[k]);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, kind, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, this.layers[k]);
    });
  }

  // See how long a picture with smooth edges takes: a processor that draws in place of a graphics card is slow.
  judge(draw) {
    const gl = this.gl, begun = performance.now();
    draw();
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const look = () => {
      const spent = performance.now() - begun;
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED || spent > 200) this.slow = spent > 25;
      else setTimeout(look, 2);
    };
    setTimeout(look, 2);
  }

  linked() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    ["point", "normal", "color"].forEach((name, k) => gl.bindAttribLocation(program, k, name));
    gl.linkProgram(program);
    return program;
  }

  // Put a mesh in place of one of this name. mesh: {points, normals, triangles}; how: {color or colors, lit, alpha, shadow, hollow, inset}.
  put(name, mesh, how) {
    const gl = this.gl;
    let kept = this.meshes.get(name);
    if (!kept) {
      kept = { array: gl.createVertexArray(), buffers: [0, 1, 2].map(() => gl.createBuffer()), index: gl.createBuffer() };
      this.meshes.set(name, kept);
    }
    gl.bindVertexArray(kept.array);
    [mesh.points, mesh.normals, how.colors].forEach((data, k) => {
      if (!data) { gl.disableVertexAttribArray(k); return; }
      gl.bindBuffer(gl.ARRAY_BUFFER, kept.buffers[k]);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(k);
      gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, kept.index);
    if (kept.triangles !== mesh.triangles) gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.triangles, gl.DYNAMIC_DRAW);
    gl.bindVertexArray(null);
    Object.assign(kept, { triangles: mesh.triangles, count: mesh.triangles.length, lit: 1, alpha: 1, shadow: false, hollow: false, inset: false,
      over: false, color: null }, how);
  }

  remove(name) { this.meshes.delete(name); }

  resize() {
    const { canvas } = this, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  }

  // look: {matrix, right, up, back}; level: height of the floor that takes shadows, or null; inset: {matrix, x, y, size} in CSS pixels.
  // fine: with smooth edges.
  draw(look, level, inset, fine) {
    const gl = this.gl, { canvas } = this;
    this.resize();
    if (fine) this.sampled();
    this.paint(look, level, inset);
    if (!fine) return;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.smooth);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    gl.blitFramebuffer(0, 0, canvas.width, canvas.height, 0, 0, canvas.width, canvas.height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  paint(look, level, inset) {
    const gl = this.gl;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(this.program);
    gl.uniformMatrix4fv(this.place.view, false, look.matrix);
    for (const name of ["back", "up", "right"]) gl.uniform3fv(this.place[name], look[name]);
    const all = [...this.meshes.values()];
    if (level !== null) {
      gl.uniform1f(this.place.flatten, 1);
      gl.uniform1f(this.place.level, level);
      for (const mesh of all) if (mesh.shadow) this.one(mesh, { lit: 0, color: mesh.shadow, alpha: 1 });
      gl.uniform1f(this.place.flatten, 0);
    }
    for (const mesh of all) if (!mesh.inset && !mesh.over && mesh.alpha === 1) this.one(mesh);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    for (const mesh of all) if (!mesh.inset && !mesh.over && mesh.alpha < 1) this.one(mesh);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    // What is inside the body shows through it: faintly where hidden would be lost, so drawn over it.
    gl.clear(gl.DEPTH_BUFFER_BIT);
    for (const mesh of all) if (mesh.over) this.one(mesh);
    const ratio = this.canvas.width / this.canvas.clientWidth;
    gl.viewport(inset.x * ratio, inset.y * ratio, inset.size * ratio, inset.size * ratio);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.place.view, false, inset.matrix);
    for (const mesh of all) if (mesh.inset) this.one(mesh);
  }

  one(mesh, other) {
    const gl = this.gl, how = other || mesh;
    if (!mesh.count) return;
    gl.bindVertexArray(mesh.array);
    if (!mesh.colors || other) {
      gl.disableVertexAttribArray(2);
      gl.vertexAttrib3fv(2, how.color);
    } else gl.enableVertexAttribArray(2);
    gl.uniform1f(this.place.lit, how.lit);
    gl.uniform1f(this.place.alpha, how.alpha);
    if (mesh.hollow && !other) { gl.enable(gl.CULL_FACE); gl.cullFace(gl.FRONT); }
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.CULL_FACE);
    gl.bindVertexArray(null);
  }
}
