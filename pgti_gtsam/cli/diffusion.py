"""`pgti-gtsam diffusion`: a pose graph as a conductor of heat."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pgti_gtsam.cli.options import IgnoreUnknown, Loops, Map, MapFiles, OneMap, Values, read_map, stages
from pgti_gtsam.diffusion import study
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
    """Compare pose-graph optimisation with heat: frames, steady state, optimisers, proxy."""
    files = MapFiles(files=file, values=values, loops=loops, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([json, html])
    with stages(8) as stage:
        stage("reading")
        dataset, _ = read_map(files, None, None)
        found = study(dataset.graph, dataset.values, stage)
        document = heat_document(found, dataset.title)
        if json is not None:
            json.write_text(json_text.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        if html is not None:
            write_heat_page(document, html)
    console = Console(highlight=False)
    print_heat(document, console)
    for what, path in (("JSON", json), ("page", html)):
        if path is not None:
            console.print(f"\n{what}: ", path, sep="", style="dim", markup=False, soft_wrap=True)
