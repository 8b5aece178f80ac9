"""Edges between poses in g2o files, and the numbers of dialects before the measurement.

``EDGE_SE2_SWITCHABLE`` names its switch there and ``EDGE_SE2_MAXMIX`` a weight (Sünderhauf's Vertigo,
doi:10.1109/IROS.2012.6385590), ``EDGE_SE3_OFFSET`` the two parameters that say where the sensors sit on the bodies.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, between_entries, planar_poses, stream_of_poses
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.noise import PLANE, SPACE, information, information_models
from pgti_gtsam.datasets.text import Table, TextFile, by_identifier

EDGES = {  # numbers in front of the measurement, and those of the measurement
    "EDGE_SE2": (0, 3),
    "TUTORIAL_EDGE_SE2": (0, 3),
    "EDGE_SE2_SWITCHABLE": (1, 3),
    "EDGE_SE2_MAXMIX": (1, 3),
    "EDGE_SE2_OFFSET": (2, 3),
    "EDGE_SE3:QUAT": (0, 7),
    "EDGE_SE3": (0, 7),
    "EDGE_SE3_SWITCHABLE": (1, 7),
    "EDGE_SE3_MAXMIX": (1, 7),
    "EDGE_SE3_OFFSET": (2, 7),
}
SENSORS = {"EDGE_SE2_OFFSET": ("PARAMS_SE2OFFSET", 3), "EDGE_SE3_OFFSET": ("PARAMS_SE3OFFSET", 7)}


def pose_edges(file: TextFile) -> list[Entry]:
    """Between factors of all edges between poses.

    Raises
    ------
    FileFormatError
        A malformed line, a zero quaternion, a sensor offset without its parameter.
    """
    entries = []
    for tag, (lead, size) in EDGES.items():
        if tag not in file.tags:
            continue
        layout = PLANE if size == 3 else SPACE
        table = file.table(tag, ids=2, widths=[lead + size + width for width in (0, *layout)], poses=2)
        matrices = information(file, table, table.numbers[:, lead + size :], layout, tag)
        measured = _measured(file, table, lead, size)
        if tag in SENSORS:
            measured, matrices = _between_bodies(file, table, measured, matrices, *SENSORS[tag])
        _note_headless(file, table, matrices, size)
        models = information_models(file, table, matrices)
        del matrices  # 288 bytes an edge, the largest part of a large file's memory
        entries += between_entries(file, table, measured, models)
    return entries


def _note_headless(file: TextFile, table: Table, matrices: NDArray[np.float64], size: int) -> None:
    """Note the edges that measure a position alone: such odometry cannot be composed, nor fix a map."""
    turns = matrices[:, 2:, 2:] if size == 3 else matrices[:, :3, :3]
    headless = (turns == 0.0).all(axis=(1, 2)) & (matrices != 0.0).any(axis=(1, 2))
    if headless.any():
        what = "heading" if size == 3 else "rotation"
        first = table.lines[np.flatnonzero(headless)[0]]
        file.notes.append(f"information says nothing of {what}: {headless.sum()} edges (first: edge line {first})")


def _measured(file: TextFile, table: Table, lead: int, size: int) -> Iterable[Pose]:
    return planar_poses(table.numbers[:, lead:]) if size == 3 else stream_of_poses(file, table, lead)


def _between_bodies(
    file: TextFile, table: Table, measured: Iterable[Pose], matrices: NDArray[np.float64], tag: str, size: int
) -> tuple[list[Pose], NDArray[np.float64]]:
    """Poses and information of bodies from those of their sensors, whose numbers come first.

    O₁ z Exp(δ) O₂⁻¹ = O₁ z O₂⁻¹ Exp(Ad(O₂) δ), so Λ of the bodies is Ad(O₂⁻¹)ᵀ Λ Ad(O₂⁻¹).
    """
    parameters = file.table(tag, ids=1, widths=[size])
    offsets = by_identifier(file, tag, parameters, _measured(file, parameters, 0, size))
    poses, moved = [], []
    for line, ends, pose, matrix in zip(
        table.lines.tolist(), table.numbers[:, :2].tolist(), measured, matrices, strict=True
    ):
        if missing := [end for end in ends if end not in offsets]:
            raise file.error(f"sensor offset {missing[0]:g} has no {tag} line", line)
        first, second = (offsets[int(end)] for end in ends)
        carry = second.inverse().AdjointMap()
        poses.append(first * pose * second.inverse())
        moved.append(carry.T @ matrix @ carry)
    return poses, np.array(moved).reshape(matrices.shape)
