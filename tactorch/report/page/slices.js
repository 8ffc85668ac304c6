// Slices across x, y and z: one row and slider per axis, one column per field or run.

const grid = query("#grid");
const MARGIN = { left: 38, right: 8, top: 6, bottom: 34 };
const CONTACT = "#d55e00";
const sliders = [];
let columns = [], panels = [];

function selectColumns() {
  if (runs.length === 1)
    return Object.keys(runs[0].fields)
      .filter((field) => !state.hidden.has(field))
      .map((field) => ({ run: runs[0], field, title: data.fields[field].title }));
  const result = runs
    .filter((run) => run.fields[state.quantity])
    .map((run) => ({ run, field: state.quantity, title: run.name }));
  if (!MODULI.has(state.quantity)) return result;
  for (const field of ["truth", "reference"]) {
    // A truth that several runs share is shown once.
    const seen = new Map();
    for (const run of runs)
      if (run.fields[field]) {
        const same = data.runs[runs.indexOf(run)];
        const key = JSON.stringify([same.points, same.tets, same.fields[field]]);
        if (!seen.has(key)) seen.set(key, run);
      }
    for (const run of seen.values()) {
      const of = seen.size > 1 ? ` of ${run.name}` : "";
      result.push({ run, field, title: data.fields[field].title + of });
    }
  }
  return result;
}

function makeGrid() {
  columns = selectColumns();
  panels = [];
  grid.replaceChildren();
  grid.style.setProperty("--columns", Math.max(columns.length, 1));
  const head = grid.appendChild(document.createElement("div"));
  head.className = "heads";
  head.append(document.createElement("span"));
  for (const column of columns) {
    const box = head.appendChild(document.createElement("div"));
    box.className = "head";
    const title = box.appendChild(document.createElement("strong"));
    title.textContent = column.title;
    const unit = box.appendChild(document.createElement("span"));
    unit.textContent = data.fields[column.field].unit;
    column.bar = box.appendChild(document.createElement("canvas"));
  }
  for (const axis of [2, 1, 0]) makeRow(axis);
}

function makeRow(axis) {
  const row = grid.appendChild(document.createElement("div"));
  row.className = "slice-row";
  const control = row.appendChild(document.createElement("div"));
  control.className = "control";
  const label = control.appendChild(document.createElement("label"));
  label.htmlFor = `slice-${AXES[axis]}`;
  label.textContent = `Slice across ${AXES[axis]}`;
  const out = control.appendChild(document.createElement("output"));
  out.htmlFor = label.htmlFor;
  const slider = control.appendChild(document.createElement("input"));
  const [low, high] = [bounds[0][axis], bounds[1][axis]];
  Object.assign(slider, { type: "range", id: label.htmlFor, min: low, max: high });
  slider.step = (high - low) / 400;
  slider.addEventListener("input", () => {
    state.at[axis] = Number(slider.value);
    scheduleRedraw();
  });
  sliders[axis] = { slider, out };
  for (const column of columns) {
    const canvas = row.appendChild(document.createElement("canvas"));
    canvas.setAttribute("role", "img");
    canvas.className = "slice";
    const panel = { canvas, axis, column };
    canvas.addEventListener("pointermove", (event) => showValues(panel, event));
    canvas.addEventListener("click", (event) => moveSlices(panel, event));
    panels.push(panel);
  }
}

// Width of the panels in CSS pixels and their scale in pixels per mm.
function layout() {
  const first = panels[0].canvas.parentElement;
  const control = query(".control", first).offsetWidth;
  const gap = 12, stacked = control > 0.6 * first.clientWidth;
  const room = stacked ? first.clientWidth - gap * (columns.length - 1)
    : first.clientWidth - control - gap * columns.length;
  const width = clamp(Math.floor(room / columns.length), 130, 380);
  const widest = Math.max(...PLANE.map(([a]) => bounds[1][a] - bounds[0][a]));
  return { width, scale: (width - MARGIN.left - MARGIN.right) / (1.06 * widest) };
}

// Transformation from mm in the plane to pixels of a panel.
function framing(axis, { width, scale }) {
  const [across, up] = PLANE[axis];
  const middle = 0.5 * (bounds[0][across] + bounds[1][across]);
  const pad = 0.03 * (bounds[1][up] - bounds[0][up]);
  const centre = (MARGIN.left + width - MARGIN.right) / 2;
  const height = Math.round(
    (bounds[1][up] - bounds[0][up] + 2 * pad) * scale + MARGIN.top + MARGIN.bottom);
  return {
    width, height, scale, across, up,
    x: (value) => centre + (value - middle) * scale,
    y: (value) => MARGIN.top + (bounds[1][up] + pad - value) * scale,
    back: (px, py) =>
      [middle + (px - centre) / scale, bounds[1][up] + pad - (py - MARGIN.top) / scale],
  };
}

