"""`pgti-gtsam audit MAP MAP …` and `compare`: many maps, and a map against an earlier audit."""

from __future__ import annotations

import json as json_text
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from pgti_gtsam import encode, fleet, outputs
from pgti_gtsam.cli.options import Terminal, check_outputs
from pgti_gtsam.cli.progress import counted
from pgti_gtsam.errors import FileFormatError, InvalidOptionError
from pgti_gtsam.fleet.comparison import GRAVITY
from pgti_gtsam.plain_text import visible
from pgti_gtsam.report.document import write_json
from pgti_gtsam.report.fleet import check_table, fleet_document, write_csv, write_fleet_page, write_table
from pgti_gtsam.report.web import require_schema

Out = Annotated[
    Path | None, typer.Option("--out", help="Of several maps: folder of the index page, the table and each map's page.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="Of several maps or parts: address of a Dask scheduler; processes on this machine without."),
]
TablePath = Annotated[
    Path | None,
    typer.Option("--table", help="Of several maps: the ranking as .csv or .parquet (needs PyArrow), for pandas."),
]
Workers = Annotated[int, typer.Option(min=1, help="Of several maps or parts: processes on this machine.")]
LimitSeconds = Annotated[float, typer.Option("--limit-s", help="Of several maps: seconds that each may take.")]
LimitMegabytes = Annotated[float, typer.Option("--limit-mb", help="Of several maps: megabytes that each may take.")]


def audit_many(
    paths: Sequence[Path],
    words: Sequence[str],
    out: Path | None,
    *,
    scheduler: str | None,
    workers: int,
    limit_s: float,
    limit_mb: float,
    fail_on: str | None,
    table: Path | None = None,
) -> None:
    """The same audit of many maps: a ranking, a table, an index page, and a page for each.

    Parameters
    ----------
    paths : sequence of Path
        Maps, or folders of maps.
    words : sequence of str
        Options of the audit, as on a command line.
    out : Path, optional
        Folder of the results.
    scheduler : str, optional
        Address of a Dask scheduler.
    workers : int
        Processes.
    limit_s, limit_mb : float
        Limits of each map: seconds, megabytes.
    fail_on : str, optional
        Verdict from which the exit code is 1.
    table : Path, optional
        Where the ranking goes as CSV or Parquet, beside the CSV in the folder.
    """
    if out is None:
        meant = f"the maps in {paths[0]}" if len(paths) == 1 else f"{len(paths)} maps"
        raise InvalidOptionError(
            f"expected --out FOLDER for the audits of {meant}, got none; "
            "if the files are sessions or robots of one map, say --one-map"
        )
    if not (limit_s > 0 and limit_mb > 0):
        raise InvalidOptionError(f"expected limits above zero, got {limit_s} s and {limit_mb} MB")
    if table is not None:
        check_table(table)
        check_outputs([table], paths)
    out.mkdir(parents=True, exist_ok=True)
    maps, others = fleet.maps_in(paths)
    jobs = [
        fleet.AuditJob(map=str(path), words=tuple(words), folder=str(out), limit_s=limit_s, limit_mb=limit_mb)
        for path in maps
    ]

    # audit what is not known yet
    with counted() as tell:
        rows = fleet.run(
            out / "maps.jsonl",
            {job.key: job for job in jobs},
            fleet.audited,
            key_of=partial(_known_as, limits=(limit_s, limit_mb)),
            scheduler=scheduler,
            workers=workers,
            progress=lambda done, of: tell("maps", done, of),
        )

    # write the ranking, and show it
    options = {"audit": " ".join(words) or "no options", "limit_s": limit_s, "limit_mb": limit_mb}
    notes = [f"no reader takes {path} for a map" for path in others]
    document = fleet_document(rows, options, out.name, notes)
    with outputs.together():
        write_json(document, out / "maps.json")
        write_csv(document, out / "maps.csv")
        if table is not None:
            write_table(document, table)
        write_fleet_page(document, out / "index.html")
    console = Terminal(highlight=False)
    _print_fleet(document, console)
    console.print("\npage: ", out / "index.html", sep="", style="dim", markup=False, soft_wrap=True)
    graver = [row for row in rows if "failed" not in row and fail_on is not None and _is_as_grave(row, fail_on)]
    if graver:
        raise typer.Exit(1)


def compare(
    old: Annotated[Path, typer.Argument(help="Result of an earlier audit, as its --json writes it.")],
    new: Annotated[Path, typer.Argument(help="Result of a later audit of the same map.")],
    json: Annotated[Path | None, typer.Option(help="Write what changed to this JSON file.")] = None,
    fail_on_worse: Annotated[
        bool, typer.Option("--fail-on-worse", help="Exit with code 1 if the map got worse.")
    ] = False,
) -> None:
    """Say what got better or worse between two audits of a map."""
    found = fleet.compare(_document(old), _document(new))
    _print_comparison(found, Terminal(highlight=False))
    if json is not None:
        changes = {name: getattr(found, name) for name in (*found.__slots__, "is_worse")}
        write_json(encode.heading("comparison") | changes, json)
    if fail_on_worse and found.is_worse:
        raise typer.Exit(1)


def _known_as(row: Mapping[str, Any], limits: tuple[float, float]) -> str:
    """Key of the job that a row answers: a job that failed within other limits answers none that is asked now."""
    answers = "failed" not in row or (row["limit_s"], row["limit_mb"]) == limits
    return str(row["key"]) if answers else f"{row['key']} within other limits"


def _print_fleet(document: Mapping[str, Any], console: Terminal) -> None:
    """The ranking, and a line for each map that failed."""
    rows = [row for row in document["maps"] if "failed" not in row]
    failed = [row for row in document["maps"] if "failed" in row]
    counts = Counter(row["verdict"] for row in rows)
    told = ", ".join(f"{counts[verdict]} {verdict}" for verdict in reversed(GRAVITY) if counts[verdict])
    console.print(f"{len(document['maps'])} maps: {told or 'no verdict'}, {len(failed)} failed", style="bold")

    # the ranking
    table = Table(box=None, pad_edge=False)
    for column in ("map", "verdict"):
        table.add_column(column)
    for column in ("Λ", "collisions", "keyframes"):
        table.add_column(column, justify="right")
    table.add_column("what to look at first", ratio=1)
    for row in rows:
        kinds = ", ".join(f"{n} × {kind}" for kind, n in row["places"].items())
        table.add_row(
            Text(visible(Path(row["map"]).name)),
            row["verdict"],
            row["score"] if isinstance(row["score"], str) else f"{row['score']:.3g}",
            str(row["collisions"]),
            str(row["keyframes"]),
            kinds or "nothing",
        )
    if rows:
        console.print(table)

    # what has no verdict, and what is no map
    for row in failed:
        console.print(visible(f"{row['map']}: {row['failed']}"), markup=False, soft_wrap=True)
    for note in document["input"]["notes"]:
        console.print(visible(note), style="dim", markup=False, soft_wrap=True)


def _print_comparison(found: fleet.Comparison, console: Terminal) -> None:
    """The changes, in lines."""
    console.print(f"{found.verdicts[0]} → {found.verdicts[1]}", style="bold")
    console.print(f"Λ {_short(found.scores[0])} → {_short(found.scores[1])}", end="; ")
    console.print(f"of collisions {_short(found.collision_scores[0])} → {_short(found.collision_scores[1])}")
    for title, places in (("New places", found.new_places), ("Places that are gone", found.gone_places)):
        if places:
            console.print(f"\n{title}", style="bold")
            for place in places:
                console.print(visible(f"  {place['kind']}: {place['sentence']}"), markup=False)
    if found.closures:
        console.print("\nClosures whose probability moved", style="bold")
        for name, before, after in found.closures[:20]:
            console.print(visible(f"  {name}: {before:.2g} → {after:.2g}"), markup=False)
        if len(found.closures) > 20:
            console.print(f"  and {len(found.closures) - 20} more")
    console.print("\nThe map is worse than before." if found.is_worse else "\nThe map is no worse than before.")


def _short(score: float | str) -> str:
    return score if isinstance(score, str) else f"{score:.3g}"


def _document(path: Path) -> Mapping[str, Any]:
    try:
        document = json_text.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileFormatError(path, f"expected the JSON of an audit: {error}") from error
    require_schema(document if isinstance(document, dict) else {}, "audit")
    found: Mapping[str, Any] = document
    return found


def _is_as_grave(row: Mapping[str, Any], verdict: str) -> bool:
    return GRAVITY.index(row["verdict"]) >= GRAVITY.index(verdict)
