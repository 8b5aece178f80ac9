"""Whether an estimate is an optimum of its own factor graph, as scores of a map assume."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.gate.trial import optimised

FAR = 0.25
"""Step, in ρ, beyond which an estimate is no optimum: overlaps of spheres change with it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence:
    """How far one step of Levenberg-Marquardt leads from an estimate.

    Attributes
    ----------
    error, error_after : float
        ½ Σ ‖e‖² in the caller's noise models, at the estimate and after the step.
    step_m : float
        Largest distance that the step moves a keyframe by.
    keyframe : int
        Index of the keyframe that moves farthest.
    """

    error: float
    error_after: float
    step_m: float
    keyframe: int

    def is_optimum(self, unit_m: float) -> bool:
        """Whether no keyframe moves by more than `FAR` free radii of so many metres."""
        return self.step_m <= FAR * unit_m


def convergence(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Convergence:
    """Try one step. Graph and values stay untouched; parts that nothing holds are held where they are.

    Raises
    ------
    UnsolvableGraphError
        The graph is singular at the estimate.
    """
    stepped = optimised(graph, values, max_iterations=1)
    steps = np.linalg.norm(read_keyframes(stepped).positions - read_keyframes(values).positions, axis=1)
    farthest = int(np.argmax(steps))
    return Convergence(
        error=float(graph.error(values)),
        error_after=float(graph.error(stepped)),
        step_m=float(steps[farthest]),
        keyframe=farthest,
    )
