// The map in space. Traces: odometry, closures by verdict, keyframes. What is chosen is drawn on the canvas.

const layers = { odometry: 0, rejected: 1, undecided: 2, accepted: 3, keyframes: 4 };

const hoverTexts = keyframes.label.map((label, i) =>
  `<b>${plotText(label)}</b><br>at ${coordinates(keyframes.position[i])} m`);

const closureText = (c) => `<b>${plotText(closureLabel(c))}</b><br>${c.verdict}, ${percent(c)}`;

const odometryLine = brokenLine(gated.edges.odometry, (i) => hoverTexts[i]);
const closureLines = Object.fromEntries(verdicts.map((verdict) => {
  const own = byVerdict[verdict].map((k) => closures[k]);
  return [verdict, brokenLine(own.map((c) => c.ends), (_, k) => closureText(own[k]))];
}));

/** Colour of a verdict, as the style sheet has it for light or dark. */
const verdictColour = (verdict) => getComputedStyle(document.documentElement).getPropertyValue(`--${verdict}`).trim();

function closureTrace(verdict) {
  return {
    type: "scatter3d", mode: "lines", name: verdict, ...closureLines[verdict], hoverinfo: "text",
    line: { color: verdictColour(verdict), width: verdict === "accepted" ? 5 : 3 }, opacity: Math.min(1, 2 * fading(10 * byVerdict[verdict].length)),
    visible: state.shown.has(verdict),
  };
}

const markerSizes = () => 0.6 * drawnBase;

/** Draw the map, as seen so far or, at first, as a whole. */
function drawMap() {
  const colors = theme();
  const camera = byId("map").layout?.scene?.camera ?? wholeView();
  drawnBase = markerBase(camera);
  const odometry = {
    type: "scatter3d", mode: "lines", name: "odometry", ...odometryLine, hoverinfo: "text",
    line: { color: colors.blue, width: 2 }, opacity: fading(gated.edges.odometry.length),
  };
  const dots = {
    type: "scatter3d", mode: "markers", name: "keyframes", x: keyframes.x, y: keyframes.y, z: keyframes.z,
    text: hoverTexts, hoverinfo: "text",
    marker: { size: markerSizes(), color: colors.muted, symbol: keyframes.n <= mostDiscs ? "circle" : "square" },
  };
  const traces = [odometry, ...["rejected", "undecided", "accepted"].map(closureTrace), dots];
  return Plotly.react("map", traces, spaceLayout(camera), mapConfig);
}

/** Show the closures that the filter leaves: all at once, for plotly draws the whole map anew. */
const showLayers = () =>
  Plotly.restyle("map", { visible: verdicts.map((name) => state.shown.has(name)) }, verdicts.map((name) => layers[name]));

/** The closure under a click, or null. */
function clickedClosure({ curveNumber, pointNumber }) {
  const verdict = verdicts.find((name) => layers[name] === curveNumber);
  return verdict === undefined ? null : byVerdict[verdict][Math.floor(pointNumber / 3)];
}

const chosenView = () => (state.closure === null ? wholeView() : viewOf(closures[state.closure].ends));

/** The chosen closure: its line, and a ring around either end, the flags pointing apart. */
function drawMarks() {
  fitCanvas(byId("map")._fullLayout._size);
  const closure = state.closure === null ? null : closures[state.closure];
  byId("marks").setAttribute("aria-label", closure === null ? "Marked: nothing" : `Marked: closure ${closureLabel(closure)}`);
  if (closure === null) return;
  const colors = theme();
  const project = projector();
  const [a, b] = closure.ends.map((i) => project(keyframes.position[i]));
  if (a !== null && b !== null) stroke(line([a, b]), verdictColour(closure.verdict), 3, { rim: colors.panel });
  [a, b].forEach((at, k) => {
    const other = k ? a : b;
    const isBelow = other !== null && at !== null && (at.y > other.y || (at.y === other.y && k === 1));
    if (at !== null) drawRing(at, colors, keyframes.label[closure.ends[k]], isBelow, 6);
  });
}

function describeMap() {
  byId("map-hint").textContent = `Drag to ${planar ? "move" : "turn"}, scroll to zoom. Click a closure to choose it. ` +
    `The map is drawn ${gated.drawn}.`;
}
