// Reading order: fill the words, draw the plots, answer clicks.

const state = { closure: closures.length ? 0 : null, shown: new Set(verdicts), at: "" };

/** The user's choice: shown in every view and kept in the address. */
async function choose(closure, { zoom = false } = {}) {
  state.closure = closure;
  history.replaceState(null, "", `#slot=${closures[closure].slot}`);
  await show();
  if (hasWebGL && zoom) await look(chosenView());
}

async function show() {
  fillClosure(state.closure);
  markChosen();
  if (hasWebGL) drawMarks();
  await markTime();
}

/** What the address asks for (#slot=1234, of a factor in the graph), or null. */
function linkedChoice() {
  const [, slot] = /^#slot=(\d+)$/.exec(location.hash) ?? [];
  const found = closures.findIndex((c) => c.slot === Number(slot));
  return found < 0 ? null : found;
}

/** A choice from a table, with the map brought into view. */
function chooseFromTable(closure) {
  byId("map").scrollIntoView({ block: "nearest" });
  return choose(closure, { zoom: true });
}

/** All that the filter changes. */
async function refilter() {
  fillClosures(chooseFromTable);
  markChosen();
  await Promise.all([drawTime(), ...(hasWebGL ? [showLayers()] : [])]);
}

async function drawAll() {
  await Promise.all([drawTime(), ...(hasWebGL ? [drawMap()] : [])]);
  await show();
}

/** The next closure that the filter leaves, in the order of the table. */
function step(by) {
  const shown = listed();
  if (!shown.length) return;
  const at = shown.indexOf(state.closure);
  choose(shown[at < 0 ? 0 : (at + by + shown.length) % shown.length], { zoom: true });
}

/** plotly reports a click in space at every drawing: one on what is chosen already must draw nothing. */
function onPlotClick(id, closureOf) {
  byId(id).on("plotly_click", ({ points }) => {
    const closure = closureOf(points[0]);
    if (closure !== null && closure !== state.closure) setTimeout(() => choose(closure));
  });
}

function listen() {
  for (const verdict of verdicts) {
    byId(`show-${verdict}`).addEventListener("change", (event) => {
      if (event.target.checked) state.shown.add(verdict);
      else state.shown.delete(verdict);
      refilter();
    });
  }
  byId("at").addEventListener("change", (event) => {
    state.at = event.target.value.trim();
    refilter();
  });
  byId("previous").addEventListener("click", () => step(-1));
  byId("next").addEventListener("click", () => step(1));
  onPlotClick("time", (point) => point.customdata ?? null);
  window.addEventListener("hashchange", () => linkedChoice() !== null && choose(linkedChoice(), { zoom: true }));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  if (hasWebGL) listenToMap();
}

function listenToMap() {
  onPlotClick("map", clickedClosure);
  byId("map").on("plotly_relayout", fitMarkers);
  byId("view-whole").addEventListener("click", () => look(wholeView()));
  byId("view-selected").addEventListener("click", () => look(chosenView()));
  followCamera();
}

fillHead(gated, "closures");
fillTally();
fillClosures(chooseFromTable);
fillInput();
fillOptions(gated.options);
describeMap();
describeTime();

state.closure = linkedChoice() ?? state.closure;
await drawAll();
listen();
document.body.dataset.ready = "true";
