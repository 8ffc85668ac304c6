// Plane sections and isosurfaces of meshes.

const PLANE = [[1, 2], [0, 2], [0, 1]]; // horizontal and vertical axes of slices across x, y and z
const AXES = "xyz";

// What a run has besides its mesh, decoded.
function decodeMap(run) {
  const fields = {};
  for (const [name, packed] of Object.entries(run.fields)) fields[name] = decodeField(packed);
  return {
    ...run, fields,
    lumps: run.lumps.map((lump) => ({
      youngs: lump.youngs,
      best: decodeSurface(lump.best), inner: decodeSurface(lump.inner), outer: decodeSurface(lump.outer),
    })),
    trueInclusion: run.trueInclusion && decode(run.trueInclusion),
    contact: run.contact.map((c) => ({ ...c, triangles: decode(c.triangles) })),
    interval: run.interval && run.interval.map(decodeField),
    nodalModulus: null, nodalGradient: null,
  };
}

function decodeSurface(surface) {
  return surface && { points: decode(surface.points), triangles: decode(surface.triangles) };
}

const runs = data.runs.map((run) => ({
  ...decodeMap(run),
  points: decode(run.points), tets: decode(run.tets), surface: decode(run.surface),
  nudge: 1e-6 * Math.hypot(...run.bounds[1].map((h, a) => h - run.bounds[0][a])),
  cuts: [{}, {}, {}],
}));

const bounds = [0, 1].map((end) =>
  [0, 1, 2].map((a) => Math[end ? "max" : "min"](...runs.map((run) => run.bounds[end][a]))));

// Position of a cutting plane, off the nodes, and within the body at its upper side.
function planePosition(run, axis, at) {
  const high = run.bounds[1][axis];
  return at <= high + run.nudge ? Math.min(at + run.nudge, high - run.nudge) : at;
}

// Sections of elements by a plane: corners of each polygon in the two coordinates of the plane.
function cut(run, axis, at) {
  const cached = run.cuts[axis];
  if (cached.at === at) return cached.section;
  const { points, tets } = run, [across, up] = PLANE[axis];
  const corners = [], ends = [0], elements = [];
  const plane = planePosition(run, axis, at);
  const crossing = (i, j) => {
    const a = points[3 * i + axis] - plane, b = points[3 * j + axis] - plane, t = a / (a - b);
    corners.push(
      points[3 * i + across] + t * (points[3 * j + across] - points[3 * i + across]),
      points[3 * i + up] + t * (points[3 * j + up] - points[3 * i + up]));
  };
  for (let e = 0; e < tets.length / 4; e++) {
    const above = [], below = [];
    for (let k = 4 * e; k < 4 * e + 4; k++)
      (points[3 * tets[k] + axis] >= plane ? above : below).push(tets[k]);
    if (!above.length || !below.length) continue;
    const [few, many] = above.length <= below.length ? [above, below] : [below, above];
    if (few.length === 1) for (const other of many) crossing(few[0], other);
    else {
      crossing(few[0], many[0]);
      crossing(few[0], many[1]);
      crossing(few[1], many[1]);
      crossing(few[1], many[0]);
    }
    ends.push(corners.length / 2);
    elements.push(e);
  }
  const section = { corners, ends, elements };
  run.cuts[axis] = { at, section };
  return section;
}

// Sections of triangles by a plane: ends of segments. The points are by default those of the mesh.
function cutTriangles(run, triangles, axis, at, points = run.points) {
  const [across, up] = PLANE[axis], plane = planePosition(run, axis, at);
  const segments = [];
  for (let t = 0; t < triangles.length; t += 3) {
    const ends = [];
    for (let k = 0; k < 3; k++) {
      const i = triangles[t + k], j = triangles[t + ((k + 1) % 3)];
      const a = points[3 * i + axis] - plane, b = points[3 * j + axis] - plane;
      if (a >= 0 === b >= 0) continue;
      const s = a / (a - b);
      ends.push(
        points[3 * i + across] + s * (points[3 * j + across] - points[3 * i + across]),
        points[3 * i + up] + s * (points[3 * j + up] - points[3 * i + up]));
    }
    if (ends.length === 4) segments.push(ends);
  }
  return segments;
}