function drawSlice(canvas, { run, field }, axis, at, frame, sharpness) {
  const g = prepareCanvas(canvas, frame.width, frame.height, sharpness);
  const { corners, ends, elements } = cut(run, axis, at), values = run.fields[field];
  g.lineJoin = "round";
  g.lineWidth = 1.2;
  for (let e = 0; e < elements.length; e++) {
    // A thin line of the same colour closes the seams between anti-aliased polygons.
    g.fillStyle = g.strokeStyle = cssColour(colourOf(field, values[elements[e]], run));
    g.beginPath();
    for (let k = ends[e]; k < ends[e + 1]; k++)
      g.lineTo(frame.x(corners[2 * k]), frame.y(corners[2 * k + 1]));
    g.closePath();
    g.fill();
    g.stroke();
  }
  const strokes = (triangles, styles, points) => {
    const segments = cutTriangles(run, triangles, axis, at, points);
    for (const [colour, width, dash] of styles) {
      g.strokeStyle = colour;
      g.lineWidth = width;
      g.setLineDash(dash || []);
      g.stroke(joinSegments(segments, frame));
    }
    g.setLineDash([]);
    return segments;
  };
  strokes(run.surface, [[cssValue("soft"), 0.8]]);
  if (state.outlines) {
    if (run.trueInclusion) strokes(run.trueInclusion, [["#000", 2.6], ["#fff", 1.4, [4, 3]]]);
    // Lumps are those of the result: the other description is not outlined.
    for (const lump of field === "other" ? [] : run.lumps) {
      for (const range of [lump.inner, lump.outer])
        if (range) strokes(range.triangles, [["#000", 1.8], ["#fff", 1.2, [1, 3]]], range.points);
      strokes(lump.best.triangles, [["#000", 2.8], ["#fff", 1.4]], lump.best.points);
    }
    for (const patch of run.contact) {
      const segments = strokes(patch.triangles, [[CONTACT, 3]]);
      drawArrows(g, segments, patch.direction, frame);
    }
  }
  if (run.next && Math.abs(run.next.center[axis] - at) <= run.next.radius)
    drawNext(g, run.next, frame);
  drawAxes(g, axis, frame);
  return elements.length;
}

// An arrow to the place of the next press.
function drawNext(g, { center, inward, radius }, { across, up, x, y }) {
  const [px, py] = [x(center[across]), y(center[up])];
  g.strokeStyle = g.fillStyle = cssColour(NEXT.map((v) => 255 * v));
  g.lineWidth = 2;
  g.beginPath();
  g.moveTo(x(center[across] - 1.5 * radius * inward[across]), y(center[up] - 1.5 * radius * inward[up]));
  g.lineTo(px, py);
  g.stroke();
  g.beginPath();
  g.arc(px, py, 4, 0, 2 * Math.PI);
  g.fill();
}

// Join segments to polylines, for continuous dashes.
function joinSegments(segments, frame) {
  const path = new Path2D(), key = (x, y) => `${x.toFixed(4)},${y.toFixed(4)}`;
  const near = new Map();
  segments.forEach((s, i) => {
    for (const k of [key(s[0], s[1]), key(s[2], s[3])])
      near.set(k, [...(near.get(k) || []), i]);
  });
  const used = new Set();
  const follow = (i, from) => {
    while (i !== undefined) {
      used.add(i);
      const s = segments[i];
      const [x, y] = key(s[0], s[1]) === from ? [s[2], s[3]] : [s[0], s[1]];
      path.lineTo(frame.x(x), frame.y(y));
      from = key(x, y);
      i = near.get(from).find((j) => !used.has(j));
    }
  };
  const loose = segments.map((_, i) => i).filter((i) =>
    near.get(key(segments[i][0], segments[i][1])).length === 1);
  for (const i of [...loose, ...segments.keys()]) {
    if (used.has(i)) continue;
    path.moveTo(frame.x(segments[i][0]), frame.y(segments[i][1]));
    follow(i, key(segments[i][0], segments[i][1]));
  }
  return path;
}

