"""`pgti-gtsam audit MAP --parts N`: a map too large to be audited at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from pgti_gtsam.cli.options import print_paths, terminal
from pgti_gtsam.cli.prepared import Prepared
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.fleet import spread
from pgti_gtsam.parts import diagnose_parts
from pgti_gtsam.report.document import write_json
from pgti_gtsam.report.merging import merging_record
from pgti_gtsam.report.parts import parts_document
from pgti_gtsam.report.terminal import print_merging, print_parts

Parts = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Audit a large map in so many parts, on --workers processes or a --scheduler: all but ζ and Λ.",
    ),
]


def check_parts(others: Mapping[str, Any]) -> None:
    """Refuse what an audit in parts does not make."""
    given = next((name for name, value in others.items() if value not in (None, False)), None)
    if given is not None:
        raise InvalidOptionError(f"expected --parts without {given}, got both; an audit in parts writes --json only")


def audited_in_parts(
    map_: Prepared, parts: int, scheduler: str | None, workers: int, stage: Callable[[str], None]
) -> dict[str, Any]:
    """The document of an audit in parts.

    Parameters
    ----------
    map_ : Prepared
    parts, scheduler, workers
        As the command line has them.
    stage : callable
        Told of each step.
    """
    with spread(scheduler, workers) as each:
        found = diagnose_parts(
            map_.dataset.graph, map_.values, parts=parts, each=each, progress=stage, **map_.arguments
        )
    document = parts_document(
        found,
        name=map_.dataset.title,
        file_format=map_.dataset.format,
        notes=map_.notes,
        options=map_.options(found.pose_graph),
    )
    return document if map_.merged is None else document | {"merging": merging_record(map_.merged)}


def tell_parts(document: Mapping[str, Any], json: Path | None) -> None:
    """Write and print what was found.

    Parameters
    ----------
    document : mapping
        As `parts_document` makes it.
    json : Path or None
        Where it goes.
    """
    if json is not None:
        write_json(document, json)
    console = terminal()
    if "merging" in document:
        print_merging(document["merging"], console)
    print_parts(document, console)
    print_paths({"JSON": json}, console)
