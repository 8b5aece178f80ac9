// Numbers as words, and words as DOM nodes. Text from the document goes through textContent (element) or plotText.

const infinity = "infinite";

/** A score as written in the document ("infinite", null or a number) as a number. */
const scoreOf = (value) => (value === infinity ? Infinity : value ?? NaN);

/** Three significant digits; "infinite" and "–" in words. */
function short(value) {
  const number = scoreOf(value);
  if (number === Infinity) return infinity;
  if (!Number.isFinite(number)) return "–";
  const size = Math.abs(number);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return number.toExponential(1);
  return size >= 100 ? number.toFixed(0) : String(Number(number.toPrecision(3)));
}

/** A count with thousands separated. */
const count = (value) => Number(value).toLocaleString("en-US");

const plural = (number, one, many = one + "s") => `${count(number)} ${number === 1 ? one : many}`;

const metres = (value) => (Number.isFinite(value) ? `${short(value)} m` : "none");

/** A probability; those beyond four digits are said to be beyond. */
function probability(value) {
  if (value == null) return "–";
  return value > 0.9999 ? "> 0.9999" : value < 0.0001 ? "< 0.0001" : value.toFixed(4);
}

/** Coordinates to the centimetre; adding 0 turns -0 into 0. */
const coordinates = (position) => position.map((value) => (Math.round(100 * value) / 100 + 0).toFixed(2)).join(", ");

/** Escape text for plotly, which reads a subset of HTML in hover texts and titles. */
const plotText = (text) =>
  String(text).replace(/[&<>]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[c]);

/** An element with properties (className, textContent, ...) and children; strings become text nodes. */
function element(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

/** A symbol such as Λ_loc with its subscript. */
function symbol(text) {
  const [base, below] = text.split("_");
  return element("span", {}, base, ...(below ? [element("sub", {}, below)] : []));
}

/** A table of rows of cells (text or nodes); the first `heads` cells of a row are its headers. */
function table({ caption, columns, rows, heads = 0, className = "" }) {
  const header = (scope) => (cell) => element("th", { scope }, cell);
  const cells = (row) => row.map((cell, k) => (k < heads ? header("row")(cell) : element("td", {}, cell)));
  return element("table", { className },
    ...(caption ? [element("caption", {}, caption)] : []),
    ...(columns ? [element("thead", {}, element("tr", {}, ...columns.map(header("col"))))] : []),
    element("tbody", {}, ...rows.map((row) => element("tr", {}, ...cells(row)))));
}

const byId = (id) => document.getElementById(id);

/** Fill a <dl> with [term, description] pairs. */
function describe(list, pairs) {
  list.replaceChildren(
    ...pairs.map(([term, text]) => element("div", {}, element("dt", {}, term), element("dd", {}, String(text)))),
  );
}
