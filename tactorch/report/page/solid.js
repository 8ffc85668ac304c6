// The body in 3-D: translucent, with the surface where the modulus passes a value, and a cut.

const turn = { yaw: 0.6, pitch: 0.42, zoom: 1 }; // radians; shared by the views of all runs
const solid = { level: 0, axis: -1, keep: 1 };
const VIEWS = {
  oblique: [0.6, 0.42], x: [Math.PI / 2, 0], y: [0, 0], z: [0, Math.PI / 2],
};
const NONE = "The 3-D view needs WebGL, which this browser does not offer or has switched off." +
  " The slices below show the same map.";

const VERTEX = `
attribute vec3 position, normal, colour;
uniform mat4 view;
varying vec3 at, outward, paint;
void main() {
  at = position;
  outward = normal;
  paint = colour;
  gl_Position = view * vec4(position, 1.0);
}`;

// Light comes from the eye. What faces it is clearer; rims are denser, as those of glass.
const FRAGMENT = `
precision highp float;
varying vec3 at, outward, paint;
uniform vec4 plane;
uniform vec3 eye;
uniform float clear, lit;
void main() {
  if (dot(plane.xyz, at) > plane.w) discard;
  float size = length(outward);
  float facing = size > 0.0 ? abs(dot(outward, eye)) / size : 1.0;
  float shine = lit > 0.0 ? 0.6 + 0.4 * facing + 0.2 * pow(facing, 16.0) : 1.0;
  float alpha = lit > 0.0 && clear < 1.0 ? mix(min(1.0, 3.0 * clear), clear, facing) : clear;
  gl_FragColor = vec4(min(paint * shine, 1.0) * alpha, alpha);
}`;

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw Error(gl.getProgramInfoLog(made));
  gl.useProgram(made);
  return made;
}

// The axes of the picture in the body's: right, up, and away from the eye.
function camera() {
  const [cy, sy, cp, sp] =
    [Math.cos(turn.yaw), Math.sin(turn.yaw), Math.cos(turn.pitch), Math.sin(turn.pitch)];
  const right = [cy, sy, 0], away = [-sy * cp, cy * cp, -sp];
  return { right, away, up: cross(right, away) };
}

