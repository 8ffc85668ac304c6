// 3-D view: the translucent body with an isosurface of the modulus and a cut.

const orientation = { yaw: 0.6, pitch: 0.42, zoom: 1 }; // radians; shared by the views of all runs
const solid = { level: 0, axis: -1, keep: 1 };
const NEXT = [0.8, 0.2, 0.6]; // the next press
const VIEWS = {
  oblique: [0.6, 0.42], x: [Math.PI / 2, 0], y: [0, 0], z: [0, Math.PI / 2],
};
const NONE = "The 3-D view needs WebGL, which this browser does not support or has disabled." +
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

// A headlight; translucent surfaces are more opaque at their rims.
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

function createProgram(gl) {
  const linked = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(linked, shader);
  }
  gl.linkProgram(linked);
  if (!gl.getProgramParameter(linked, gl.LINK_STATUS)) throw Error(gl.getProgramInfoLog(linked));
  gl.useProgram(linked);
  return linked;
}

// Unit vectors of the picture: right, up, and away from the viewer.
function camera() {
  const [cy, sy, cp, sp] =
    [Math.cos(orientation.yaw), Math.sin(orientation.yaw), Math.cos(orientation.pitch), Math.sin(orientation.pitch)];
  const right = [cy, sy, 0], away = [-sy * cp, cy * cp, -sp];
  return { right, away, up: cross(right, away) };
}

