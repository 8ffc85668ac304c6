// Presses and convergence.

const HUES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];

// A frame with ticks; returns the two scales.
function drawFrame(g, { width, height, x, y, xTitle, yTitle, logY }) {
  const box = { left: 52, right: width - 12, top: 12, bottom: height - 40 };
  const toX = (v) => box.left + ((v - x[0]) / (x[1] - x[0])) * (box.right - box.left);
  const level = logY ? Math.log : (v) => v;
  const toY = (v) =>
    box.bottom - ((level(v) - level(y[0])) / (level(y[1]) - level(y[0]))) * (box.bottom - box.top);
  g.lineWidth = 1;
  g.fillStyle = cssValue("soft");
  g.strokeStyle = cssValue("line");
  g.textBaseline = "middle";
  g.textAlign = "right";
  for (const tick of logY ? logTicks(...y) : ticks(...y)) {
    const at = Math.round(toY(tick)) + 0.5;
    g.beginPath();
    g.moveTo(box.left, at);
    g.lineTo(box.right, at);
    g.stroke();
    g.fillText(formatNumber(tick), box.left - 6, at);
  }
  g.textAlign = "center";
  g.textBaseline = "top";
  for (const tick of ticks(...x)) {
    const at = Math.round(toX(tick)) + 0.5;
    g.beginPath();
    g.moveTo(at, box.bottom);
    g.lineTo(at, box.bottom + 4);
    g.stroke();
    g.fillText(formatNumber(tick), at, box.bottom + 7);
  }
  g.fillText(xTitle, (box.left + box.right) / 2, box.bottom + 24);
  g.save();
  g.translate(11, (box.top + box.bottom) / 2);
  g.rotate(-Math.PI / 2);
  g.textBaseline = "middle";
  g.fillText(yTitle, 0, 0);
  g.restore();
  return { toX, toY, box };
}

function drawMarker(g, kind, x, y, size) {
  g.beginPath();
  if (kind === 0) g.arc(x, y, size, 0, 2 * Math.PI);
  else if (kind === 1) {
    g.moveTo(x, y - 1.2 * size);
    g.lineTo(x + 1.1 * size, y + 0.9 * size);
    g.lineTo(x - 1.1 * size, y + 0.9 * size);
    g.closePath();
  } else g.rect(x - 0.9 * size, y - 0.9 * size, 1.8 * size, 1.8 * size);
  g.stroke();
}

const decodedPresses = new Map();
function decodePress(run, index) {
  const press = run.presses[index];
  if (!decodedPresses.has(press))
    decodedPresses.set(press, {
      ...press, nodes: decode(press.nodes), observed: decodeVectors(press.observed),
      residual: decodeVectors(press.residual), deviations: decodeVectors(press.deviations),
    });
  return decodedPresses.get(press);
}

const selectedPress = { run: 0, index: 0 };

function makePresses() {
  if (!query("#press")) return;
  const withPresses = runs.map((run, i) => [run, i]).filter(([run]) => run.presses.length);
  const choice = query("#press-run");
  selectedPress.run = withPresses[0][1];
  if (choice) {
    for (const [run, i] of withPresses) choice.add(new Option(run.name, i));
    choice.addEventListener("change", () => {
      selectedPress.run = Number(choice.value);
      fill();
      scheduleRedraw();
    });
  }
  const select = query("#press");
  const fill = () => {
    select.replaceChildren();
    runs[selectedPress.run].presses.forEach((press, i) =>
      select.add(new Option(`${press.name} (${formatNumber(press.force, 2)} N)`, i)));
    selectedPress.index = runs[selectedPress.run].presses.length - 1;
    select.value = selectedPress.index;
    query("#press-note").textContent = `Residuals are those of the ${runs[selectedPress.run].description}.` +
      " Errors of the model that the inversion corrects are removed, and what remains of them is part of" +
      " the standard deviations.";
  };
  select.addEventListener("change", () => {
    selectedPress.index = Number(select.value);
    scheduleRedraw();
  });
  fill();
}

function drawPresses() {
  if (!query("#press")) return;
  const press = decodePress(runs[selectedPress.run], selectedPress.index);
  query("#press-out").textContent = `residual ${formatNumber(press.rms_um, 3)} µm RMS, ` +
    `${formatNumber(press.rms_deviations, 2)} standard deviations`;
  query("#press-summary").textContent = (runs.length > 1 ? `${runs[selectedPress.run].name}: ` : "") +
    `press ${press.name} (${formatNumber(press.force, 2)} N), ${query("#press-out").textContent}.`;
  drawScatter(press);
  drawPressMaps(press);
}

