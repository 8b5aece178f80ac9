"""The common view of two keyframes by their landmarks: spheres know nothing of walls, nor of a camera's direction.

A keyframe's own landmarks say where the keyframe looks and how far. A landmark of another keyframe is *in view* if
an own landmark lies in about the same direction (else the keyframe looks elsewhere, or nothing is known there) and
not much nearer (else a surface hides the landmark, or the landmark is out of range). Constants are chosen on the
ray-cast storeys and campus, seeds 1000 to 1003, cameras of 100° and 50°, intact, with a revisit dropped and on odometry
alone, of contacts between which the drift is small. Of contacts that no camera can tie, each pair being parted by a
surface or looking more than 60° apart, no pair sees more than 0.63 of each other's; of contacts that a camera can tie
the best pair sees 0.77 at least. The worse of the two counts: through a floor, either keyframe can have nine tenths of
the other's landmarks in view and itself look elsewhere. Where the drift allows more than the spheres reach the rule is
not asked: 5 of 6 contacts that drift made have no common view either.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pgti_gtsam.adapter import MIN_SHARED_LANDMARKS
from pgti_gtsam.sightings import Sightings

BESIDE_RAD = float(np.radians(20))
"""Angle between two directions that are about the same, rad."""

BEHIND = 1.2
"""Distance of a landmark, in that of the own one beside it, beyond which a surface hides it."""

COMMON = 0.7
"""Share of the other's landmarks that both must have in view to have a view in common."""

ASKED = 200
"""Pairs at most of a contact that are asked."""


def without_common_view(sightings: Sightings, positions: NDArray[np.float64], pairs: NDArray[np.int64]) -> bool:
    """Whether no pair of keyframes has a view in common.

    Keyframes that see fewer landmarks than connect two keyframes tell no field of view, and are not asked.

    Parameters
    ----------
    sightings : Sightings
    positions : (n, 3) float, m
    pairs : (k, 2) int

    Returns
    -------
    bool
        False if no pair can be asked.
    """
    # landmarks of the keyframes that are asked
    some = pairs[np.unique(np.linspace(0, len(pairs) - 1, ASKED).round().astype(int))]
    seen = _landmarks_of(sightings, np.unique(some))
    asked = [(i, j) for i, j in some.tolist() if min(len(seen[i]), len(seen[j])) >= MIN_SHARED_LANDMARKS]

    # what each sees of the other's
    shares = [min(_in_view(positions[i], seen[i], seen[j]), _in_view(positions[j], seen[j], seen[i])) for i, j in asked]
    return bool(asked) and max(shares) < COMMON


def _landmarks_of(sightings: Sightings, keyframes: NDArray[np.int64]) -> dict[int, NDArray[np.float64]]:
    """Positions of the landmarks that each keyframe sees, (l, 3) m."""
    incidence = sightings.incidence()
    ends, landmarks = incidence.indptr, incidence.indices
    points = {int(k): sightings.landmark_positions[landmarks[ends[k] : ends[k + 1]]] for k in keyframes}
    return {k: own[np.isfinite(own).all(axis=1)] for k, own in points.items()}


def _in_view(centre: NDArray[np.float64], own: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Share of points that a keyframe could see, judged by the keyframe's own points."""
    (directions, depths), (towards, distances) = _seen_from(centre, own), _seen_from(centre, others)
    chords, nearest = KDTree(directions).query(towards)
    beside = chords <= 2 * np.sin(BESIDE_RAD / 2)
    return float((beside & (distances <= BEHIND * depths[nearest])).mean())


def _seen_from(
    centre: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors to points, (l, 3), and their distances, (l,) m."""
    away = points - centre
    distances = np.linalg.norm(away, axis=1)
    return away / np.maximum(distances, np.finfo(float).tiny)[:, None], distances
