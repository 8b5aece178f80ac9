// Audits of many maps: a table that sorts and filters, with a small picture of each map.

const fleet = JSON.parse(byId("document").textContent);
const gravity = ["consistent", "incomplete", "undecided", "inconsistent"];
const judged = fleet.maps.filter((map) => map.failed === undefined);
const failed = fleet.maps.filter((map) => map.failed !== undefined);
const fileName = (path) => path.split("/").pop();

/** The way of a map, fitted into a small canvas that is no higher than the way. */
function picture({ way }) {
  const low = [0, 1].map((k) => Math.min(...way.map((point) => point[k])));
  const size = [0, 1].map((k) => Math.max(...way.map((point) => point[k])) - low[k]);
  const scale = Math.min(148 / (size[0] || 1), 84 / (size[1] || 1));
  const canvas = element("canvas", { width: 160, height: 12 + scale * size[1], className: "thumbnail" });
  const bottom = canvas.height - 6;
  const context = canvas.getContext("2d");
  context.strokeStyle = getComputedStyle(document.body).color;
  context.lineWidth = 1.5;
  context.beginPath();
  way.forEach(([x, y], k) => context[k ? "lineTo" : "moveTo"](6 + scale * (x - low[0]), bottom - scale * (y - low[1])));
  context.stroke();
  return canvas;
}

const least = ({ least_probable: closure }) =>
  (closure === null ? "–" : `${closure.keyframes.join(" – ")}: ${probability(closure.probability)}`);

const columns = [
  ["map", (map) => element("a", { href: encodeURIComponent(map.page), textContent: fileName(map.map), title: map.map }), (map) => map.map],
  ["verdict", (map) => {
    const verdict = element("strong", { className: "kind" }, map.verdict);
    verdict.dataset.level = map.verdict;
    return verdict;
  }, (map) => -gravity.indexOf(map.verdict)],
  ["way", picture, (map) => map.keyframes],
  ["Λ", (map) => short(map.score), (map) => -scoreOf(map.score)],
  ["collisions", (map) => count(map.collisions), (map) => -map.collisions],
  ["places", (map) => Object.entries(map.places).map(([kind, n]) => `${n} × ${kind}`).join(", ") || "none",
    (map) => -Object.values(map.places).reduce((sum, n) => sum + n, 0)],
  ["least probable closure", least, (map) => map.least_probable?.probability ?? 2],
  ["keyframes", (map) => count(map.keyframes), (map) => -map.keyframes],
  ["seconds", (map) => short(map.seconds), (map) => -map.seconds],
];
const state = { by: null, filter: "" };

function fillMaps() {
  const shown = judged.filter((map) => map.map.toLowerCase().includes(state.filter));
  if (state.by !== null) {
    const key = columns[state.by][2];
    shown.sort((a, b) => (key(a) < key(b) ? -1 : key(a) > key(b) ? 1 : 0));
  }
  const heads = columns.map(([name], k) => {
    const button = link(name);
    button.style.whiteSpace = "nowrap";
    button.addEventListener("click", () => { state.by = k; fillMaps(); });
    return button;
  });
  byId("map-table").replaceChildren(
    table({ columns: heads, rows: shown.map((map) => columns.map(([, cell]) => cell(map))), className: "stacked" }));
}

fillHead(fleet, "the audits");
const tally = gravity.map((verdict) => [verdict, judged.filter((map) => map.verdict === verdict).length]);
const worst = tally.findLast(([, n]) => n > 0)?.[0] ?? "undecided";
fillVerdict(worst, `${tally.filter(([, n]) => n).map(([verdict, n]) => `${n} ${verdict}`).reverse().join(", ")}; ` +
  `${failed.length} without a verdict.`);
fillOptions(fleet.options);
byId("notes").replaceChildren(...notesOf(fleet.input));
byId("filter").addEventListener("input", (event) => { state.filter = event.target.value.toLowerCase(); fillMaps(); });
byId("failures").hidden = failed.length === 0;
byId("failed-table").replaceChildren(
  table({ columns: ["map", "why"], className: "stacked", rows: failed.map((map) => [element("span", { textContent: fileName(map.map), title: map.map }), map.failed]) }));
fillMaps();
document.body.dataset.ready = "true";
