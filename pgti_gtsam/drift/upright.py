"""The axis of the body that stays vertical, and how fast the odometry's tilt drifts: read from the odometry itself.

A wheeled robot stays level, a hand-held camera nearly so, a drone comes back to level; an accelerometer holds tilt
where nothing holds heading. The chained odometry shows it: the body axis whose direction in the world changes least,
and how far that direction wanders from one end of a drive to the other. Tilt of the body itself adds to errors of the
odometry, so that the median change, which ramps do not move, is a bound on the drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

LEAST_TILT = 0.05
"""Least drift of the tilt in parts of the heading's: a bound from one drive is not trusted beyond."""

PAIRS = 20
"""Least number of pairs of keyframes that a bound is taken from."""

MEDIAN = float(2 * np.log(2))
"""Median of χ² with two degrees of freedom."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Upright:
    """The body's vertical.

    Attributes
    ----------
    levelling : gtsam.Rot3
        Turns the z axis into the body's vertical: a pose T becomes T Q, with the z axis there.
    tilt : float
        Standard deviation of the tilt's drift in parts of that of an odometry that nothing levels, at most 1.
    """

    levelling: gtsam.Rot3
    tilt: float


def upright(rotations: Array, gathered: Array, chains: NDArray[np.int64]) -> Upright:
    """The vertical of a body, from the odometry.

    Parameters
    ----------
    rotations : (n, 3, 3) float
        World from body, chained from the first keyframe of each chain.
    gathered : (n,) float
        Variance of the heading that an odometry without levelling has gathered since then, rad².
    chains : (n,) int
        Number of each keyframe's chain.

    Returns
    -------
    Upright
        Without a tilt that is held, the body's own axes and 1.
    """
    # the axis whose mean direction in the world is longest, in each chain
    means = [(float((chains == c).sum()), rotations[chains == c].mean(axis=0)) for c in np.unique(chains)]
    axis = np.linalg.eigh(np.sum([n * mean.T @ mean for n, mean in means], axis=0))[1][:, -1]

    # how far it wanders over the longest gap of which there are enough
    tilt = np.sqrt(min(_wandered(rotations @ axis, gathered, chains), 1.0))
    if tilt == 1.0:
        return Upright(levelling=gtsam.Rot3(), tilt=1.0)
    return Upright(levelling=_turning(axis), tilt=max(float(tilt), LEAST_TILT))


def chained(
    n: int, pairs: NDArray[np.int64], steps: Sequence[gtsam.Pose3], variances: Array
) -> tuple[Array, Array, NDArray[np.int64]]:
    """The vertical, from the steps of the odometry in any order, i < j; each keyframe follows the latest earlier.

    Parameters
    ----------
    n : int
        Number of keyframes.
    pairs : (m, 2) int
    steps : sequence of m gtsam.Pose3
    variances : (m,) float
        That each step gathers.
    """
    before = {}
    for k in np.lexsort((pairs[:, 0], pairs[:, 1])).tolist():
        before[int(pairs[k, 1])] = k
    turned, gathered, chains = [gtsam.Rot3()] * n, np.zeros(n), np.arange(n)
    for j, k in sorted(before.items()):
        i = int(pairs[k, 0])
        turned[j], gathered[j] = turned[i].compose(steps[k].rotation()), gathered[i] + variances[k]
        chains[j] = chains[i]
    return np.array([rotation.matrix() for rotation in turned]), gathered, chains


def _wandered(pointed: Array, gathered: Array, chains: NDArray[np.int64]) -> float:
    """Median square of a direction's change in parts of the variance gathered; infinite where nothing tells."""
    gap = len(pointed) // 2
    while gap:
        changes = np.square(pointed[gap:] - pointed[:-gap]).sum(axis=1)
        more = gathered[gap:] - gathered[:-gap]
        known = (chains[gap:] == chains[:-gap]) & (more > 0)
        if known.sum() >= PAIRS:
            return float(np.median(changes[known] / more[known]) / MEDIAN)
        gap //= 2
    return np.inf


def _turning(axis: Array) -> gtsam.Rot3:
    """The shortest turn that takes the z axis to an axis or its opposite, whichever is nearer."""
    axis = axis * (1.0 if axis[2] >= 0 else -1.0)
    turn = np.array([-axis[1], axis[0], 0.0])
    sine = float(np.linalg.norm(turn))
    return gtsam.Rot3.Expmap(turn / max(sine, 1e-12) * np.arctan2(sine, axis[2]))
