"""An optimum of the drift model as a running pipeline keeps it: arrays, and no object of a single keyframe or tie.

A map is read anew now and then. If thousands of small objects stayed of each reading, the memory between them would
stay with the process.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.drift.settled import Settled
from pgti_gtsam.drift.ties import Ties, level_closures
from pgti_gtsam.drift.units import Units
from pgti_gtsam.gate.kept.pose_rows import pose_of, rows_of
from pgti_gtsam.spectral.block_inverse import BlockFactor

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KeptOptimum:
    """What predictions need of a `Settled`.

    Attributes
    ----------
    units : Units
    poses : (n, p) float
        Of the keyframes, as `pose_rows` has poses.
    component : (n,) int
        Connected part of every keyframe.
    factor : BlockFactor
        Of the information matrix.
    pairs : (c, 2) int
        Keyframes i < j of the map's own closures.
    measured : (c, p) float
        Pose of j seen from i, likewise.
    """

    units: Units
    poses: Array
    component: NDArray[np.int32]
    factor: BlockFactor
    pairs: NDArray[np.int64]
    measured: Array

    @classmethod
    def of(cls, settled: Settled) -> KeptOptimum:
        """The same optimum in arrays, after the last linear step."""
        closures, units = settled.model.ties.only(settled.model.ties.slots >= 0), settled.model.units
        poses = (pose.retract(step) for pose, step in zip(settled.poses, settled.steps, strict=True))
        return cls(
            units=units,
            poses=rows_of(poses, is_planar=units.is_planar),
            component=settled.component,
            factor=settled.factor,
            pairs=closures.pairs,
            measured=rows_of(closures.measured, is_planar=units.is_planar),
        )

    def __len__(self) -> int:
        """Count the keyframes."""
        return len(self.poses)

    def pose(self, keyframe: int) -> Any:
        """A keyframe's gtsam.Pose2 or gtsam.Pose3."""
        return pose_of(self.poses[keyframe])

    def closures_between(self, pairs: NDArray[np.int64]) -> Ties:
        """The map's own closures between some pairs of keyframes."""
        own = np.flatnonzero((self.pairs[:, None] == pairs[None]).all(axis=2).any(axis=1))
        return level_closures(self.pairs[own], map(pose_of, self.measured[own]), self.units)
