"""`pgti-gtsam audit` and `view`: say whether a map is right and where not, write the result, show the map."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from pgti_gtsam import diagnosis, outputs
from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.cli.fleet import LimitMegabytes, LimitSeconds, Out, Scheduler, Workers, audit_many
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
    Values,
    print_paths,
    read_map,
    split_names,
    terminal,
)
from pgti_gtsam.cli.progress import stages
from pgti_gtsam.datasets import Dataset, is_map, write_g2o
from pgti_gtsam.diagnosis import Diagnosis
from pgti_gtsam.diagnosis.proposals import proposal_graph
from pgti_gtsam.diagnosis.sweep import radius_sweep
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.fleet.comparison import GRAVITY
from pgti_gtsam.places import tied_radius_m
from pgti_gtsam.plain_text import visible
from pgti_gtsam.report import scene
from pgti_gtsam.report.document import Document, audit_document, sweep_rows, write_json
from pgti_gtsam.report.html import write_page
from pgti_gtsam.report.terminal import print_summary, print_sweep

AnyRadius = Annotated[
    str | None,
    typer.Option(
        metavar="METRES|auto",
        help="Free distance around every keyframe; auto: the median distance of keyframes that closures tie.",
    ),
]
Optimise = Annotated[bool, typer.Option("--optimise", help="Audit the optimum of the graph, not the stored estimate.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Audited:
    """A map with its diagnosis and document."""

    dataset: Dataset
    values: Any
    diagnosis: Diagnosis
    document: Document


def audit(
    file: File = None,
    values: Values = None,
    loops: Loops = None,
    one_map: OneMap = False,
    ignore_unknown: IgnoreUnknown = False,
    radius: AnyRadius = None,
    cloud: Cloud = None,
    edges: Edges = None,
    min_shared_landmarks: MinShared = None,
    beta: Beta = 0.5,
    optimise: Optimise = False,
    sweep: Annotated[
        bool,
        typer.Option("--radius-sweep", help="Audit at a quarter to four times the radii too: does the verdict hold?"),
    ] = False,
    json: Annotated[Path | None, typer.Option(help="Write everything found to this JSON file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a self-contained page to this file.")] = None,
    proposals: Annotated[
        Path | None, typer.Option(help="Write ties that a scan matcher can try to this g2o file, as predicted.")
    ] = None,
    fail_on: Annotated[
        str | None,
        typer.Option(metavar="VERDICT", help=f"Exit with code 1 from this on: {', '.join(GRAVITY[1:])}."),
    ] = None,
    fail_above: Annotated[float | None, typer.Option(help="Exit with code 1 if Λ is above this.")] = None,
    out: Out = None,
    scheduler: Scheduler = None,
    workers: Workers = 2,
    limit_s: LimitSeconds = 600.0,
    limit_mb: LimitMegabytes = 8000.0,
) -> None:
    """Say whether a map is right, where not, and what to do.

    Several maps, or a folder of maps, become a ranking with a page for each.
    """
    files = MapFiles(files=file, values=values, loops=loops, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([json, html, proposals], cloud)
    _check_failures(fail_on, fail_above)
    if _are_many(file, one_map=one_map):
        _check_alone(values=values, loops=loops, cloud=cloud, json=json, html=html, proposals=proposals)
        words = _words(radius, edges, min_shared_landmarks, beta, optimise=optimise, ignore_unknown=ignore_unknown)
        audit_many(
            file or (),
            words,
            out,
            scheduler=scheduler,
            workers=workers,
            limit_s=limit_s,
            limit_mb=limit_mb,
            fail_on=fail_on,
        )
        return

    # audit, and write what was asked for
    with stages() as stage:
        audited = _audit(files, radius, cloud, edges, min_shared_landmarks, beta, optimise, stage)
        document = audited.document
        if sweep:
            swept = radius_sweep(
                audited.dataset.graph,
                audited.values,
                audited.diagnosis,
                closures=audited.dataset.closures,
                progress=stage,
            )
            document["radius_sweep"] = sweep_rows(swept)
        with outputs.together():
            if json is not None:
                stage("writing JSON")
                write_json(document, json)
            if html is not None:
                stage("writing the page")
                write_page(document, html)
            if proposals is not None:
                graph, places = proposal_graph(audited.diagnosis, audited.values)
                write_g2o(graph, places, proposals)

    # show it
    console = terminal()
    print_summary(document, console)
    if sweep:
        print_sweep(document, console)
    print_paths({"JSON": json, "page": html, "proposals": proposals}, console)
    if _fails(document, fail_on, fail_above):
        raise typer.Exit(1)


def view(
    file: File = None,
    values: Values = None,
    loops: Loops = None,
    one_map: OneMap = False,
    ignore_unknown: IgnoreUnknown = False,
    radius: AnyRadius = None,
    cloud: Cloud = None,
    edges: Edges = None,
    min_shared_landmarks: MinShared = None,
    beta: Beta = 0.5,
    optimise: Optimise = False,
    png: Annotated[Path | None, typer.Option(help="Render to this file instead of opening a window.")] = None,
) -> None:
    """Show the audited map in 3D (needs Open3D)."""
    files = MapFiles(files=file, values=values, loops=loops, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([png], cloud)
    with stages() as stage:
        audited = _audit(files, radius, cloud, edges, min_shared_landmarks, beta, optimise, stage)
        if png is not None:
            stage("rendering")
            scene.render_png(audited.document, png)
    if png is None:
        scene.show(audited.document)


def _audit(
    files: MapFiles,
    radius: str | None,
    cloud: Path | None,
    edges: str | None,
    min_shared_landmarks: int | None,
    beta: float,
    optimise: bool,
    stage: Callable[[str], None],
) -> _Audited:
    """Read, optimise, find the radius, diagnose: numbered steps of every command that audits a map."""
    # the map, or its optimum
    stage("reading")
    metres = None if radius in (None, "auto") else _metres(str(radius))
    dataset, radii = read_map(files, metres, cloud)
    notes, best = list(dataset.notes), dataset.values

    if optimise:
        stage("optimising")
        best = optimised(dataset.graph, dataset.values)
        before, after = dataset.graph.error(dataset.values), dataset.graph.error(best)
        notes.append(f"the optimum is audited: error {before:.4g} as stored, {after:.4g} there")

    # radii
    adaptation: dict[str, Any] = {
        "edges": split_names(edges),
        "min_shared_landmarks": min_shared_landmarks,
        "closures": dataset.closures,
    }
    if radius == "auto":
        radii = tied_radius_m(from_gtsam(dataset.graph, best, radii=1.0, **adaptation))
        notes.append(f"radius {radii:.3g} m around every keyframe: the median distance of keyframes that closures tie")
    elif metres is not None:
        notes.append(f"radius {metres:g} m around every keyframe is what --radius says; --radius-sweep tries others")

    # diagnose, and keep the settings beside the result
    found = diagnosis.diagnose(dataset.graph, best, radii=radii, beta=beta, progress=stage, **adaptation)
    adapted = found.pose_graph.adaptation
    options = {
        "radius": radius if metres is None else metres,
        "cloud": None if cloud is None else visible(cloud.name),
        "edges": list(adapted.edges) if adapted else [],
        "min_shared_landmarks": adapted.min_shared_landmarks if adapted else min_shared_landmarks,
        "beta": beta,
        "n_times": len(found.integrity.times),
        "norm": found.integrity.norm,
        "optimise": optimise,
    }
    document = audit_document(found, name=dataset.title, file_format=dataset.format, notes=notes, options=options)
    return _Audited(dataset=dataset, values=best, diagnosis=found, document=document)


def _are_many(files: list[Path] | None, *, one_map: bool) -> bool:
    """Whether several maps are meant: files without --one-map, or a folder that is no model by itself."""
    given = files or []
    return not one_map and (len(given) > 1 or any(path.is_dir() and not is_map(path) for path in given))


def _check_alone(**options: Any) -> None:
    """Refuse options that belong to a single map."""
    given = next((name for name, value in options.items() if value is not None), None)
    if given is not None:
        raise InvalidOptionError(
            f"expected --{given} with one map, got several; --out names the folder that their results go to"
        )


def _words(
    radius: str | None,
    edges: str | None,
    min_shared_landmarks: int | None,
    beta: float,
    *,
    optimise: bool,
    ignore_unknown: bool,
) -> list[str]:
    """The options of an audit as its command line has them."""
    given = {"radius": radius, "edges": edges, "min-shared-landmarks": min_shared_landmarks, "beta": beta}
    words = [word for name, value in given.items() if value is not None for word in (f"--{name}", str(value))]
    return words + ["--optimise"] * optimise + ["--ignore-unknown"] * ignore_unknown


def _metres(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidOptionError(f"expected metres or auto for --radius, got {text!r}") from None


def _check_failures(fail_on: str | None, fail_above: float | None) -> None:
    if fail_on is not None and fail_on not in GRAVITY[1:]:
        raise InvalidOptionError(f"expected --fail-on {', '.join(GRAVITY[1:])}, got {fail_on!r}")
    if fail_above is not None and math.isnan(fail_above):
        raise InvalidOptionError("expected a number for --fail-above, got nan: no score is above that")


def _fails(document: Document, fail_on: str | None, fail_above: float | None) -> bool:
    score, level = document["summary"]["score"], document["verdict"]["level"]
    too_high = fail_above is not None and (score == "infinite" or score > fail_above)
    return too_high or (fail_on is not None and GRAVITY.index(level) >= GRAVITY.index(fail_on))
