// The audit document as typed arrays. Nothing here touches the page.

const audit = JSON.parse(byId("document").textContent);
const { places, closures } = audit;

const keyframes = (() => {
  const { label, position, radius, score, collision_score, stable_score } = audit.keyframes;
  return {
    n: label.length,
    label,
    position,
    x: Float64Array.from(position, (p) => p[0]),
    y: Float64Array.from(position, (p) => p[1]),
    z: Float64Array.from(position, (p) => p[2]),
    radius: Float64Array.from(radius, (r) => r ?? 0),
    score: Float64Array.from(score, scoreOf),
    collision: Float64Array.from(collision_score, scoreOf),
    stable: Float64Array.from(stable_score, scoreOf),
  };
})();

const worst = audit.summary.worst ?? 0;
const planar = keyframes.z.every((z) => z === keyframes.z[0]);

/** Largest finite value, 1 where there is none: the top of a colour scale, which infinite scores share. */
const topOf = (values) => values.reduce((top, v) => (v < Infinity && v > top ? v : top), 0) || 1;

/** From a list of edges [[i, j], ...] to a function: the keyframes joined to a keyframe. */
function neighbourhood(edges) {
  const joined = new Map();
  const join = (i, j) => (joined.has(i) ? joined.get(i).push(j) : joined.set(i, [j]));
  for (const [i, j] of edges) {
    join(i, j);
    join(j, i);
  }
  return (keyframe) => joined.get(keyframe) ?? [];
}

const joinedBy = Object.fromEntries(
  ["pose_graph", "fusion", "collisions"].map((name) => [name, neighbourhood(audit.edges[name])]),
);

/** Keyframes whose minimum spheres meet this one's. */
function overlapsOf(keyframe) {
  const { x, y, z, radius, n } = keyframes;
  const found = [];
  if (!(radius[keyframe] > 0)) return found;
  for (let k = 0; k < n; k++) {
    const apart = Math.hypot(x[k] - x[keyframe], y[k] - y[keyframe], z[k] - z[keyframe]);
    if (k !== keyframe && radius[k] > 0 && apart <= radius[k] + radius[keyframe]) found.push(k);
  }
  return found;
}

/** Keyframes of a stretch [first, last] of track. */
const stretch = ([first, last]) => Array.from({ length: last - first + 1 }, (_, k) => first + k);
const stretchLabel = ([first, last]) =>
  first === last ? keyframes.label[first] : `${keyframes.label[first]}–${keyframes.label[last]}`;

/** The place (its number in the list) whose stretches hold a keyframe, the first such one, or -1. */
const placeOf = (() => {
  const found = new Int32Array(keyframes.n).fill(-1);
  for (let k = places.length - 1; k >= 0; k--) {
    for (const [first, last] of places[k].stretches) found.fill(k, first, last + 1);
  }
  return found;
})();
const inPlace = (keyframe, k) => places[k].stretches.some(([first, last]) => first <= keyframe && keyframe <= last);

/** A pair of heat kernel signatures: {times, poseGraph, mergedGraph}, or null where none is stored. */
const signatureOf = (() => {
  const { keyframes: stored, pose_graph, merged_graph } = audit.signatures;
  const rowOf = new Map(stored.map((keyframe, row) => [keyframe, row]));
  const poseGraph = decodeMatrix(pose_graph);
  const mergedGraph = decodeMatrix(merged_graph);
  return (keyframe) => {
    const row = rowOf.get(keyframe);
    return row === undefined ? null : { poseGraph: poseGraph(row), mergedGraph: mergedGraph(row) };
  };
})();

/** Little-endian float32 in base64 -> a function from the row's number to the row. */
function decodeMatrix({ dtype, shape, base64 }) {
  if (dtype !== "float32") throw new Error(`expected signatures in float32, found ${dtype}`);
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  const values = new Float32Array(bytes.buffer);
  return (row) => values.subarray(row * shape[1], (row + 1) * shape[1]);
}

/** Number of times on the local side of the split β. */
const localTimes = (beta) => Math.round(beta * audit.times.length);

/** Relative distance of two signatures over the times [from, to): Eq. 17 with the document's norm. */
function distortion({ poseGraph, mergedGraph }, from, to) {
  const p = audit.options.norm ?? 2; // the default of `assess`
  let change = 0;
  let size = 0;
  for (let k = from; k < to; k++) {
    change += Math.abs(poseGraph[k] - mergedGraph[k]) ** p;
    size += Math.abs(poseGraph[k]) ** p;
  }
  if (change === 0) return 0;
  return size === 0 ? Infinity : (change / size) ** (1 / p);
}

/** The keyframe that a label or an index (in decimal) names, or null: labels come first. */
function findKeyframe(text) {
  const labelled = keyframes.label.indexOf(text);
  if (labelled >= 0) return labelled;
  return /^\d+$/.test(text) && Number(text) < keyframes.n ? Number(text) : null;
}