class View {
  constructor(container, run) {
    Object.assign(this, { container, run, surfaces: {} });
    this.canvas = query("canvas.gl", container);
    this.overlay = query("canvas.overlay", container);
    this.gl = this.canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl) {
      this.canvas.hidden = this.overlay.hidden = true;
      query(".none", container).hidden = false;
      query(".none", container).textContent = NONE;
      return;
    }
    this.initialise();
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.initialise();
      scheduleRedraw();
    });
    addControls(this.canvas);
  }

  initialise() {
    const { gl, run } = this;
    this.program = createProgram(gl);
    this.names = Object.fromEntries(["view", "plane", "eye", "clear", "lit"].map(
      (name) => [name, gl.getUniformLocation(this.program, name)]));
    this.surfaces = {};
    this.put("body", ...expandTriangles(run, run.surface));
    this.put("edges", sharpEdges(run));
    this.put("box", boxEdges(run.bounds));
    this.renew();
  }

  // Take the map, the contact and the next press of the run as they are now.
  renew() {
    if (!this.gl) return;
    const { run } = this;
    this.shown = {};
    this.put("touched", ...expandTriangles(run, run.contact.flatMap((c) => [...c.triangles])));
    this.put("next", run.next ? circle(run.next) : []);
  }

  put(name, position, normal, colour) {
    const { gl } = this, buffers = this.surfaces[name] || (this.surfaces[name] = {});
    for (const [what, list] of Object.entries({ position, normal, colour })) {
      if (!list) continue;
      buffers[what] = buffers[what] || gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[what]);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(list), gl.STATIC_DRAW);
    }
    buffers.count = position.length / 3;
  }

  paint(name, { colour = [0, 0, 0], clear = 1, lit = true, mode, plane }) {
    const { gl, names } = this, buffers = this.surfaces[name];
    if (!buffers || !buffers.count) return;
    for (const what of ["position", "normal", "colour"]) {
      const where = gl.getAttribLocation(this.program, what);
      if (buffers[what]) {
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[what]);
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
    gl.drawArrays(mode === undefined ? gl.TRIANGLES : mode, 0, buffers.count);
  }

  draw() {
    if (!this.gl || this.gl.isContextLost()) return;
    const width = this.container.clientWidth, height = this.container.clientHeight;
    const sharpness = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [width, height].map((size) => Math.max(1, Math.round(size * sharpness)));
    if (this.canvas.width !== w) this.canvas.width = w;
    if (this.canvas.height !== h) this.canvas.height = h;
    this.refresh();
    this.frame(width, height);
    this.scene(w, h);
    this.label(width, height);
  }

  // Update surfaces that depend on the controls.
  refresh() {
    const { run, shown } = this, at = state.at[solid.axis];
    if (!this.showsLumps() && shown.level !== solid.level) {
      const { positions, normals } = isosurface(run, solid.level);
      this.put("level", positions, normals);
    }
    const look = [solid.axis, at, state.colours, state.log, state.own].join();
    if (shown.look !== look) {
      this.put("cut", ...cutFace(run, solid.axis, at));
      for (const kind of ["best", "outer"]) this.put(kind, ...lumpSurfaces(run, kind));
    }
    this.shown = { level: this.showsLumps() ? null : solid.level, look };
  }

  // Whether the surfaces of fitted inclusions are shown, rather than an isosurface of the field.
  showsLumps() {
    return !solid.chosen && this.run.lumps.some((lump) => lump.outer);
  }

  frame(width, height) {
    const { right, up, away } = camera(), [low, high] = bounds;
    const middle = low.map((v, a) => 0.5 * (v + high[a]));
    const reach = 0.5 * Math.hypot(...high.map((v, a) => v - low[a]));
    const scale = (0.84 * orientation.zoom * Math.min(width, height)) / (2 * reach); // pixels a mm
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
    const grey = state.colours === "ultrasound", dark = cssValue("scheme") === "dark";
    const neutral = dark ? [0.75, 0.79, 0.84] : [0.42, 0.47, 0.53];
    const whole = [0, 0, 0, 1], plane = [0, 0, 0, 1];
    if (solid.axis >= 0) {
      plane[solid.axis] = solid.keep;
      plane[3] = solid.keep * state.at[solid.axis] + run.nudge;
    }
    gl.viewport(0, 0, w, h);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true); // required to clear the depth buffer
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(names.view, false, this.matrix);
    gl.uniform3fv(names.eye, this.away);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const colour = colourOf("youngs", solid.level).map((v) => v / 255);
    if (this.showsLumps()) this.paint("best", { plane });
    else this.paint("level", { colour, plane });
    if (solid.axis >= 0) {
      gl.enable(gl.POLYGON_OFFSET_FILL); // the cut is in front of the isosurface
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
    if (this.showsLumps()) this.paint("outer", { clear: 0.12, plane });
    gl.depthFunc(gl.LEQUAL);
    const touch = grey ? neutral : [0.835, 0.369, 0];
    this.paint("touched", { colour: touch, clear: 0.1, lit: false, plane });
    gl.depthFunc(gl.LESS);
    this.paint("next", { colour: NEXT, lit: false, mode: gl.LINES, plane });
  }

  // Label one edge of the bounding box per axis, the lowest in the picture or the leftmost.
  label(width, height) {
    const g = prepareCanvas(this.overlay, width, height), [low, high] = this.run.bounds;
    g.fillStyle = g.strokeStyle = cssValue("soft");
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
        const end = [...edge.start];
        end[axis] = tick;
        const [x, y] = this.project(end);
        g.beginPath();
        g.moveTo(x, y);
        g.lineTo(x + 4 * out[0], y + 4 * out[1]);
        g.stroke();
        const at = [x + 9 * out[0], y + 10 * out[1]];
        if (written.some(([p, q]) => Math.hypot(p - at[0], q - at[1]) < 17)) continue;
        written.push(at);
        g.fillText(formatNumber(tick), ...at);
      }
      g.fillText(`${AXES[axis]} (mm)`, mx + 30 * out[0], my + 26 * out[1]);
    }
    const what = this.showsLumps()
      ? `the surface of each lump, of ${this.run.lumps.map((l) => `${formatNumber(l.youngs)} MPa`).join(", ")}, ` +
        "and a translucent one, outside of which points belong to it with a probability below 5 %"
      : `the isosurface of Young's modulus at ${formatNumber(solid.level)} MPa`;
    const label =
      `3-D view of ${this.run.name}: ${what}, in the translucent body` +
      (solid.axis < 0 ? "" : `, cut across ${AXES[solid.axis]} at ${formatMm(state.at[solid.axis])} mm`);
    this.canvas.setAttribute("aria-label", label);
    query(".paper", this.container).textContent = label;
  }

  // Image of the view for prints.
  still() {
    if (!this.gl) return;
    const flat = document.createElement("canvas");
    flat.width = this.canvas.width;
    flat.height = this.canvas.height;
    const g = flat.getContext("2d");
    g.drawImage(this.canvas, 0, 0);
    g.drawImage(this.overlay, 0, 0, flat.width, flat.height);
    const image = query("img.still", this.container);
    image.src = flat.toDataURL("image/png");
    image.alt = this.canvas.getAttribute("aria-label");
  }
}

