// The map in space. Traces: edges of G_p, inserted edges, spheres, keyframes, the chosen keyframe.

const layers = { poseGraph: 0, inserted: 1, spheres: 2, keyframes: 3, chosen: 4 };
const layerSwitches = { poseGraph: "show-pose-graph", inserted: "show-inserted", spheres: "show-spheres" };

// Spheres are meshes of some 80 faces: above this many, only those around the places listed are drawn.
const mostSpheres = 400;

const sphereKeyframes = (() => {
  const all = keyframes.n <= mostSpheres;
  const wanted = all ? [...keyframes.label.keys()] : [...new Set(audit.places.flatMap((p) => p.keyframes))];
  return wanted.filter((i) => keyframes.radius[i] > 0 && Number.isFinite(keyframes.radius[i])).slice(0, mostSpheres);
})();

const hoverTexts = keyframes.label.map((label, i) =>
  [`<b>${plotText(label)}</b>`, `ζ ${short(keyframes.score[i])}`, `radius ${metres(keyframes.radius[i])}`,
    `at ${place(keyframes.position[i])} m`].join("<br>"),
);

/** All edges as one broken line: (i, j, gap), (i, j, gap), ... */
function edgeTrace(edges, name, color, width) {
  const line = { x: new Float64Array(3 * edges.length), y: null, z: null };
  line.y = line.x.slice();
  line.z = line.x.slice();
  const text = [];
  edges.forEach((ends, k) => {
    for (const axis of ["x", "y", "z"]) {
      line[axis].set([keyframes[axis][ends[0]], keyframes[axis][ends[1]], NaN], 3 * k);
    }
    text.push(hoverTexts[ends[0]], hoverTexts[ends[1]], "");
  });
  return { type: "scatter3d", mode: "lines", name, ...line, text, hoverinfo: "text", line: { color, width } };
}

/** Vertices and faces of a unit ball (a twice halved octahedron, 66 vertices), or of a disc for a planar map. */
function unitBall() {
  if (planar) {
    const corners = 32;
    const rim = Array.from({ length: corners }, (_, k) => (2 * Math.PI * k) / corners);
    return {
      vertices: [[0, 0, 0], ...rim.map((a) => [Math.cos(a), Math.sin(a), 0])],
      faces: rim.map((_, k) => [0, 1 + k, 1 + ((k + 1) % corners)]),
    };
  }
  const vertices = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
  let faces = [0, 1].flatMap((x) => [2, 3].flatMap((y) => [4, 5].map((z) => [x, y, z])));
  for (let halving = 0; halving < 2; halving++) {
    const middles = new Map();
    const middle = (a, b) => {
      const key = a < b ? `${a} ${b}` : `${b} ${a}`;
      if (!middles.has(key)) middles.set(key, vertices.push(unit(vertices[a].map((v, k) => v + vertices[b][k]))) - 1);
      return middles.get(key);
    };
    faces = faces.flatMap(([a, b, c]) => {
      const [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
      return [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]];
    });
  }
  return { vertices, faces };
}

const ballSize = planar ? 33 : 66;

function sphereTrace() {
  const ball = unitBall();
  const mesh = { x: [], y: [], z: [], i: [], j: [], k: [], text: [] };
  sphereKeyframes.forEach((keyframe, copy) => {
    const centre = keyframes.position[keyframe];
    const radius = keyframes.radius[keyframe];
    for (const v of ball.vertices) {
      mesh.x.push(centre[0] + radius * v[0]);
      mesh.y.push(centre[1] + radius * v[1]);
      mesh.z.push(centre[2] + radius * v[2]);
      mesh.text.push(hoverTexts[keyframe]);
    }
    for (const f of ball.faces) {
      mesh.i.push(copy * ballSize + f[0]);
      mesh.j.push(copy * ballSize + f[1]);
      mesh.k.push(copy * ballSize + f[2]);
    }
  });
  const lighting = { ambient: 0.8, diffuse: 0.3, specular: 0 };
  return { type: "mesh3d", name: "spheres", ...mesh, hoverinfo: "text", color: theme().ball, opacity: 0.18, lighting };
}

const level = keyframes.score.map((s) => (Number.isNaN(s) ? 0 : Math.min(s, topScore)));

/** Markers grow with ζ, shrink where keyframes are many, and grow again as the eye comes near. */
function markerSizes(nearness = 1) {
  const base = Math.min(6, nearness * Math.max(2.5, 6 - keyframes.n / 1000));
  return Array.from(level, (s) => base * (1 + s / topScore));
}

function keyframeTrace() {
  const colors = theme();
  return {
    type: "scatter3d", mode: "markers", name: "keyframes",
    x: keyframes.x, y: keyframes.y, z: keyframes.z, text: hoverTexts, hoverinfo: "text",
    marker: {
      size: markerSizes(),
      symbol: Array.from(keyframes.score, (s) => (s === Infinity ? "diamond" : "circle")),
      color: level, cmin: 0, cmax: topScore, colorscale: "Viridis", opacity: 1,
      line: { color: colors.outline, width: keyframes.n <= 2000 ? 0.8 : 0 },
      colorbar: {
        title: { text: "ζ", font: { size: 16 } }, thickness: 12, len: 0.75, x: 1, xpad: 4, outlinewidth: 0,
        tickfont: { color: colors.muted },
      },
    },
  };
}

