// The page of a mended map: words, tables, and what a click does.

const part = (value) => (value === null ? "–" : `${(100 * value).toFixed(0)} %`);

function fillTiles() {
  const tile = (title, value, below) => element("div", { className: "tile" },
    element("h2", {}, title), element("div", { className: "value" }, value), element("div", { className: "muted" }, below));
  const { before, after } = mended;
  const untied = (side) => Object.entries(side.places).filter(([kind]) => kind !== "incomplete fusion").reduce((n, [, k]) => n + k, 0);
  byId("tiles").replaceChildren(
    tile("Verdict", `${before.verdict.level} → ${after.verdict.level}`, "before and after"),
    tile("Places to look at", `${count(untied(before))} → ${count(untied(after))}`,
      Object.entries(after.places).map(([kind, k]) => `${k} ${kind}`).join(", ") || "none is left"),
    tile("Collisions", `${count(before.n_collisions)} → ${count(after.n_collisions)}`, `Λ of collisions ${short(before.collision_score)} → ${short(after.collision_score)}`),
    tile("Closures", `${count(mended.out.length)} out, ${count(pairsOf("confirmed").length)} in`,
      `${count(attempts.length)} ties tried in ${plural(mended.n_rounds, "round")}`));
}

function fillAttempts() {
  const rows = attempts.map((a, k) => {
    const box = element("input", { type: "checkbox", checked: state.taken.has(k), disabled: a.g2o === null });
    box.setAttribute("aria-label", `take ${a.labels.join(" – ")}`);
    box.addEventListener("click", (event) => event.stopPropagation());
    box.addEventListener("change", () => {
      if (box.checked) state.taken.add(k); else state.taken.delete(k);
      tellTaken();
    });
    const outcome = element("strong", { className: "kind" }, a.outcome);
    outcome.dataset.verdict = { confirmed: "accepted", refused: "rejected" }[a.outcome] ?? a.outcome;
    const moved = a.moved_m === null ? "–" : `${short(Number(a.moved_m.toFixed(2)))} m, ${a.moved_deg.toFixed(1)}°`;
    return [box, link(a.labels.join(" – ")), outcome, a.place ?? "–", moved, part(a.agreement), part(a.seen), a.reason];
  });
  const filled = table({ columns: ["take", "keyframes", "outcome", "place", "moved", "agreement", "seen by both", "why"], rows, className: "stacked" });
  attempts.forEach((_, k) => filled.tBodies[0].rows[k].addEventListener("click", () => choose(k)));
  byId("attempts").replaceChildren(attempts.length ? filled : element("p", { className: "muted" }, "None: nothing that is untied was found."));
  tellTaken();
}

const tellTaken = () => {
  byId("taken").textContent = `${count(state.taken.size)} taken`;
  byId("export").disabled = !state.taken.size;
};

function fillOut() {
  const labels = keyframes.label;
  byId("out-card").hidden = !mended.out.length;
  byId("out").replaceChildren(table({
    columns: ["closure", "verdict", "probability", "why"], className: "stacked",
    rows: mended.out.map((c) => [c.keyframes.map((k) => labels[k]).join(" – "), c.verdict, probability(c.probability), c.reason]),
  }));
}

/** The ties that are taken as g2o: vertices that edges need, and the edges. */
function exported() {
  const edges = [...state.taken].sort((a, b) => a - b).map((k) => attempts[k].g2o);
  const used = new Set(edges.flatMap((edge) => edge.split(/\s+/).slice(1, 3)));
  const vertices = mended.g2o_vertices.filter((vertex) => used.has(vertex.split(/\s+/)[1]));
  return [...vertices, ...edges].join("\n") + "\n";
}

function save() {
  const address = URL.createObjectURL(new Blob([exported()], { type: "text/plain" }));
  const anchor = element("a", { href: address, download: "ties.g2o" });
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}

function choose(k) {
  state.attempt = k;
  const a = attempts[k];
  byId("pair-title").textContent = `Two scans: ${a.labels.join(" and ")}, ${a.outcome}`;
  byId("first-name").textContent = a.labels[0];
  byId("second-name").textContent = a.labels[1];
  byId("pair-hint").textContent = a.clouds ? `· ${a.reason}` : `· ${a.reason} No scan or cloud is at hand.`;
  markRow("attempts", k);
  drawMap();
  drawPair();
}

/** The tie whose middle lies nearest to a click. */
function nearest(x, y) {
  const away = attempts.map(({ keyframes: [i, j] }) => Math.hypot((shownAt[i][0] + shownAt[j][0]) / 2 - x, (shownAt[i][1] + shownAt[j][1]) / 2 - y));
  return away.indexOf(away.reduce((a, b) => Math.min(a, b), Infinity));
}

function start() {
  fillHead(mended, "a mended map");
  fillVerdict(mended.after.verdict.level, mended.after.verdict.text);
  attempts.forEach((a, k) => a.outcome === "confirmed" && a.g2o !== null && state.taken.add(k));
  fillTiles();
  fillAttempts();
  fillOut();
  fillOptions(mended.options);
  byId("notes").replaceChildren(...notesOf(mended.input));

  // what a click does
  for (const id of ["show-before", "show-after", "show-scans"]) byId(id).addEventListener("change", drawMap);
  for (const id of ["as-predicted", "as-aligned", "as-both"]) byId(id).addEventListener("change", drawPair);
  byId("plan").addEventListener("click", ({ offsetX, offsetY }) => attempts.length && choose(nearest(offsetX, offsetY)));
  byId("export").addEventListener("click", save);
  byId("take-confirmed").addEventListener("click", () => {
    state.taken = new Set(attempts.flatMap((a, k) => (a.outcome === "confirmed" && a.g2o !== null ? [k] : [])));
    fillAttempts();
  });
  window.addEventListener("resize", () => { drawMap(); drawPair(); });
  const asked = /^#tie=(\d+)$/.exec(location.hash);
  if (location.hash === "#before") byId("show-before").checked = true;
  if (attempts.length) choose(asked ? Math.min(Number(asked[1]), attempts.length) - 1 : 0);
  else drawMap();
  byId("pair-card").hidden = !attempts.length;
}

start();
