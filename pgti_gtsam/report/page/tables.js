// Everything that is words and numbers.

function fillHeader() {
  const { input, summary, pgti_gtsam_version: version } = audit;
  byId("name").textContent = input.name;
  byId("origin").textContent = `${input.format} · pgti-gtsam ${version}`;
  byId("verdict").dataset.level = summary.verdict.level;
  byId("verdict-level").textContent = summary.verdict.level;
  byId("verdict-text").textContent = summary.verdict.text;
  byId("footer").textContent =
    `Drawn from an audit of pgti-gtsam ${version}, document version ${audit.schema_version}. ` +
    "This page holds all its data and loads nothing.";
}

function fillTiles() {
  const s = audit.summary;
  const parts = s.n_components_pose_graph;
  const overlaps = plural(s.n_free_space_edges, "overlap");
  const tiles = [
    [["Λ"], short(s.score), `Largest ζ, at keyframe ${keyframes.label[worst]}. 0: graph and space agree.`],
    [["mean ζ"], short(s.mean_score), "Near Λ: trouble everywhere. Far below: in one place."],
    [[symbol("Λ_loc"), " / ", symbol("Λ_glob")], `${short(s.split.local)} / ${short(s.split.global)}`,
      "Is the neighbourhood wrong, or the shape of the whole map?"],
    [["stable score"], short(s.stable_score), "Does not fade as the map grows: compare maps by this one."],
    [["keyframes"], count(s.n_keyframes),
      parts === 1 ? "All connected with one another." : `In ${count(parts)} parts that no edge connects.`],
    [["pose-graph edges"], count(s.n_pose_graph_edges), "Connections that the map's factors make."],
    [["missing connections"], count(s.n_inserted_edges),
      `Free space joins them, the pose graph does not. Of ${overlaps}.`],
  ];
  byId("tiles").replaceChildren(...tiles.map(([name, value, text]) =>
    element("div", { className: "tile" },
      element("h2", {}, ...name),
      element("p", { className: "value" }, value),
      element("p", { className: "hint" }, text))));
}

/** What a reader must know before trusting the scores. */
function fillWarnings() {
  const { unknown = {}, keyframes_without_radius: bare, empty_slots: empty } = audit.adaptation ?? {};
  const { n_components_pose_graph: inGraph, n_components_merged_graph: inSpace } = audit.summary;
  const missed = Object.values(unknown).reduce((a, b) => a + b, 0);
  const names = Object.keys(unknown).join(", ");
  const warnings = [
    missed && `${plural(missed, "factor")} of unknown type took no part in this audit: ${names}.`,
    bare && `${plural(bare, "keyframe")} of ${count(keyframes.n)} without a radius: the space there is not judged.`,
    inSpace < inGraph &&
      `The pose graph is in ${count(inGraph)} parts, the space in ${count(inSpace)}: parts touch, unconnected.`,
    empty && `${plural(empty, "slot")} of the factor graph without a factor (removed).`,
  ];
  byId("warnings").replaceChildren(
    ...warnings.filter(Boolean).map((text) => element("p", { className: "notice" }, text)));
}

function fillKeyframe(i) {
  const most = 6; // labels that are listed
  const missing = neighbours(audit.edges.inserted, i).map((j) => keyframes.label[j]);
  const more = missing.length > most ? ` and ${count(missing.length - most)} more` : "";
  byId("keyframe-title").textContent = `Keyframe ${keyframes.label[i]}`;
  describe(byId("keyframe-facts"), [
    ["ζ", short(keyframes.score[i])],
    ["stable score", short(keyframes.stable[i])],
    ["radius", metres(keyframes.radius[i])],
    ["position (m)", place(keyframes.position[i])],
    ["index", `${count(i)} of 0 … ${count(keyframes.n - 1)}`],
    ["pose-graph edges", count(neighbours(audit.edges.pose_graph, i).length)],
    ["missing connections", missing.length ? `to ${missing.slice(0, most).join(", ")}${more}` : "none"],
  ]);
}

