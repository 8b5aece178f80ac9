"""`pgti-gtsam diffusion`: a pose graph as a conductor of heat."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pgti_gtsam import outputs
from pgti_gtsam.cli.options import (
    IgnoreUnknown,
    Loops,
    Map,
    MapFiles,
    OneMap,
    Values,
    print_paths,
    read_map,
    terminal,
)
from pgti_gtsam.cli.progress import stages
from pgti_gtsam.diffusion import study
from pgti_gtsam.report.document import write_json
from pgti_gtsam.report.heat import heat_document, write_heat_page
from pgti_gtsam.report.terminal import print_heat


def diffusion(
    file: Map,
    values: Values = None,
    loops: Loops = None,
    one_map: OneMap = False,
    ignore_unknown: IgnoreUnknown = False,
    json: Annotated[Path | None, typer.Option(help="Write everything found to this JSON file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the figures to this page.")] = None,
) -> None:
    """Compare pose-graph optimisation with the flow of heat.

    Frames, steady state, optimisers, and the proxy that PGTI takes.
    """
    files = MapFiles(files=file, values=values, loops=loops, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([json, html])
    with stages() as stage:
        stage("reading")
        dataset, _ = read_map(files, None, None)
        found = study(dataset.graph, dataset.values, stage)
        document = heat_document(found, name=dataset.title, file_format=dataset.format, notes=dataset.notes)
        with outputs.together():
            if json is not None:
                write_json(document, json)
            if html is not None:
                write_heat_page(document, html)
    console = terminal()
    print_heat(document, console)
    print_paths({"JSON": json, "page": html}, console)
