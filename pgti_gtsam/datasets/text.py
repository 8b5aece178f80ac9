"""Lines of text to checked numbers, every complaint with file and line."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.errors import FileFormatError

ENDINGS = {".gz", ".bz2", ".xz", ".lzma", ".zip"}
MAX_ID = 2**63 - 1  # keys of GTSAM have 64 bits, and the letter of a symbol in ASCII leaves the highest one free
LARGEST = 1e30  # no length, angle or information reaches this, and its square is still a float64
CHUNK = 8192  # lines whose fields are held as text at a time: fields take ten times the memory of their line

_IDS = re.compile(r"(?:-?[0-9]{1,19} )*", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?", re.ASCII)

Item = TypeVar("Item")


class Line(NamedTuple):
    """Number, counted from 1, and text of a line that is not empty."""

    number: int
    text: str

    @property
    def fields(self) -> list[str]:
        """What blanks separate."""
        return self.text.split()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Lines of one kind as arrays: line numbers (n,), identifiers (n, k) and finite numbers (n, m)."""

    lines: NDArray[np.int64]
    ids: NDArray[np.int64]
    numbers: NDArray[np.float64]

    def where(self, kept: NDArray[np.bool_] | NDArray[np.int64]) -> Table:
        """The rows that a mask (n,) keeps, or rows by number, in order."""
        return Table(lines=self.lines[kept], ids=self.ids[kept], numbers=self.numbers[kept])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TextFile:
    """The lines of a file, also grouped by their first field, the tag; comments apart.

    Attributes
    ----------
    path : Path
        The file, or the first of several files of a map.
    lines, comments : sequence of Line
    tags : mapping of str to sequence of Line
    notes : list of str
        Sentences that reading adds to; an error takes the notes along.
    ignore_unknown : bool
        Lines that tie two variables in an unknown way are counted instead of refused.
    others : tuple of (int, Path)
        Number of the first line of every further file, and the file, where several files are one map.
    shift : int
        Added to identifiers of poses, so that none is negative: keys of GTSAM cannot be.
    title : str, optional
        The name of the map, where that is not the file's.
    """

    path: Path
    lines: Sequence[Line]
    tags: Mapping[str, Sequence[Line]]
    comments: Sequence[Line] = ()
    notes: list[str] = field(default_factory=list)
    ignore_unknown: bool = False
    others: tuple[tuple[int, Path], ...] = ()
    shift: int = 0
    title: str | None = None

    @property
    def name(self) -> str:
        """The title, or else the file's name without the ending of its format and compression."""
        return self.title or bare_name(self.path)

    def table(self, tag: str, *, ids: int, widths: Collection[int], poses: int = 0) -> Table:
        """Lines of ``tag`` as arrays.

        Parameters
        ----------
        tag : str
            First field of the lines.
        ids : int
            Identifiers behind the tag.
        widths : collection of int
            Allowed counts of numbers behind the identifiers.
        poses : int
            Poses among the numbers, at the front.

        Raises
        ------
        FileFormatError
            Too few or too many fields, an identifier that is no whole number below 2**63 in size, a field that
            is no finite number, a number beyond 1e30.
        """
        table = parse_table(self, self.tags.get(tag, ()), ids=ids, widths=widths, first=1)
        table.ids[:, :poses] += self.shift
        negative = np.flatnonzero((table.ids[:, :poses] < 0).any(axis=1))
        if negative.size:
            message = "expected a pose with an identifier from 0 on, got a negative one that no vertex line defines"
            raise self.error(message, table.lines[negative[0]])
        return table

    def rows(self, *, ids: int, widths: Collection[int]) -> Table:
        """All lines, in a file without tags, as arrays; raises as `table` does.

        Parameters
        ----------
        ids : int
            Identifiers on a line.
        widths : collection of int
            Allowed counts of numbers behind the identifiers.
        """
        return parse_table(self, self.lines, ids=ids, widths=widths, first=0)

    def error(self, message: str, line: int | None = None) -> FileFormatError:
        """An error that names this file and takes the notes along.

        Parameters
        ----------
        message : str
        line : int, optional
            Number of the line.
        """
        path, before = self.path, 0
        if line is not None and self.others:
            place = bisect_right([first for first, _ in self.others], line)
            if place:
                first, path = self.others[place - 1]
                before = first - 1
        error = FileFormatError(path, message, line=None if line is None else int(line) - before)
        for note in self.notes:
            error.add_note(note)
        return error