function drawScatter(press) {
  const canvas = query("#scatter"), width = Math.min(canvas.parentElement.clientWidth, 420);
  const height = Math.round(0.82 * width), g = prepareCanvas(canvas, width, height);
  let low = Infinity, high = -Infinity;
  press.observed.forEach((value, i) => {
    if (!Number.isFinite(value) || !Number.isFinite(press.residual[i])) return;
    low = Math.min(low, 1e3 * value, 1e3 * (value + press.residual[i]));
    high = Math.max(high, 1e3 * value, 1e3 * (value + press.residual[i]));
  });
  const pad = 0.05 * (high - low) || 1, range = [low - pad, high + pad];
  const { toX, toY, box } = drawFrame(g, {
    width, height, x: range, y: range, xTitle: "observed (µm)", yTitle: "predicted (µm)",
  });
  g.strokeStyle = cssValue("text");
  g.beginPath();
  g.moveTo(toX(range[0]), toY(range[0]));
  g.lineTo(toX(range[1]), toY(range[1]));
  g.stroke();
  g.lineWidth = 1.3;
  press.observed.forEach((value, i) => {
    if (!Number.isFinite(value) || !Number.isFinite(press.residual[i])) return;
    g.strokeStyle = HUES[i % 3];
    drawMarker(g, i % 3, toX(1e3 * value), toY(1e3 * (value + press.residual[i])), 3);
  });
  g.textAlign = "left";
  g.textBaseline = "middle";
  [0, 1, 2].forEach((axis) => {
    g.strokeStyle = HUES[axis];
    drawMarker(g, axis, box.left + 14, box.top + 12 + 16 * axis, 3.5);
    g.fillStyle = cssValue("text");
    g.fillText(`along ${AXES[axis]}`, box.left + 24, box.top + 12 + 16 * axis);
  });
  canvas.setAttribute("aria-label",
    `Press ${press.name}: predicted against observed displacements, from ${formatNumber(low)} to ` +
    `${formatNumber(high)} micrometres; residual ${formatNumber(press.rms_um)} micrometres RMS`);
}

// Discs on the surface, seen along the press: observed, predicted, difference.
function drawPressMaps(press) {
  const run = runs[selectedPress.run], canvas = query("#press-maps");
  const width = Math.min(canvas.parentElement.clientWidth, 660), gap = 14;
  const size = press.direction.map(Math.abs), axis = size.indexOf(Math.max(...size));
  const [across, up] = PLANE[axis], n = press.nodes.length;
  const part = (width - 2 * gap) / 3;
  const wide = bounds[1][across] - bounds[0][across], tall = bounds[1][up] - bounds[0][up];
  const scale = (part - 56) / wide, height = Math.round(24 + tall * scale + 90);
  const g = prepareCanvas(canvas, width, height);
  const length = (list, k) => Math.hypot(...[0, 1, 2].map((d) => list[3 * k + d] || 0));
  const nodes = [...Array(n).keys()].sort((a, b) => // the farthest from the viewer first
    press.direction[axis] *
    (run.points[3 * press.nodes[b] + axis] - run.points[3 * press.nodes[a] + axis]));
  const predicted = press.observed.map((value, i) => value + press.residual[i]);
  const largest = 1e3 * Math.max(...nodes.map((k) =>
    Math.max(length(press.observed, k), length(predicted, k))));
  const worst = Math.max(3, ...nodes.map((k) => length(press.deviations, k)));
  const radius = clamp(0.42 * scale * Math.sqrt((wide * tall) / Math.max(n, 1)), 1.5, 11);
  const grey = state.colours === "ultrasound", map = grey ? MAPS.ultrasound : MAPS.cividis;
  const kinds = [
    ["observed (µm)", press.observed, 1e3, largest], ["predicted (µm)", predicted, 1e3, largest],
    ["difference (SD)", press.deviations, 1, worst],
  ];
  kinds.forEach(([title, list, unit, top], kind) => {
    const left = kind * (part + gap) + 44;
    const toX = (v) => left + (v - bounds[0][across]) * scale;
    const toY = (v) => 26 + (bounds[1][up] - v) * scale;
    g.fillStyle = cssValue("text");
    g.textAlign = "left";
    g.textBaseline = "top";
    g.fillText(title, left, 0);
    g.strokeStyle = cssValue("line");
    g.strokeRect(toX(bounds[0][across]), toY(bounds[1][up]), wide * scale, tall * scale);
    for (const k of nodes) {
      const share = (unit * length(list, k)) / top;
      // The size of a disc shows the difference too.
      const r = kind < 2 ? radius : radius * (0.3 + 0.7 * share);
      g.fillStyle = cssColour(mapColour(map, kind < 2 ? share : 1 - share));
      if (kind === 2 && cssValue("scheme") === "dark") g.fillStyle = cssColour(mapColour(map, share));
      g.beginPath();
      g.arc(toX(run.points[3 * press.nodes[k] + across]),
        toY(run.points[3 * press.nodes[k] + up]), r, 0, 2 * Math.PI);
      g.fill();
    }
    const bottom = 26 + tall * scale + radius;
    g.fillStyle = cssValue("soft");
    g.textAlign = "center";
    for (const tick of ticks(bounds[0][across], bounds[1][across], 3))
      g.fillText(formatNumber(tick), toX(tick), bottom + 5);
    g.fillText(`${AXES[across]} (mm)`, left + 0.5 * wide * scale, bottom + 19);
    g.textAlign = "right";
    g.textBaseline = "middle";
    for (const tick of ticks(bounds[0][up], bounds[1][up], 3))
      g.fillText(formatNumber(tick), left - radius - 4, toY(tick));
    const flip = kind === 2 && cssValue("scheme") !== "dark";
    for (let x = 0; x < wide * scale; x++) {
      const share = x / (wide * scale);
      g.fillStyle = cssColour(mapColour(map, flip ? 1 - share : share));
      g.fillRect(left + x, bottom + 38, 1.5, 8);
    }
    g.fillStyle = cssValue("soft");
    g.textBaseline = "top";
    g.textAlign = "left";
    g.fillText("0", left, bottom + 50);
    g.textAlign = "right";
    g.fillText(formatNumber(top, 2), left + wide * scale, bottom + 50);
  });
  canvas.setAttribute("aria-label",
    `Press ${press.name}, seen along ${AXES[axis]}: displacement up to ${formatNumber(largest)} ` +
    `micrometres at ${n} nodes; the largest difference is ` +
    `${formatNumber(Math.max(...nodes.map((k) => length(press.deviations, k))), 2)} standard deviations`);
}

