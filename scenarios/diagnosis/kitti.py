"""The way of KITTI 00 by odometry alone: as measured, and with a scale that shrinks as a single camera's does."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import gtsam
import numpy as np

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import poses_of
from scenarios.diagnosis import damage
from scenarios.diagnosis.damage import Case
from scenarios.problem import between

NAME = "kitti_00"

RADIUS_M, EVERY = 4.0, 5
"""As of the other sequences in `real`."""

PERCENT = (0, 2, 5, 10)
"""Scale lost per kilometre; the paper drives KITTI 05 with 10."""

SIGMAS = (0.1, 0.1, 0.01)
"""Of a step whose scale shrinks, which the diagnosis does not read."""


def case(percent: int, kind: str, data: Path) -> Case:
    """KITTI 00, every fifth pose.

    Parameters
    ----------
    percent : int
        Scale lost per kilometre of a drive with no other error; asked for with `damage.SCALE` alone.
    kind : str
        `damage.ODOMETRY`, the stereo odometry as measured, or `damage.SCALE`.
    data : Path
        Folder of all data.
    """
    folder = data / "kitti_robustslam" / "00"
    truth = list(poses_of(datasets.read(folder / "kitti_00_GT.g2o").values).values())[::EVERY]
    if kind == damage.SCALE:
        steps = _shrinking(truth, percent / 100)
    else:
        measured = poses_of(datasets.chain_odometry(datasets.read(folder / "kitti_00_odom.g2o")))
        steps = [one.between(other) for one, other in pairwise(list(measured.values())[::EVERY])]

    # the chain of the steps
    graph, values, at = gtsam.NonlinearFactorGraph(), gtsam.Values(), truth[0]
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(SIGMAS))
    values.insert(0, at)
    for i, step in enumerate(steps):
        at = at.compose(step)
        graph.add(between(i, i + 1, step, noise))
        values.insert(i + 1, at)
    places = np.array([pose.translation() for pose in truth])
    return Case(graph=graph, values=values, radii=RADIUS_M, places=places)


def _shrinking(truth: list[gtsam.Pose2], per_km: float) -> list[gtsam.Pose2]:
    """True steps whose scale falls by exp(−per_km) a kilometre."""
    steps = [one.between(other) for one, other in pairwise(truth)]
    way_km = np.cumsum([np.linalg.norm(step.translation()) for step in steps]) / 1000
    scales = np.exp(-per_km * way_km).tolist()
    return [gtsam.Pose2(step.rotation(), s * step.translation()) for step, s in zip(steps, scales, strict=True)]
