// Canvases of the page of a mended map: the map from above, and the two scans of a tie.

const mended = JSON.parse(byId("document").textContent);
const { attempts, keyframes } = mended;
const state = { attempt: attempts.length ? 0 : null, taken: new Set() };
const sides = ["before", "after"];
const chosenSide = () => mended[byId("show-before").checked ? "before" : "after"];

/** The two axes along which the map is largest, the longer one across. */
const plan = (() => {
  const extents = [0, 1, 2].map((k) => {
    const values = mended.after.position.map((p) => p[k]);
    return values.reduce((a, b) => Math.max(a, b)) - values.reduce((a, b) => Math.min(a, b));
  });
  return [0, 1, 2].sort((a, b) => extents[b] - extents[a]).slice(0, 2);
})();

/** Points from base64 of int16 centimetres, as [x, y] in m. */
function unpacked(base64) {
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  const numbers = new Int16Array(bytes.buffer);
  return Array.from({ length: numbers.length / 2 }, (_, k) => [numbers[2 * k] / 100, numbers[2 * k + 1] / 100]);
}

const placed = ([x, y, heading]) => ([u, v]) => [
  x + Math.cos(heading) * u - Math.sin(heading) * v, y + Math.sin(heading) * u + Math.cos(heading) * v,
];

/** A canvas cleared for drawing, and a function from metres to its pixels that shows all of some points. */
function prepared(id, points) {
  const canvas = byId(id);
  const ratio = window.devicePixelRatio;
  const { clientWidth: width, clientHeight: height } = canvas;
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const [low, high] = [Math.min, Math.max].map((pick) => [0, 1].map((k) => points.reduce((a, p) => pick(a, p[k]), points[0][k])));
  const scale = Math.min(...[width, height].map((size, k) => (size - 36) / Math.max(high[k] - low[k], 1e-9)));
  const pixel = ([x, y]) => [
    width / 2 + scale * (x - (low[0] + high[0]) / 2), height / 2 - scale * (y - (low[1] + high[1]) / 2),
  ];
  return { context, pixel, width, height, scale };
}

const flat = (side) => side.position.map((p) => plan.map((k) => p[k]));
const wholeFrame = sides.flatMap((name) => flat(mended[name]));
let shownAt = [];

function drawLines(context, at, pairs, color, width, opacity = 1) {
  Object.assign(context, { strokeStyle: color, lineWidth: width, globalAlpha: opacity });
  context.beginPath();
  for (const [i, j] of pairs) {
    context.moveTo(...at[i]);
    context.lineTo(...at[j]);
  }
  context.stroke();
  context.globalAlpha = 1;
}

function drawDots(context, points, color, size, opacity = 1) {
  Object.assign(context, { fillStyle: color, globalAlpha: opacity });
  for (const [x, y] of points) context.fillRect(x - size / 2, y - size / 2, size, size);
  context.globalAlpha = 1;
}

const pairsOf = (outcome) => attempts.filter((a) => a.outcome === outcome).map((a) => a.keyframes);

/** The chosen side of the map: its way, its ties, and the places that are left. */
function drawMap() {
  const { context, pixel } = prepared("plan", wholeFrame);
  const side = chosenSide();
  const at = flat(side).map(pixel);
  shownAt = at;
  const colors = { ...theme(), ...verdictColours() };
  const isAfter = side === mended.after;
  if (byId("show-scans").checked) drawDots(context, wallsOf(isAfter ? "after" : "before").map(pixel), colors.muted, 1, 0.35);
  for (const { kind, keyframes: own } of side.stretches) {
    drawDots(context, own.map((k) => at[k]), kind === "likely false closure" ? colors.rejected : colors.undecided, 11, 0.3);
  }
  drawLines(context, at, mended.odometry, colors.ink, 1, 0.55);
  drawLines(context, at, mended.kept, colors.blue, 1, 0.7);
  if (isAfter) drawLines(context, at, pairsOf("confirmed"), colors.accepted, 1.5, 0.9);
  else drawLines(context, at, mended.out.filter((c) => c.keyframes.length === 2).map((c) => c.keyframes), colors.rejected, 1.5, 0.9);
  if (state.attempt !== null) drawEnds(context, attempts[state.attempt].keyframes.map((k) => at[k]), colors);
}

function drawEnds(context, ends, colors) {
  drawLines(context, ends, [[0, 1]], colors.red, 2.5);
  for (const [x, y] of ends) {
    context.beginPath();
    context.arc(x, y, 7, 0, 2 * Math.PI);
    Object.assign(context, { strokeStyle: colors.red, lineWidth: 2.5 });
    context.stroke();
  }
}

function verdictColours() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(["accepted", "undecided", "rejected"].map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

/** What the keyframes of all attempts saw, in the world, from their poses seen from above: once for each side. */
const walls = {};
function wallsOf(name) {
  walls[name] ??= attempts.flatMap(({ clouds, keyframes: ends }) => (clouds ?? []).flatMap((cloud, k) =>
    unpacked(cloud).filter((_, i) => i % 3 === 0).map(placed(mended[name].pose[ends[k]]))));
  return plan[0] + plan[1] === 1 ? walls[name].map((p) => plan.map((k) => p[k])) : [];
}

/** The two scans of the chosen tie, seen from the first keyframe. */
function drawPair() {
  const a = state.attempt === null ? null : attempts[state.attempt];
  const canvas = byId("pair");
  if (!a?.clouds) return canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
  const [first, second] = a.clouds.map(unpacked);
  const colors = theme();
  const as = document.querySelector("input[name=fit]:checked").value;
  const shown = (as === "both" ? ["predicted", "measured"] : [as]).filter((name) => a[name]);
  const moved = Object.fromEntries(["predicted", "measured"].filter((name) => a[name]).map((name) => [name, second.map(placed(a[name]))]));
  const { context, pixel } = prepared("pair", [[0, 0], ...first, ...Object.values(moved).flat()]);
  drawDots(context, first.map(pixel), colors.blue, 3);
  for (const name of shown) drawDots(context, moved[name].map(pixel), colors.red, 3, as === "both" && name === "predicted" ? 0.3 : 1);
  const ends = [[0, 0], ...shown.map((name) => a[name].slice(0, 2))].map(pixel);
  ends.forEach(([x, y], k) => {
    context.beginPath();
    context.arc(x, y, 6, 0, 2 * Math.PI);
    Object.assign(context, { strokeStyle: k ? colors.red : colors.blue, lineWidth: 2.5 });
    context.stroke();
  });
}