// Three arrows along the force, inside the line of contact.
function drawArrows(g, segments, direction, frame) {
  const flat = [direction[frame.across], direction[frame.up]], size = Math.hypot(...flat);
  if (!segments.length || size < 0.3) return;
  const [dx, dy] = [flat[0] / size, -flat[1] / size];
  const middles = segments.map((s) => [frame.x((s[0] + s[2]) / 2), frame.y((s[1] + s[3]) / 2)]);
  middles.sort((a, b) => (b[0] - a[0]) * dy - (b[1] - a[1]) * dx);
  g.strokeStyle = g.fillStyle = CONTACT;
  g.lineWidth = 1.3;
  for (const share of [1 / 6, 1 / 2, 5 / 6]) {
    const [x, y] = middles[Math.floor(share * middles.length)];
    g.beginPath();
    g.moveTo(x, y);
    g.lineTo(x + 9 * dx, y + 9 * dy);
    g.stroke();
    g.beginPath();
    g.moveTo(x + 14 * dx, y + 14 * dy);
    g.lineTo(x + 8 * dx - 3 * dy, y + 8 * dy + 3 * dx);
    g.lineTo(x + 8 * dx + 3 * dy, y + 8 * dy - 3 * dx);
    g.fill();
  }
}

function drawAxes(g, axis, frame) {
  const { across, up, width, height } = frame;
  const bottom = height - MARGIN.bottom + 2;
  g.fillStyle = g.strokeStyle = cssValue("soft");
  g.lineWidth = 1;
  g.textAlign = "center";
  g.textBaseline = "top";
  const count = clamp(Math.round((bounds[1][across] - bounds[0][across]) * frame.scale / 45), 2, 6);
  for (const tick of ticks(bounds[0][across], bounds[1][across], count)) {
    g.fillRect(Math.round(frame.x(tick)) - 0.5, bottom, 1, 4);
    g.fillText(formatNumber(tick), frame.x(tick), bottom + 6);
  }
  g.fillText(`${AXES[across]} (mm)`, (MARGIN.left + width - MARGIN.right) / 2, bottom + 19);
  g.textAlign = "right";
  g.textBaseline = "middle";
  const high = clamp(Math.round((bounds[1][up] - bounds[0][up]) * frame.scale / 35), 2, 6);
  const left = Math.min(frame.x(bounds[0][across]) - 4, MARGIN.left);
  for (const tick of ticks(bounds[0][up], bounds[1][up], high)) {
    g.fillRect(left - 4, Math.round(frame.y(tick)) - 0.5, 4, 1);
    g.fillText(formatNumber(tick), left - 6, frame.y(tick));
  }
  g.save();
  g.translate(left - 30, frame.y(0.5 * (bounds[0][up] + bounds[1][up])));
  g.rotate(-Math.PI / 2);
  g.textAlign = "center";
  g.fillText(`${AXES[up]} (mm)`, 0, 0);
  g.restore();
}

// Thin lines at the positions of the other two slices.
function drawCrossHair(g, axis, frame) {
  g.strokeStyle = cssValue("hair");
  g.lineWidth = 1;
  g.setLineDash([2, 3]);
  g.beginPath();
  const x = Math.round(frame.x(state.at[frame.across])) + 0.5;
  const y = Math.round(frame.y(state.at[frame.up])) + 0.5;
  g.moveTo(x, MARGIN.top);
  g.lineTo(x, frame.height - MARGIN.bottom);
  g.moveTo(MARGIN.left, y);
  g.lineTo(frame.width - MARGIN.right, y);
  g.stroke();
  g.setLineDash([]);
}

function drawSlices() {
  if (!panels.length) return;
  const size = layout();
  grid.style.setProperty("--panel", `${size.width}px`);
  for (const column of columns) colourBar(column.bar, column.field, size.width, column.run);
  for (const axis of [0, 1, 2]) {
    const { slider, out } = sliders[axis];
    slider.value = state.at[axis];
    out.textContent = `${AXES[axis]} = ${formatMm(state.at[axis])} mm`;
    slider.setAttribute("aria-valuetext", out.textContent);
  }
  for (const panel of panels) {
    const { canvas, axis, column } = panel;
    panel.frame = framing(axis, size);
    const shown = renderPanel(panel);
    const g = prepareCanvas(canvas, panel.frame.width, panel.frame.height);
    g.drawImage(panel.base, 0, 0, panel.frame.width, panel.frame.height);
    drawCrossHair(g, axis, panel.frame);
    const label = `${column.title}, slice across ${AXES[axis]} at ${formatMm(state.at[axis])} mm`;
    canvas.setAttribute("aria-label", shown ? label + describeRange(panel) : `${label}: outside the body`);
  }
}

// The slice without the cross hair, redrawn only if it changes.
function renderPanel(panel) {
  const { axis, column, frame } = panel;
  const look = [state.at[axis], state.colours, state.log, state.own, state.outlines, frame.width, frame.scale,
    cssValue("scheme"), window.devicePixelRatio].join();
  if (panel.look !== look) {
    panel.look = look;
    panel.base = panel.base || document.createElement("canvas");
    panel.shown = drawSlice(panel.base, column, axis, state.at[axis], frame);
  }
  return panel.shown;
}

