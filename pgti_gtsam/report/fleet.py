"""Audits of many maps: a ranking in the terminal, a table for pandas, an index page."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from pgti_gtsam.fleet.comparison import GRAVITY, Comparison
from pgti_gtsam.report import web

SCHEMA, SCHEMA_VERSION = "pgti-gtsam/fleet", 1

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
    """All rows, the worst map first, maps without a verdict last."""
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "pgti_gtsam_version": version("pgti-gtsam"),
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


def print_fleet(document: Mapping[str, Any], console: Console) -> None:
    """The ranking, and a line for each map that failed."""
    rows = [row for row in document["maps"] if "failed" not in row]
    failed = [row for row in document["maps"] if "failed" in row]
    counts = Counter(row["verdict"] for row in rows)
    told = ", ".join(f"{counts[verdict]} {verdict}" for verdict in reversed(GRAVITY) if counts[verdict])
    console.print(f"{len(document['maps'])} maps: {told or 'no verdict'}, {len(failed)} failed", style="bold")
    table = Table(box=None, pad_edge=False)
    for column in ("map", "verdict"):
        table.add_column(column)
    for column in ("Λ", "collisions", "keyframes"):
        table.add_column(column, justify="right")
    table.add_column("what to look at first", ratio=1)
    for row in rows:
        kinds = ", ".join(f"{n} × {kind}" for kind, n in row["places"].items())
        table.add_row(
            Text(Path(row["map"]).name),
            row["verdict"],
            row["score"] if isinstance(row["score"], str) else f"{row['score']:.3g}",
            str(row["collisions"]),
            str(row["keyframes"]),
            kinds or "nothing",
        )
    if rows:
        console.print(table)
    for row in failed:
        console.print(f"{row['map']}: {row['failed']}", markup=False, soft_wrap=True)
    for note in document["input"]["notes"]:
        console.print(note, style="dim", markup=False, soft_wrap=True)


def write_csv(document: Mapping[str, Any], path: Path) -> None:
    """The ranking as a table, one map a line."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(document["maps"])


def write_fleet_page(document: Mapping[str, Any], path: Path) -> None:
    """Write the index page: a table that sorts and filters, with a small picture of each map and a link to its page."""
    web.require_schema(document, SCHEMA, SCHEMA_VERSION)
    page = web.assembled(
        document,
        what="audits of many maps",
        body="fleet.html",
        first="maps",
        scripts=("text.js", "errors.js", "fleet.js"),
    )
    path.write_bytes(page.encode("utf-8"))


def print_comparison(found: Comparison, console: Console) -> None:
    """What changed, in lines."""
    console.print(f"{found.verdicts[0]} → {found.verdicts[1]}", style="bold")
    console.print(f"Λ {_short(found.scores[0])} → {_short(found.scores[1])}", end="; ")
    console.print(f"of collisions {_short(found.collision_scores[0])} → {_short(found.collision_scores[1])}")
    for title, places in (("New places", found.new_places), ("Places that are gone", found.gone_places)):
        if places:
            console.print(f"\n{title}", style="bold")
            for place in places:
                console.print(f"  {place['kind']}: {place['sentence']}", markup=False)
    if found.closures:
        console.print("\nClosures whose probability moved", style="bold")
        for name, before, after in found.closures[:20]:
            console.print(f"  {name}: {before:.2g} → {after:.2g}", markup=False)
        if len(found.closures) > 20:
            console.print(f"  and {len(found.closures) - 20} more")
    console.print("\nThe map is worse than before." if found.is_worse else "\nThe map is no worse than before.")


def _short(score: float | str) -> str:
    return score if isinstance(score, str) else f"{score:.3g}"
