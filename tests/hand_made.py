"""Pose graphs made by hand, as GTSAM graphs and values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

UNIT_NOISE = gtsam.noiseModel.Unit.Create(6)


def as_gtsam(positions: Any, edges: Sequence[tuple[int, int]]) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Unturned poses at the positions, (n, 3), and a factor for every edge that measures what the values say.

    A keyframe without an edge gets a prior factor instead, since `from_gtsam` refuses poses without a factor.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses = [gtsam.Pose3(gtsam.Rot3(), position) for position in np.asarray(positions, dtype=float)]
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    for i, j in edges:
        graph.add(gtsam.BetweenFactorPose3(i, j, poses[i].between(poses[j]), UNIT_NOISE))
    for key in set(range(len(poses))) - {key for edge in edges for key in edge}:
        graph.add(gtsam.PriorFactorPose3(key, poses[key], UNIT_NOISE))
    return graph, values
