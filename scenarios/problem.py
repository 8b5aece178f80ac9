"""The input of every method: a map without its candidates, the candidates, and the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """A map and its candidate closures, in time order. Keyframe i has the key i.

    Attributes
    ----------
    name : str
    graph : gtsam.NonlinearFactorGraph
        The map without any candidate: a prior, then odometry in order. All noise models are those that
        methods are told, whatever the noise was.
    values : gtsam.Values
        First estimates: odometry chained.
    closures : tuple of gtsam.NonlinearFactorGraph
        Candidates, a between factor each, by the later keyframe.
    true : (n_closures,) bool
        Labelled by geometry: does the measured relative pose agree with the truth?
    overlapping : (n_closures,) bool
        False candidates that would lay free space upon unconnected free space; the
        others are beyond the reach of PGTI, as the paper states. True of every true candidate.
    radii : float, or mapping from key to float
        m.
    truth : gtsam.Values
        Poses only, in a frame of their own.
    ambiguity : float
        Share of keyframes whose place has a look-alike elsewhere; NaN where nobody knows what they see.
    """

    name: str
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    closures: tuple[gtsam.NonlinearFactorGraph, ...]
    true: NDArray[np.bool_]
    overlapping: NDArray[np.bool_]
    radii: float | Mapping[int, float]
    truth: gtsam.Values
    ambiguity: float = np.nan

    @property
    def planar(self) -> bool:
        """Whether keyframes are `Pose2`; `Pose3` otherwise."""
        return isinstance(self.graph.at(0), gtsam.PriorFactorPose2)

    @property
    def n_keyframes(self) -> int:
        """Their keys are 0 to this, exclusive."""
        return int(self.truth.size())

    def poses(self, values: gtsam.Values) -> list[Any]:
        """All keyframes' poses in some values, in order."""
        at = values.atPose2 if self.planar else values.atPose3
        return [at(key) for key in range(self.n_keyframes)]


def between(i: int, j: int, measured: gtsam.Pose2 | gtsam.Pose3, noise: gtsam.noiseModel.Base) -> Any:
    """The between factor of the poses' own kind.

    Parameters
    ----------
    i, j : int
    measured : gtsam.Pose2 or gtsam.Pose3
    noise : gtsam.noiseModel.Base
    """
    factor = gtsam.BetweenFactorPose2 if isinstance(measured, gtsam.Pose2) else gtsam.BetweenFactorPose3
    return factor(i, j, measured, noise)


def alone(factor: Any) -> gtsam.NonlinearFactorGraph:
    """A graph of a single factor."""
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    return graph


def space(pose: gtsam.Pose2 | gtsam.Pose3) -> gtsam.Pose3:
    """A pose of the plane as a pose in space, any other unchanged."""
    return gtsam.Pose3(pose) if isinstance(pose, gtsam.Pose2) else pose
