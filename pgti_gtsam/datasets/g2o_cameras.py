"""Camera poses of g2o files: ``VERTEX_SE3:EXPMAP``, ``VERTEX_SIM3:EXPMAP`` and their edges.

g2o's optimiser holds a camera as the transform from world to camera, but its files hold the inverse: ``write`` of these
vertices and edges inverts, ``read`` inverts back (types_six_dof_expmap.cpp, types_seven_dof_expmap.cpp). Programs that
write such a file by themselves are known to leave the inversion out. Edges tell: right edges fit the poses. Information
is in the order of the tangent space, rotation first. A similarity is written as its logarithm (rotation, translation,
scale: the matrix [sR t; 0 1] is the exponential) with the camera's four numbers behind the vertex, or as position,
quaternion and scale (``:QUAT``). The scale is taken out: translations of an edge are multiplied by the scale of the
first vertex.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from pgti_gtsam.datasets.assembly import Entry, between_entries, quaternion_poses
from pgti_gtsam.datasets.noise import CAMERA, SCALED_CAMERA, information, information_models
from pgti_gtsam.datasets.text import Table, TextFile, by_identifier

RIGID, SIMILAR, SIMILAR_QUAT = "SE3:EXPMAP", "SIM3:EXPMAP", "SIM3:QUAT"
WIDTHS = {RIGID: 7, SIMILAR: 7, SIMILAR_QUAT: 8}
CAMERA_TAGS = {f"{kind}_{name}" for kind in ("VERTEX", "EDGE") for name in WIDTHS}
INTRINSICS = 4  # focal lengths and principal point behind a VERTEX_SIM3:EXPMAP


class Cameras(NamedTuple):
    """Poses by identifier, their scales, and whether the file holds transforms from world to camera."""

    poses: dict[int, gtsam.Pose3]
    scales: dict[int, float]
    is_inverse: bool


def camera_poses(file: TextFile) -> Cameras:
    """Camera vertices as poses in the world."""
    poses: dict[int, gtsam.Pose3] = {}
    scales: dict[int, float] = {}
    for name, width in WIDTHS.items():
        tag = f"VERTEX_{name}"
        widths = [width, width + INTRINSICS] if name == SIMILAR else [width]
        table = file.table(tag, ids=1, widths=widths, poses=1)
        rigid, sizes = _similarities(file, table, name)
        poses |= by_identifier(file, tag, table, rigid, poses)
        scales |= dict(zip(table.ids[:, 0].tolist(), sizes, strict=True))
    if any(abs(scale - 1.0) > 1e-9 for scale in scales.values()):
        file.notes.append("similarities are read without their scale")
    is_inverse = bool(poses) and _fits_better_inverted(file, poses, scales)
    if is_inverse:
        file.notes.append("camera poses are inverted: the edges fit transforms from world to camera")
        poses = {key: pose.inverse() for key, pose in poses.items()}
    return Cameras(poses, scales, is_inverse)


def camera_edges(file: TextFile, cameras: Cameras) -> list[Entry]:
    """Edges between cameras as between factors.

    Parameters
    ----------
    file : TextFile
    cameras : Cameras
    """
    entries = []
    for name, width in WIDTHS.items():
        layout, tag = CAMERA if name == RIGID else SCALED_CAMERA, f"EDGE_{name}"
        table = file.table(tag, ids=2, widths=[width + numbers for numbers in (0, *layout)], poses=2)
        measured = _measured(file, table, name, cameras.scales)
        if cameras.is_inverse:
            measured = [pose.inverse() for pose in measured]
        matrices = information(file, table, table.numbers[:, width:], layout, tag)
        entries += between_entries(file, table, measured, information_models(file, table, matrices))
    return entries


def _measured(file: TextFile, table: Table, name: str, scales: dict[int, float]) -> list[gtsam.Pose3]:
    rigid, _ = _similarities(file, table, name)
    first = [scales.get(key, 1.0) for key in table.ids[:, 0].tolist()]
    return [
        pose if scale == 1.0 else gtsam.Pose3(pose.rotation(), scale * pose.translation())
        for pose, scale in zip(rigid, first, strict=True)
    ]


def _similarities(file: TextFile, table: Table, name: str) -> tuple[list[gtsam.Pose3], list[float]]:
    """Rigid parts and scales of the rows of a table."""
    if name != SIMILAR:
        scales = table.numbers[:, 7].tolist() if name == SIMILAR_QUAT else [1.0] * len(table.lines)
        return quaternion_poses(file, table), scales
    matrices = [_exponential(row) for row in table.numbers[:, :7]]
    scales = [float(np.cbrt(np.linalg.det(matrix[:3, :3]))) for matrix in matrices]
    poses = [
        gtsam.Pose3(gtsam.Rot3(matrix[:3, :3] / scale), matrix[:3, 3])
        for matrix, scale in zip(matrices, scales, strict=True)
    ]
    return poses, scales


def _exponential(tangent: NDArray[np.float64]) -> NDArray[np.float64]:
    """[sR t; 0 1] of a logarithm: rotation (3), translation (3), scale."""
    generator = np.zeros((4, 4))
    generator[:3, :3] = gtsam.Rot3.Hat(tangent[:3]) + tangent[6] * np.eye(3)
    generator[:3, 3] = tangent[3:6]
    return np.asarray(expm(generator))


def _fits_better_inverted(file: TextFile, poses: dict[int, gtsam.Pose3], scales: dict[int, float]) -> bool:
    """Whether the edges fit the poses better when all edges are transforms from world to camera."""
    as_written, inverted = 0.0, 0.0
    for name, width in WIDTHS.items():
        layout = CAMERA if name == RIGID else SCALED_CAMERA
        widths = [width + numbers for numbers in (0, *layout)]
        table = file.table(f"EDGE_{name}", ids=2, widths=widths, poses=2)
        for (i, j), pose in zip(table.ids.tolist(), _measured(file, table, name, scales), strict=True):
            if i in poses and j in poses:
                as_written += _misfit(pose, poses[i].between(poses[j]))
                inverted += _misfit(pose, poses[j] * poses[i].inverse())
    return inverted < as_written


def _misfit(measured: gtsam.Pose3, pose: gtsam.Pose3) -> float:
    return float(np.linalg.norm(measured.logmap(pose)))