def bare_name(path: Path) -> str:
    """A file's name without the ending of its format and compression."""
    return (path.with_suffix("") if path.suffix in ENDINGS else path).stem


def quote(label: object, length: int = 40) -> str:
    """Text from a file, harmless and short enough to print.

    Parameters
    ----------
    label : object
    length : int
        Most characters.
    """
    text = str(label)
    return ascii(text if len(text) <= length else text[:length] + "…")


def split_lines(path: Path, text: str, *, ignore_unknown: bool = False, comma: bool = False) -> TextFile:
    """Lines of ``text`` without empty lines, grouped by tag, and ``#`` comments; ``comma``: commas separate too.

    Parameters
    ----------
    path : Path
        Named in errors.
    text : str
    ignore_unknown : bool
        As for `TextFile`.
    comma : bool
        Whether commas separate fields too.
    """
    lines, comments = list[Line](), list[Line]()
    tags: dict[str, list[Line]] = {}
    for number, raw in enumerate(text.split("\n"), 1):
        words = (raw.replace(",", " ") if comma else raw).strip()
        if words.startswith("#"):
            comments.append(Line(number, words))
        elif words:
            line = Line(number, words.partition(" #")[0] if "#" in words else words)
            lines.append(line)
            tags.setdefault(words.split(None, 1)[0], []).append(line)
    return TextFile(path=path, lines=lines, tags=tags, comments=comments, ignore_unknown=ignore_unknown)


def joined(files: Sequence[TextFile]) -> TextFile:
    """The lines of several files together; errors still name the line's own file."""
    lines, comments, others = list[Line](), list[Line](), list[tuple[int, Path]]()
    tags: dict[str, list[Line]] = {}
    before = 0
    for file in files:
        others.append((before + 1, file.path))
        comments += [Line(line.number + before, line.text) for line in file.comments]
        for line in file.lines:
            moved = Line(line.number + before, line.text)
            lines.append(moved)
            tags.setdefault(line.fields[0], []).append(moved)
        before += max((line.number for line in (*file.lines, *file.comments)), default=0)
    notes = [f"{len(files)} files are one map: {', '.join(file.path.name for file in files)}"]
    return replace(files[0], lines=lines, comments=comments, tags=tags, others=tuple(others), notes=notes)


def parse_table(file: TextFile, lines: Sequence[Line], *, ids: int, widths: Collection[int], first: int) -> Table:
    """Lines of one kind as arrays; see `TextFile.table`.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    lines : sequence of Line
        ``first`` fields that are passed over, ``ids`` identifiers, then numbers, of which all lines have
        equally many.
    ids, first : int
    widths : collection of int
        How many numbers there may be.
    """
    width, numbers = min(widths, default=0), np.empty((0, 0))
    identifiers = np.empty((len(lines), ids), np.int64)
    for start in range(0, len(lines), CHUNK):
        part, end = lines[start : start + CHUNK], min(start + CHUNK, len(lines))
        rows = [line.fields[first:] for line in part]
        width = _common_width(file, part, rows, ids, {width} if start else set(widths), first)
        if not start:
            numbers = np.empty((len(lines), width))
        identifiers[start:end] = np.array(_ids(file, part, [row[:ids] for row in rows]), np.int64).reshape(
            len(part), ids
        )
        numbers[start:end] = _numbers(file, part, [row[ids:] for row in rows]).reshape(len(part), width)
    return Table(
        lines=np.fromiter((line.number for line in lines), np.int64, count=len(lines)),
        ids=identifiers,
        numbers=numbers.reshape(len(lines), width),
    )


def _common_width(
    file: TextFile, lines: Sequence[Line], rows: Sequence[list[str]], ids: int, widths: set[int], first: int
) -> int:
    """Count of numbers after the identifiers, the same on every line and among ``widths``."""
    allowed = widths
    for line, row in zip(lines, rows, strict=True):
        if len(row) - ids not in allowed:
            expected = " or ".join(str(first + ids + width) for width in sorted(allowed))
            got = f"got {first + len(row)} in {quote(line.text)}"
            raise file.error(f"expected {expected} fields, {got}{_comma_advice(row)}", line.number)
        allowed = {len(row) - ids}
    return min(allowed)