function describeRange({ axis, column }) {
  const { elements } = cut(column.run, axis, state.at[axis]);
  let low = Infinity, high = -Infinity;
  for (const e of elements) {
    const value = column.run.fields[column.field][e];
    if (!isDefined(column.field, value)) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return `: ${formatNumber(low)} to ${formatNumber(high)} ${data.fields[column.field].unit}`;
}

// ------------------------------------------------------------ pointing

function locatePointer({ canvas, axis, column, frame }, event) {
  const box = canvas.getBoundingClientRect();
  const [x, y] = frame.back(event.clientX - box.left, event.clientY - box.top);
  return { x, y, element: elementAt(cut(column.run, axis, state.at[axis]), x, y) };
}

function showValues(panel, event) {
  const { x, y, element } = locatePointer(panel, event), { run } = panel.column;
  if (element < 0) return;
  const point = [...state.at];
  point[panel.frame.across] = x;
  point[panel.frame.up] = y;
  const parts = [`(${point.map((v) => v.toFixed(1)).join(", ")}) mm`];
  if (runs.length > 1) parts.push(run.name);
  for (const [field, values] of Object.entries(run.fields)) {
    const { title, unit } = data.fields[field];
    let text = `${title} ${formatNumber(values[element])} ${unit}`;
    if (field === "uncertainty") text = `${title} ± ${formatNumber(values[element], 2)} %`;
    if (!isDefined(field, values[element])) text = `${title} undefined: the map is at a bound`;
    if (field === "youngs" && run.interval && isDefined("uncertainty", run.fields.uncertainty[element])) {
      const [low, high] = run.interval.map((end) => formatNumber(end[element]));
      text += ` (90 %: ${low} to ${high})`;
    }
    parts.push(text);
  }
  query("#readout").textContent = parts.join("  ·  ");
}

function moveSlices(panel, event) {
  const { x, y, element } = locatePointer(panel, event);
  if (element < 0) return;
  state.at[panel.frame.across] = x;
  state.at[panel.frame.up] = y;
  scheduleRedraw();
}

// ------------------------------------------------------------ legend, and prints

function describeFields() {
  const legend = [];
  const has = (what) => runs.some((run) => run[what] && run[what].length);
  if (has("lumps")) legend.push(["solid", "lump"]);
  if (runs.some((run) => run.lumps.some((lump) => lump.outer)))
    legend.push(["dotted", "90 % range of its boundary"]);
  if (has("trueInclusion")) legend.push(["dashed", "true inclusions"]);
  if (has("contact")) legend.push(["touched", "contact, with arrows along the force"]);
  if (runs.some((run) => run.next)) legend.push(["next", "next press"]);
  query("#legend").replaceChildren(...legend.map(([kind, text]) => {
    const entry = document.createElement("span"), key = document.createElement("span");
    key.className = `key ${kind}`;
    entry.append(key, text);
    return entry;
  }));
  const notes = [...new Set(columns.map((column) => column.field))].map((field) =>
    `${data.fields[field].title}: ${data.fields[field].note}.`);
  if (columns.some((column) => column.field === "uncertainty"))
    notes.push(...new Set(columns.map((column) => column.run.posterior).filter(Boolean)));
  query("#field-notes").textContent = notes.join(" ");
}

// Prints have slices at the positions of the sliders and at two fixed positions per axis.
function drawForPrint() {
  const paper = query("#print-slices"), width = Math.min(230, Math.floor(700 / columns.length));
  const widest = Math.max(...PLANE.map(([a]) => bounds[1][a] - bounds[0][a]));
  const scale = (width - MARGIN.left - MARGIN.right) / (1.06 * widest);
  paper.replaceChildren();
  for (const column of columns) {
    const bar = paper.appendChild(document.createElement("div"));
    bar.className = "print-head";
    bar.style.width = `${width}px`;
    bar.textContent = `${column.title} (${data.fields[column.field].unit})`;
    colourBar(bar.appendChild(document.createElement("canvas")), column.field, width, column.run);
  }
  for (const axis of [2, 1, 0]) {
    const low = bounds[0][axis], size = bounds[1][axis] - low;
    const positions = [low + 0.2 * size, state.at[axis], low + 0.8 * size].sort((a, b) => a - b);
    for (const at of positions) {
      const title = paper.appendChild(document.createElement("p"));
      title.textContent = `Slice across ${AXES[axis]} at ${formatMm(at)} mm`;
      const row = paper.appendChild(document.createElement("div"));
      for (const column of columns)
        drawSlice(row.appendChild(document.createElement("canvas")), column, axis, at,
          framing(axis, { width, scale }), 3);
    }
  }
}