function drawCurve() {
  const canvas = query("#curve"), width = Math.min(canvas.parentElement.clientWidth, 720);
  const height = 300, g = prepareCanvas(canvas, width, height);
  const curves = runs.map((run) => run.history.filter((record) => record.deviations > 0));
  const ys = curves.flat().map((record) => record.deviations);
  const last = Math.max(1, ...curves.flat().map((record) => record.iteration));
  const low = Math.min(0.7, ...ys), high = Math.max(1.4, ...ys);
  const { toX, toY, box } = drawFrame(g, {
    width, height, x: [0, last], y: [low * 0.85, high * 1.2], logY: true,
    xTitle: "iteration or model", yTitle: "residual (standard deviations)",
  });
  g.strokeStyle = cssValue("text");
  g.setLineDash([2, 3]);
  g.beginPath();
  g.moveTo(box.left, toY(1));
  g.lineTo(box.right, toY(1));
  g.stroke();
  g.fillStyle = cssValue("text");
  g.textAlign = "right";
  g.textBaseline = "bottom";
  g.fillText("noise", box.right - 4, toY(1) - 3);
  curves.forEach((curve, i) => {
    const hue = state.colours === "ultrasound" ? cssValue("text") : HUES[i % HUES.length];
    g.strokeStyle = g.fillStyle = hue;
    g.lineWidth = 1.8;
    g.setLineDash(DASHES[i % DASHES.length]);
    g.beginPath();
    for (const record of curve) g.lineTo(toX(record.iteration), toY(record.deviations));
    g.stroke();
    g.setLineDash([]);
    for (const record of curve) drawMarker(g, i % 3, toX(record.iteration), toY(record.deviations), 2.6);
    if (runs.length === 1) return;
    const y = box.top + 10 + 16 * i, x = box.right - 150;
    g.setLineDash(DASHES[i % DASHES.length]);
    g.beginPath();
    g.moveTo(x, y);
    g.lineTo(x + 30, y);
    g.stroke();
    g.setLineDash([]);
    drawMarker(g, i % 3, x + 15, y, 2.6);
    g.fillStyle = cssValue("text");
    g.textAlign = "left";
    g.textBaseline = "middle";
    g.fillText(runs[i].name, x + 36, y);
  });
  canvas.setAttribute("aria-label", "Convergence: " + runs.map((run, i) => {
    const end = curves[i][curves[i].length - 1];
    return end ? `${run.name} ends at ${formatNumber(end.deviations, 2)} standard deviations after ` +
      `${end.iteration} iterations or models` : run.name;
  }).join("; "));
}