class View {
  constructor(place, run) {
    Object.assign(this, { place, run, surfaces: {} });
    this.canvas = one("canvas.gl", place);
    this.overlay = one("canvas.overlay", place);
    this.gl = this.canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl) {
      this.canvas.hidden = this.overlay.hidden = true;
      one(".none", place).hidden = false;
      one(".none", place).textContent = NONE;
      return;
    }
    this.begin();
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.begin();
      changed();
    });
    steer(this.canvas);
  }

  begin() {
    const { gl, run } = this;
    this.program = program(gl);
    this.names = Object.fromEntries(["view", "plane", "eye", "clear", "lit"].map(
      (name) => [name, gl.getUniformLocation(this.program, name)]));
    this.surfaces = {};
    this.shown = {};
    this.put("body", ...triangles(run, run.surface));
    this.put("touched", ...triangles(run, run.contact.flatMap((c) => [...c.triangles])));
    this.put("edges", edges(run));
    this.put("box", boxEdges(run.bounds));
  }

  put(name, position, normal, colour) {
    const { gl } = this, held = this.surfaces[name] || (this.surfaces[name] = {});
    for (const [what, list] of Object.entries({ position, normal, colour })) {
      if (!list) continue;
      held[what] = held[what] || gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, held[what]);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(list), gl.STATIC_DRAW);
    }
    held.count = position.length / 3;
  }

  paint(name, { colour = [0, 0, 0], clear = 1, lit = true, mode, plane }) {
    const { gl, names } = this, held = this.surfaces[name];
    if (!held || !held.count) return;
    for (const what of ["position", "normal", "colour"]) {
      const where = gl.getAttribLocation(this.program, what);
      if (held[what]) {
        gl.bindBuffer(gl.ARRAY_BUFFER, held[what]);
        gl.enableVertexAttribArray(where);
        gl.vertexAttribPointer(where, 3, gl.FLOAT, false, 0, 0);
      } else {
        gl.disableVertexAttribArray(where);
        gl.vertexAttrib3fv(where, what === "colour" ? colour : [0, 0, 0]);
      }
    }
    gl.uniform4fv(names.plane, plane);
    gl.uniform1f(names.clear, clear);
    gl.uniform1f(names.lit, lit ? 1 : 0);
    gl.drawArrays(mode === undefined ? gl.TRIANGLES : mode, 0, held.count);
  }

  draw() {
    if (!this.gl || this.gl.isContextLost()) return;
    const width = this.place.clientWidth, height = this.place.clientHeight;
    const sharpness = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [width, height].map((size) => Math.max(1, Math.round(size * sharpness)));
    if (this.canvas.width !== w) this.canvas.width = w;
    if (this.canvas.height !== h) this.canvas.height = h;
    this.refresh();
    this.frame(width, height);
    this.scene(w, h);
    this.label(width, height);
  }

  // Make anew what follows from the controls.
  refresh() {
    const { run, shown } = this, at = state.at[solid.axis];
    if (shown.level !== solid.level) {
      const { positions, normals } = isosurface(run, solid.level);
      this.put("level", positions, normals);
    }
    const look = [solid.axis, at, state.colours, state.log].join();
    if (shown.look !== look) this.put("cut", ...cap(run, solid.axis, at));
    this.shown = { level: solid.level, look };
  }

  frame(width, height) {
    const { right, up, away } = camera(), [low, high] = bounds;
    const middle = low.map((v, a) => 0.5 * (v + high[a]));
    const reach = 0.5 * Math.hypot(...high.map((v, a) => v - low[a]));
    const scale = (0.84 * turn.zoom * Math.min(width, height)) / (2 * reach); // pixels a mm
    this.project = (p) => {
      const from = p.map((v, a) => v - middle[a]);
      return [width / 2 + scale * dot(right, from), height / 2 - scale * dot(up, from)];
    };
    const rows = [right.map((v) => (2 * scale * v) / width), up.map((v) => (2 * scale * v) / height),
      away.map((v) => v / (1.05 * reach))];
    this.matrix = [0, 1, 2].flatMap((a) => [...rows.map((row) => row[a]), 0]);
    this.matrix.push(...rows.map((row) => -dot(row, middle)), 1);
    this.away = away;
  }

  scene(w, h) {
    const { gl, names, run } = this;
    const grey = state.colours === "ultrasound", dark = ink("scheme") === "dark";
    const neutral = dark ? [0.75, 0.79, 0.84] : [0.42, 0.47, 0.53];
    const whole = [0, 0, 0, 1], plane = [0, 0, 0, 1];
    if (solid.axis >= 0) {
      plane[solid.axis] = solid.keep;
      plane[3] = solid.keep * state.at[solid.axis] + run.nudge;
    }
    gl.viewport(0, 0, w, h);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true); // else the depth would not be cleared
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(names.view, false, this.matrix);
    gl.uniform3fv(names.eye, this.away);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const colour = colourOf("youngs", solid.level).map((v) => v / 255);
    this.paint("level", { colour, plane });
    if (solid.axis >= 0) {
      gl.enable(gl.POLYGON_OFFSET_FILL); // where the surface meets the cut, the cut is seen
      gl.polygonOffset(-1, -1);
      this.paint("cut", { lit: false, plane: whole });
      gl.disable(gl.POLYGON_OFFSET_FILL);
    }
    this.paint("edges", { colour: neutral, lit: false, mode: gl.LINES, plane });
    gl.depthMask(false);
    this.paint("box", { colour: neutral, clear: 0.3, lit: false, mode: gl.LINES, plane: whole });
    gl.enable(gl.CULL_FACE);
    for (const side of [gl.FRONT, gl.BACK]) {
      gl.cullFace(side);
      this.paint("body", { colour: neutral, clear: dark ? 0.1 : 0.09, plane });
    }
    gl.disable(gl.CULL_FACE);
    gl.depthFunc(gl.LEQUAL);
    const touch = grey ? neutral : [0.835, 0.369, 0];
    this.paint("touched", { colour: touch, clear: 0.1, lit: false, plane });
    gl.depthFunc(gl.LESS);
  }

  // Millimetres along one edge of the box for each axis: the lowest in the picture, or leftmost.
  label(width, height) {
    const g = prepared(this.overlay, width, height), [low, high] = this.run.bounds;
    g.fillStyle = g.strokeStyle = ink("soft");
    g.textBaseline = "middle";
    const written = [];
    for (const axis of [0, 1, 2]) {
      const [b, c] = [0, 1, 2].filter((a) => a !== axis);
      const edge = [[low, low], [low, high], [high, low], [high, high]].map(([p, q]) => {
        const start = [], end = [];
        start[axis] = low[axis];
        end[axis] = high[axis];
        start[b] = end[b] = p[b];
        start[c] = end[c] = q[c];
        return { start, end, middle: this.project(start.map((v, a) => 0.5 * (v + end[a]))) };
      }).sort((p, q) => axis < 2 ? q.middle[1] - p.middle[1] : p.middle[0] - q.middle[0])[0];
      const ends = [this.project(edge.start), this.project(edge.end)];
      const length = Math.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]);
      if (length < 30) continue;
      let out = [ends[0][1] - ends[1][1], ends[1][0] - ends[0][0]].map((v) => v / length);
      const [mx, my] = edge.middle;
      if (out[0] * (mx - width / 2) + out[1] * (my - height / 2) < 0) out = out.map((v) => -v);
      g.textAlign = Math.abs(out[0]) < 0.4 ? "center" : out[0] > 0 ? "left" : "right";
      for (const tick of ticks(low[axis], high[axis], clamp(Math.floor(length / 40), 1, 5))) {
        const place = [...edge.start];
        place[axis] = tick;
        const [x, y] = this.project(place);
        g.beginPath();
        g.moveTo(x, y);
        g.lineTo(x + 4 * out[0], y + 4 * out[1]);
        g.stroke();
        const at = [x + 9 * out[0], y + 10 * out[1]];
        if (written.some(([p, q]) => Math.hypot(p - at[0], q - at[1]) < 17)) continue;
        written.push(at);
        g.fillText(number(tick), ...at);
      }
      g.fillText(`${AXES[axis]} (mm)`, mx + 30 * out[0], my + 26 * out[1]);
    }
    const told =
      `3-D view of ${this.run.name}: the surface where Young's modulus passes ` +
      `${number(solid.level)} MPa, within the translucent body` +
      (solid.axis < 0 ? "" : `, cut across ${AXES[solid.axis]} at ${mm(state.at[solid.axis])} mm`);
    this.canvas.setAttribute("aria-label", told);
    one(".paper", this.place).textContent = told;
  }

  // A picture for paper.
  still() {
    if (!this.gl) return;
    const flat = document.createElement("canvas");
    flat.width = this.canvas.width;
    flat.height = this.canvas.height;
    const g = flat.getContext("2d");
    g.drawImage(this.canvas, 0, 0);
    g.drawImage(this.overlay, 0, 0, flat.width, flat.height);
    const image = one("img.still", this.place);
    image.src = flat.toDataURL("image/png");
    image.alt = this.canvas.getAttribute("aria-label");
  }
}

