// The map in space. Traces: edges of G_p, fusion edges, collisions, keyframes. What is chosen: marks.js.

const layers = { poseGraph: 0, fusion: 1, collisions: 2, keyframes: 3 };
const layerEdges = [audit.edges.pose_graph, audit.edges.fusion, audit.edges.collisions];
const layerSwitches = { poseGraph: "show-pose-graph", fusion: "show-fusion", collisions: "show-collisions" };

const hoverTexts = keyframes.label.map((label, i) =>
  [`<b>${plotText(label)}</b>`, `ζ ${short(keyframes.score[i])}, of collisions ${short(keyframes.collision[i])}`,
    `radius ${metres(keyframes.radius[i])}`, `at ${coordinates(keyframes.position[i])} m`].join("<br>"),
);

const brokenLines = layerEdges.map((edges) => brokenLine(edges, (i) => hoverTexts[i]));

function edgeTrace(layer, name, color, width, opacity) {
  const look = { line: { color, width }, opacity, visible: byId(layerSwitches[layer]).checked };
  return { type: "scatter3d", mode: "lines", name, ...brokenLines[layers[layer]], hoverinfo: "text", ...look };
}

const scoreLevels = (values) => {
  const top = topOf(values);
  return { top, level: values.map((s) => (Number.isNaN(s) ? 0 : Math.min(s, top))) };
};

/** What the keyframes can be coloured by. */
const colourings = {
  score: { title: "ζ", values: keyframes.score, ...scoreLevels(keyframes.score) },
  collisions: { title: "ζ of<br>collisions", values: keyframes.collision, ...scoreLevels(keyframes.collision) },
  place: { values: null, top: 1, level: Float64Array.from(placeOf, (k) => (k < 0 ? 0 : 1)) },
};

/** A score enlarges its marker. */
function markerSizes() {
  const { level, top } = colourings[state.colour];
  return Array.from(level, (s) => drawnBase * (1 + s / top));
}

function markerColours() {
  const { dull, muted } = theme();
  const { values, level, top, title } = colourings[state.colour];
  if (values === null) return { color: Array.from(placeOf, (k) => (k < 0 ? dull : placeColour(k))), showscale: false };
  const colorbar = {
    title: { text: title, font: { size: 14 } }, thickness: 12, len: 0.75, x: 1, xpad: 4, outlinewidth: 0,
    tickfont: { color: muted },
  };
  return { color: level, cmin: 0, cmax: top, colorscale: "Viridis", showscale: true, colorbar };
}

function keyframeTrace() {
  const { values } = colourings[state.colour];
  const plain = keyframes.n <= mostDiscs ? "circle" : "square";
  return {
    type: "scatter3d", mode: "markers", name: "keyframes",
    x: keyframes.x, y: keyframes.y, z: keyframes.z, text: hoverTexts, hoverinfo: "text",
    marker: {
      size: markerSizes(), opacity: 1, ...markerColours(),
      symbol: values === null ? plain : Array.from(values, (s) => (s === Infinity ? "diamond" : plain)),
      line: { color: theme().outline, width: values !== null && keyframes.n <= 2000 ? 0.8 : 0 },
    },
  };
}

/** Draw the map, as seen so far or, at first, as the choice asks for. */
function drawMap() {
  const colors = theme();
  const camera = byId("map").layout?.scene?.camera ?? chosenView();
  drawnBase = markerBase(camera);
  const traces = [
    edgeTrace("poseGraph", "pose graph", colors.blue, 2, fading(audit.edges.pose_graph.length)),
    edgeTrace("fusion", "fusion", colors.fusion, 2, fading(audit.edges.fusion.length)),
    edgeTrace("collisions", "collisions", colors.red, audit.edges.collisions.length > 2000 ? 3 : 5, 1),
    keyframeTrace(),
  ];
  return Plotly.react("map", traces, spaceLayout(camera), mapConfig);
}

/** The keyframe under a click: an edge answers for the keyframe at the end that was hit. */
function clickedKeyframe({ curveNumber, pointNumber }) {
  const edges = layerEdges[curveNumber];
  return edges ? edges[Math.floor(pointNumber / 3)][pointNumber % 3] : pointNumber;
}

/** The camera that sees what is chosen: a place's stretches, a closure's ends, or a keyframe and its neighbours. */
function chosenView() {
  const ends = chosenEnds();
  if (ends === null) return keyframeView(state.keyframe);
  return viewOf(ends);
}

function chosenEnds() {
  if (state.closure !== null) return closures[state.closure].keyframes;
  return state.place === null ? null : places[state.place].stretches.flatMap(stretch);
}

function keyframeView(keyframe) {
  const joined = Object.values(joinedBy).flatMap((neighbours) => neighbours(keyframe));
  const centre = keyframes.position[keyframe];
  const distances = joined.map((i) => Math.hypot(...keyframes.position[i].map((v, k) => v - centre[k])));
  const farthest = Math.min(Math.max(0, ...distances), frame.scale / 6);
  const reach = Math.max(keyframes.radius[keyframe], frame.scale / 25, farthest);
  return cameraOn(around(centre, reach), mapAspect());
}

const setLayer = (layer, visible) => Plotly.restyle("map", { visible }, [layers[layer]]);

function describeMap() {
  const parts = [`Drag to ${planar ? "move" : "turn"}, scroll to zoom. Click a keyframe to choose it.`];
  const { values } = colourings[state.colour];
  if (values?.includes(Infinity)) parts.push("Diamonds: infinite ζ, at the top of the colour scale.");
  if (values === null) {
    parts.push("Colours as in the table of places; grey: in none of them.");
    if (places.length > placeColours.length) parts.push(`Every ${placeColours.length + 1}th place starts the colours anew.`);
  }
  if (places.length) parts.push("Of the place that is chosen, the earlier stretch is drawn solid, the later one dashed.");
  byId("map-hint").textContent = parts.join(" ");
}
