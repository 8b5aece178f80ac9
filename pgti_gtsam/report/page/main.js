// Reading order: fill the words, draw the plots, answer clicks.

const state = { keyframe: worst, place: null, closure: null, colour: "score", logarithmic: false };

// Choices. A keyframe leaves its place chosen, another keyframe does not.
const atKeyframe = (keyframe) => ({
  keyframe, closure: null, place: state.place !== null && inPlace(keyframe, state.place) ? state.place : null,
});
const atPlace = (place) => ({ keyframe: places[place].closest[1], place, closure: null });
const atClosure = (closure) => ({ keyframe: closures[closure].keyframes[1], place: null, closure });

/** The user's choice: shown in every view and kept in the address. */
function choose(choice, options) {
  const name = choice.place === null || choice.keyframe !== places[choice.place].closest[1]
    ? `keyframe=${choice.keyframe}` : `place=${places[choice.place].rank}`;
  history.replaceState(null, "", `#${name}`);
  return show(choice, options);
}

/** Show a choice in every view; `zoom` also moves the camera there. */
async function show(choice, { zoom = false } = {}) {
  Object.assign(state, choice);
  fillChoice();
  if (hasWebGL) drawMarks();
  await Promise.all([drawSignature(state.keyframe), markTrajectory()]);
  if (hasWebGL && zoom) await look(chosenView());
}

/** All words that depend on the choice. */
function fillChoice() {
  fillKeyframe(state.keyframe);
  describePlace(state.place);
  describeClosure(state.closure);
  markRow("places-table", state.place);
  markRow("closures-table", state.closure);
  byId("find-error").textContent = "";
}

/** What the address asks for (#keyframe=17, an index; #place=2, a rank), or null. */
function linkedChoice() {
  const [, name, number] = /^#(keyframe|place)=(\d+)$/.exec(location.hash) ?? [];
  if (name === "keyframe") return Number(number) < keyframes.n ? atKeyframe(Number(number)) : null;
  const place = places.findIndex((p) => p.rank === Number(number));
  return place < 0 ? null : atPlace(place);
}

async function drawAll() {
  fillChoice();
  await Promise.all([
    drawSweep(), drawSignature(state.keyframe), drawTrajectory(), ...(hasWebGL ? [drawMap()] : []),
  ]);
  if (hasWebGL) drawMarks();
}

/**
 * plotly's events carry the points hit; `keyframeOf` says which keyframe a point stands for. In space plotly reports the
 * click at every drawing until the button is up: a click on what is shown already must draw nothing.
 */
function onPlotClick(id, keyframeOf) {
  byId(id).on("plotly_click", ({ points }) => {
    const keyframe = keyframeOf(points[0]);
    if (keyframe !== state.keyframe) setTimeout(() => choose(atKeyframe(keyframe)));
  });
}

function listen() {
  const step = (by) => choose(atKeyframe((state.keyframe + by + keyframes.n) % keyframes.n));
  byId("previous").addEventListener("click", () => step(-1));
  byId("next").addEventListener("click", () => step(1));
  byId("find").addEventListener("submit", (event) => {
    event.preventDefault();
    const text = byId("find-text").value.trim();
    const found = findKeyframe(text);
    if (found !== null) choose(atKeyframe(found), { zoom: true });
    else byId("find-error").textContent = `No keyframe is called ${text}; indices run from 0 to ${keyframes.n - 1}.`;
  });
  for (const id of ["scale-linear", "scale-log"]) {
    byId(id).addEventListener("change", () => {
      state.logarithmic = byId("scale-log").checked;
      drawTrajectory();
    });
  }
  onPlotClick("trajectory", (point) => point.x);
  window.addEventListener("hashchange", () => linkedChoice() !== null && show(linkedChoice(), { zoom: true }));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  if (hasWebGL) listenToMap();
}

function listenToMap() {
  onPlotClick("map", clickedKeyframe);
  byId("map").on("plotly_relayout", fitMarkers);
  for (const [layer, id] of Object.entries(layerSwitches)) {
    byId(id).addEventListener("change", (event) => setLayer(layer, event.target.checked));
  }
  byId("show-spheres").addEventListener("change", drawMarks);
  byId("colour-by").addEventListener("change", (event) => {
    state.colour = event.target.value;
    describeMap();
    drawMap();
  });
  byId("view-whole").addEventListener("click", () => look(wholeView()));
  byId("view-selected").addEventListener("click", () => look(chosenView()));
  followCamera();
}

/** A choice from a table, with the map brought into view. */
function chooseFromTable(choice) {
  byId("map").scrollIntoView({ block: "nearest" });
  return choose(choice, { zoom: true });
}

fillHead(audit, "an audit");
fillVerdict(audit.verdict.level, audit.verdict.text);
fillTiles();
fillWarnings();
fillPlaces((place) => chooseFromTable(atPlace(place)));
fillClosures((closure) => chooseFromTable(atClosure(closure)));
fillInput();
fillOptions(audit.options);
fillOptimality();
describeMap();

Object.assign(state, linkedChoice() ?? (places.length ? atPlace(0) : atKeyframe(worst)));
await drawAll();
listen();
document.body.dataset.ready = "true";
