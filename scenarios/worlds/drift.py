"""Odometry that drifts: a random walk, a bias in heading that no model mentions, for a camera a scale that walks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import gtsam
import numpy as np

from scenarios.worlds.solid import Array

WALK = np.array([0.0005, 0.0005, 0.003, 0.03, 0.02, 0.01])
"""Standard deviations after one metre, in GTSAM's order: roll, pitch, yaw in rad, forward, left, up in m."""

BIAS = 0.0004
"""Of the heading bias, which is drawn once for each drive: rad per metre."""

SCALE = 0.003
"""Of the logarithm of the scale, after one metre."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Odometry:
    """What was measured: (n - 1) steps, the (n,) scale at every keyframe, and (6,) sigmas of a step's noise."""

    steps: list[gtsam.Pose3]
    scales: Array
    sigmas: Array

    def chained(self, start: gtsam.Pose3) -> list[gtsam.Pose3]:
        """Poses that the steps lead to."""
        return list(accumulate(self.steps, gtsam.Pose3.compose, initial=start))


def odometry(truth: Sequence[gtsam.Pose3], random: np.random.Generator, *, planar: bool, scaled: bool) -> Odometry:
    """Steps between true poses as they are measured; in the plane nothing rolls, pitches or climbs."""
    step_m = float(np.median([a.range(b) for a, b in pairwise(truth)]))
    sigmas = WALK * np.sqrt(step_m) * (np.array([0, 0, 1, 1, 1, 0]) if planar else 1)
    bias = np.array([0, 0, random.normal(0.0, BIAS) * step_m, 0, 0, 0])
    here = gtsam.Similarity3()
    steps, scales = [], [1.0]
    for one, other in pairwise(truth):
        moved = one.between(other).compose(gtsam.Pose3.Expmap(random.normal(0.0, sigmas) + bias))
        growth = float(np.exp(random.normal(0.0, SCALE * np.sqrt(step_m)))) if scaled else 1.0
        there = here * gtsam.Similarity3(moved.rotation(), moved.translation() / growth, growth)
        steps.append(_pose(here).between(_pose(there)))
        scales.append(there.scale())
        here = there
    return Odometry(steps=steps, scales=np.array(scales), sigmas=sigmas)


def _pose(similarity: gtsam.Similarity3) -> gtsam.Pose3:
    """Where a similarity puts a body and its axes; it maps x to s (R x + t)."""
    return gtsam.Pose3(similarity.rotation(), similarity.scale() * similarity.translation())
