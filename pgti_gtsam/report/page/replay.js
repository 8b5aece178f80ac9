// The replay: a plan of the map at one moment on a canvas, the curves in plotly, and the slider between them.

const replayed = JSON.parse(byId("document").textContent);
const { moments, keyframes, edges } = replayed;
const nMoments = moments.n_keyframes.length;
const state = { moment: nMoments - 1, timer: null };

function bytes(base64) {
  const text = atob(base64);
  return Uint8Array.from(text, (c) => c.charCodeAt(0));
}

const levels = bytes(replayed.levels);
const moved = replayed.positions === null ? null : new Float32Array(bytes(replayed.positions).buffer);

/** Where the values of each moment begin, in keyframes. */
const begins = moments.n_keyframes.reduce((sums, n) => [...sums, sums.at(-1) + n], [0]);

// Viridis, as the audit's page has it: eleven stops of matplotlib's map.
const viridis = [
  [68, 1, 84], [72, 35, 116], [64, 67, 135], [52, 94, 141], [41, 120, 142], [32, 144, 140], [34, 167, 132],
  [68, 190, 112], [121, 209, 81], [189, 222, 38], [253, 231, 36],
];
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const stops = () => (dark.matches ? viridis.slice(3) : viridis); // the first three are as dark as a dark page

/** Colours by level; the last is that of an infinite ζ. */
function levelColours() {
  const scale = stops();
  return Array.from({ length: 256 }, (_, level) => {
    if (level === 255) return theme().red;
    const at = (level / 254) * (scale.length - 1);
    const k = Math.min(Math.floor(at), scale.length - 2);
    return `rgb(${scale[k].map((c, i) => Math.round(c + (at - k) * (scale[k + 1][i] - c))).join()})`;
  });
}

/** The two axes along which the map is largest, the longer one across; a camera's y axis points down. */
const plan = (() => {
  const extents = [0, 1, 2].map((k) => {
    const values = keyframes.position.map((p) => p[k]);
    return values.reduce((a, b) => Math.max(a, b)) - values.reduce((a, b) => Math.min(a, b));
  });
  return [0, 1, 2].sort((a, b) => extents[b] - extents[a]).slice(0, 2);
})();

const positionAt = (moment, i) =>
  moved === null ? plan.map((k) => keyframes.position[i][k]) : plan.map((k) => moved[3 * (begins[moment] + i) + k]);

/** From positions to pixels of a canvas: all moments share one frame, so that nothing jumps. */
const frame = (() => {
  const low = [Infinity, Infinity];
  const high = [-Infinity, -Infinity];
  for (let m = moved === null ? nMoments - 1 : 0; m < nMoments; m++) {
    for (let i = 0; i < moments.n_keyframes[m]; i++) {
      positionAt(m, i).forEach((v, k) => {
        low[k] = Math.min(low[k], v);
        high[k] = Math.max(high[k], v);
      });
    }
  }
  return { low, high };
})();

function toPixels(width, height) {
  const margin = 24;
  const spans = frame.high.map((v, k) => Math.max(v - frame.low[k], 1e-9));
  const scale = Math.min((width - 2 * margin) / spans[0], (height - 2 * margin) / spans[1]);
  const middle = frame.low.map((v, k) => (v + frame.high[k]) / 2);
  return ([x, y]) => [width / 2 + scale * (x - middle[0]), height / 2 - scale * (y - middle[1])];
}

function drawPlan() {
  byId("scale").style.background = `linear-gradient(90deg, ${stops().map((c) => `rgb(${c.join()})`).join()})`;
  const canvas = byId("plan");
  const ratio = window.devicePixelRatio;
  const { clientWidth: width, clientHeight: height } = canvas;
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const pixel = toPixels(width, height);
  const n = moments.n_keyframes[state.moment];
  const at = Array.from({ length: n }, (_, i) => pixel(positionAt(state.moment, i)));
  const colors = theme();
  drawWhole(context, pixel, colors);
  if (byId("show-pose-graph").checked) drawEdges(context, at, edges.pose_graph, colors.blue, 1, 0.5);
  if (byId("show-inserted").checked) drawEdges(context, at, edges.inserted, colors.red, 1.5, 0.8);
  drawKeyframes(context, at, colors);
}

