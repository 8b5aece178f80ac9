// Numbers as words, and words as DOM nodes: what all pages share. Text from the document goes through textContent (element) or plotText.

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

/** A number to so many decimals: what lies beyond is no use to a person. */
const rounded = (value, decimals) => Number(value.toFixed(decimals));

/** Two significant digits. */
const rough = (value) => short(Number(value.toPrecision(2)));

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

/**
 * A table of rows of cells (text or nodes); the first `heads` cells of a row are its headers.
 * Where the table is "stacked", a phone shows every row as lines of its own, with the column's name before each text.
 */
function table({ caption, columns, rows, heads = 0, className = "" }) {
  const header = (scope) => (cell) => element("th", { scope }, cell);
  const named = (cell, k) => {
    const node = element("td", {}, cell);
    if (columns && typeof cell !== "object") node.dataset.column = columns[k].textContent ?? columns[k];
    return node;
  };
  const cells = (row) => row.map((cell, k) => (k < heads ? header("row")(cell) : named(cell, k)));
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

const link = (text) => element("button", { type: "button", className: "link" }, text);

/** Mark one row of a table, or none, and scroll the table, not the page, until the row is seen. */
function markRow(id, k) {
  byId(id).querySelector("tr.chosen")?.classList.remove("chosen");
  const row = k === null ? null : byId(id).querySelector("tbody").rows[k];
  if (!row) return;
  row.classList.add("chosen");
  const [box, seen] = [byId(id), row].map((node) => node.getBoundingClientRect());
  const head = byId(id).querySelector("thead").offsetHeight;
  if (seen.top < box.top + head || seen.bottom > box.bottom) byId(id).scrollTop += seen.top - box.top - head;
}

/** Name of the map, and where it came from. */
function fillHead({ input, pgti_gtsam_version: version, schema_version: drawn }, kind) {
  byId("name").textContent = input.name;
  byId("origin").textContent = `${input.format} · pgti-gtsam ${version}`;
  byId("footer").textContent =
    `Drawn from ${kind} of pgti-gtsam ${version}, document version ${drawn}. ` +
    "This page holds all its data and loads nothing.";
}

/** The verdict in the head of a page: a level, which sets the colour, and a sentence. */
function fillVerdict(level, text) {
  byId("verdict").dataset.level = level;
  byId("verdict-level").textContent = level;
  byId("verdict-text").textContent = text;
}

/** A heading and a list of what a reader should know of the input, or nothing. */
const notesOf = ({ notes }) => (notes.length
  ? [element("h3", {}, "Notes"), element("ul", {}, ...notes.map((note) => element("li", {}, note)))] : []);

/** What was asked for, in words. */
function fillOptions(options) {
  const words = (value) => (value == null ? "not given" : Array.isArray(value) ? value.join(", ") : String(value));
  describe(byId("options"),
    Object.entries(options).map(([name, value]) => [name.replaceAll("_", " "), words(value)]));
}
