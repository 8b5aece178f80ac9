"""Pairs of keyframes by their positions on the track: independent of the package's own grouping."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import KDTree

from scenarios.worlds.solid import Array

NEIGHBOURS = 5
"""Keyframes between one pair and the next, on either stretch, that belong together."""

WIDENED, REAL_WITHIN = 5, 1.3
"""Keyframes by which stretches are widened, and how near they come in truth, in the sum of their radii."""

Pairs = NDArray[np.int64]
Stretches = tuple[tuple[int, int], tuple[int, int]]


def grouped(pairs: Pairs) -> list[Pairs]:
    """Pairs that lead from neighbour to neighbour on both stretches, together: (k, 2) int each."""
    if not len(pairs):
        return []
    near = KDTree(pairs).query_pairs(NEIGHBOURS, p=np.inf, output_type="ndarray")
    links = sparse.coo_array((np.ones(len(near)), near.T.astype(np.int64)), shape=(len(pairs), len(pairs)))
    group = csgraph.connected_components(links, directed=False)[1]
    return np.split(pairs[np.argsort(group, kind="stable")], np.cumsum(np.bincount(group))[:-1])


def stretches(pairs: Pairs) -> Stretches:
    """First and last keyframe of either stretch."""
    (a, c), (b, d) = pairs.min(axis=0).tolist(), pairs.max(axis=0).tolist()
    return (a, b), (c, d)


def nearest(gaps: Array, ends: Stretches) -> float:
    """How near two stretches, widened, come in truth; `gaps` are true distances in the sum of the radii, (n, n).

    Parameters
    ----------
    gaps : (n, n) float
        True distances in the sum of the radii.
    ends : Stretches
    """
    (a, b), (c, d) = ((max(first - WIDENED, 0), last + WIDENED + 1) for first, last in ends)
    return float(gaps[a:b, c:d].min())


def is_real(gaps: Array, ends: Stretches) -> bool:
    """Whether two stretches run through the same space in truth.

    Parameters
    ----------
    gaps : (n, n) float
        True distances in the sum of the radii.
    ends : Stretches
    """
    return nearest(gaps, ends) <= REAL_WITHIN


def any_chance(gaps: Array, pairs: Pairs) -> bool:
    """Whether some pair is of keyframes that are apart in truth.

    Parameters
    ----------
    gaps : (n, n) float
        True distances in the sum of the radii.
    pairs : (k, 2) int
    """
    return any(not is_real(gaps, ((i, i), (j, j))) for i, j in pairs.tolist())
