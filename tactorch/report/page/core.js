// Data, colours, numbers and axes shared by all figures.

const data = JSON.parse(document.getElementById("data").textContent);
const query = (selector, within = document) => within.querySelector(selector);
const queryAll = (selector, within = document) => [...within.querySelectorAll(selector)];
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

const ARRAYS = {
  float32: Float32Array, uint32: Uint32Array, uint16: Uint16Array, int16: Int16Array,
  uint8: Uint8Array,
};

function decode(packed) {
  const text = atob(packed.data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new ARRAYS[packed.dtype](bytes.buffer);
}

function decodeField(packed) {
  const step = (packed.high - packed.low) / 65535;
  return Float32Array.from(decode(packed), (k) => {
    const value = packed.low + k * step;
    return packed.ratio ? Math.exp(value) : value;
  });
}

function decodeVectors(packed) {
  return Float32Array.from(decode(packed), (k) => (k === -32768 ? NaN : k * packed.step));
}

// ------------------------------------------------------------ state of the controls

const state = {
  at: [0, 0, 0], // mm, the slice across each axis
  colours: data.colours,
  log: false,
  own: false, // limits of each run instead of common ones
  outlines: true,
  quantity: "youngs",
  hidden: new Set(["resolution"]),
  printing: false,
};
const listeners = [];
let drawing = 0;

// Redraw in the next animation frame.
function scheduleRedraw() {
  if (drawing) return;
  drawing = requestAnimationFrame(redraw);
}

function redraw() {
  cancelAnimationFrame(drawing);
  drawing = 0;
  for (const draw of listeners) draw();
}

// ------------------------------------------------------------ colours

const MAPS = Object.fromEntries(Object.entries(data.maps).map(([k, v]) => [k, decode(v)]));
const MODULI = new Set(["youngs", "other", "truth", "reference"]);

// Moduli use the selected colours and other fields cividis; in grey, all fields are grey.
function colourMap(field) {
  if (state.colours === "ultrasound" || MODULI.has(field)) return MAPS[state.colours];
  return MAPS.cividis;
}

function isLog(field) {
  return field === "credibility" || (state.log && MODULI.has(field));
}

function limitsOf(field, run) {
  if (state.own && run) return ownLimits(field, run.fields[field]);
  const [low, high] = data.limits[field];
  if (!isLog(field)) return [low, high];
  return [low > 0 ? low : minModulus(field), high];
}

const ownRanges = new WeakMap(); // of arrays of values
// The range of the values of one column; around that of a constant field.
function ownLimits(field, values) {
  if (!ownRanges.has(values)) {
    let low = Infinity, high = -Infinity;
    for (const value of values) {
      if (!isDefined(field, value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    ownRanges.set(values, high > low ? [low, high] : [0.9 * low, 1.1 * high]);
  }
  const [low, high] = ownRanges.get(values);
  return isLog(field) ? [Math.max(low, high / 1000), high] : [low, high];
}

const minimums = {};
// A logarithmic scale starts at the minimum of all runs, at most three decades below the maximum.
function minModulus(field) {
  if (!(field in minimums)) {
    minimums[field] = Infinity;
    for (const run of runs)
      for (const name of MODULI)
        for (const value of run.fields[name] || [])
          minimums[field] = Math.min(minimums[field], value);
    minimums[field] = Math.max(minimums[field], data.limits[field][1] / 1000);
  }
  return minimums[field];
}

// A negative uncertainty is undefined: the map is at a bound.
const isDefined = (field, value) => field !== "uncertainty" || value > -0.5;

function colourFraction(field, value, run) {
  if (!isDefined(field, value)) return 1;
  const [low, high] = limitsOf(field, run);
  const share = isLog(field)
    ? Math.log(Math.max(value, 1e-12) / low) / Math.log(high / low)
    : (value - low) / (high - low);
  return clamp(share, 0, 1);
}

function mapColour(map, share) {
  const k = 3 * Math.round(255 * clamp(share, 0, 1));
  return [map[k], map[k + 1], map[k + 2]];
}

const cssColour = ([r, g, b]) => `rgb(${r} ${g} ${b})`;
const colourOf = (field, value, run) =>
  mapColour(colourMap(field), colourFraction(field, value, run));

function cssValue(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// ------------------------------------------------------------ numbers and axes

const RAISED = Object.fromEntries([..."-0123456789"].map((c, i) => [c, "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"[i]]));

function formatNumber(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) {
    const [lead, power] = value.toExponential(digits - 1).split("e");
    return `${Number(lead)}·10${[...power.replace("+", "")].map((c) => RAISED[c]).join("")}`;
  }
  return String(Number(value.toPrecision(digits)));
}

const formatMm = (value) => (Math.abs(value) < 5e-3 ? 0 : value).toFixed(2);

function ticks(low, high, count = 5) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
  const result = [];
  for (let k = Math.ceil(low / step - 1e-6); k <= high / step + 1e-6; k++)
    result.push(Number((k * step).toPrecision(8)));
  return result;
}

function logTicks(low, high) {
  const result = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++)
    for (const lead of [1, 2, 5]) {
      const value = lead * 10 ** power;
      if (value >= low * 0.999 && value <= high * 1.001) result.push(Number(value.toPrecision(3)));
    }
  return result.length > 6 ? result.filter((v) => /^[1]/.test(v.toExponential())) : result;
}

// Set the size of a canvas in CSS pixels and return its context, which draws in CSS pixels.
function prepareCanvas(canvas, width, height, sharpness = window.devicePixelRatio || 1) {
  const w = Math.round(width * sharpness), h = Math.round(height * sharpness);
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(sharpness, 0, 0, sharpness, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "11px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
  return context;
}

function colourBar(canvas, field, width, run) {
  const g = prepareCanvas(canvas, width, 30), map = colourMap(field);
  const [low, high] = limitsOf(field, run);
  const left = 4, right = width - 4;
  for (let x = left; x < right; x++) {
    g.fillStyle = cssColour(mapColour(map, (x - left) / (right - left)));
    g.fillRect(x, 0, 1.5, 10);
  }
  g.strokeStyle = cssValue("line");
  g.strokeRect(left, 0.5, right - left, 10);
  g.fillStyle = cssValue("soft");
  g.textBaseline = "top";
  let end = -Infinity;
  for (const tick of isLog(field) ? logTicks(low, high) : ticks(low, high, 4)) {
    const x = left + colourFraction(field, tick, run) * (right - left), label = formatNumber(tick);
    const half = g.measureText(label).width / 2;
    const middle = clamp(x, half, width - half);
    if (middle - half < end + 6) continue;
    g.textAlign = "center";
    g.fillText(label, middle, 16);
    g.fillRect(x - 0.5, 10, 1, 4);
    end = middle + half;
  }
}
