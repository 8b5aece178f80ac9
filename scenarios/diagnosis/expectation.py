"""What the truth says of a map: which contacts are real, which second passes are tied, and so what a verdict should be.

A contact of a map is two stretches of track whose spheres meet although the way between them is longer than the spheres
reach. It is *real* if the two stretches, widened by five keyframes, come within 1.3 times the sum of their radii in the
truth, else it is chance. A pair of keyframes of a real contact is *tied* if a true closure lies within ten keyframes
of both, or if even poor odometry would carry the relative position from one to the other along the shortest way of
true ties more exactly than their spheres reach. Where the world is known, pairs that a surface parts need no tie.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial.distance import cdist

from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from scenarios.diagnosis.damage import Case
from scenarios.diagnosis.stretches import REAL_WITHIN, Pairs, grouped, nearest, stretches
from scenarios.worlds.solid import Array

BESIDE = 10
"""Keyframes on either stretch within which a closure ties."""

LOOSE = 1.0
"""Standard deviation of poor odometry, in the sum of the radii, beyond which a second pass is not tied."""

ASKED = 12
"""Pairs at most of every contact that are asked for their ties."""

POOR, MATCH, MATCH_RAD = 0.03, 0.125, 0.075
"""Standard deviations of poor odometry after one ρ, in ρ and rad, and of a closure, in ρ and in rad; ρ is the median
radius. The package grants the same: a map is tied if it need not be trusted further than that."""

LEAST_STEP = 0.05
"""Least length of a step, in ρ."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expectation:
    """What the truth says.

    Attributes
    ----------
    verdict : {"consistent", "incomplete", "inconsistent"}
    n_real, n_chance, n_untied : int
        Contacts of the map; the untied ones are real, and in sight of each other.
    loosest : float
        Largest standard deviation of poor odometry along the ties between the two stretches of a real contact that no
        closure ties near by, in the sum of the radii; 0 without any.
    nearest_chance : float
        How near in truth, in the sum of their radii, the two stretches of a chance contact come that come nearest;
        infinite without any.
    gaps : (n, n) float
        True distances of the keyframes in the sum of their radii.
    """

    verdict: str
    n_real: int
    n_chance: int
    n_untied: int
    loosest: float
    nearest_chance: float
    gaps: Array


def expected(case: Case, pose_graph: PoseGraph) -> Expectation:
    """The verdict that is right of a map, by the truth."""
    radii = pose_graph.radii
    gaps = cdist(case.places, case.places) / np.maximum(radii[:, None] + radii, np.finfo(float).tiny)
    ties, contacts = _Ties.of(case, pose_graph), _contacts(case, pose_graph)
    apart = np.array([nearest(gaps, stretches(pairs)) for pairs in contacts])
    real = [pairs for pairs, gap in zip(contacts, apart, strict=True) if gap <= REAL_WITHIN]
    seen = [pairs for pairs in (_in_sight(case, pairs) for pairs in real) if len(pairs)]
    loose = [ties.looseness(_some(pairs)) for pairs in seen]
    n_untied, n_chance = sum(value > LOOSE for value in loose), len(contacts) - len(real)
    verdict = "inconsistent" if n_chance or case.false_slots else "incomplete" if n_untied else "consistent"
    return Expectation(
        verdict=verdict,
        n_real=len(real),
        n_chance=n_chance,
        n_untied=n_untied,
        loosest=max(loose, default=0.0),
        nearest_chance=float(apart[apart > REAL_WITHIN].min(initial=np.inf)),
        gaps=gaps,
    )


def _contacts(case: Case, pose_graph: PoseGraph) -> list[Pairs]:
    """Overlaps of the map that the way between them does not bring, by contact."""
    radii = pose_graph.radii
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(case.places, axis=0), axis=1))])
    reach = radii[:, None] + radii
    touching = np.argwhere((cdist(pose_graph.positions, pose_graph.positions) <= reach) & (way - way[:, None] > reach))
    return grouped(touching)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ties:
    """True ties of a map: its closures, and the net of all with their lengths in ρ."""

    closures: Pairs
    closing: frozenset[tuple[int, int]]
    net: sparse.csr_array
    places: Array
    reach: Array

    @classmethod
    def of(cls, case: Case, pose_graph: PoseGraph) -> _Ties:
        false = _false_pairs(case, pose_graph)
        closures = _measured(pose_graph, false, odometry=False)
        ties = np.concatenate([_measured(pose_graph, false, odometry=True), closures])
        unit = float(np.median(pose_graph.radii[pose_graph.radii > 0]))
        lengths = np.linalg.norm(np.diff(case.places[ties], axis=1)[:, 0], axis=1) / unit
        n = len(pose_graph)
        net = sparse.coo_array((np.maximum(lengths, LEAST_STEP), ties.T), shape=(n, n)).tocsr()
        closing = frozenset((i, j) for i, j in closures.tolist())
        return cls(
            closures=closures, closing=closing, net=net, places=case.places / unit, reach=pose_graph.radii / unit
        )

    def looseness(self, pairs: Pairs) -> float:
        """Largest standard deviation between pairs that no closure ties near by, in what their spheres reach."""
        far = [pair for pair in pairs.tolist() if not (np.abs(self.closures - pair) <= BESIDE).all(axis=1).any()]
        if not far:
            return 0.0
        starts = np.array(far)[:, 0]
        _, before = csgraph.dijkstra(self.net, directed=False, indices=starts, return_predecessors=True)
        found = [_along(self.places, row, pair, self.closing) for row, pair in zip(before, far, strict=True)]
        return float((np.array(found) / self.reach[far].sum(axis=1)).max())


def _along(places: Array, before: NDArray[np.int32], pair: list[int], closing: frozenset[tuple[int, int]]) -> float:
    """Standard deviation of the position of j seen from i along a way of ties, in ρ: Σ σ² (1 + lever²)."""
    i, j = pair
    squares, here = 0.0, j
    while here != i:
        there = int(before[here])
        if there < 0:
            return np.inf
        lever = float(np.square(places[here] - places[j]).sum())
        if (min(here, there), max(here, there)) in closing:
            squares += MATCH**2 + MATCH_RAD**2 * lever
        else:
            squares += POOR**2 * max(float(np.linalg.norm(places[here] - places[there])), LEAST_STEP) * (1 + lever)
        here = there
    return float(np.sqrt(squares))


def _measured(pose_graph: PoseGraph, false: Pairs, *, odometry: bool) -> Pairs:
    """Edges that measure, without the false closures: steps of the track, or all others."""
    sources = pose_graph.edge_sources
    measured = sources & (EdgeSource.BETWEEN | EdgeSource.COVISIBILITY) > 0
    edges = pose_graph.edges[measured & ((sources & EdgeSource.ODOMETRY > 0) == odometry)]
    n = len(pose_graph)
    return edges[~np.isin(edges[:, 0] * n + edges[:, 1], false[:, 0] * n + false[:, 1])]


def _false_pairs(case: Case, pose_graph: PoseGraph) -> Pairs:
    keys = [sorted(case.graph.at(slot).keys()) for slot in case.false_slots]
    return np.searchsorted(pose_graph.keys, np.array(keys, dtype=np.uint64).reshape(-1, 2)).astype(np.int64)


def _in_sight(case: Case, pairs: Pairs) -> Pairs:
    """Pairs that no surface parts; all where the world is not known."""
    i, j = pairs.T
    return pairs if case.solid is None else pairs[~case.solid.parts(case.places[i], case.places[j])]


def _some(pairs: Pairs) -> Pairs:
    return pairs[np.unique(np.linspace(0, len(pairs) - 1, ASKED).round().astype(int))]
