// The audit document as typed arrays. Nothing here touches the page.

const audit = JSON.parse(byId("audit").textContent);

const keyframes = (() => {
  const { label, position, radius, score, stable_score } = audit.keyframes;
  return {
    n: label.length,
    label,
    position,
    x: Float64Array.from(position, (p) => p[0]),
    y: Float64Array.from(position, (p) => p[1]),
    z: Float64Array.from(position, (p) => p[2]),
    radius: Float64Array.from(radius, (r) => r ?? 0),
    score: Float64Array.from(score, scoreOf),
    stable: Float64Array.from(stable_score, scoreOf),
  };
})();

const worst = audit.summary.worst ?? 0;
const planar = keyframes.z.every((z) => z === keyframes.z[0]);

/** Largest finite score: the top of the colour scale, which infinite scores share. */
const topScore = keyframes.score.reduce((top, s) => (s < Infinity && s > top ? s : top), 0) || 1;

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
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
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

/** Keyframes joined to this one by edges of a list [[i, j], ...]. */
const neighbours = (edges, keyframe) =>
  edges.flatMap(([i, j]) => (i === keyframe ? [j] : j === keyframe ? [i] : []));

/** The keyframe that a label or an index (in decimal) names, or null: labels come first. */
function findKeyframe(text) {
  const labelled = keyframes.label.indexOf(text);
  if (labelled >= 0) return labelled;
  return /^\d+$/.test(text) && Number(text) < keyframes.n ? Number(text) : null;
}
