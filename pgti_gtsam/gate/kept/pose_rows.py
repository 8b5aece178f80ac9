"""Poses as rows of an array, exactly: x, y, cosine and sine in the plane, the homogeneous matrix in space."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rows_of(poses: Iterable[Any], *, is_planar: bool) -> Array:
    """The rows of some gtsam.Pose2 or gtsam.Pose3, (n, 4) or (n, 16).

    Parameters
    ----------
    poses : iterable of gtsam.Pose2 or gtsam.Pose3
    is_planar : bool
    """
    if is_planar:
        rows = [(pose.x(), pose.y(), pose.rotation().c(), pose.rotation().s()) for pose in poses]
        return np.array(rows).reshape(-1, 4)
    return np.array([pose.matrix().ravel() for pose in poses]).reshape(-1, 16)


def pose_of(row: Array) -> Any:
    """The gtsam.Pose2 or gtsam.Pose3 of a row."""
    if len(row) == 4:
        x, y, cosine, sine = row.tolist()
        return gtsam.Pose2(gtsam.Rot2.fromCosSin(cosine, sine), np.array([x, y]))
    return gtsam.Pose3(row.reshape(4, 4))
