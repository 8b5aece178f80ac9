// Everything that is words and numbers.

const mostClosures = 200; // rows of their table

function fillTiles() {
  const s = audit.summary;
  const parts = s.n_components_pose_graph;
  const odometry = audit.adaptation?.edges.between === 0
    ? "Without odometry, joined by what they see" : `On ${plural(s.n_chains, "chain")} of odometry`;
  const connected = parts === 1 ? "all connected" : `in ${count(parts)} parts that no edge connects`;
  const tiles = [
    [["Λ"], short(s.score), `Largest ζ, at keyframe ${keyframes.label[worst]}. 0: graph and space agree.`],
    [["Λ of collisions"], short(s.collisions.score), "The part of it that no tie of the map explains."],
    [["Λ of fusion"], short(s.fusion.score), "The part that ties near by explain: how incomplete they are."],
    [[symbol("Λ_loc"), " / ", symbol("Λ_glob")], `${short(s.split.local)} / ${short(s.split.global)}`,
      "Is the neighbourhood wrong, or the shape of the whole map?"],
    [["mean ζ"], short(s.mean_score), "Near Λ: trouble everywhere. Far below: in one place."],
    [["stable score"], short(s.stable_score), "Does not fade as the map grows: compare maps by this one."],
    [["keyframes"], count(s.n_keyframes),
      `${odometry}, ${connected}; ${plural(s.n_pose_graph_edges, "edge")}.`],
    [["collisions"], count(s.n_collision_edges),
      `Overlaps that nothing explains. Explained: ${count(s.n_fusion_edges)}. In all: ${count(s.n_free_space_edges)}.`],
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
  const { estimate } = audit;
  const warnings = [
    estimate && !estimate.is_optimum &&
      `The stored estimate is no optimum of its graph: one step moves keyframe ${keyframes.label[estimate.keyframe]} ` +
      `by ${metres(estimate.step_m)}. Scores are of the map as stored; --optimise audits the optimum.`,
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
  const missing = joinedBy.collisions(i).map((j) => keyframes.label[j]);
  const more = missing.length > most ? ` and ${count(missing.length - most)} more` : "";
  byId("keyframe-title").textContent = `Keyframe ${keyframes.label[i]}`;
  describe(byId("keyframe-facts"), [
    ["ζ", short(keyframes.score[i])],
    ["ζ of collisions", short(keyframes.collision[i])],
    ["stable score", short(keyframes.stable[i])],
    ["radius", metres(keyframes.radius[i])],
    ["position (m)", coordinates(keyframes.position[i])],
    ["index", `${count(i)} of 0 … ${count(keyframes.n - 1)}`],
    ["place", placeOf[i] < 0 ? "none" : String(places[placeOf[i]].rank)],
    ["pose-graph edges", count(joinedBy.pose_graph(i).length)],
    ["explained overlaps", count(joinedBy.fusion(i).length)],
    ["collisions", missing.length ? `with ${missing.slice(0, most).join(", ")}${more}` : "none"],
  ]);
}

/** How grave a kind of place is: the verdict that it leads to. */
const gravity = new Map(Object.entries({
  "likely false closure": "inconsistent", "undecided contact": "undecided",
  "missed closure": "incomplete", "untied second pass": "incomplete", "tracking gap": "incomplete",
}));

/** The places, gravest first; `choose` is called with the place's number in the list. */
function fillPlaces(choose) {
  const rows = places.map((p, k) => {
    const swatch = element("i", { className: "swatch place" });
    swatch.style.background = placeColour(k);
    const kind = element("strong", { className: "kind" }, p.kind);
    kind.dataset.level = gravity.get(p.kind) ?? "none";
    const [earlier, later] = p.stretches.map(stretchLabel);
    return [
      element("span", { className: "rank" }, swatch, link(String(p.rank))), kind,
      element("span", { className: "where", title: `${earlier}\n${later}` },
        element("span", {}, earlier), element("span", {}, later)),
      element("span", {}, `${p.sentence} `, element("em", {}, p.remedy)),
    ];
  });
  const filled = table({ columns: ["place", "kind", "where", "what is there, and what to do"], rows });
  filled.hidden = rows.length === 0;
  rows.forEach((_, k) => filled.tBodies[0].rows[k].addEventListener("click", () => choose(k)));
  byId("places-table").replaceChildren(filled);
}

/** The numbers of the place that is chosen. */
function describePlace(k) {
  const said = () => {
    const p = places[k];
    const by = p.closure ? `Brought about by the closure ${closureLabel({ keyframes: p.closure })}. ` : "";
    return `Place ${p.rank}. ${by}The contact is real, not made by drift, with probability ${probability(p.probability)}. ` +
      `Drift allows ${lengthOf(p.allowance_m)}, spheres reach ${lengthOf(p.reach_m)}. ${plural(p.edges.length, "overlap")} that a tie ` +
      `would explain; gain ${short(p.gain)}. ζ up to ${short(p.score)}, mostly ${p.scale}; stable score ${short(p.stable_score)}.`;
  };
  byId("places-hint").textContent =
    !places.length ? "None: the pose graph has every connection that the free space shows." :
    k === null ? "Choose a row to see the place on the map." : said();
}

const lengthOf = (value) => (value === infinity ? "any distance" : `${rough(value)} m`);
const closureLabel = ({ keyframes: [i, j] }) => `${keyframes.label[i]} – ${keyframes.label[j]}`;
const isJudged = (closure) => closure.probability !== null;

/** The map's own closures, least probable first; `choose` is called with the closure's number in the list. */
function fillClosures(choose) {
  const columns = ["closure", "probability", "misses by", "allowed", "others"];
  const shown = closures.slice(0, mostClosures);
  const rows = shown.map((c) => [
    link(closureLabel(c)), probability(c.probability),
    ...(isJudged(c) ? [`${rough(rounded(c.missed_m, 3))} m, ${rough(rounded(c.missed_deg, 2))}°`, lengthOf(c.allowed_m)] : ["–", "–"]),
    isJudged(c) ? (c.is_false ? "contradict" : "agree") : "silent",
  ]);
  const filled = table({ columns, rows });
  filled.hidden = rows.length === 0;
  shown.forEach((c, k) => {
    filled.tBodies[0].rows[k].classList.toggle("false", c.is_false);
    filled.tBodies[0].rows[k].addEventListener("click", () => choose(k));
  });
  byId("closures-table").replaceChildren(filled);
  byId("found").classList.toggle("without-closures", places.length > 0 && closures.length === 0);
}

/** What the others say of the closure that is chosen. */
function describeClosure(k) {
  const listed = closures.length > mostClosures ? `The ${count(mostClosures)} least probable of ` : "";
  byId("closures-hint").textContent =
    !closures.length ? "None: no factor closes a loop." :
    k === null ? `${listed}${plural(closures.length, "closure")}. Choose a row to see the closure on the map.` :
    `${closureLabel(closures[k])}: ${closures[k].sentence}`;
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
  byId("input").replaceChildren(
    ...(adaptation ? adaptationTables(adaptation) : [direct]),
    ...notesOf(input));
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
