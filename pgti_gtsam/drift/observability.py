"""Directions in which factors leave a pose open: the null space of their Jacobian."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

OPEN = 1e-6
"""Information along a direction, in parts of the largest, below which the direction is open: a landmark seen by bearing
and range leaves the way around it open, two points leave the turn about the line between them, a range all but its own
direction."""


def open_directions(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, key: int, lengths: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Orthonormal directions of a pose about which no factor says anything, (d, k); None where there are none.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        The factors.
    values : gtsam.Values
    key : int
        Of the pose; the other variables are fixed.
    lengths : (d,) float
        Units in which translations and rotations compare, in GTSAM's order.
    """
    ordering = gtsam.Ordering()
    for each in [key, *sorted(set(graph.keyVector()) - {key})]:
        ordering.push_back(each)
    jacobian, _ = graph.linearize(values).jacobian(ordering)
    own = jacobian[:, : len(lengths)] * lengths
    information, axes = np.linalg.eigh(own.T @ own)
    is_open = information <= OPEN * information[-1]
    return axes[:, is_open] if is_open.any() else None
