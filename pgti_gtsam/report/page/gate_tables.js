// Everything that is words and numbers.

const mostRows = 1000; // of the table

const termNames = {
  drift: "drift", contact_rise: "free space", global_rise: "rise of Λ_glob", keyframe_rise: "rise of a keyframe’s ζ",
  keyframe_global_rise: "rise of a keyframe’s ζ_glob",
};

function fillTally() {
  const told = (is, what, wanted) => {
    const own = closures.filter((c) => c.is_true === is);
    const right = own.filter((c) => c.accepted === is).length;
    return own.length ? ` Known to be ${what}: ${plural(own.length, "closure")}, of which ${right} ${wanted}.` : "";
  };
  fillVerdict(`${count(byVerdict.accepted.length)} of ${count(closures.length)} accepted`,
    `${count(byVerdict.undecided.length)} undecided, ${count(byVerdict.rejected.length)} rejected.` +
    told(true, "true", "accepted") + told(false, "false", "not accepted"));
  for (const verdict of verdicts) byId(`count-${verdict}`).textContent = count(byVerdict[verdict].length);
}

/** Whether a closure is at the keyframe that was asked for. */
const isListed = (k) => {
  if (state.at === "") return true;
  return closures[k].ends.some((i) => keyframes.label[i] === state.at);
};

/** Numbers of the closures that the filter leaves, least probable first. */
const listed = () => closures.flatMap((c, k) => (state.shown.has(c.verdict) && isListed(k) ? [k] : []));

/** The table of closures; `choose` is called with a closure's number. */
function fillClosures(choose) {
  const shown = listed();
  const columns = [
    "closure", "verdict", "probability", ...(hasScores ? [symbol("Λ_glob")] : []), ...(hasTruth ? ["known"] : []), "why",
  ];
  const rows = shown.slice(0, mostRows).map((k) => {
    const c = closures[k];
    const verdict = element("strong", { className: "kind" }, c.verdict);
    verdict.dataset.verdict = c.verdict;
    return [
      link(closureLabel(c)), verdict, percent(c), ...(hasScores ? [change(c.global_score)] : []),
      ...(hasTruth ? [known(c)] : []), c.reasons.join(" "),
    ];
  });
  const filled = table({ columns, rows, className: "stacked" });
  shown.slice(0, mostRows).forEach((k, row) => {
    filled.tBodies[0].rows[row].classList.toggle("mistaken", isMistaken(closures[k]));
    filled.tBodies[0].rows[row].addEventListener("click", () => choose(k));
  });
  byId("gated-table").replaceChildren(filled);
  const cut = shown.length > mostRows ? ` The table holds the ${count(mostRows)} least probable.` : "";
  byId("closures-hint").textContent =
    !closures.length ? "None: no factor closes a loop." :
    `${count(shown.length)} of ${plural(closures.length, "closure")}.${cut} Choose a row to see the closure on the map.`;
}

const markChosen = () => {
  const row = state.closure === null ? -1 : listed().indexOf(state.closure);
  markRow("gated-table", row < 0 ? null : row);
};

/** What is known of the closure that is chosen. */
function fillClosure(k) {
  byId("closure-title").textContent = k === null ? "No closure" : `Closure ${closureLabel(closures[k])}`;
  byId("evidence").replaceChildren();
  byId("reasons").replaceChildren();
  describe(byId("closure-facts"), []);
  if (k === null) return;
  const c = closures[k];
  const with_ = c.judged_with - 1;
  describe(byId("closure-facts"), [
    ["verdict", c.verdict], ["probability", percent(c)], ["log odds", signed(numberOf(c.log_odds))],
    ["Λ", change(c.score)], [symbol("Λ_glob"), change(c.global_score)],
    ["weighed with", with_ ? plural(with_, "other") : "no other"],
    ...(c.is_true === null ? [] : [["known to be", known(c)]]),
  ]);
  const rows = Object.entries(c.terms).map(([name, term]) => [termNames[name] ?? name, signed(numberOf(term.log_odds))]);
  if (rows.length) {
    byId("evidence").replaceChildren(
      table({ columns: ["evidence", "log odds"], rows, heads: 1, className: "counts" }));
  }
  byId("reasons").replaceChildren(...c.reasons.map((reason) => element("li", {}, reason)));
}

/** A number with its sign, infinite ones in words. */
const signed = (value) => (value === -Infinity ? `−${infinity}` : value > 0 ? `+${short(value)}` : short(value));

function fillInput() {
  const { unjudged } = gated;
  const alone = unjudged.length
    ? [element("p", { className: "hint" }, `${plural(unjudged.length, "closure")} not judged: a keyframe hangs alone on each.`)]
    : [];
  describe(byId("counts"), [["keyframes", count(keyframes.n)], ["steps of odometry", count(gated.edges.odometry.length)],
    ["closures", count(closures.length)]]);
  byId("input").replaceChildren(...alone, ...notesOf(gated.input));
}
