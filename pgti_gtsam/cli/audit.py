"""`pgti-gtsam audit` and `view`: score a map, write it down, show it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pgti_gtsam.adapter import MIN_SHARED_LANDMARKS, from_gtsam
from pgti_gtsam.cli.options import (
    Beta,
    Cloud,
    Edges,
    File,
    MinShared,
    Radius,
    Values,
    check_outputs,
    read_map,
    split_names,
    stages,
)
from pgti_gtsam.integrity import assess
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.report import scene
from pgti_gtsam.report.document import Document, audit_document, write_json
from pgti_gtsam.report.html import write_page
from pgti_gtsam.report.terminal import print_summary


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
    check_outputs([json, html], [file, values, cloud])
    with stages(5) as stage:
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
    check_outputs([png], [file, values, cloud])
    with stages(4) as stage:
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
    dataset, radii = read_map(file, values, radius, cloud)
    stage("adapting")
    pose_graph: PoseGraph = from_gtsam(
        dataset.graph,
        dataset.values,
        radii=radii,
        edges=split_names(edges),
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