function triangles(run, list) {
  const position = [], normal = [];
  for (let t = 0; t < list.length; t += 3) {
    const p = [0, 1, 2].map((k) => [...run.points.subarray(3 * list[t + k], 3 * list[t + k] + 3)]);
    const [a, b] = [1, 2].map((k) => p[k].map((v, d) => v - p[0][d]));
    const n = cross(a, b), size = Math.hypot(...n) || 1;
    for (const q of p) {
      position.push(...q);
      normal.push(...n.map((v) => v / size));
    }
  }
  return [position, normal];
}

// Edges of the body where its surface bends by more than some 30 degrees.
function edges(run) {
  const [, normal] = triangles(run, run.surface), open = new Map(), found = [];
  for (let t = 0; t < run.surface.length; t++) {
    const i = run.surface[t], j = run.surface[t % 3 === 2 ? t - 2 : t + 1];
    const key = i < j ? `${i},${j}` : `${j},${i}`, n = normal.slice(3 * t, 3 * t + 3);
    if (open.has(key) && dot(open.get(key), n) < 0.86)
      for (const k of [i, j]) found.push(...run.points.subarray(3 * k, 3 * k + 3));
    open.set(key, n);
  }
  return found;
}

function boxEdges([low, high]) {
  const found = [];
  for (let i = 0; i < 8; i++)
    for (let axis = 0; axis < 3; axis++)
      if (!(i & (1 << axis)))
        for (const k of [i, i | (1 << axis)])
          found.push(...[0, 1, 2].map((a) => (k & (1 << a) ? high[a] : low[a])));
  return found;
}

