// The document of gated closures. Nothing here touches the page.

const gated = JSON.parse(byId("document").textContent);
const { closures } = gated; // least probable first

const verdicts = ["accepted", "undecided", "rejected"];

const keyframes = (() => {
  const { label, position } = gated.keyframes;
  const along = (k) => Float64Array.from(position, (p) => p[k]);
  return { n: label.length, label, position, x: along(0), y: along(1), z: along(2), radius: new Float64Array(label.length) };
})();

const planar = keyframes.z.every((z) => z === keyframes.z[0]);

const byVerdict = Object.fromEntries(verdicts.map((verdict) =>
  [verdict, closures.flatMap((c, k) => (c.verdict === verdict ? [k] : []))]));

const closureLabel = ({ ends: [i, j] }) => `${keyframes.label[i]} – ${keyframes.label[j]}`;

/** A number that JSON may hold as a word. */
const numberOf = (value) =>
  ({ infinite: Infinity, "-infinite": -Infinity, undefined: NaN })[value] ?? (typeof value === "number" ? value : NaN);

const hasScores = closures.some((c) => c.global_score !== null);
const hasTruth = closures.some((c) => c.is_true !== null);

/** "0.01 → 1.37", or a dash where the scores were not computed. */
const change = (score) =>
  (score === null ? "–" : `${digits(numberOf(score.before))} → ${digits(numberOf(score.after))}`);
const digits = (value) => (Number.isFinite(value) ? value.toFixed(2) : short(value));

/** A probability in words, none of which rounds to certainty. */
const percent = (c) => {
  const p = numberOf(c.probability);
  if (Number.isNaN(p)) return "not judged";
  return p < 0.001 ? "< 0.1 %" : p > 0.999 ? "> 99.9 %" : `${(100 * p).toPrecision(3)} %`;
};

const known = (c) => (c.is_true === null ? "" : c.is_true ? "true" : "false");
const isMistaken = (c) => c.is_true !== null && c.is_true !== c.accepted;
