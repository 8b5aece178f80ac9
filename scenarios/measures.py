"""What a method's answer is worth: shares of closures, and the trajectory's error by evo."""

from __future__ import annotations

import gtsam
import numpy as np
from evo.core import metrics, trajectory
from numpy.typing import NDArray


def ate_m(truth: gtsam.Values, values: gtsam.Values) -> float:
    """Root mean square of the absolute trajectory error of planar poses after rigid alignment."""
    keys = [key for key in truth.keys() if values.exists(key)]  # noqa: SIM118
    wanted, found = (
        trajectory.PosePath3D(poses_se3=[gtsam.Pose3(poses.atPose2(key)).matrix() for key in keys])
        for poses in (truth, values)
    )
    found.align(wanted)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((wanted, found))
    return float(error.get_statistic(metrics.StatisticsType.rmse))


def f1(true: NDArray[np.bool_], accepted: NDArray[np.bool_]) -> float:
    """Harmonic mean of precision and recall of accepted true closures; 1 where there are none and none was accepted."""
    wrong = int((true != accepted).sum())
    right = int((true & accepted).sum())
    return 1.0 if not right and not wrong else 2 * right / (2 * right + wrong)
