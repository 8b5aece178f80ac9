// Reading order: collect errors, fill the words, draw the plots, answer clicks.

const errors = [];
const report = (text) => {
  errors.push(String(text));
  document.body.dataset.errors = JSON.stringify(errors);
};
window.addEventListener("error", (event) => report(event.message));
window.addEventListener("unhandledrejection", (event) => report(event.reason));
document.addEventListener("securitypolicyviolation", (event) =>
  report(`blocked: ${event.violatedDirective} ${event.blockedURI}`));

const state = { keyframe: worst, logarithmic: false };
const hasWebGL = Boolean(document.createElement("canvas").getContext("webgl"));

/** The user's choice: shown in every view and kept in the address. */
function choose(keyframe, options) {
  history.replaceState(null, "", `#keyframe=${keyframe}`);
  return show(keyframe, options);
}

/** Show a keyframe in every view; `zoom` also moves the camera there. */
async function show(keyframe, { zoom = false } = {}) {
  state.keyframe = keyframe;
  fillKeyframe(keyframe);
  markPlace(keyframe);
  byId("find-error").textContent = "";
  await Promise.all([drawSignature(keyframe), drawTrajectory(keyframe, state.logarithmic)]);
  if (!hasWebGL) return;
  await markOnMap(keyframe);
  if (zoom) await zoomTo(keyframe);
}

/** The keyframe index that the address asks for (#keyframe=17), or null. */
function linkedKeyframe() {
  const match = /^#keyframe=(\d+)$/.exec(location.hash);
  return match && Number(match[1]) < keyframes.n ? Number(match[1]) : null;
}

async function drawAll() {
  await Promise.all([drawSweep(), ...(hasWebGL ? [drawMap()] : [])]);
  await show(state.keyframe);
}

/**
 * plotly's events carry the points hit; `keyframeOf` says which keyframe a point stands for. In space plotly reports the
 * click at every drawing until the button is up: a click on what is shown already must draw nothing.
 */
function onPlotClick(id, keyframeOf) {
  byId(id).on("plotly_click", ({ points }) => {
    const keyframe = keyframeOf(points[0]);
    if (keyframe !== state.keyframe) setTimeout(choose, 0, keyframe);
  });
}

function listen() {
  const step = (by) => choose((state.keyframe + by + keyframes.n) % keyframes.n);
  byId("previous").addEventListener("click", () => step(-1));
  byId("next").addEventListener("click", () => step(1));
  byId("find").addEventListener("submit", (event) => {
    event.preventDefault();
    const text = byId("find-text").value.trim();
    const found = findKeyframe(text);
    if (found !== null) choose(found, { zoom: true });
    else byId("find-error").textContent = `No keyframe is called ${text}; indices run from 0 to ${keyframes.n - 1}.`;
  });
  for (const id of ["scale-linear", "scale-log"]) {
    byId(id).addEventListener("change", () => {
      state.logarithmic = byId("scale-log").checked;
      drawTrajectory(state.keyframe, state.logarithmic);
    });
  }
  onPlotClick("trajectory", (point) => point.x);
  window.addEventListener("hashchange", () => linkedKeyframe() !== null && show(linkedKeyframe(), { zoom: true }));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  if (hasWebGL) listenToMap();
}

function listenToMap() {
  onPlotClick("map", clickedKeyframe);
  byId("map").on("plotly_relayout", fitMarkers);
  for (const [layer, id] of Object.entries(layerSwitches)) {
    byId(id).addEventListener("change", (event) => setLayer(layer, event.target.checked));
  }
  byId("view-whole").addEventListener("click", seeWholeMap);
  byId("view-selected").addEventListener("click", () => zoomTo(state.keyframe));
}

fillHeader();
fillTiles();
fillWarnings();
fillPlaces((keyframe) => choose(keyframe, { zoom: true }));
fillInput();
fillOptions();
fillOptimality();
describeMap();
if (!hasWebGL) {
  byId("map").textContent = "This browser offers no WebGL, which the map needs. All else on this page works.";
  report("no WebGL");
}

const linked = linkedKeyframe();
state.keyframe = linked ?? worst;
await drawAll();
listen();
if (linked !== null && hasWebGL) await zoomTo(linked);
document.body.dataset.ready = "true";
