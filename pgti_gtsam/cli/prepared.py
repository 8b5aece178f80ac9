"""A map on the command line before its audit: read, optimised if wanted, with its radii."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.cli.options import MapFiles, read_map, split_names
from pgti_gtsam.datasets import Dataset, read_links
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.merging import Merged, merge
from pgti_gtsam.places import tied_radius_m
from pgti_gtsam.plain_text import visible
from pgti_gtsam.pose_graph import PoseGraph

AnyRadius = Annotated[
    str | None,
    typer.Option(
        metavar="METRES|auto",
        help="Free distance around every keyframe; auto: the median distance of keyframes that closures tie.",
    ),
]
Links = Annotated[
    Path | None,
    typer.Option(help="With --one-map: g2o edges between the maps, each judged before it fuses anything."),
]
Optimise = Annotated[bool, typer.Option("--optimise", help="Audit the optimum of the graph, not the stored estimate.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """A map to be audited.

    Attributes
    ----------
    dataset : Dataset
    values : gtsam.Values
        As stored, or the optimum.
    notes : tuple of str
        What a reader of the audit should know.
    arguments : mapping
        Of `from_gtsam`.
    settings : mapping
        Options as given.
    merged : Merged or None
        What became of the links between maps.
    """

    dataset: Dataset
    values: Any
    notes: tuple[str, ...]
    arguments: Mapping[str, Any]
    settings: Mapping[str, Any]
    merged: Merged | None = None

    def options(self, pose_graph: PoseGraph) -> dict[str, Any]:
        """The settings of the audit, with what the adapter chose by itself."""
        adapted = pose_graph.adaptation
        return {
            **self.settings,
            "edges": list(adapted.edges) if adapted else [],
            "min_shared_landmarks": adapted.min_shared_landmarks if adapted else self.arguments["min_shared_landmarks"],
        }


def prepared(
    files: MapFiles,
    radius: str | None,
    cloud: Path | None,
    edges: str | None,
    min_shared_landmarks: int | None,
    *,
    optimise: bool,
    stage: Callable[[str], None],
    links: Path | None = None,
) -> Prepared:
    """Read, optimise, find the radius: the steps of every command that audits a map.

    Parameters
    ----------
    files, radius, cloud, edges, min_shared_landmarks, optimise, links
        As the command line has them.
    stage : callable
        Told of each step.
    """
    # the map, or its optimum
    stage("reading")
    metres = None if radius in (None, "auto") else _metres(str(radius))
    dataset, radii = read_map(files, metres, cloud)
    notes, merged = list(dataset.notes), None
    if links is not None:
        stage("judging links")
        if radius == "auto":
            raise InvalidOptionError("expected --radius METRES with --links, got auto: closures tell it after merging")
        dataset, merged = _merged(dataset, links, radii)
        notes += [f"the optimum of the maps with the links that passed is audited: {links.name}"]
    best = dataset.values
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
    return Prepared(
        dataset=dataset,
        values=best,
        notes=tuple(notes),
        arguments={"radii": radii, **adaptation},
        merged=merged,
        settings={
            "radius": radius if metres is None else metres,
            "cloud": None if cloud is None else visible(cloud.name),
            "optimise": optimise,
        },
    )


def _merged(dataset: Dataset, links: Path, radii: Any) -> tuple[Dataset, Merged]:
    """The maps of a dataset, joined by the links that pass."""
    found = merge(dataset.graph, dataset.values, read_links(links, dataset), radii, closures=dataset.closures)
    return replace(dataset, graph=found.graph, values=found.values, closures=found.closures), found


def _metres(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidOptionError(f"expected metres or auto for --radius, got {text!r}") from None
