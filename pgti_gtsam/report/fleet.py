"""Audits of many maps: a ranking, as a table for pandas and as an index page."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pgti_gtsam import encode, outputs
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
