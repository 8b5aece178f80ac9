"""A map too large to be audited at once: in parts that overlap, each a task of its own.

1. The map is cut into boxes of keyframes, and each box taken with the surroundings (`cut`).
2. Parts find and explain overlaps, and tell each other, until no part learns anything: the fusion and collision edges
   are those of the whole map (`overlaps`).
3. Parts score keyframes, with a bound of the changes that the rest may make (`scores`).
4. The drift model, the closures' probabilities and the places hang on all ties, and stay in a single process: a closure
   at an end of a map says how far two keyframes at the other end may lie apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.diagnosis import concluded, convergence_of
from pgti_gtsam.diagnosis.records import ClosureFinding, Level, Place
from pgti_gtsam.estimate import Convergence
from pgti_gtsam.parts.cut import EdgeList, Indices, Neighbours, cores, part_of
from pgti_gtsam.parts.overlaps import Each, Overlaps, overlaps_of
from pgti_gtsam.parts.scores import COMPARED, CoreScores, LocalScores, Surroundings, core_scores, peak_mb, surroundings
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.laplacian import adjacency, connected_components

__all__ = ["ComparedInParts", "DiagnosisInParts", "PartRecord", "diagnose_parts"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartRecord:
    """Size, time and memory of a part.

    Attributes
    ----------
    n_core : int
        Keyframes that are in the core of no other part.
    n_keyframes, n_scored : int
        Keyframes of the part, and keyframes that the scores were computed with.
    seconds : float
        Of the scores.
    peak_mb : float
        Peak memory of the worker process, MB.
    """

    n_core: int
    n_keyframes: int
    n_scored: int
    seconds: float
    peak_mb: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedInParts:
    """Pose graph and free space, compared part by part.

    Attributes
    ----------
    fusion_edges, collision_edges : (f, 2), (c, 2) int
        As of the whole map, exactly.
    n_rounds : int
        How often parts were asked.
    merged_edges : (m, 2) int
        E_m: the pose graph's edges and both, not sorted.
    n_components_pose_graph : int
    scores, fusion, collisions : LocalScores
        G_p against G_m, G_p against G_e, and G_e against G_m.
    """

    fusion_edges: Indices
    collision_edges: Indices
    n_rounds: int
    merged_edges: Indices
    n_components_pose_graph: int
    scores: LocalScores
    fusion: LocalScores
    collisions: LocalScores

    @property
    def keyframe_scores(self) -> NDArray[np.float64]:
        """ζ, unknown to every part of a map: NaN, (n,)."""
        return self.scores.keyframe_scores


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DiagnosisInParts:
    """Result of `diagnose_parts`.

    Attributes
    ----------
    verdict, reason, places, closures, pose_graph, convergence, unit_m
        As in `Diagnosis`. The places' ζ is NaN, and no place of incomplete fusion is named, for ζ decides on those.
    compared : ComparedInParts
    parts : tuple of PartRecord
    seconds : dict of str to float
        Of each step.
    peak_mb : float
        Peak memory of the process that joins the results, MB.
    """

    verdict: Level
    reason: str
    places: tuple[Place, ...]
    closures: tuple[ClosureFinding, ...]
    pose_graph: PoseGraph
    compared: ComparedInParts
    convergence: Convergence | None
    unit_m: float
    parts: tuple[PartRecord, ...]
    seconds: Mapping[str, float]
    peak_mb: float


def diagnose_parts(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    *,
    parts: int,
    radii: float | Mapping[int, float] | None = None,
    edges: Collection[str] | None = None,
    min_shared_landmarks: int | None = None,
    closures: Collection[int] | None = None,
    each: Each = map,
    progress: Callable[[str], None] = lambda step: None,
) -> DiagnosisInParts:
    """Say of a large map whether it is right, where not, and how to mend it. Graph and values stay untouched.

    Verdict, places, closures' probabilities and collisions are the same as of `diagnose`. Scores are stable scores,
    with bounds; ζ and Λ ask how heat spreads over the whole map, and are left out.

    Parameters
    ----------
    graph, values, radii, edges, min_shared_landmarks, closures, progress
        As in `diagnose`.
    parts : int
        Number of parts; a part of ten thousand keyframes takes some hundred megabytes.
    each : callable
        Runs a function on every task: `map` does so in this process; `fleet.spread` gives a function that does so on a
        Dask cluster.

    Raises
    ------
    InvalidOptionError
        Fewer parts than one, or more than keyframes.
    PgtiError
        As of `diagnose`.
    """
    # the whole map, lightly
    watch = _Watch(progress)
    watch.step("adapting")
    pose_graph = from_gtsam(
        graph, values, radii=radii, edges=edges, min_shared_landmarks=min_shared_landmarks, closures=closures
    )
    n, core_of = len(pose_graph), cores(pose_graph.positions, parts)
    watch.step("checking the estimate")
    step = convergence_of(graph, values)

    # overlaps and scores, part by part
    watch.step(f"overlaps of {n} keyframes in {parts} parts")
    own, neighbours = EdgeList.of(n, pose_graph.edges), Neighbours.of(pose_graph)
    each_core = _members(core_of, parts)
    pieces = [part_of(pose_graph, own, neighbours, core) for core in each_core]
    sizes = [len(piece.vertices) for piece in pieces]
    overlaps = overlaps_of(n, pieces, each)
    del pieces, neighbours
    watch.step("scores")
    scored = list(each(core_scores, _all_surroundings(pose_graph, overlaps, each_core)))
    compared = _compared(pose_graph, overlaps, each_core, scored)

    # the whole map again
    found = concluded(graph, values, pose_graph, compared, watch.step)
    watch.step("done")
    return DiagnosisInParts(
        verdict=found.verdict,
        reason=found.reason,
        places=found.places,
        closures=found.closures,
        pose_graph=pose_graph,
        compared=compared,
        convergence=step,
        unit_m=found.unit_m,
        parts=tuple(
            PartRecord(
                n_core=len(core), n_keyframes=size, n_scored=took.n_vertices, seconds=took.seconds, peak_mb=took.peak_mb
            )
            for core, size, took in zip(each_core, sizes, scored, strict=True)
        ),
        seconds=watch.seconds,
        peak_mb=peak_mb(),
    )


class _Watch:
    """Time of each step."""

    def __init__(self, progress: Callable[[str], None]) -> None:
        self.seconds: dict[str, float] = {}
        self._progress, self._name, self._since = progress, "", time.monotonic()

    def step(self, name: str) -> None:
        """End the step before, and begin this one."""
        now = time.monotonic()
        if self._name:
            self.seconds[self._name] = round(now - self._since, 3)
        self._name, self._since = name, now
        self._progress(name)


def _members(core_of: Indices, parts: int) -> list[Indices]:
    """Keyframes of each core, ascending."""
    order = np.argsort(core_of, kind="stable")
    return np.split(order, np.searchsorted(core_of[order], np.arange(1, parts)))


def _all_surroundings(pose_graph: PoseGraph, overlaps: Overlaps, each_core: list[Indices]) -> Iterator[Surroundings]:
    """The task of each core, made on demand."""
    n, layers = len(pose_graph), (pose_graph.edges, overlaps.fusion_edges, overlaps.collision_edges)
    lists = (EdgeList.of(n, layers[0]), EdgeList.of(n, layers[1]), EdgeList.of(n, layers[2]))
    degrees = np.cumsum([np.bincount(layer.ravel(), minlength=n) for layer in layers], axis=0)
    tied = adjacency(n, np.concatenate(layers))
    for core in each_core:
        yield surroundings(core, lists, tied, degrees)


def _compared(
    pose_graph: PoseGraph, overlaps: Overlaps, each_core: list[Indices], scored: list[CoreScores]
) -> ComparedInParts:
    """The findings of all parts."""
    n = len(pose_graph)
    scores, bounds, late = np.zeros((3, n)), np.zeros((3, n)), np.zeros((3, n), dtype=bool)
    for core, found in zip(each_core, scored, strict=True):
        scores[:, core], bounds[:, core], late[:, core] = found.scores, found.bounds, found.late
    merged, fusion, collisions = (
        LocalScores(stable_scores=scores[k], bounds=bounds[k], late=late[k]) for k in range(len(COMPARED))
    )
    return ComparedInParts(
        fusion_edges=overlaps.fusion_edges,
        collision_edges=overlaps.collision_edges,
        n_rounds=overlaps.n_rounds,
        merged_edges=np.concatenate([pose_graph.edges, overlaps.fusion_edges, overlaps.collision_edges]),
        n_components_pose_graph=connected_components(n, pose_graph.edges)[0],
        scores=merged,
        fusion=fusion,
        collisions=collisions,
    )
