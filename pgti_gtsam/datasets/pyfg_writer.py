"""Factor graphs to PyFG text, such that `formats.pyfg` reads the same graph again.

Names are symbols, and noise is written as covariance. A graph knows no timestamps: in their place stands the
number of the pose among the poses of the robot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam import outputs
from pgti_gtsam.adapter.values import typed_value
from pgti_gtsam.datasets.chain import LETTER, Pose, poses_of
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
from pgti_gtsam.datasets.landmarks import cartesian, planar_point, spatial_point
from pgti_gtsam.pose_graph import key_label

TIMES = "timestamps, in whose place poses are counted"


def write_pyfg(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, path: Path) -> Mapping[str, int]:
    """Write poses, landmarks and factors as PyFG text; returns a count of the rest, by class or kind.

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
    names = {key: key_label(key) for key in values.keys()}  # noqa: SIM118  no mapping
    times = _times(poses)
    lines = [_pose_line(key, pose, names[key], times[key]) for key, pose in poses.items()]
    lines += [_point_line(values, key, names[key]) for key in names if key not in poses]
    for edge in edges:
        lines += edge._replace(loss=[]).lines(names, times[max(set(edge.keys) & poses.keys())])
    outputs.write_text(path, "\n".join(lines) + "\n")
    lost = Counter({"robust losses": sum(bool(edge.loss) for edge in edges), TIMES: len(poses)})
    return unwritten + lost


def _times(poses: Mapping[int, Pose]) -> dict[int, str]:
    """Number of each pose among the poses of its letter."""
    counts, times = Counter[int](), dict[int, str]()
    for key in poses:
        times[key] = f"{counts[key >> LETTER]}.0"
        counts[key >> LETTER] += 1
    return times


def _pose_line(key: int, pose: Pose, name: str, time: str) -> str:
    tag = "VERTEX_SE2" if isinstance(pose, gtsam.Pose2) else "VERTEX_SE3:QUAT"
    return f"{tag} {time} {name} {number_text(checked_numbers(key, pose_numbers(pose)))}"


def _point_line(values: gtsam.Values, key: int, name: str) -> str:
    point = typed_value(values, "Point3", key)
    tag = "VERTEX_XY" if point is None else "VERTEX_XYZ"
    return f"{tag} {name} {number_text(checked_numbers(key, values.atPoint2(key) if point is None else point))}"


def _covariance(information: Numbers) -> Numbers:
    """Upper triangle of the covariance; NaN for unmeasured directions, whose covariance is infinite."""
    if np.linalg.matrix_rank(information, hermitian=True) < len(information):
        return np.array([np.nan])
    return triangle(np.asarray(np.linalg.inv(information), np.float64))


def _planar_between(factor: Any, information: Numbers) -> Numbers:
    return np.concatenate([pose_numbers(factor.measured()), _covariance(information)])


def _spatial_between(factor: Any, information: Numbers) -> Numbers:
    swapped = information[np.ix_(TRANSLATION_FIRST, TRANSLATION_FIRST)]
    return np.concatenate([pose_numbers(factor.measured()), _covariance(swapped)])


def _planar_sighting(factor: Any, information: Numbers) -> Numbers:
    point = planar_point(factor)
    return np.concatenate([point, _covariance(cartesian(point, information))])


def _spatial_sighting(factor: Any, information: Numbers) -> Numbers:
    point = spatial_point(factor)
    return np.concatenate([point, _covariance(cartesian(point, information))])


def _range(factor: Any, information: Numbers) -> Numbers:
    return np.concatenate([[factor.measured()], _covariance(information)])


_PARTS = {
    "BetweenFactorPose2": Part("EDGE_SE2", (), _planar_between),
    "BetweenFactorPose3": Part("EDGE_SE3:QUAT", (), _spatial_between),
    "BearingRangeFactor2D": Part("EDGE_SE2_XY", (), _planar_sighting),
    "BearingRangeFactor3D": Part("EDGE_SE3_XYZ", (), _spatial_sighting),
    "RangeFactor2D": Part("EDGE_RANGE", (), _range),
    "RangeFactor3D": Part("EDGE_RANGE", (), _range),
}
"""By class of factor."""
