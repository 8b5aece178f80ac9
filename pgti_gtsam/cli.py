"""The command line: parse, call, print. The only place that catches `PgtiError`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from pgti_gtsam import datasets
from pgti_gtsam.adapter import EDGE_SOURCES, MIN_SHARED_LANDMARKS, from_gtsam
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.dense_map import radii_from_cloud
from pgti_gtsam.errors import InvalidOptionError, PgtiError
from pgti_gtsam.integrity import assess
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.report import scene
from pgti_gtsam.report.document import Document, audit_document, write_json
from pgti_gtsam.report.html import write_page
from pgti_gtsam.report.terminal import print_summary

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)

File = Annotated[
    Path | None,
    typer.Argument(
        help="Map: g2o, TORO, GTSAM archive, KITTI stereo, CARMEN or FLIRTLib log. Default: KITTI 00 from GTSAM.",
        show_default=False,
    ),
]
Values = Annotated[
    Path | None, typer.Option("--values", help="Archive of the values, where FILE is an archived graph.")
]
Radius = Annotated[float | None, typer.Option(help="Free distance around every keyframe, in metres.")]
Cloud = Annotated[Path | None, typer.Option(help="Point cloud or mesh: radii are the distances to it (needs Open3D).")]
Edges = Annotated[
    str | None,
    typer.Option(
        help=f"What connects keyframes, from {','.join(EDGE_SOURCES)}. Default: the first two; "
        "all three where radii do not come from landmarks or no landmarks are shared."
    ),
]
MinShared = Annotated[int, typer.Option(help="Landmarks that two keyframes must share to be connected.")]
Beta = Annotated[float, typer.Option(help="Share of the time scales that counts as local.")]


@app.callback()
def describe() -> None:
    """Is this map right, and where not? Pose-graph topological integrity of SLAM maps."""


@app.command()
def audit(
    file: File = None,
    values: Values = None,
    radius: Radius = None,
    cloud: Cloud = None,
    edges: Edges = None,
    min_shared_landmarks: MinShared = MIN_SHARED_LANDMARKS,
    beta: Beta = 0.5,
    json: Annotated[Path | None, typer.Option(help="Write everything found to this JSON file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a self-contained page to this file.")] = None,
    fail_above: Annotated[float | None, typer.Option(help="Exit with code 1 if Λ is above this.")] = None,
) -> None:
    """Score a map, and name the places where its pose graph disagrees with its free space."""
    inputs = [path for path in (file, values, cloud) if path is not None]
    for output in (json, html):
        _check_output(output, inputs)
    with _stages(5) as stage:
        document = _audit(file, values, radius, cloud, edges, min_shared_landmarks, beta, stage)
        if json is not None:
            stage("writing JSON")
            write_json(document, json)
        if html is not None:
            stage("writing the page")
            write_page(document, html)
    console = Console(highlight=False)
    print_summary(document, console)
    for what, path in (("JSON", json), ("page", html)):
        if path is not None:
            console.print(f"\n{what}: ", path, sep="", style="dim", markup=False, soft_wrap=True)
    score = document["summary"]["score"]
    if fail_above is not None and (score == "infinite" or score > fail_above):
        raise typer.Exit(1)


@app.command()
def view(
    file: File = None,
    values: Values = None,
    radius: Radius = None,
    cloud: Cloud = None,
    edges: Edges = None,
    min_shared_landmarks: MinShared = MIN_SHARED_LANDMARKS,
    beta: Beta = 0.5,
    png: Annotated[Path | None, typer.Option(help="Render to this file instead of opening a window.")] = None,
) -> None:
    """Show the scored map in 3D (needs Open3D)."""
    _check_output(png, [path for path in (file, values, cloud) if path is not None])
    with _stages(4) as stage:
        document = _audit(file, values, radius, cloud, edges, min_shared_landmarks, beta, stage)
        if png is not None:
            stage("rendering")
            scene.render_png(document, png)
    if png is None:
        scene.show(document)


def _audit(
    file: Path | None,
    values: Path | None,
    radius: float | None,
    cloud: Path | None,
    edges: str | None,
    min_shared_landmarks: int,
    beta: float,
    stage: Callable[[str], None],
) -> Document:
    """Read, adapt, assess: numbered steps of every command that scores a map."""
    stage("reading")
    dataset = datasets.builtin() if file is None else datasets.read(file, values)
    stage("adapting")
    radii: Any = radius if radius is not None else dataset.radii
    if cloud is not None:
        if radius is not None:
            raise InvalidOptionError("expected --radius or --cloud, got both")
        keyframes = read_keyframes(dataset.values)
        distances = radii_from_cloud(keyframes.positions, cloud)
        radii = dict(zip(keyframes.keys.tolist(), distances.tolist(), strict=True))
    pose_graph: PoseGraph = from_gtsam(
        dataset.graph,
        dataset.values,
        radii=radii,
        edges=None if edges is None else [name.strip() for name in edges.split(",")],
        min_shared_landmarks=min_shared_landmarks,
    )
    stage(f"spectra of {len(pose_graph)} keyframes")
    integrity = assess(pose_graph, beta=beta)
    options = {
        "radius": radius,
        "cloud": None if cloud is None else cloud.name,
        "edges": list(pose_graph.adaptation.edges) if pose_graph.adaptation else [],
        "min_shared_landmarks": min_shared_landmarks,
        "beta": beta,
        "n_times": len(integrity.times),
        "norm": integrity.norm,
    }
    return audit_document(
        pose_graph, integrity, name=dataset.name, file_format=dataset.format, notes=dataset.notes, options=options
    )


def _check_output(output: Path | None, inputs: list[Path]) -> None:
    """Refuse an output that cannot be written, or that would overwrite what is read."""
    if output is None:
        return
    if any(path.exists() and output.exists() and path.samefile(output) for path in inputs):
        raise InvalidOptionError(f"expected an output of its own, got the input {output}; name another file")
    if output.is_dir() or not output.parent.is_dir():
        raise InvalidOptionError(f"expected a file in an existing folder, got {output}")


@contextmanager
def _stages(count: int) -> Iterator[Callable[[str], None]]:
    """A bar on standard error that moves by stages and vanishes when done."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("starting", total=count)

        def stage(description: str) -> None:
            progress.update(task, description=description, advance=1)

        yield stage


def main() -> None:
    """Run the command line; bad input ends with one line on standard error and exit code 2."""
    try:
        app()
    except PgtiError as error:
        Console(stderr=True, highlight=False).print(f"pgti-gtsam: {error}", markup=False, soft_wrap=True)
        sys.exit(2)
