"""Where to look again: the new tie that would lower the integrity score most (section 8 of the paper)."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.integrity import relative_distortion, time_grid
from pgti_gtsam.places import WINDOW
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.heat_kernel import HeatKernel, heat_kernels
from pgti_gtsam.spectral.laplacian import connected_components
from pgti_gtsam.spectral.one_edge import OneMoreEdge
from pgti_gtsam.support_graph import support_graph

Pairs = NDArray[np.int64]

TOLERANCE = 1e-10
"""Error of the graph's signatures relative to the largest. A tie raises λ₂ and lowers the late ones, by 1e-4 at most on
the paper's grid, which ends at 4 ln 10 / λ₂ of the merged graph; so that those of the tied graph are good to 1e-6."""

N_WITNESSES = 8
"""Keyframes at which every tie is tried first: those with the largest ζ, each `WINDOW` keyframes from the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NewTie:
    """A tie that the pose graph does not have, between two keyframes whose spheres meet.

    Attributes
    ----------
    keyframes : (int, int)
        Indices, the earlier first.
    keys : (int, int)
    score, score_before : float
        Λ with the tie and without any.
    """

    keyframes: tuple[int, int]
    keys: tuple[int, int]
    score: float
    score_before: float


def best_revisits(pose_graph: PoseGraph, count: int = 10, *, n_times: int = 100, norm: int = 2) -> list[NewTie]:
    """Rank the ties that a robot could still make by how far each lowers Λ.

    Candidates are the inserted edges: the space connects the two keyframes, so that a second look can tie
    them. The tie joins G_p; the merged graph has the edge already, so neither the signatures of G_m nor the times
    change. Every candidate costs a sweep over the factors of G_p (a low-rank update), and is bounded from below by the
    ζ of the keyframes that are worst now; candidates are computed in full in the order of their bounds, until
    enough are better than every remaining bound. The result equals that of trying all candidates.

    Parameters
    ----------
    pose_graph : PoseGraph
    count : int
        Ties wanted. A tie with both ends within `places.WINDOW` keyframes of a better tie is left out:
        the two are the same revisit.
    n_times, norm : int
        As for `assess`.

    Returns
    -------
    list of NewTie
        Lowest Λ first, and only ties that lower Λ; empty where the graph lacks no edge. Where the pose graph falls
        into parts only ties that join parts are tried, each by a new factorisation: until the graph is connected,
        nothing else counts.

    Raises
    ------
    InvalidOptionError
        `count` below one.
    """
    if count < 1:
        raise InvalidOptionError(f"expected a count of at least 1, got {count}")
    support = support_graph(pose_graph)
    ties, n = support.inserted_edges, len(pose_graph)
    if not len(ties):
        return []

    # what they are measured by
    before, after = heat_kernels(n, pose_graph.edges, support.merged_edges)
    target = _Target.of(before, after, n_times, norm)

    # the best ones; between parts of a map each by itself
    n_parts, labels = connected_components(n, pose_graph.edges)
    if n_parts > 1:
        joining = ties[labels[ties[:, 0]] != labels[ties[:, 1]]]
        ranked = _tried(pose_graph, joining, target, count)
    else:
        ranked = _searched(OneMoreEdge.of(n, pose_graph.edges, target.times, TOLERANCE), ties, target, count)

    # those that help
    score_before = float(target.scores.max())
    return [
        NewTie(
            keyframes=(int(i), int(j)),
            keys=(int(pose_graph.keys[i]), int(pose_graph.keys[j])),
            score=score,
            score_before=score_before,
        )
        for score, (i, j) in ranked
        if score < score_before
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Target:
    """The merged graph against which a tied pose graph is scored, and ζ before any tie."""

    times: NDArray[np.float64]
    signatures: NDArray[np.float64]
    scores: NDArray[np.float64]
    norm: int

    @classmethod
    def of(cls, before: HeatKernel, after: HeatKernel, n_times: int, norm: int) -> _Target:
        times = time_grid(after, n_times)
        signatures = after.signatures(times)
        scores = relative_distortion(before.signatures(times), signatures, norm)
        return cls(times=times, signatures=signatures, scores=scores, norm=norm)

    def score(self, tied: NDArray[np.float64], vertices: Pairs) -> float:
        """Largest ζ at given vertices of a graph with these signatures."""
        return float(relative_distortion(tied, self.signatures[vertices], self.norm).max())

    def witnesses(self) -> Pairs:
        """The worst keyframes, apart from each other."""
        found: list[int] = []
        for vertex in np.argsort(-self.scores, kind="stable").tolist():
            if all(abs(vertex - other) > WINDOW for other in found):
                found.append(vertex)
            if len(found) == N_WITNESSES:
                break
        return np.array(found, dtype=np.int64)


def _searched(graph: OneMoreEdge, ties: Pairs, target: _Target, count: int) -> list[tuple[float, Pairs]]:
    """The best ties by their scores: bounds first, the full score where a bound leads."""
    some, every = target.witnesses(), np.arange(len(target.scores))
    bounds = [target.score(tied, some) for tied in graph.signatures(ties, some)]
    heap = [(bound, k, False) for k, bound in enumerate(bounds)]
    heapq.heapify(heap)
    found: list[tuple[float, Pairs]] = []
    while heap and len(found) < count:
        score, k, is_full = heapq.heappop(heap)
        if any((np.abs(ties[k] - other) <= WINDOW).all() for _, other in found):
            continue
        if is_full:
            found.append((score, ties[k]))
            continue
        (tied,) = graph.signatures(ties[[k]], every)
        heapq.heappush(heap, (target.score(tied, every), k, True))
    return found


def _tried(pose_graph: PoseGraph, ties: Pairs, target: _Target, count: int) -> list[tuple[float, Pairs]]:
    """The best ties by factorising the graph with each tie."""
    n, every, found = len(pose_graph), np.arange(len(pose_graph)), []
    for tie in ties:
        (kernel,) = heat_kernels(n, np.concatenate([pose_graph.edges, tie[None]]))
        found.append((target.score(kernel.signatures(target.times), every), tie))
    found.sort(key=lambda each: each[0])
    kept: list[tuple[float, Pairs]] = []
    for score, tie in found:
        if len(kept) < count and not any((np.abs(tie - other) <= WINDOW).all() for _, other in kept):
            kept.append((score, tie))
    return kept
