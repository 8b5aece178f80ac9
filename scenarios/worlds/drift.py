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
    """The measurements: (n - 1) steps, the (n,) scale at every keyframe, and (6,) sigmas of a step's noise."""

    steps: list[gtsam.Pose3]
    scales: Array
    sigmas: Array

    def chained(self, start: gtsam.Pose3) -> list[gtsam.Pose3]:
        """Poses that the steps lead to."""
        return list(accumulate(self.steps, gtsam.Pose3.compose, initial=start))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors:
    """How odometry errs.

    Attributes
    ----------
    walk : float
        Random walk and scale, in `WALK` and `SCALE`.
    bias : float
        Standard deviation of the heading bias, in `BIAS`.
    longer : float
        Part by which all steps are too long.
    slips : float
        Slips in a hundred steps: the next `SLIPPING` steps are measured `SLIPPED` times as long.
    bad_steps : float
        Of a hundred steps, those with an error of `BAD` beyond all others.
    """

    walk: float = 1.0
    bias: float = 1.0
    longer: float = 0.0
    slips: float = 0.0
    bad_steps: float = 0.0


USUAL = Errors()

KINDS = {
    "no drift": Errors(walk=0.0, bias=0.0),
    "half the drift": Errors(walk=0.5, bias=0.5),
    "the drift": USUAL,
    "twice the drift": Errors(walk=2.0, bias=2.0),
    "thrice the drift": Errors(walk=3.0, bias=3.0),
    "slips": Errors(slips=1.0),
    "bad steps": Errors(bad_steps=0.5),
    "another bias": Errors(bias=5.0, longer=0.03),
}
"""What a table is varied by."""

SLIPPING, SLIPPED = 4, 1.5
"""Steps that wheels slip for, and how much longer they are measured."""

BAD = np.array([0, 0, 0.2, 0.5, 0.5, 0])
"""Standard deviations of a bad step, roll, pitch, yaw in rad and the rest in its length: a scan that was misaligned."""

LEAST_TOLD = 0.3
"""Of the walk's sigmas, what methods are told at least: no noise model has none."""


def odometry(
    truth: Sequence[gtsam.Pose3], random: np.random.Generator, *, planar: bool, scaled: bool, errors: Errors = USUAL
) -> Odometry:
    """Steps between true poses with errors of odometry.

    Parameters
    ----------
    truth : sequence of gtsam.Pose3
    random : np.random.Generator
    planar : bool
        Whether nothing rolls, pitches or climbs.
    scaled : bool
        Whether the scale drifts too.
    errors : Errors
    """
    step_m = float(np.median([a.range(b) for a, b in pairwise(truth)]))
    usual = WALK * np.sqrt(step_m) * (np.array([0, 0, 1, 1, 1, 0]) if planar else 1)
    sigmas = errors.walk * usual
    bias = np.array([0, 0, errors.bias * random.normal(0.0, BIAS) * step_m, 0, 0, 0])
    here = gtsam.Similarity3()
    steps, scales = [], [1.0]
    for one, other in pairwise(truth):
        moved = one.between(other).compose(gtsam.Pose3.Expmap(random.normal(0.0, sigmas) + bias))
        walked = errors.walk * SCALE * np.sqrt(step_m)
        growth = float(np.exp(random.normal(0.0, walked))) if scaled else 1.0
        there = here * gtsam.Similarity3(moved.rotation(), moved.translation() / growth, growth)
        steps.append(_pose(here).between(_pose(there)))
        scales.append(there.scale())
        here = there
    steps = _spoilt(steps, random, errors, step_m)
    return Odometry(steps=steps, scales=np.array(scales), sigmas=max(errors.walk, LEAST_TOLD) * usual)


def _spoilt(steps: list[gtsam.Pose3], random: np.random.Generator, errors: Errors, step_m: float) -> list[gtsam.Pose3]:
    """Steps with what happens now and then."""
    if not (errors.longer or errors.slips or errors.bad_steps):
        return steps
    slipping = np.convolve(random.random(len(steps)) < errors.slips / 100, np.ones(SLIPPING))[: len(steps)] > 0
    lengths = (1 + errors.longer) * np.where(slipping, SLIPPED, 1.0)
    bad = random.random(len(steps)) < errors.bad_steps / 100
    sigmas = BAD * np.array([1, 1, 1, step_m, step_m, step_m])
    return [
        gtsam.Pose3(step.rotation(), length * step.translation()).compose(
            gtsam.Pose3.Expmap(is_bad * random.normal(0.0, sigmas))
        )
        for step, length, is_bad in zip(steps, lengths, bad, strict=True)
    ]


def _pose(similarity: gtsam.Similarity3) -> gtsam.Pose3:
    """The pose of a body under a similarity that maps x to s (R x + t)."""
    return gtsam.Pose3(similarity.rotation(), similarity.scale() * similarity.translation())