// The rim of a round patch as lines, and its normal out of the body.
function circle({ center, inward, radius }) {
  const least = inward.map(Math.abs).indexOf(Math.min(...inward.map(Math.abs)));
  const side = cross(inward, [0, 1, 2].map((a) => (a === least ? 1 : 0)));
  const first = side.map((v) => v / Math.hypot(...side)), second = cross(inward, first);
  const lift = 0.02 * radius, points = [];
  const at = (k) => center.map((c, a) => c - lift * inward[a] + radius *
    (Math.cos((Math.PI * k) / 24) * first[a] + Math.sin((Math.PI * k) / 24) * second[a]));
  for (let k = 0; k < 48; k++) points.push(...at(k), ...at(k + 1));
  points.push(...center, ...center.map((c, a) => c - 1.5 * radius * inward[a]));
  return points;
}

// Triangles of one kind of surface of all lumps, each in the colour of its modulus.
function lumpSurfaces(run, kind) {
  const positions = [], normals = [], colours = [];
  for (const lump of run.lumps) {
    if (!lump[kind]) continue;
    const [position, normal] = expandTriangles(lump[kind], lump[kind].triangles);
    const paint = colourOf("youngs", lump.youngs, run).map((v) => v / 255);
    for (let k = 0; k < position.length; k++) {
      positions.push(position[k]);
      normals.push(normal[k]);
      colours.push(paint[k % 3]);
    }
  }
  return [positions, normals, colours];
}

function expandTriangles({ points }, list) {
  const position = [], normal = [];
  for (let t = 0; t < list.length; t += 3) {
    const p = [0, 1, 2].map((k) => [...points.subarray(3 * list[t + k], 3 * list[t + k] + 3)]);
    const [a, b] = [1, 2].map((k) => p[k].map((v, d) => v - p[0][d]));
    const n = cross(a, b), size = Math.hypot(...n) || 1;
    for (const q of p) {
      position.push(...q);
      normal.push(...n.map((v) => v / size));
    }
  }
  return [position, normal];
}

// Edges of the surface with a dihedral angle above about 30 degrees.
function sharpEdges(run) {
  const [, normal] = expandTriangles(run, run.surface), open = new Map(), points = [];
  for (let t = 0; t < run.surface.length; t++) {
    const i = run.surface[t], j = run.surface[t % 3 === 2 ? t - 2 : t + 1];
    const key = i < j ? `${i},${j}` : `${j},${i}`, n = normal.slice(3 * t, 3 * t + 3);
    if (open.has(key) && dot(open.get(key), n) < 0.86)
      for (const k of [i, j]) points.push(...run.points.subarray(3 * k, 3 * k + 3));
    open.set(key, n);
  }
  return points;
}

function boxEdges([low, high]) {
  const points = [];
  for (let i = 0; i < 8; i++)
    for (let axis = 0; axis < 3; axis++)
      if (!(i & (1 << axis)))
        for (const k of [i, i | (1 << axis)])
          points.push(...[0, 1, 2].map((a) => (k & (1 << a) ? high[a] : low[a])));
  return points;
}

