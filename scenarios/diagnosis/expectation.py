"""The truth on a map: the real contacts, the tied second passes, and so the right verdict.

A contact of a map is two stretches of track whose spheres meet although the way between them is longer than the spheres
reach. A contact is *real* if the two stretches, widened by five keyframes, come within 1.3 times the sum of their radii
in the truth, else the contact is chance. A pair of keyframes of a real contact is *tied* if a true closure lies within
ten keyframes of both, or if all true ties together hold the relative position more exactly than their spheres reach
even where odometry is poor. Where the world is known, pairs that a surface parts need no tie.

A place that a diagnosis names tells a mapper to match two stretches and to tie them, to match before believing
anything, to look at a closure, or to do nothing (`is_right`). So a second pass is named rightly if the contact is real
and some pair of its keyframes could be matched; a contact that drift or a false closure made is named rightly by any
kind without a tie to make: undecided, or a likely false closure. An undecided contact that is real is neither
right nor wrong: the mapper is told to match there, and nothing false.

"All ties together" matters. A stretch that is tied at both ends is held like a beam that is clamped at both: the
middle gives less than half of the play that either end alone would leave, let alone one end by the shortest way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from scenarios.diagnosis.damage import Case
from scenarios.diagnosis.held import Held
from scenarios.diagnosis.stretches import REAL_WITHIN, Pairs, grouped, nearest, stretches
from scenarios.worlds.solid import Array

BESIDE = 10
"""Keyframes on either stretch within which a closure ties. What nearer neighbours on the track see in common is what
the odometry is made of, and no tie of its own."""

LOOSE = 1.0
"""Standard deviation of poor odometry, in the sum of the radii, beyond which a second pass is not tied."""

ASKED = 12
"""Pairs at most of every contact that are asked for their ties."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expectation:
    """The truth on a map.

    Attributes
    ----------
    verdict : {"consistent", "incomplete", "inconsistent"}
    n_real, n_chance, n_untied : int
        Contacts of the map; the untied contacts are real, and in sight of each other.
    loosest : float
        Largest standard deviation that the ties leave to the two stretches of a real contact that no closure ties near
        by, in the sum of the radii; 0 without any.
    nearest_chance : float
        Smallest true distance of the two stretches of a chance contact, in the sum of their radii;
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
    """The verdict that is right of a map, by the truth.

    Parameters
    ----------
    case : Case
    pose_graph : PoseGraph
    """
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


def is_right(kind: str, *, is_real: bool, can_be_tied: bool) -> bool | None:
    """Whether the kind of a place is right; None where the diagnosis leaves a real contact open.

    Parameters
    ----------
    kind : str
        One of `pgti_gtsam.diagnosis.records.Kind`.
    is_real : bool
        Whether its stretches run through the same space in truth.
    can_be_tied : bool
        Whether some pair of its keyframes could be matched: see `can_be_matched`.
    """
    if kind == "undecided contact":
        return None if is_real else True
    if kind == "likely false closure":
        return not is_real
    if kind == "different view":
        return not can_be_tied
    return is_real and (can_be_tied or kind == "incomplete fusion")


def can_be_matched(case: Case, pairs: Pairs) -> bool:
    """Whether no surface parts some pair of keyframes in truth; where the world is not known, yes.

    Parameters
    ----------
    case : Case
    pairs : (k, 2) int
    """
    return bool(len(_in_sight(case, pairs)))


def _contacts(case: Case, pose_graph: PoseGraph) -> list[Pairs]:
    """Overlaps of the map that the way between does not bring, by contact."""
    radii = pose_graph.radii
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(case.places, axis=0), axis=1))])
    reach = radii[:, None] + radii
    touching = np.argwhere((cdist(pose_graph.positions, pose_graph.positions) <= reach) & (way - way[:, None] > reach))
    return grouped(touching)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ties:
    """True ties of a map: the closures, and how all closures hold the map together."""

    closures: Pairs
    held: Held
    radii: Array

    @classmethod
    def of(cls, case: Case, pose_graph: PoseGraph) -> _Ties:
        false = _false_pairs(case, pose_graph)
        steps = _measured(pose_graph, false, odometry=True)
        closures = _measured(pose_graph, false, odometry=False)
        far = closures[np.diff(closures, axis=1)[:, 0] > BESIDE]
        unit = float(np.median(pose_graph.radii[pose_graph.radii > 0]))
        axes = np.ptp(case.places, axis=0) > 0  # a drive in the plane knows no height,
        axes[:2] = True  # but a straight one turns too
        held = Held.by(case.places[:, axes] / unit, steps, far)
        return cls(closures=closures, held=held, radii=pose_graph.radii / unit)

    def looseness(self, pairs: Pairs) -> float:
        """Largest standard deviation between pairs that no closure ties near by, in units of the spheres' reach."""
        near = (np.abs(self.closures[:, None] - pairs) <= BESIDE).all(axis=2).any(axis=0)
        far = pairs[~near]
        return float((self.held.deviations(far) / self.radii[far].sum(axis=1)).max(initial=0.0))


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
