"""`pgti-gtsam replay`: every metric while the map grows keyframe by keyframe."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pgti_gtsam import outputs
from pgti_gtsam.cli.options import (
    Beta,
    Cloud,
    Edges,
    File,
    IgnoreUnknown,
    Loops,
    MapFiles,
    MinShared,
    OneMap,
    Radius,
    Values,
    print_paths,
    read_map,
    split_names,
    terminal,
)
from pgti_gtsam.cli.progress import counted
from pgti_gtsam.replaying import METRICS, Measure
from pgti_gtsam.replaying import replay as grow
from pgti_gtsam.report.curves import require_png, write_replay_png
from pgti_gtsam.report.replay import replay_document, write_replay_page


def replay(
    file: File = None,
    values: Values = None,
    loops: Loops = None,
    one_map: OneMap = False,
    ignore_unknown: IgnoreUnknown = False,
    radius: Radius = None,
    cloud: Cloud = None,
    edges: Edges = None,
    min_shared_landmarks: MinShared = None,
    beta: Beta = 0.5,
    every: Annotated[int, typer.Option(help="Measure at every so many-th keyframe; 1: at each.")] = 1,
    json: Annotated[
        Path | None,
        typer.Option(help="Add every moment to this file of JSON lines; a run that was stopped goes on from there."),
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page: the map, its curves, and a slider.")] = None,
    png: Annotated[Path | None, typer.Option(help="Draw the curves for a paper (needs matplotlib).")] = None,
) -> None:
    """Show every metric of a map while the map grows.

    A table says how soon each metric answers to inserted edges.
    """
    files = MapFiles(files=file, values=values, loops=loops, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([json, html, png], cloud)
    require_png(png)
    with counted() as tell:
        tell("reading", 0, 1)
        dataset, radii = read_map(files, radius, cloud)
        found = grow(
            dataset.graph,
            dataset.values,
            radii=radii,
            edges=split_names(edges),
            min_shared_landmarks=min_shared_landmarks,
            closures=dataset.closures,
            every=every,
            measure=Measure(beta=beta),
            path=json,
            progress=lambda done, of: tell("measuring", done, of),
        )

        # write what was asked for
        document = replay_document(found, name=dataset.title, file_format=dataset.format, notes=dataset.notes)
        with outputs.together():
            if html is not None:
                write_replay_page(document, html)
            if png is not None:
                write_replay_png(document, png)

    # show it
    console = terminal()
    _print(document, console)
    print_paths({"JSON lines": json, "page": html, "picture": png}, console)


def _print(document: Mapping[str, Any], console: Console) -> None:
    """Print each metric at its end and at its peak, and how soon its changes answer to inserted edges."""
    moments, table = document["moments"], Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 0, 0))
    for name in ("metric", "at the end", "largest", "with keyframes", "lag", "correlation", "without lag"):
        table.add_column(name, justify="left" if name == "metric" else "right")

    # each metric
    for field, row in zip(METRICS, document["lags"], strict=True):
        curve = [float("inf") if value == "infinite" else value for value in moments[field]]
        peak = max(range(len(curve)), key=curve.__getitem__)
        numbers = (curve[-1], curve[peak]), (row["correlation"], row["at_zero"])
        (end, top), (best, at_once) = (["–" if x is None else f"{x:.3g}" for x in pair] for pair in numbers)
        lag = "–" if row["lag"] is None else str(row["lag"])
        table.add_row(row["metric"], end, top, str(moments["n_keyframes"][peak]), lag, best, at_once)

    # what grew
    inserted = sum(new > 0 for new in moments["n_new"])
    console.print(Text.assemble((document["input"]["name"], "bold"), f", {moments['n_keyframes'][-1]} keyframes"))
    counts = f"{moments['n_inserted'][-1]} inserted edges, {moments['n_collisions'][-1]} of them collisions"
    console.print(Text(f"{len(curve)} moments, edges inserted at {inserted} of them; at the end {counts}"))
    console.print()
    console.print(table)
    console.print(Text("lag: moments by which a metric's changes follow the edge-insertion signal", style="dim"))
