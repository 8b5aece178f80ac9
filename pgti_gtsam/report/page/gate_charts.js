// Closures in time: how probable each is, and Λ_glob before and after.

const mostOdds = 10; // log odds beyond which a closure is drawn at the rim
const oddsTicks = { "0.01 %": -9.21, "1 %": -4.6, "50 %": 0, "99 %": 4.6, "99.99 %": 9.21 };

const oddsOf = (c) => {
  const odds = numberOf(c.log_odds);
  return Number.isNaN(odds) ? null : Math.max(-mostOdds, Math.min(mostOdds, odds));
};

const later = (c) => c.ends[1];
const inChart = (c) => `<b>${plotText(closureLabel(c))}</b><br>${c.verdict}, ${percent(c)}` +
  (c.global_score === null ? "" : `<br>Λ<sub>glob</sub> ${change(c.global_score)}`);

/** A closure's symbol tells the verdict where its colour does not. */
const symbols = { accepted: "circle", undecided: "diamond", rejected: "x-thin" };

function pointsOf(verdict, values, yaxis) {
  const color = verdictColour(verdict);
  const shown = state.shown.has(verdict) ? byVerdict[verdict].filter(isListed) : [];
  return {
    mode: "markers", name: verdict, x: shown.map((k) => later(closures[k])), y: shown.map((k) => values(closures[k])),
    customdata: shown, text: shown.map((k) => inChart(closures[k])), hoverinfo: "text", yaxis,
    marker: { color, size: 7, symbol: symbols[verdict], line: { color, width: verdict === "rejected" ? 1.8 : 0 } },
  };
}

/** A line from Λ_glob before to Λ_glob after for every closure. */
function spikesOf(verdict) {
  const shown = (state.shown.has(verdict) ? byVerdict[verdict].filter(isListed) : [])
    .map((k) => closures[k]).filter((c) => c.global_score !== null);
  return {
    mode: "lines", hoverinfo: "skip", yaxis: "y2", line: { color: verdictColour(verdict), width: 1.5 },
    x: shown.flatMap((c) => [later(c), later(c), null]),
    y: shown.flatMap((c) => [numberOf(c.global_score.before), numberOf(c.global_score.after), null]),
  };
}

const timeHeight = () => byId("time").style.setProperty("height", hasScores ? "420px" : "230px");

function drawTime() {
  timeHeight();
  const score = (c) => (c.global_score === null ? null : numberOf(c.global_score.after));
  const range = [-0.01 * keyframes.n - 0.5, 1.01 * keyframes.n - 0.5];
  const layout = {
    ...plainLayout(), shapes: timeMarks(), margin: { l: 64, r: 12, t: 8, b: 44 },
    xaxis: flatAxis("keyframe at which the closure came", { anchor: hasScores ? "y2" : "y", range, tickformat: ",d" }),
    yaxis: flatAxis("probability", {
      domain: hasScores ? [0.56, 1] : [0, 1], range: [-11, 11],
      tickvals: Object.values(oddsTicks), ticktext: Object.keys(oddsTicks),
    }),
    ...(hasScores && { yaxis2: flatAxis("Λ<sub>glob</sub>", { domain: [0, 0.46], rangemode: "tozero", nticks: 6 }) }),
  };
  const order = ["rejected", "undecided", "accepted"];
  const traces = [
    ...order.map((verdict) => pointsOf(verdict, oddsOf, "y")),
    ...(hasScores ? order.flatMap((verdict) => [spikesOf(verdict), pointsOf(verdict, score, "y2")]) : []),
  ];
  return Plotly.react("time", traces, layout, plotConfig);
}

/** The bounds of the verdicts, and where the chosen closure came. */
function timeMarks() {
  const { min_probability: least, rule } = gated.options;
  const bound = rule === "log_odds" ? Math.log(least / (1 - least)) : null;
  const bounds = bound === null ? [] : [bound, -bound].map((y) => ({
    type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y, yref: "y", layer: "below",
    line: { color: theme().muted, width: 1, dash: "dot" },
  }));
  return [...bounds, ...(state.closure === null ? [] : [upright(later(closures[state.closure]))])];
}

const markTime = () => Plotly.relayout("time", { shapes: timeMarks() });

function describeTime() {
  const parts = ["Click a closure to choose it."];
  if (gated.options.rule === "log_odds") parts.push("Dotted: from where closures are accepted, and up to where rejected.");
  const rest = hasScores
    ? " of the map: from without the closure to with it, all else as in the end."
    : " before and after was not computed: --scores adds both.";
  byId("time-hint").replaceChildren(`${parts.join(" ")} `, symbol("Λ_glob"), rest);
}
