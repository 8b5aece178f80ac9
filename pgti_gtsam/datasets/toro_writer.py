"""Factor graphs to TORO text, such that `formats.toro` reads the same graph again.

The file holds poses, between factors and, in the plane, bearing-range factors with noise of bearing and range
(``BR``). TORO has no line for a landmark: a reader puts a landmark where its nearest sighting places it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam import outputs
from pgti_gtsam.datasets.chain import Pose, poses_of
from pgti_gtsam.datasets.edge_lines import (
    TRANSLATION_FIRST,
    Numbers,
    Part,
    check_known,
    checked_numbers,
    edge_lines,
    number_text,
    pose_numbers,
    triangle,
)
from pgti_gtsam.datasets.landmarks import landmark_identifier


def write_toro(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, path: Path) -> Mapping[str, int]:
    """Write poses and factors as TORO text; returns a count of the rest, by class or kind.

    Parameters
    ----------
    graph, values
    path : Path

    Raises
    ------
    MissingValueError
        A factor refers to a key without a value.
    InvalidValueError
        A value is not finite, or beyond 1e30.
    """
    poses = poses_of(values)
    edges, unwritten = edge_lines(graph, _PARTS)
    check_known(edges, values.keys())
    lines = [_vertex(key, pose) for key, pose in poses.items()]
    for edge in edges:
        lines += edge.lines({key: key if key in poses else landmark_identifier(key) for key in edge.keys})
    outputs.write_text(path, "\n".join(lines) + "\n")
    return unwritten


def _vertex(key: int, pose: Pose) -> str:
    tag = "VERTEX2" if isinstance(pose, gtsam.Pose2) else "VERTEX3"
    return f"{tag} {key} {number_text(checked_numbers(key, _euler_numbers(pose)))}"


def _euler_numbers(pose: Pose) -> Numbers:
    """x, y, heading; in space x, y, z, roll, pitch, yaw."""
    if isinstance(pose, gtsam.Pose2):
        return pose_numbers(pose)
    return np.concatenate([pose.translation(), pose.rotation().rpy()])


def _planar_between(factor: Any, information: Numbers) -> Numbers:
    i, j = np.array([(0, 0), (0, 1), (1, 1), (2, 2), (0, 2), (1, 2)]).T  # the order of `noise.TORO_3`
    return np.concatenate([pose_numbers(factor.measured()), information[i, j]])


def _spatial_between(factor: Any, information: Numbers) -> Numbers:
    swapped = information[np.ix_(TRANSLATION_FIRST, TRANSLATION_FIRST)]
    return np.concatenate([_euler_numbers(factor.measured()), triangle(swapped)])


def _sighting(factor: Any, information: Numbers) -> Numbers:
    """Bearing and range with sigmas; NaN where the two are not independent."""
    seen, variances = factor.measured(), np.diag(information)
    if information[0, 1] != 0.0 or not (variances > 0.0).all():
        return np.full(4, np.nan)
    return np.array([seen.bearing().theta(), seen.range(), *1 / np.sqrt(variances)])


_PARTS = {
    "BetweenFactorPose2": Part("EDGE2", (), _planar_between),
    "BetweenFactorPose3": Part("EDGE3", (), _spatial_between),
    "BearingRangeFactor2D": Part("BR", (), _sighting),
}
"""By class of factor."""
