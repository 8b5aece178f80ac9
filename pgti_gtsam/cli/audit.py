"""`pgti-gtsam audit` and `view`: say whether a map is right and where not, write the result, show the map."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from pgti_gtsam import diagnosis, outputs
from pgti_gtsam.cli.fleet import LimitMegabytes, LimitSeconds, Out, Scheduler, TablePath, Workers, audit_many
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
    terminal,
)
from pgti_gtsam.cli.parts import Parts, audited_in_parts, check_parts, tell_parts
from pgti_gtsam.cli.prepared import AnyRadius, Links, Optimise, prepared
from pgti_gtsam.cli.progress import stages
from pgti_gtsam.datasets import Dataset, is_map, write_g2o
from pgti_gtsam.diagnosis import Diagnosis
from pgti_gtsam.diagnosis.proposals import proposal_graph
from pgti_gtsam.diagnosis.sweep import radius_sweep
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.fleet.comparison import GRAVITY
from pgti_gtsam.report import scene
from pgti_gtsam.report.document import Document, audit_document, sweep_rows, write_json
from pgti_gtsam.report.html import write_page
from pgti_gtsam.report.merging import merging_record
from pgti_gtsam.report.terminal import print_merging, print_summary, print_sweep


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
    links: Links = None,
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
    parts: Parts = None,
    out: Out = None,
    table: TablePath = None,
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
    if links is not None and not one_map:
        raise InvalidOptionError("expected --links with --one-map, got them alone: links lie between maps")
    if table is not None and not _are_many(file, one_map=one_map):
        raise InvalidOptionError("expected --table with several maps, got one; --json writes what is found of a map")
    if _are_many(file, one_map=one_map):
        _check_alone(values=values, loops=loops, cloud=cloud, json=json, html=html, proposals=proposals, parts=parts)
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
            table=table,
        )
        return

    if parts is not None:
        check_parts({"--html": html, "--proposals": proposals, "--radius-sweep": sweep, "--fail-above": fail_above})
        with stages() as stage:
            map_ = prepared(
                files, radius, cloud, edges, min_shared_landmarks, optimise=optimise, stage=stage, links=links
            )
            document = audited_in_parts(map_, parts, scheduler, workers, stage)
        tell_parts(document, json)
        if _fails(document, fail_on, None):
            raise typer.Exit(1)
        return

    # audit, and write what was asked for
    with stages() as stage:
        audited = _audit(files, radius, cloud, edges, min_shared_landmarks, beta, optimise, stage, links)
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
    if "merging" in document:
        print_merging(document["merging"], console)
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
        return
    console = terminal()
    console.print(scene.legend(audited.document), markup=False, soft_wrap=True)
    print_paths({"picture": png}, console)


def _audit(
    files: MapFiles,
    radius: str | None,
    cloud: Path | None,
    edges: str | None,
    min_shared_landmarks: int | None,
    beta: float,
    optimise: bool,
    stage: Callable[[str], None],
    links: Path | None = None,
) -> _Audited:
    """Read, optimise, find the radius, diagnose: numbered steps of every command that audits a map."""
    map_ = prepared(files, radius, cloud, edges, min_shared_landmarks, optimise=optimise, stage=stage, links=links)

    # diagnose, and keep the settings beside the result
    found = diagnosis.diagnose(map_.dataset.graph, map_.values, beta=beta, progress=stage, **map_.arguments)
    options = map_.options(found.pose_graph) | {
        "beta": beta,
        "n_times": len(found.integrity.times),
        "norm": found.integrity.norm,
    }
    document = audit_document(
        found, name=map_.dataset.title, file_format=map_.dataset.format, notes=map_.notes, options=options
    )
    if map_.merged is not None:
        document["merging"] = merging_record(map_.merged)
    return _Audited(dataset=map_.dataset, values=map_.values, diagnosis=found, document=document)


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


def _check_failures(fail_on: str | None, fail_above: float | None) -> None:
    if fail_on is not None and fail_on not in GRAVITY[1:]:
        raise InvalidOptionError(f"expected --fail-on {', '.join(GRAVITY[1:])}, got {fail_on!r}")
    if fail_above is not None and math.isnan(fail_above):
        raise InvalidOptionError("expected a number for --fail-above, got nan: no score is above that")


def _fails(document: Document, fail_on: str | None, fail_above: float | None) -> bool:
    score, level = document["summary"].get("score"), document["verdict"]["level"]
    too_high = fail_above is not None and (score == "infinite" or score > fail_above)
    return too_high or (fail_on is not None and GRAVITY.index(level) >= GRAVITY.index(fail_on))
