// A map in space as plotly draws it: edges, axes, the camera.

const hasWebGL = Boolean(document.createElement("canvas").getContext("webgl"));
if (!hasWebGL) {
  byId("map").textContent = "This browser offers no WebGL, which the map needs. All else on this page works.";
  report("no WebGL");
}

// Above this many keyframes, markers are squares of two triangles: a round one takes some hundred.
const mostDiscs = 3000;

/** All edges as one broken line: (i, j, gap), (i, j, gap), ...; `textOf` an end and its edge's number says what it is. */
function brokenLine(edges, textOf) {
  const line = { text: edges.flatMap(([i, j], k) => [textOf(i, k), textOf(j, k), ""]) };
  for (const axis of ["x", "y", "z"]) {
    const values = keyframes[axis];
    line[axis] = new Float64Array(3 * edges.length).fill(NaN);
    edges.forEach(([i, j], k) => {
      line[axis][3 * k] = values[i];
      line[axis][3 * k + 1] = values[j];
    });
  }
  return line;
}

/** Edges fade where they are many: 3000 are opaque, 20 000 nearly a veil. */
const fading = (number) => Math.max(0.15, Math.min(1, 3000 / number) ** 0.7);

/** Markers are small where keyframes are many, and grow as the eye comes nearer than for the whole map. */
function markerBase(camera) {
  const nearness = 2 ** Math.max(0, Math.round(Math.log2(eyeDistance(wholeView()) / eyeDistance(camera))));
  return Math.min(6, nearness * Math.max(2.5, 6 - keyframes.n / 1000));
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

/** The layout of a map seen by a camera. */
function spaceLayout(camera) {
  const scene = {
    xaxis: axis("x", 0), yaxis: axis("y", 1), zaxis: axis("z", 2),
    aspectmode: "manual", aspectratio: xyz(frame.ratio), camera,
    dragmode: planar ? "pan" : viewpoint.up[2] === 1 ? "turntable" : "orbit",
  };
  return { ...plainLayout(), margin: { l: 0, r: 0, t: 0, b: 0 }, scene, uirevision: "map" };
}

/** The camera that sees some keyframes, and a little around them. */
function viewOf(ends) {
  const seen = ends.map((i) => keyframes.position[i]);
  const middle = [0, 1, 2].map((k) => middleOf(seen.map((p) => p[k])));
  return cameraOn([...seen, ...around(middle, frame.scale / 20)], mapAspect());
}

let drawnBase = null; // of the markers, for the camera that they were last drawn for

/** Fit the markers to the camera, once it has come to rest: plotly draws the whole map anew. Pages say `markerSizes` and `layers`. */
const fitMarkers = (() => {
  let timer = null;
  const fit = () => {
    const base = markerBase(byId("map").layout.scene.camera);
    if (base === drawnBase) return;
    drawnBase = base;
    Plotly.restyle("map", { "marker.size": [markerSizes()] }, [layers.keyframes]);
  };
  return () => {
    clearTimeout(timer);
    timer = setTimeout(fit, 200);
  };
})();

const look = (camera) => Plotly.relayout("map", { "scene.camera": camera });
