// The flat charts of an audit.

/** Both signatures of a keyframe, their difference shaded, the split β marked. */
function drawSignature(keyframe) {
  const signature = signatureOf(keyframe);
  byId("signature").hidden = signature === null;
  if (signature === null) {
    byId("signature-hint").textContent = "The document holds no signatures of this keyframe; the worst ones have them.";
    return Promise.resolve();
  }
  const { times } = audit;
  const { beta } = audit.summary.split;
  const split = localTimes(beta);
  const local = distortion(signature, 0, split);
  const global = distortion(signature, split, times.length);
  byId("signature-hint").textContent =
    `Shaded: what the overlaps change. Split at β = ${beta}: ` +
    `local ζ ${short(local)}, global ζ ${short(global)}.`;
  const colors = theme();
  const curve = (y, name, color, dash, fill) => ({
    x: times, y: Array.from(y), name, mode: "lines", line: { color, width: 2, dash }, fill, fillcolor: colors.shade,
    hovertemplate: "t %{x:.3g}: %{y:.4g}",
  });
  const traces = [
    curve(signature.poseGraph, "pose graph", colors.blue, "solid", "none"),
    curve(signature.mergedGraph, "merged graph", colors.red, "dot", "tonexty"),
  ];
  const layout = {
    ...plainLayout(), showlegend: true, legend: topLegend, hovermode: "x", margin: { l: 58, r: 12, t: 30, b: 44 },
    xaxis: flatAxis("diffusion time", { type: "log", dtick: decades(times) >= 2 ? 1 : undefined }),
    yaxis: flatAxis("", { rangemode: "tozero", nticks: 6 }),
  };
  if (0 < split && split < times.length) {
    const at = Math.sqrt(times[split - 1] * times[split]);
    layout.shapes = [upright(at)];
    layout.annotations = [cornerNote(Math.log10(at), "right", "local "), cornerNote(Math.log10(at), "left", " global")];
  }
  return Plotly.react("signature", traces, layout, plotConfig);
}

/** ζ and stable score by keyframe: two charts, one abscissa. Infinite scores stand as triangles at the top. */
function drawTrajectory() {
  const colors = theme();
  const { logarithmic } = state;
  const index = Array.from(keyframes.label.keys());
  const words = (values, name) => (i) => `<b>${plotText(keyframes.label[i])}</b><br>${name} ${short(values[i])}`;
  const curve = (values, name, yaxis, color, fill) => ({
    x: index, y: Array.from(values, (v) => (v < Infinity && !(logarithmic && v === 0) ? v : null)), name, yaxis,
    mode: keyframes.n <= 2 ? "markers" : "lines", line: { color, width: 1.6 }, marker: { color },
    fill: logarithmic ? "none" : fill, fillcolor: colors.wash, text: index.map(words(values, name)), hoverinfo: "text",
  });
  const peaks = (values, name, yaxis) => {
    const at = index.filter((i) => values[i] === Infinity);
    return {
      x: at, y: at.map(() => topOf(values)), mode: "markers", name, yaxis, text: at.map(words(values, name)),
      hoverinfo: "text", marker: { symbol: "triangle-up", size: 9, color: colors.red }, showlegend: false,
    };
  };
  const scale = { type: logarithmic ? "log" : "linear", rangemode: "tozero", nticks: 5 };
  const range = [-0.01 * keyframes.n - 0.5, 1.01 * keyframes.n - 0.5];
  const layout = {
    ...plainLayout(), shapes: trajectoryMarks(), showlegend: true, legend: topLegend,
    margin: { l: 58, r: 12, t: 26, b: 44 },
    xaxis: flatAxis("keyframe index", { anchor: "y2", range, tickformat: ",d" }),
    yaxis: flatAxis("ζ", { domain: [0.55, 1], ...scale }),
    yaxis2: flatAxis("stable score", { domain: [0, 0.45], ...scale }),
  };
  const traces = [
    curve(keyframes.score, "ζ", "y", colors.accent, "tozeroy"),
    curve(keyframes.collision, "ζ of collisions", "y", colors.red, "none"),
    { ...curve(keyframes.stable, "stable score", "y2", colors.accent, "tozeroy"), showlegend: false },
    peaks(keyframes.score, "ζ", "y"), peaks(keyframes.collision, "ζ of collisions", "y"),
    peaks(keyframes.stable, "stable score", "y2"),
  ];
  return Plotly.react("trajectory", traces, layout, plotConfig);
}

/** The chosen keyframe and the stretches of the chosen place, as shapes: these change without the curves. */
function trajectoryMarks() {
  const colors = theme();
  const dot = (value, yref) => ({
    type: "circle", xsizemode: "pixel", ysizemode: "pixel", xanchor: state.keyframe, yanchor: value, yref,
    x0: -4.5, x1: 4.5, y0: -4.5, y1: 4.5, fillcolor: colors.panel, line: { color: colors.ink, width: 2 },
  });
  const dots = [[keyframes.score, "y"], [keyframes.stable, "y2"]]
    .map(([values, yref]) => [values[state.keyframe], yref])
    .filter(([value]) => value < Infinity && !(state.logarithmic && value === 0));
  const bands = (state.place === null ? [] : places[state.place].stretches).map(([first, last]) => ({
    type: "rect", x0: first - 0.5, x1: last + 0.5, yref: "paper", y0: 0, y1: 1, layer: "below", opacity: 0.35,
    fillcolor: placeColour(state.place), line: { color: placeColour(state.place), width: 1 },
  }));
  return [...bands, upright(state.keyframe), ...dots.map(([value, yref]) => dot(value, yref))];
}

const markTrajectory = () => Plotly.relayout("trajectory", { shapes: trajectoryMarks() });

/** Λ_loc and Λ_glob against β; infinite values are left out. */
function drawSweep() {
  const colors = theme();
  const beta = audit.beta_sweep.map((row) => row.beta);
  const scores = (key) => audit.beta_sweep.map((row) => scoreOf(row[key]));
  const curve = (key, name, color, symbol) => ({
    x: beta, y: scores(key).map((s) => (s < Infinity ? s : null)), name,
    mode: "lines+markers", line: { color, width: 2 }, marker: { symbol, size: 7, color },
    hovertemplate: "β %{x}: %{y:.3g}",
  });
  const layout = {
    ...plainLayout(), showlegend: true, legend: topLegend, hovermode: "x", margin: { l: 58, r: 12, t: 30, b: 44 },
    shapes: [upright(audit.summary.split.beta)], xaxis: flatAxis("split β", { range: [0, 1] }),
    yaxis: flatAxis("", { rangemode: "tozero", nticks: 6 }),
  };
  if (![...scores("local"), ...scores("global")].some((s) => s < Infinity)) {
    const text = "Infinite at every β: the pose graph leaves<br>the worst keyframe alone.";
    const inside = { xref: "paper", x: 0.5, yref: "paper", y: 0.5, showarrow: false, bgcolor: colors.panel };
    layout.annotations = [{ ...inside, text }];
  }
  const traces = [
    curve("local", "Λ<sub>loc</sub>", colors.accent, "circle"),
    curve("global", "Λ<sub>glob</sub>", colors.red, "square"),
  ];
  return Plotly.react("sweep", traces, layout, plotConfig);
}