// Element of a section that contains a point of the plane, or -1.
function elementAt({ corners, ends, elements }, x, y) {
  for (let e = 0; e < elements.length; e++) {
    let sign = 0, inside = true;
    for (let k = ends[e]; k < ends[e + 1] && inside; k++) {
      const next = k + 1 < ends[e + 1] ? k + 1 : ends[e];
      const turn =
        (corners[2 * next] - corners[2 * k]) * (y - corners[2 * k + 1]) -
        (corners[2 * next + 1] - corners[2 * k + 1]) * (x - corners[2 * k]);
      if (turn * sign < 0) inside = false;
      if (turn) sign = Math.sign(turn);
    }
    if (inside) return elements[e];
  }
  return -1;
}

// Modulus at the nodes: mean logarithm over the adjacent elements, weighted by volume.
function nodalModulus(run) {
  if (run.nodalModulus) return run.nodalModulus;
  const { points, tets } = run, youngs = run.fields.youngs;
  const sum = new Float64Array(points.length / 3), weight = new Float64Array(points.length / 3);
  for (let e = 0; e < youngs.length; e++) {
    const p = [0, 1, 2, 3].map((k) => points.subarray(3 * tets[4 * e + k], 3 * tets[4 * e + k] + 3));
    const [a, b, c] = [1, 2, 3].map((k) => [0, 1, 2].map((d) => p[k][d] - p[0][d]));
    const volume = Math.abs(dot(a, cross(b, c)));
    for (let k = 0; k < 4; k++) {
      sum[tets[4 * e + k]] += volume * Math.log(youngs[e]);
      weight[tets[4 * e + k]] += volume;
    }
  }
  run.nodalModulus = Float32Array.from(sum, (s, i) => Math.exp(s / weight[i]));
  return run.nodalModulus;
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// Gradient of the nodal modulus, for smooth shading of the isosurface.
function nodalGradient(run) {
  if (run.nodalGradient) return run.nodalGradient;
  const { points, tets } = run, field = nodalModulus(run);
  const gradient = new Float32Array(points.length);
  for (let e = 0; e < tets.length / 4; e++) {
    const ids = [0, 1, 2, 3].map((k) => tets[4 * e + k]);
    const p = ids.map((i) => points.subarray(3 * i, 3 * i + 3));
    const [a, b, c] = [1, 2, 3].map((k) => [0, 1, 2].map((d) => p[k][d] - p[0][d]));
    const normals = [cross(b, c), cross(c, a), cross(a, b)];
    for (let d = 0; d < 3; d++) {
      let slope = 0; // times six volumes, the weight of the element
      for (let k = 0; k < 3; k++)
        slope += normals[k][d] * (field[ids[k + 1]] - field[ids[0]]);
      for (const i of ids) gradient[3 * i + d] += slope;
    }
  }
  run.nodalGradient = gradient;
  return gradient;
}

// Marching tetrahedra: positions and normals of the surface where the nodal modulus is `level`.
function isosurface(run, level) {
  const { points, tets } = run, field = nodalModulus(run), slope = nodalGradient(run);
  const positions = [], normals = [];
  const corner = (i, j) => {
    const t = (level - field[i]) / (field[j] - field[i]);
    for (let d = 0; d < 3; d++) {
      positions.push(points[3 * i + d] + t * (points[3 * j + d] - points[3 * i + d]));
      normals.push(-(slope[3 * i + d] + t * (slope[3 * j + d] - slope[3 * i + d])));
    }
  };
  for (let e = 0; e < tets.length / 4; e++) {
    const above = [], below = [];
    for (let k = 4 * e; k < 4 * e + 4; k++) (field[tets[k]] >= level ? above : below).push(tets[k]);
    if (!above.length || !below.length) continue;
    const [few, many] = above.length <= below.length ? [above, below] : [below, above];
    if (few.length === 1) for (const other of many) corner(few[0], other);
    else {
      const [a, b] = few, [c, d] = many;
      for (const [i, j] of [[a, c], [a, d], [b, d], [a, c], [b, d], [b, c]]) corner(i, j);
    }
  }
  return { positions, normals };
}
