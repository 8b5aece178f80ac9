"""Lines of text to checked numbers, every complaint with its file and line."""

from __future__ import annotations

import bz2
import gzip
import math
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.errors import FileFormatError

UNDERSTOOD = (
    "understood are g2o, TORO, GTSAM text archives (graph and values), the stereo files and Victoria Park "
    "of the GTSAM wheel, CARMEN logs and FLIRTLib scan graphs, each also compressed with gzip or bzip2"
)
OPENERS = {b"\x1f\x8b": gzip.decompress, b"BZh": bz2.decompress}
ENDINGS = {".gz", ".bz2"}
MAX_ID = 2**53  # float64 holds every integer up to here; below 2**56, where a symbol's letter starts
LARGEST = 1e30  # no length, angle or information reaches this, and its square is still a float64

Item = TypeVar("Item")


class Line(NamedTuple):
    """Number, counted from 1, and whitespace-separated fields of a line that is neither empty nor comment."""

    number: int
    fields: list[str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Lines of one kind as arrays: line numbers (n,), identifiers (n, k) and finite numbers (n, m)."""

    lines: NDArray[np.int64]
    ids: NDArray[np.int64]
    numbers: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TextFile:
    """The lines of a file, also grouped by their first field, the tag; comments apart."""

    path: Path
    lines: Sequence[Line]
    tags: Mapping[str, Sequence[Line]]
    comments: Sequence[Line] = ()

    @property
    def name(self) -> str:
        """The file's name without the ending of its format and compression."""
        path = self.path.with_suffix("") if self.path.suffix in ENDINGS else self.path
        return path.stem

    def table(self, tag: str, *, ids: int, widths: Collection[int]) -> Table:
        """Lines of ``tag`` as arrays; ``widths`` are the allowed counts of numbers after the identifiers."""
        return parse_table(self.path, self.tags.get(tag, ()), ids=ids, widths=widths)

    def error(self, message: str, line: int | None = None) -> FileFormatError:
        """An error that names this file."""
        return FileFormatError(self.path, message, line=None if line is None else int(line))


def quote(label: object, length: int = 40) -> str:
    """Text from a file, harmless and short enough to print."""
    text = str(label)
    return ascii(text if len(text) <= length else text[:length] + "…")


def read_text(path: Path) -> str:
    """Text of a plain or compressed file.

    Raises
    ------
    FileFormatError
        The file cannot be read, is damaged, empty or binary. Bytes that are not UTF-8 become "�".
    """
    data = _read_bytes(path)
    if b"\0" in data:
        raise FileFormatError(path, f"is binary, expected text; {UNDERSTOOD}")
    text = data.decode("utf-8-sig", errors="replace")
    if not text or text.isspace():
        raise FileFormatError(path, f"is empty; {UNDERSTOOD}")
    return text


def _read_bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
        for magic, decompress in OPENERS.items():
            if data.startswith(magic):
                return decompress(data)
    except IsADirectoryError:
        raise FileFormatError(path, f"is a directory, expected a file; {UNDERSTOOD}") from None
    except FileNotFoundError:
        raise FileFormatError(path, "no such file") from None
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise FileFormatError(path, f"cannot be read: {error}") from error
    return data


def split_lines(path: Path, text: str) -> TextFile:
    """Lines of ``text`` without empty ones, grouped by tag, and ``#`` comments."""
    split = [Line(number, line.split()) for number, line in enumerate(text.split("\n"), 1)]
    lines = [line for line in split if line.fields and not line.fields[0].startswith("#")]
    comments = [line for line in split if line.fields and line.fields[0].startswith("#")]
    tags: dict[str, list[Line]] = {}
    for line in lines:
        tags.setdefault(line.fields[0], []).append(line)
    return TextFile(path=path, lines=lines, tags=tags, comments=comments)


def parse_table(path: Path, lines: Sequence[Line], *, ids: int, widths: Collection[int], tagged: bool = True) -> Table:
    """Lines of one kind as arrays.

    Parameters
    ----------
    path : Path
        Named in errors.
    lines : sequence of Line
        Tag (when ``tagged``), ``ids`` identifiers, then numbers, of which all lines have equally many.
    ids : int
        How many identifiers.
    widths : collection of int
        How many numbers there may be.
    tagged : bool
        Whether the first field is a tag.

    Raises
    ------
    FileFormatError
        Too few or too many fields, an identifier that is no whole number from 0 to 2**53, a field that is
        no finite number, a number beyond 1e30.
    """
    first = int(tagged)
    width = _common_width(path, lines, first + ids, widths)
    identifiers = [parse_ids(path, line, line.fields[first : first + ids]) for line in lines]
    numbers = [parse_numbers(path, line, line.fields[first + ids :]) for line in lines]
    table = Table(
        lines=np.array([line.number for line in lines], np.int64),
        ids=np.array(identifiers, np.int64).reshape(len(lines), ids),
        numbers=np.array(numbers, np.float64).reshape(len(lines), width),
    )
    too_large = np.argwhere(np.abs(table.numbers) > LARGEST)
    if too_large.size:
        row, column = too_large[0]
        message = f"expected numbers up to {LARGEST:g} in size, got {table.numbers[row, column]:g}"
        raise FileFormatError(path, message, line=int(table.lines[row]))
    return table


def _common_width(path: Path, lines: Sequence[Line], before: int, widths: Collection[int]) -> int:
    """Count of numbers after the first ``before`` fields, the same on every line and one of ``widths``."""
    allowed = set(widths)
    for line in lines:
        if len(line.fields) - before not in allowed:
            expected = " or ".join(str(before + width) for width in sorted(allowed))
            message = f"expected {expected} fields, got {len(line.fields)} in {quote(' '.join(line.fields))}"
            raise FileFormatError(path, message, line=line.number)
        allowed = {len(line.fields) - before}
    return min(allowed)


def parse_ids(path: Path, line: Line, fields: Iterable[str]) -> list[int]:
    """Identifiers from 0 to 2**53."""
    for field in fields:
        if not (field.isascii() and field.isdecimal() and len(field) <= 16 and int(field) <= MAX_ID):
            message = f"expected an identifier, a whole number from 0 to 2**53, got {quote(field)}"
            raise FileFormatError(path, message, line=line.number)
    return [int(field) for field in fields]


def parse_numbers(path: Path, line: Line, fields: Sequence[str]) -> list[float]:
    """Finite numbers; what Python alone takes for one (``1_0``) is refused."""
    try:
        numbers = [float(field) for field in fields]
    except ValueError:
        numbers = []
    if len(numbers) == len(fields) and all(map(math.isfinite, numbers)) and "_" not in "".join(fields):
        return numbers
    culprit = next((field for field in fields if not is_number(field)), fields[-1])
    message = f"expected a finite number, got {quote(culprit)}"
    raise FileFormatError(path, message, line=line.number)


def is_number(field: str) -> bool:
    """Whether a field is a finite number."""
    try:
        return math.isfinite(float(field)) and "_" not in field
    except ValueError:
        return False


def by_identifier(
    file: TextFile, tag: str, table: Table, items: Iterable[Item], others: Collection[int] = ()
) -> dict[int, Item]:
    """Items by the first identifier of their rows.

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


def note_ignored(file: TextFile, known: Collection[str]) -> list[str]:
    """One sentence about the lines that no reader used, by tag."""
    unknown = {tag: lines for tag, lines in file.tags.items() if tag not in known}
    shown = sorted(unknown, key=lambda tag: -len(unknown[tag]))[:8]  # a note is a line or two, not a list
    counts = [f"{len(unknown[tag])} {quote(tag)}" for tag in shown]
    if len(unknown) > len(shown):
        rest = sum(map(len, unknown.values())) - sum(len(unknown[tag]) for tag in shown)
        counts.append(f"{rest} with {len(unknown) - len(shown)} other tags")
    return [f"ignored lines: {', '.join(counts)}"] if counts else []