function chosenTrace() {
  const { ink } = theme();
  return {
    type: "scatter3d", mode: "markers", name: "chosen", x: [], y: [], z: [], hoverinfo: "skip",
    marker: { size: 17, symbol: "circle-open", color: ink, line: { width: 3, color: ink } },
  };
}

function axis(name, k) {
  const colors = theme();
  return {
    title: { text: `${name} (m)`, font: { color: colors.muted, size: 12 } }, range: frame.range[k], autorange: false,
    visible: !(planar && name === "z"), showspikes: false, showbackground: false, zeroline: false,
    gridcolor: colors.grid, linecolor: colors.grid, tickfont: { color: colors.muted, size: 10 },
    nticks: Math.max(2, Math.round(8 * frame.ratio[k])),
  };
}

const mapAspect = () => byId("map").clientWidth / byId("map").clientHeight;
const wholeView = () => cameraOn([...keyframes.position, ...(planar ? [] : frame.corners)], mapAspect());

function drawMap() {
  const colors = theme();
  const scene = {
    xaxis: axis("x", 0), yaxis: axis("y", 1), zaxis: axis("z", 2),
    aspectmode: "manual", aspectratio: xyz(frame.ratio), camera: wholeView(),
    dragmode: planar ? "pan" : viewpoint.up[2] === 1 ? "turntable" : "orbit",
  };
  const traces = [
    edgeTrace(audit.edges.pose_graph, "pose graph", colors.blue, 2),
    edgeTrace(audit.edges.inserted, "missing connections", colors.red, audit.edges.inserted.length > 2000 ? 3 : 6),
    sphereTrace(), keyframeTrace(), chosenTrace(),
  ];
  for (const layer of Object.keys(layerSwitches)) traces[layers[layer]].visible = byId(layerSwitches[layer]).checked;
  const layout = { ...plainLayout(), margin: { l: 0, r: 0, t: 0, b: 0 }, scene, uirevision: "map" };
  return Plotly.react("map", traces, layout, mapConfig);
}

/** Fit the markers to the camera's distance, in powers of two, so that they are seldom uploaded anew. */
const fitMarkers = (() => {
  let current = 1;
  const distance = ({ eye, center }) => Math.hypot(eye.x - center.x, eye.y - center.y, eye.z - center.z);
  return async () => {
    const { camera } = byId("map").layout.scene;
    const nearness = 2 ** Math.max(0, Math.round(Math.log2(distance(wholeView()) / distance(camera))));
    if (nearness === current) return;
    current = nearness;
    await Plotly.restyle("map", { "marker.size": [markerSizes(nearness)] }, [layers.keyframes]);
  };
})();

/** The keyframe under a click: edges and spheres answer for the keyframe at the vertex that was hit. */
function clickedKeyframe({ curveNumber, pointNumber }) {
  if (curveNumber === layers.chosen) return state.keyframe;
  if (curveNumber === layers.spheres) return sphereKeyframes[Math.floor(pointNumber / ballSize)];
  const edges = { [layers.poseGraph]: audit.edges.pose_graph, [layers.inserted]: audit.edges.inserted }[curveNumber];
  return edges ? edges[Math.floor(pointNumber / 3)][pointNumber % 3] : pointNumber;
}

function markOnMap(keyframe) {
  const [x, y, z] = keyframes.position[keyframe];
  const colors = theme();
  const flag = {
    x, y, z, text: plotText(keyframes.label[keyframe]), ax: 0, ay: -34, showarrow: true, arrowhead: 0, arrowwidth: 1.5,
    standoff: 10, arrowcolor: colors.ink, font: { color: colors.panel, size: 12 }, bgcolor: colors.ink, borderpad: 3,
  };
  const ring = { x: [[x]], y: [[y]], z: [[z]] };
  return Plotly.update("map", ring, { "scene.annotations": [flag] }, [layers.chosen]);
}

/** Look at a keyframe with the keyframes and the space around it. */
function zoomTo(keyframe) {
  const joined = [...neighbours(audit.edges.inserted, keyframe), ...neighbours(audit.edges.pose_graph, keyframe)];
  const centre = keyframes.position[keyframe];
  const distances = joined.map((i) => Math.hypot(...keyframes.position[i].map((v, k) => v - centre[k])));
  const farthest = Math.min(Math.max(0, ...distances), frame.scale / 6);
  const reach = Math.max(keyframes.radius[keyframe], frame.scale / 25, farthest);
  return Plotly.relayout("map", { "scene.camera": cameraOn(around(centre, reach), mapAspect()) });
}

const seeWholeMap = () => Plotly.relayout("map", { "scene.camera": wholeView() });
const setLayer = (layer, visible) => Plotly.restyle("map", { visible }, [layers[layer]]);

function describeMap() {
  const all = keyframes.n <= mostSpheres;
  byId("spheres-label").textContent = all ? "minimum spheres" : "spheres of worst places";
  byId("show-spheres").disabled = sphereKeyframes.length === 0;
  const parts = [`Drag to ${planar ? "move" : "turn"}, scroll to zoom. Click a keyframe to choose it.`];
  if (keyframes.score.includes(Infinity)) parts.push("Diamonds: infinite ζ, at the top of the colour scale.");
  if (!all) {
    const drawn = count(sphereKeyframes.length);
    parts.push(`Of ${count(keyframes.n)} spheres only the ${drawn} in the places listed below can be drawn.`);
  }
  byId("map-hint").textContent = parts.join(" ");
}