// The face of a cut, each element in its colour.
function cap(run, axis, at) {
  const position = [], colour = [];
  if (axis < 0) return [position, null, colour];
  const { corners, ends, elements } = cut(run, axis, at), [across, up] = PLANE[axis];
  elements.forEach((element, e) => {
    const paint = colourOf("youngs", run.fields.youngs[element]).map((v) => v / 255);
    for (let k = ends[e] + 1; k + 1 < ends[e + 1]; k++)
      for (const i of [ends[e], k, k + 1]) {
        const p = [];
        p[axis] = at;
        p[across] = corners[2 * i];
        p[up] = corners[2 * i + 1];
        position.push(...p);
        colour.push(...paint);
      }
  });
  return [position, null, colour];
}

// ------------------------------------------------------------ hands and keys

function rotate(yaw, pitch) {
  turn.yaw += yaw;
  turn.pitch = clamp(turn.pitch + pitch, -Math.PI / 2, Math.PI / 2);
  changed();
}

function enlarge(factor) {
  turn.zoom = clamp(turn.zoom * factor, 0.4, 5);
  changed();
}

function steer(canvas) {
  const held = new Map();
  const spread = () => {
    const [a, b] = [...held.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const apart = held.size === 2 && spread();
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (held.size === 2) enlarge(spread() / Math.max(apart, 1));
    else rotate(-0.01 * (event.clientX - before[0]), 0.01 * (event.clientY - before[1]));
  });
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return; // the page scrolls
    event.preventDefault();
    enlarge(Math.exp(-0.01 * event.deltaY));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => rotate(0.1, 0), ArrowRight: () => rotate(-0.1, 0),
    ArrowUp: () => rotate(0, -0.1), ArrowDown: () => rotate(0, 0.1),
    "+": () => enlarge(1.15), "=": () => enlarge(1.15), "-": () => enlarge(1 / 1.15),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });
}

let views = [];

function makeSolid() {
  views = all(".view").map((place, index) => {
    one(".label", place).textContent = runs.length > 1 ? runs[index].name : "";
    return new View(place, runs[index]);
  });
  if (views.every((view) => !view.gl)) {
    one("#solid-controls").hidden = true;
    return;
  }
  const fields = runs.map(nodal);
  const low = Math.min(...fields.map((f) => f.reduce((a, b) => Math.min(a, b), Infinity)));
  const high = Math.max(...fields.map((f) => f.reduce((a, b) => Math.max(a, b), 0)));
  const slider = one("#level"), share = (value) => Math.log(value / low) / Math.log(high / low);
  const levels = runs.map((run) => run.level).filter((level) => level).sort((a, b) => a - b);
  const told = levels[(levels.length - 1) >> 1];
  solid.level = told ? clamp(told, low, high) : Math.sqrt(low * high);
  slider.value = high > low ? 1000 * share(solid.level) : 500;
  slider.addEventListener("input", () => {
    solid.level = low * (high / low) ** (slider.value / 1000);
    changed();
  });
  one("#cut").addEventListener("change", (event) => {
    solid.axis = event.target.value === "" ? -1 : Number(event.target.value);
    // What lies before the cut, as the eye sees it, is taken away.
    if (solid.axis >= 0) solid.keep = camera().away[solid.axis] > 0 ? -1 : 1;
    one("#cut-flip").checked = false;
    changed();
  });
  one("#cut-at").addEventListener("input", (event) => {
    const [low, high] = [bounds[0][solid.axis], bounds[1][solid.axis]];
    state.at[solid.axis] = low + (high - low) * (event.target.value / 1000);
    changed();
  });
  one("#cut-flip").addEventListener("change", () => {
    solid.keep = -solid.keep;
    changed();
  });
  for (const button of all("[data-view]"))
    button.addEventListener("click", () => {
      [turn.yaw, turn.pitch] = VIEWS[button.dataset.view];
      turn.zoom = 1;
      changed();
    });
}

function drawSolid() {
  const { axis } = solid, at = one("#cut-at");
  one("#level-out").textContent = `${number(solid.level)} MPa`;
  one("#level").setAttribute("aria-valuetext", `${number(solid.level)} MPa`);
  for (const control of all("#cut-place, #flip")) control.hidden = axis < 0;
  one("#cut-out").textContent = axis < 0 ? "" : `${mm(state.at[axis])} mm`;
  if (axis >= 0) {
    const share = (state.at[axis] - bounds[0][axis]) / (bounds[1][axis] - bounds[0][axis]);
    at.value = 1000 * share;
    at.setAttribute("aria-valuetext", `${AXES[axis]} = ${mm(state.at[axis])} mm`);
  }
  for (const view of views) view.draw();
}