/** The way as a whole, faintly: where the map will grow. */
function drawWhole(context, pixel, colors) {
  if (moved !== null) return;
  context.fillStyle = colors.dull;
  keyframes.position.forEach((_, i) => {
    const [x, y] = pixel(positionAt(state.moment, i));
    context.fillRect(x - 0.75, y - 0.75, 1.5, 1.5);
  });
}

function drawEdges(context, at, pairs, color, width, opacity) {
  Object.assign(context, { strokeStyle: color, lineWidth: width, globalAlpha: opacity });
  context.beginPath();
  for (const [i, j] of pairs) {
    if (i >= at.length || j >= at.length) continue;
    context.moveTo(...at[i]);
    context.lineTo(...at[j]);
  }
  context.stroke();
  context.globalAlpha = 1;
}

/** Dots by ζ, the brightest last; rings around the newest keyframe and around the worst. */
function drawKeyframes(context, at, colors) {
  const level = (i) => levels[begins[state.moment] + i];
  const order = Array.from(at.keys()).sort((a, b) => level(a) - level(b));
  const size = at.length > 2000 ? 2.2 : 3.2;
  const colourOf = levelColours();
  for (const i of order) {
    context.fillStyle = colourOf[level(i)];
    context.beginPath();
    context.arc(...at[i], size * (1 + level(i) / 254), 0, 2 * Math.PI);
    context.fill();
  }
  const rings = [[at.length - 1, colors.muted], ...(moments.score[state.moment] ? [[moments.worst[state.moment], colors.ink]] : [])];
  for (const [i, color] of rings) {
    Object.assign(context, { strokeStyle: color, lineWidth: 2 });
    context.beginPath();
    context.arc(...at[i], 11, 0, 2 * Math.PI);
    context.stroke();
  }
}

const largest = (values) => values.reduce((most, v) => Math.max(most, scoreOf(v)), 0);
const shares = (values) => values.map((v) => v / (largest(values) || 1));

function drawCurves() {
  const colors = theme();
  const x = moments.n_keyframes;
  const curve = (values, name, yaxis, color, dash = "solid") => ({
    x, y: values.map((v) => (scoreOf(v) < Infinity ? v : null)), name, yaxis, mode: x.length > 1 ? "lines" : "markers",
    line: { color, width: 1.8, dash }, hovertemplate: "%{y:.3g}", legend: `legend${yaxis.slice(1)}`,
  });
  const inserted = x.filter((_, m) => moments.n_new[m] > 0);
  const traces = [
    curve(moments.score, "Λ", "y", colors.accent), curve(moments.mean_score, "Z̄", "y", colors.red),
    curve(moments.stable_score, "stable score", "y", colors.fusion, "dot"),
    curve(moments.global_, "Λ<sub>glob</sub>", "y2", colors.red), curve(moments.local, "Λ<sub>loc</sub>", "y2", colors.accent),
    curve(shares(moments.d), "ΔD", "y3", colors.accent), curve(shares(moments.t), "ΔT", "y3", colors.fusion, "dash"),
    curve(shares(moments.e), "ΔE", "y3", colors.red), curve(shares(moments.e_tilde), "ΔẼ", "y3", colors.muted, "dot"),
    curve(moments.n_inserted, "inserted", "y4", colors.accent), curve(moments.n_collisions, "collisions", "y4", colors.red),
    { x: inserted, y: inserted.map(() => 0), yaxis: "y4", mode: "markers", hoverinfo: "skip", showlegend: false,
      marker: { symbol: "line-ns-open", size: 10, color: colors.ink }, cliponaxis: false },
  ];
  const tops = [1, 0.74, 0.48, 0.22];
  const legend = (top) => ({ ...topLegend, y: top - 0.002, x: 0, font: { size: 11 } });
  const scale = (title, top) => flatAxis(title, { domain: [top - 0.19, top - 0.03], rangemode: "tozero", nticks: 4 });
  const layout = {
    ...plainLayout(), hovermode: "x unified", showlegend: true, margin: { l: 58, r: 12, t: 20, b: 44 },
    xaxis: flatAxis("keyframes", { anchor: "y4", tickformat: ",d" }),
    yaxis: scale("score", tops[0]), yaxis2: scale("at worst", tops[1]), yaxis3: scale("part of max", tops[2]),
    yaxis4: { ...scale("edges", tops[3]), tickformat: ",d", ...(largest(moments.n_inserted) < 4 ? { dtick: 1 } : {}) }, shapes: [upright(x[state.moment])],
    legend: legend(tops[0]), legend2: legend(tops[1]), legend3: legend(tops[2]), legend4: legend(tops[3]),
  };
  return Plotly.react("curves", traces, layout, plotConfig);
}