/** The places, worst first; `choose` is called with the place's worst keyframe. */
function fillPlaces(choose) {
  const columns = ["rank", "stable score", "ζ", "keyframe", "x, y, z (m)", "keyframes here", "missing connections"];
  const rows = audit.places.map((p) => [
    p.rank, short(p.stable_score), short(p.score), element("button", { type: "button", className: "link" }, p.label),
    place(p.position), count(p.keyframes.length), count(p.n_inserted_edges),
  ]);
  const filled = table({ columns, rows });
  filled.hidden = rows.length === 0;
  audit.places.forEach((p, k) => filled.tBodies[0].rows[k].addEventListener("click", () => choose(p.worst)));
  byId("places-table").replaceChildren(filled);
  byId("places-hint").textContent = rows.length
    ? "Choose a row to see the place on the map. Ranked by stable score, which is largest where the fault is; " +
      "ζ may be largest far from it."
    : "None: the pose graph has every connection that the free space shows.";
}

function markPlace(keyframe) {
  const { rows } = byId("places-table").querySelector("tbody");
  audit.places.forEach((p, k) => rows[k].classList.toggle("chosen", p.worst === keyframe));
}

function countTable(caption, counts, className = "") {
  const rows = Object.entries(counts).map(([name, n]) => [name, count(n)]);
  return table({ caption, rows, heads: 1, className: `counts ${className}` });
}

/** Tables of what the adapter met in the factor graph. */
function adaptationTables(adaptation) {
  const { used, ignored, unknown, edges } = adaptation;
  const sources = Object.fromEntries(Object.entries(edges).filter(([, n]) => n > 0));
  const found = {
    landmarks: adaptation.n_landmarks, observations: adaptation.n_observations,
    "most landmarks shared by two keyframes": adaptation.max_shared_landmarks,
    "keyframes without a radius": adaptation.keyframes_without_radius, "empty factor slots": adaptation.empty_slots,
  };
  return [
    countTable("Factors used", used),
    countTable("Factors ignored: they say nothing about connectivity", ignored),
    countTable("Unknown factors, not used", unknown, "unknown"),
    countTable("Pose-graph edges by source (one edge may have several)", sources),
    countTable("Found", Object.fromEntries(Object.entries(found).filter(([, n]) => n != null))),
  ].filter((filled) => filled.tBodies[0].rows.length > 0);
}

function fillInput() {
  const { adaptation, input } = audit;
  const direct = element("p", { className: "hint" }, "The pose graph was given directly, not read from factors.");
  const notes = input.notes.map((note) => element("li", {}, note));
  byId("input").replaceChildren(
    ...(adaptation ? adaptationTables(adaptation) : [direct]),
    ...(notes.length ? [element("h3", {}, "Notes"), element("ul", {}, ...notes)] : []));
}

function fillOptions() {
  const words = (value) => (value == null ? "not given" : Array.isArray(value) ? value.join(", ") : String(value));
  describe(byId("options"),
    Object.entries(audit.options).map(([name, value]) => [name.replaceAll("_", " "), words(value)]));
}

function optimalityTable(caption, { pose_graph, merged_graph, change }) {
  const names = { d: "D-opt", t: "T-opt", e: "E-opt", e_tilde: "Ẽ-opt" };
  const rows = Object.entries(names).map(([key, name]) =>
    [name, ...[pose_graph, merged_graph, change].map((criteria) => short(criteria[key]))]);
  return table({ caption, columns: ["", symbol("G_p"), symbol("G_m"), "change"], rows, heads: 1, className: "counts" });
}

function fillOptimality() {
  const { unweighted, weighted } = audit.optimality;
  const tables = [optimalityTable("Graphs without weights", unweighted)];
  if (weighted) tables.push(optimalityTable("Edges weighted by their information", weighted));
  byId("optimality").replaceChildren(...tables);
}
