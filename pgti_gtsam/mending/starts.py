"""Where to start an alignment: poses spread over the region that the drift model leaves."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

EXTENT = 2.0
"""Standard deviations of the prediction that starts are spread over, to either side."""

SPACING, SPACING_RAD = 4 / 3, float(np.radians(20))
"""Distance in ρ and angle between starts: as far as points are matched at first, and what generalised ICP turns by."""

MOST = 500
"""Most starts. Where the region asks for more they are spread over less of it."""

Array = NDArray[np.float64]


def starts(predicted: Any, covariance: Array, unit_m: float) -> list[Any]:
    """The predicted pose, and poses about it along the axes of its covariance, the most probable first.

    Parameters
    ----------
    predicted : gtsam.Pose2 or gtsam.Pose3
    covariance : (d, d) float
        In the tangent space, in GTSAM's order.
    unit_m : float
        ρ.
    """
    # axes on which a start is a step: standard deviations in units of the spacing
    d = len(covariance)
    turning = np.array([False, False, True] if d == 3 else [True] * 3 + [False] * 3)
    spacing = np.where(turning, SPACING_RAD, SPACING * unit_m)
    squares, axes = np.linalg.eigh(covariance / np.outer(spacing, spacing))
    reach = EXTENT * np.sqrt(np.maximum(squares, 0.0))

    # as many as fit, the farthest axis shortened first
    counts = np.floor(reach + 0.5).astype(int)
    while np.prod(2 * counts + 1) > MOST:
        counts[np.argmax(counts)] -= 1
    steps = np.array(list(product(*(range(-n, n + 1) for n in counts.tolist()))), dtype=float)
    order = np.argsort((steps**2 / np.maximum(squares, 1e-12)).sum(axis=1), kind="stable")
    return [predicted.retract(spacing * (axes @ step)) for step in steps[order]]