// The face of a cut with the colour of each element.
function cutFace(run, axis, at) {
  const position = [], colour = [];
  if (axis < 0) return [position, null, colour];
  const { corners, ends, elements } = cut(run, axis, at), [across, up] = PLANE[axis];
  elements.forEach((element, e) => {
    const paint = colourOf("youngs", run.fields.youngs[element], run).map((v) => v / 255);
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

// ------------------------------------------------------------ pointer and keyboard

function rotate(yaw, pitch) {
  orientation.yaw += yaw;
  orientation.pitch = clamp(orientation.pitch + pitch, -Math.PI / 2, Math.PI / 2);
  scheduleRedraw();
}

function zoom(factor) {
  orientation.zoom = clamp(orientation.zoom * factor, 0.4, 5);
  scheduleRedraw();
}

function addControls(canvas) {
  const pointers = new Map();
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const distance = pointers.size === 2 && spread();
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size === 2) zoom(spread() / Math.max(distance, 1));
    else rotate(-0.01 * (event.clientX - before[0]), 0.01 * (event.clientY - before[1]));
  });
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return; // the page scrolls
    event.preventDefault();
    zoom(Math.exp(-0.01 * event.deltaY));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => rotate(0.1, 0), ArrowRight: () => rotate(-0.1, 0),
    ArrowUp: () => rotate(0, -0.1), ArrowDown: () => rotate(0, 0.1),
    "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });
}

let views = [];

// The range of the isosurface's modulus, and the modulus itself where nobody chose it.
function setLevels() {
  const fields = runs.map(nodalModulus);
  const low = Math.min(...fields.map((f) => f.reduce((a, b) => Math.min(a, b), Infinity)));
  const high = Math.max(...fields.map((f) => f.reduce((a, b) => Math.max(a, b), 0)));
  const levels = runs.map((run) => run.level).filter((level) => level).sort((a, b) => a - b);
  const label = levels[(levels.length - 1) >> 1];
  const usual = label ? clamp(label, low, high) : Math.sqrt(low * high);
  solid.range = [low, high];
  solid.level = solid.chosen ? clamp(solid.level, low, high) : usual;
  const share = Math.log(solid.level / low) / Math.log(high / low);
  query("#level").value = high > low ? 1000 * share : 500;
}

function makeViews() {
  views = queryAll(".view").map((container, index) => {
    query(".label", container).textContent = runs.length > 1 ? runs[index].name : "";
    return new View(container, runs[index]);
  });
  if (views.every((view) => !view.gl)) {
    query("#solid-controls").hidden = true;
    return;
  }
  setLevels();
  const slider = query("#level");
  slider.addEventListener("input", () => {
    const [low, high] = solid.range;
    solid.level = low * (high / low) ** (slider.value / 1000);
    solid.chosen = true;
    scheduleRedraw();
  });
  query("#cut").addEventListener("change", (event) => {
    solid.axis = event.target.value === "" ? -1 : Number(event.target.value);
    // Remove the part in front of the cut.
    if (solid.axis >= 0) solid.keep = camera().away[solid.axis] > 0 ? -1 : 1;
    query("#cut-flip").checked = false;
    scheduleRedraw();
  });
  query("#cut-at").addEventListener("input", (event) => {
    const [low, high] = [bounds[0][solid.axis], bounds[1][solid.axis]];
    state.at[solid.axis] = low + (high - low) * (event.target.value / 1000);
    scheduleRedraw();
  });
  query("#cut-flip").addEventListener("change", () => {
    solid.keep = -solid.keep;
    scheduleRedraw();
  });
  for (const button of queryAll("[data-view]"))
    button.addEventListener("click", () => {
      [orientation.yaw, orientation.pitch] = VIEWS[button.dataset.view];
      orientation.zoom = 1;
      scheduleRedraw();
    });
}

function drawViews() {
  const { axis } = solid, at = query("#cut-at");
  const shown = views.some((view) => view.showsLumps()) ? "lumps" : `${formatNumber(solid.level)} MPa`;
  query("#level-out").textContent = shown;
  query("#level").setAttribute("aria-valuetext", shown);
  for (const control of queryAll("#cut-position, #flip")) control.hidden = axis < 0;
  query("#cut-out").textContent = axis < 0 ? "" : `${formatMm(state.at[axis])} mm`;
  if (axis >= 0) {
    const share = (state.at[axis] - bounds[0][axis]) / (bounds[1][axis] - bounds[0][axis]);
    at.value = 1000 * share;
    at.setAttribute("aria-valuetext", `${AXES[axis]} = ${formatMm(state.at[axis])} mm`);
  }
  for (const view of views) view.draw();
}
