"""Trajectories: TUM (``timestamp x y z qx qy qz qw``) and KITTI (the 4x4 of a pose by rows, or its upper 3x4).

Most SLAM programs write either. Trajectories hold no edges: consecutive poses are tied with assumed sigmas. Loops come
in a second file, ``i j`` or ``timestamp timestamp``, and behind the pair the pose of the second from the first where
known: ``x y θ``, ``x y z qx qy qz qw`` or a 3x4 by rows. A loop without a pose measures the trajectory's own pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, assemble, quaternion_poses, trajectory_steps
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Format, Source, read_bytes, read_text
from pgti_gtsam.datasets.text import Table, TextFile, is_number, split_lines
from pgti_gtsam.factor_graphs import between_factor

TUM, KITTI = "TUM trajectory", "KITTI trajectory"
UNIT = 0.02  # a quaternion of two digits departs so far from a length of one
RIGID = 1e-3  # a rotation matrix of six digits departs less from an orthonormal one
LOOP_SIGMAS = (0.05, 0.05, 0.05, 0.2, 0.2, 0.2)  # assumed: rad and m, a scan or image match


def parse(source: Source) -> Dataset:
    """Poses, the steps between them, and the loops of a second file.

    Raises
    ------
    FileFormatError
        A malformed line, a pose that is no rigid motion, a loop to an unknown pose.
    """
    # poses in the order of time
    file = source.file
    is_tum = len(source.first) == 8
    table = file.rows(ids=0, widths=[8 if is_tum else len(source.first)])
    if is_tum and (np.diff(table.numbers[:, 0]) < 0.0).any():
        file.notes.append("lines are put in the order of time, and counted in it")
        table = table.where(np.argsort(table.numbers[:, 0], kind="stable"))
    made = quaternion_poses(file, table, 1) if is_tum else matrix_poses(file, table)
    poses = dict(enumerate(made))
    times = table.numbers[:, 0] if is_tum else np.arange(len(table.lines), dtype=float)

    # steps and loops
    file.notes.append(
        "a trajectory holds no edge: consecutive poses are tied, with assumed sigmas of 0.01 rad and 0.1 m"
    )
    loops: list[Entry] = []
    if source.loops is None:
        file.notes.append("no loop is known; name a list of them with --loops")
    else:
        loops = _loops(source.loops, made, times, file.notes)
    return assemble(
        file,
        format=TUM if is_tum else KITTI,
        poses=poses,
        entries=trajectory_steps(poses),
        loops=loops,
        known=file.tags.keys(),
    )


def matrix_poses(file: TextFile, table: Table, before: int = 0) -> list[gtsam.Pose3]:
    """Poses of rows that hold, behind ``before`` other numbers, a 3x4 matrix by rows.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    table : Table
    before : int
        Numbers before the matrix.

    Raises
    ------
    FileFormatError
        A matrix is no rigid motion.
    """
    matrices = table.numbers[:, before : before + 12].reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    errors = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    bad = np.flatnonzero(~(errors < RIGID) | (np.linalg.det(rotations) < 0.0))
    if bad.size:
        raise file.error("expected a rigid motion as a 3x4 matrix by rows", table.lines[bad[0]])
    u, _, vt = np.linalg.svd(rotations)
    placed = zip(u @ vt, matrices[:, :, 3], strict=True)
    return [gtsam.Pose3(gtsam.Rot3(rotation), position) for rotation, position in placed]


def _loops(path: Path, poses: Sequence[gtsam.Pose3], times: NDArray[np.float64], notes: list[str]) -> list[Entry]:
    """Loop closures of a list, in order; numbers may stand between commas, and the list may be empty."""
    if not read_bytes(path).strip():
        notes.append(f"{path.name} is empty: it names no loop")
        return []
    file = split_lines(path, read_text(path), comma=True)
    table = file.rows(ids=0, widths=[2, 2 + 3, 2 + 7, 2 + 12])
    ends = _indices(file, table, times)
    width = table.numbers.shape[1] - 2

    # what they measure
    measured: Sequence[gtsam.Pose3]
    if width == 0:
        notes.append("loops bring no pose: they measure what the trajectory says")
        measured = [poses[i].between(poses[j]) for i, j in ends.tolist()]
    elif width == 3:
        measured = [gtsam.Pose3(gtsam.Pose2(*row)) for row in table.numbers[:, 2:].tolist()]
    else:
        measured = quaternion_poses(file, table, 2) if width == 7 else matrix_poses(file, table, 2)
    notes.append(f"{len(ends)} loops from {file.path.name}, with assumed sigmas of 0.05 rad and 0.2 m")
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array(LOOP_SIGMAS))
    rows = zip(ends.tolist(), measured, strict=True)
    return [Entry(0, (i, j), between_factor(i, j, pose, model)) for (i, j), pose in rows]


def _indices(file: TextFile, table: Table, times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices (n, 2) of the poses that loops tie: as written where all are indices, else by the nearest timestamp."""
    ends = table.numbers[:, :2]
    if (ends == np.round(ends)).all() and (ends >= 0).all() and (ends < len(times)).all():
        found = ends.astype(np.int64)
    else:
        found = np.abs(ends[:, :, None] - times).argmin(axis=2)
        spacing = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
        far = np.flatnonzero((np.abs(times[found] - ends) > 0.5 * abs(spacing)).any(axis=1))
        if far.size:
            line = int(table.lines[far[0]])
            spans = f"indices from 0 to {len(times) - 1} or timestamps from {times.min():.3f} to {times.max():.3f}"
            raise file.error(f"expected two poses of the trajectory, by {spans}, got another", line)
    same = np.flatnonzero(found[:, 0] == found[:, 1])
    if same.size:
        raise file.error("expected a loop between two poses, got one twice", table.lines[same[0]])
    return found


def _recognises(source: Source) -> bool:
    fields = source.first
    if len(fields) not in (8, 12, 16) or not all(map(is_number, fields)):
        return False
    if len(fields) == 16:
        return list(map(float, fields[12:])) == [0.0, 0.0, 0.0, 1.0]
    return len(fields) == 12 or abs(float(np.linalg.norm(np.array(fields[4:], dtype=float))) - 1.0) < UNIT


FORMAT = Format("TUM or KITTI trajectory", _recognises, parse, takes_loops=True)
