"""Stretches at different heights: spheres reach through floors and bridges, where no way leads.

The radius of free space comes from landmarks ahead and around. A robot on a floor knows nothing of the free space
below, and the sphere around the robot reaches through. Two passes of the same way have the same height, however far the
odometry has drifted sideways, and sensors that hold the tilt hold the height too. So the map itself shows where a
stretch passes over another. The rule asks for a body that keeps upright (`gate.upright`), for else the map's vertical
is not known, and for poses in space.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.drift.settled import Settled

LEVEL = 0.25
"""Height between two keyframes of one level, in the sum of their radii. Chosen on storeys of `scenarios.worlds`, seeds
1000 to 1004, with all ties and without any: contacts on one floor come within 0.06 in their best pair, those through
a floor not within 0.47."""

SURE = 2.0
"""Standard deviations of the drift's height that the height between two levels must exceed on top."""


def rise_m(
    settled: Settled,
    positions: NDArray[np.float64],
    radii: NDArray[np.float64],
    overlaps: NDArray[np.int64],
    pair: tuple[int, int],
    covariance: NDArray[np.float64],
) -> float:
    """Least height of the later stretch above the earlier, m, where the two are on different levels; else 0.

    Parameters
    ----------
    settled : Settled
        The drift model, which knows the body's vertical.
    positions : (n, d) float
        Of the map, m.
    radii : (n,) float, m
    overlaps : (k, 2) int
        All overlaps between the stretches.
    pair : (int, int)
        The overlap whose relative pose has the covariance.
    covariance : (d, d) float
        In the tangent space of the pair's second keyframe; NaN where nothing predicts.

    Returns
    -------
    float
        Negative where the later stretch is below; 0 for poses of the plane, and where the body does not keep upright or
        nothing predicts.
    """
    model = settled.model
    if model.units.is_planar or model.units.tilt == 1.0 or np.isnan(covariance).any():
        return 0.0
    i, j = overlaps.T
    up = np.asarray(settled.poses[pair[1]].rotation().matrix())[:, 2]
    rises = (positions[j] - positions[i]) @ up
    allowed = LEVEL * (radii[i] + radii[j]) + SURE * float(np.sqrt(covariance[-1, -1]))
    return float(rises[np.abs(rises).argmin()]) if (np.abs(rises) > allowed).all() else 0.0
