"""Audits of many maps: a ranking, as a table for pandas and as an index page."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pgti_gtsam import encode, outputs
from pgti_gtsam.errors import InvalidOptionError, MissingDependencyError
from pgti_gtsam.fleet.comparison import GRAVITY
from pgti_gtsam.report import web

COLUMNS = (
    "map",
    "verdict",
    "score",
    "collision_score",
    "collisions",
    "keyframes",
    "false_closures",
    "seconds",
    "failed",
    "page",
    "document",
)

SCORES = ("score", "collision_score")

Row = Mapping[str, Any]


def fleet_document(
    rows: Sequence[Row], options: Mapping[str, Any], name: str, notes: Sequence[str] = ()
) -> dict[str, Any]:
    """All rows, the worst map first, maps without a verdict last.

    Parameters
    ----------
    rows : sequence of Row
    options : mapping
        Settings of the audits.
    name : str
        Name of the folder.
    notes : sequence of str
    """
    return {
        **encode.heading("fleet"),
        "input": {"name": name, "format": f"{len(rows)} maps", "notes": list(notes)},
        "options": dict(options),
        "maps": sorted(rows, key=gravity),
    }


def gravity(row: Row) -> tuple[Any, ...]:
    """Key that sorts the worst map first: by verdict, false closures, places to act on, collisions."""
    if "failed" in row:
        return (1, row["map"])
    named = sum(n for kind, n in row["places"].items() if kind not in ("incomplete fusion", "different view"))
    return (0, -GRAVITY.index(row["verdict"]), -row["false_closures"], -named, -row["collisions"], row["map"])


def check_table(path: Path) -> None:
    """Refuse a table that cannot be written.

    Raises
    ------
    InvalidOptionError
        Another ending than .csv and .parquet.
    MissingDependencyError
        PyArrow, which writes Parquet, is not installed.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise InvalidOptionError(f"expected --table with a path that ends with .csv or .parquet, got {path}")
    if path.suffix == ".parquet" and find_spec("pyarrow") is None:
        raise MissingDependencyError("PyArrow is missing: install it with  pip install 'pgti-gtsam[parquet]'")


def write_table(document: Mapping[str, Any], path: Path) -> None:
    """The ranking as a table, a map a line: CSV, or Parquet where the path ends with .parquet.

    In Parquet scores are numbers, infinite ones too, and what a failed map lacks is null.

    Parameters
    ----------
    document : mapping
        As `fleet_document` makes it.
    path : Path
    """
    if path.suffix != ".parquet":
        write_csv(document, path)
        return

    # columns of one type each
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    types = {"score": arrow.float64(), "collision_score": arrow.float64(), "seconds": arrow.float64()}
    types |= dict.fromkeys(("collisions", "keyframes", "false_closures"), arrow.int64())
    rows = [row | {name: _decoded(row.get(name)) for name in SCORES} for row in map(dict, document["maps"])]
    columns = {name: arrow.array([row.get(name) for row in rows], types.get(name, arrow.string())) for name in COLUMNS}
    stream = arrow.BufferOutputStream()
    parquet.write_table(arrow.table(columns), stream)
    outputs.write_bytes(path, stream.getvalue().to_pybytes())


def _decoded(score: float | str | None) -> float | None:
    return None if score is None else encode.decoded(score)


def write_csv(document: Mapping[str, Any], path: Path) -> None:
    """The ranking as a table, a map a line.

    Parameters
    ----------
    document : mapping
        As `fleet_document` makes it.
    path : Path
    """
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(document["maps"])
    outputs.write_text(path, text.getvalue())


def write_fleet_page(document: Mapping[str, Any], path: Path) -> None:
    """Write the index page: a table that sorts and filters, with a small picture of each map and a link to its page.

    Parameters
    ----------
    document : mapping
        As `fleet_document` makes it.
    path : Path
    """
    web.require_schema(document, "fleet")
    page = web.assembled(
        document,
        what="audits of many maps",
        body="fleet.html",
        first="maps",
        scripts=("text.js", "errors.js", "fleet.js"),
    )
    outputs.write_text(path, page)