def _ids(file: TextFile, lines: Sequence[Line], rows: Sequence[list[str]]) -> list[list[int]]:
    """Identifiers below 2**63 in size."""
    if _IDS.fullmatch(" ".join(chain.from_iterable(rows)) + " ") or not any(rows):
        found = [list(map(int, row)) for row in rows]
        if all(abs(number) <= MAX_ID for row in found for number in row):
            return found
    for line, row in zip(lines, rows, strict=True):
        for word in row:
            if not _IDS.fullmatch(word + " ") or abs(int(word)) > MAX_ID:
                message = f"expected an identifier, a whole number below 2**63, got {quote(word)}"
                raise file.error(message, line.number)
    raise AssertionError("unreachable: a line without fields")


def _numbers(file: TextFile, lines: Sequence[Line], rows: Sequence[list[str]]) -> NDArray[np.float64]:
    """Finite numbers up to 1e30; spellings of Python alone (``1_0``) are refused."""
    try:
        numbers = np.fromiter(map(float, chain.from_iterable(rows)), np.float64)
        if (np.abs(numbers) <= LARGEST).all() and "_" not in " ".join(chain.from_iterable(rows)):
            return numbers
    except ValueError:
        pass
    for line, row in zip(lines, rows, strict=True):
        parse_numbers(file, line, row)
    raise AssertionError("unreachable: every number by itself is valid")


def parse_numbers(file: TextFile, line: Line, fields: Sequence[str]) -> list[float]:
    """Finite numbers of a line, up to 1e30 in size.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    line : Line
        Named in errors.
    fields : sequence of str
    """
    for word in fields:
        if not is_number(word):
            raise file.error(f"expected a finite number, got {quote(word)}{_comma_advice([word])}", line.number)
        if abs(float(word)) > LARGEST:
            raise file.error(f"expected numbers up to {LARGEST:g} in size, got {float(word):g}", line.number)
    return [float(word) for word in fields]


def _comma_advice(fields: Iterable[str]) -> str:
    is_comma = any(_DECIMAL_COMMA.fullmatch(word) for word in fields)
    return ", a decimal comma; write the file with LC_NUMERIC=C" if is_comma else ""


def is_number(word: str) -> bool:
    """Whether a field is a finite number."""
    try:
        return bool(np.isfinite(float(word))) and "_" not in word
    except ValueError:
        return False


def by_identifier(
    file: TextFile, tag: str, table: Table, items: Iterable[Item], others: Collection[int] = ()
) -> dict[int, Item]:
    """Items by the first identifier of their rows.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    tag : str
        Named in errors.
    table : Table
    items : iterable of Item
        An item per row of the table.
    others : collection of int
        Identifiers that are taken already.

    Raises
    ------
    FileFormatError
        An identifier comes a second time, or is among ``others``.
    """
    found: dict[int, Item] = {}
    for line, identifier, item in zip(table.lines.tolist(), table.ids[:, 0].tolist(), items, strict=True):
        if identifier in found or identifier in others:
            raise file.error(f"{tag} {identifier} is defined a second time", line)
        found[identifier] = item
    return found


def note_ignored(file: TextFile, known: Collection[str]) -> None:
    """Note in a sentence the lines that no reader used, by tag.

    Parameters
    ----------
    file : TextFile
    known : collection of str
        Tags that a reader used.
    """
    unknown = {tag: lines for tag, lines in file.tags.items() if tag not in known}
    shown = sorted(unknown, key=lambda tag: -len(unknown[tag]))[:8]  # a note is a line or two, not a list
    counts = [f"{len(unknown[tag])} {quote(tag)}" for tag in shown]
    if len(unknown) > len(shown):
        rest = sum(map(len, unknown.values())) - sum(len(unknown[tag]) for tag in shown)
        counts.append(f"{rest} with {len(unknown) - len(shown)} other tags")
    if counts:
        file.notes.append(f"ignored lines: {', '.join(counts)}")
