"""The worth of a method's answer: shares of closures, and the trajectory's errors by evo."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from evo.core import metrics, trajectory
from evo.core.units import Unit
from numpy.typing import NDArray
from scipy import stats

from scenarios.problem import space

Pose = gtsam.Pose2 | gtsam.Pose3

RPE_KEYFRAMES = 10
"""Way over which the relative error is taken."""

RECALLS = np.linspace(0.1, 1.0, 10)


def trajectory_errors(truth: Sequence[Pose], estimate: Sequence[Pose]) -> dict[str, float]:
    """Root mean square of the absolute error after rigid alignment, and of the relative error, both in m.

    Parameters
    ----------
    truth : sequence of Pose
    estimate : sequence of Pose
    """
    wanted, found = (
        trajectory.PosePath3D(poses_se3=[space(pose).matrix() for pose in poses]) for poses in (truth, estimate)
    )
    relative = metrics.RPE(metrics.PoseRelation.translation_part, RPE_KEYFRAMES, Unit.frames, all_pairs=True)
    relative.process_data((wanted, found))
    found.align(wanted)
    absolute = metrics.APE(metrics.PoseRelation.translation_part)
    absolute.process_data((wanted, found))
    rmse = metrics.StatisticsType.rmse
    return {"ate_m": float(absolute.get_statistic(rmse)), "rpe_m": float(relative.get_statistic(rmse))}


def f1(true: NDArray[np.bool_], accepted: NDArray[np.bool_]) -> float:
    """Harmonic mean of precision and recall of accepted true closures; 1 where none is true and none was accepted.

    Parameters
    ----------
    true : (k,) bool
    accepted : (k,) bool
    """
    wrong = int((true != accepted).sum())
    right = int((true & accepted).sum())
    return 1.0 if not right and not wrong else 2 * right / (2 * right + wrong)


def area_under_curve(true: NDArray[np.bool_], confidence: NDArray[np.float64]) -> float | None:
    """Probability that a true closure gets more confidence than a false closure (receiver operating characteristic).

    Parameters
    ----------
    true : (k,) bool
    confidence : (k,) float
    """
    if not true.any() or true.all():
        return None
    wins = stats.mannwhitneyu(confidence[true], confidence[~true]).statistic
    return float(wins / (true.sum() * (~true).sum()))


def precisions(true: NDArray[np.bool_], confidence: NDArray[np.float64]) -> list[float]:
    """Best precision at each of `RECALLS` by accepting the most trusted closures, ties together.

    Parameters
    ----------
    true : (k,) bool
    confidence : (k,) float
    """
    if not len(true):
        return [0.0] * len(RECALLS)
    order = np.argsort(-confidence, kind="stable")
    ends = np.flatnonzero(np.append(np.diff(confidence[order]) != 0, True))
    right = np.cumsum(true[order])[ends]
    precision, recall = right / (ends + 1), right / max(int(true.sum()), 1)
    return [float(np.max(precision[recall >= wanted - 1e-12], initial=0.0)) for wanted in RECALLS]