function fillMoment() {
  const m = state.moment;
  const tile = (name, value, note) =>
    element("div", { className: "tile" }, element("h2", {}, name), element("p", { className: "value" }, value),
      element("p", { className: "hint" }, note));
  const worst = keyframes.label[moments.worst[m]];
  byId("tiles").replaceChildren(
    tile("Λ", short(moments.score[m]), moments.score[m] ? `at keyframe ${worst}` : "graph and space agree"),
    tile(element("span", {}, symbol("Λ_loc"), " and ", symbol("Λ_glob")), `${short(moments.local[m])} and ${short(moments.global_[m])}`, "there, its neighbourhood and the whole map"),
    tile("Z̄ and stable score", `${short(moments.mean_score[m])} and ${short(moments.stable_score[m])}`, "the mean, and what does not fade"),
    tile("Inserted edges", count(moments.n_inserted[m]), `${count(moments.n_collisions[m])} of them collisions, ${count(moments.n_new[m])} new`),
  );
  byId("when").textContent = `${count(moments.n_keyframes[m])} of ${plural(keyframes.label.length, "keyframe")}`;
  byId("scale-top").textContent = short(replayed.tops[m]);
  byId("plan").setAttribute("aria-label", `Map of ${moments.n_keyframes[m]} keyframes, coloured by ζ; worst: ${worst}`);
}

function show(moment) {
  state.moment = Math.max(0, Math.min(nMoments - 1, moment));
  byId("moment").value = state.moment;
  fillMoment();
  drawPlan();
  return Plotly.relayout("curves", { "shapes[0].x0": moments.n_keyframes[state.moment], "shapes[0].x1": moments.n_keyframes[state.moment] });
}

function play() {
  const button = byId("play");
  if (state.timer !== null) {
    clearInterval(state.timer);
    state.timer = null;
  } else {
    if (state.moment === nMoments - 1) show(0);
    const step = Math.max(1, Math.round(nMoments / 300)); // the whole takes some fifteen seconds
    state.timer = setInterval(() => (state.moment < nMoments - 1 ? show(state.moment + step) : play()), 50);
  }
  button.textContent = state.timer === null ? "▶" : "❚❚";
  button.setAttribute("aria-label", state.timer === null ? "Play" : "Pause");
}

function fillWords() {
  fillHead(replayed, "a replay");
  byId("notes").replaceChildren(...notesOf(replayed.input));
  byId("verdict-level").textContent = `Λ ${short(moments.score.at(-1))}`;
  byId("verdict-text").textContent = `at the end; the largest was ${short(largest(moments.score))}`;
  byId("map-hint").textContent =
    "Strong ring: the keyframe with the largest ζ. Faint ring: the newest keyframe." + (moved === null ? " Faint dots: where the map will grow." : " Each moment as it was estimated then.");
  byId("lags").replaceChildren(table({
    columns: ["metric", "lag", "correlation", "without lag"], heads: 1, className: "counts",
    rows: replayed.lags.map((row) => [symbol(row.metric), row.lag ?? "–", short(row.correlation), short(row.at_zero)]),
  }));
}

fillWords();
byId("moment").max = nMoments - 1;
byId("moment").value = state.moment;
const linked = /^#keyframes=(\d+)$/.exec(location.hash);
if (linked) state.moment = Math.max(0, moments.n_keyframes.findIndex((n) => n >= Number(linked[1])));
await drawCurves();
await show(state.moment);
byId("moment").addEventListener("input", (event) => show(Number(event.target.value)));
byId("play").addEventListener("click", play);
for (const id of ["show-pose-graph", "show-inserted"]) byId(id).addEventListener("change", drawPlan);
byId("curves").on("plotly_click", ({ points }) => show(moments.n_keyframes.indexOf(points[0].x)));
window.addEventListener("resize", drawPlan);
dark.addEventListener("change", () => drawCurves().then(drawPlan));
document.body.dataset.ready = "true";
