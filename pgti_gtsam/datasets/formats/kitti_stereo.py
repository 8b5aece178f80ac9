"""KITTI stereo files of the GTSAM wheel: observations, camera poses and calibration in three files.

``VO_stereo_factors*.txt``: camera landmark uL uR v X Y Z (pixels; metres in the camera's frame);
``VO_camera_poses*.txt``: camera, then the 16 numbers of its 4x4 pose by rows;
``VO_calibration*.txt``: fx fy skew u0 v0 baseline (pixels; metres).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import gtsam
import numpy as np

from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Format, Source, read_lines
from pgti_gtsam.datasets.text import Table, TextFile, by_identifier, is_number

NAME = "KITTI stereo"
WIDTH = 8  # fields of an observation
FACTORS, POSES, CALIBRATION = "stereo_factors", "camera_poses", "calibration"

PIXEL_SIGMA = 1.0  # assumed: feature matches are good to about a pixel
# Assumed for the steps between camera poses: rotation 0.01 rad, translation 0.1 m, about a tenth of a step
ODOMETRY_SIGMAS = (0.01, 0.01, 0.01, 0.1, 0.1, 0.1)
ORTHONORMAL = 1e-3  # the files write six digits; what departs more is no rotation


def parse(source: Source) -> Dataset:
    """Stereo factors, and odometry from the stored camera poses.

    Cameras have the keys ``symbol("x", i)``, landmarks ``symbol("l", j)``. A landmark is put where its first
    observation sees it from the stored pose of its camera.

    Raises
    ------
    FileFormatError
        A malformed line, a disparity or depth that is not positive, a camera without a pose, a pose that is
        no rigid motion, poses or calibration missing beside the file.
    """
    file = source.file
    table = file.rows(ids=2, widths=[WIDTH - 2])
    behind = np.flatnonzero((table.numbers[:, 0] <= table.numbers[:, 1]) | (table.numbers[:, 5] <= 0.0))
    if behind.size:
        raise file.error("expected a landmark in front of the cameras: uL > uR and Z > 0", table.lines[behind[0]])

    # cameras beside it, and their calibration
    poses = _camera_poses(_sibling(file, POSES))
    unknown = np.flatnonzero(~np.isin(table.ids[:, 0], list(poses)))
    if unknown.size:
        message = f"camera {table.ids[unknown[0], 0]} has no pose in {_sibling(file, POSES).name}"
        raise file.error(message, table.lines[unknown[0]])
    calibration = _sibling(file, CALIBRATION)

    # the map
    graph = _odometry(poses)
    _add_observations(graph, table, _calibration(calibration))
    return Dataset(
        name=file.name,
        format=NAME,
        graph=graph,
        values=_values(poses, table),
        notes=(
            f"stereo observations have an assumed sigma of {PIXEL_SIGMA:g} pixel",
            "odometry is not in the file: it is taken from the camera poses, with assumed sigmas "
            f"{ODOMETRY_SIGMAS[0]:g} rad and {ODOMETRY_SIGMAS[-1]:g} m",
            f"calibration from {calibration.name}; landmarks are placed by their first observation",
        ),
    )


def _sibling(file: TextFile, kind: str) -> Path:
    """The file of another kind beside the observations: same ending, or for the calibration none."""
    if FACTORS not in file.path.name:
        raise file.error(f"holds stereo observations; expected {FACTORS} in its name, to find {kind} beside it")
    path = file.path.with_name(file.path.name.replace(FACTORS, kind))
    shared = file.path.with_name(f"VO_{CALIBRATION}.txt")
    if kind == CALIBRATION and not path.is_file() and shared.is_file():
        return shared  # as of VO_stereo_factors_large.txt in GTSAM's data
    if not path.is_file():
        raise file.error(f"expected {path.name} beside it, which is missing")
    return path


def _camera_poses(path: Path) -> dict[int, gtsam.Pose3]:
    """Poses by camera, ascending, with rotations brought from six digits to the nearest rotation."""
    file = read_lines(path)
    table = file.rows(ids=1, widths=[16])
    matrices = table.numbers.reshape(-1, 4, 4)
    rotations = matrices[:, :3, :3]
    errors = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    is_rigid = (errors < ORTHONORMAL) & (np.linalg.det(rotations) > 0.0)
    bad = np.flatnonzero(~is_rigid | (matrices[:, 3] != [0.0, 0.0, 0.0, 1.0]).any(axis=1))
    if bad.size:
        raise file.error("expected a rigid motion as a 4x4 matrix by rows", table.lines[bad[0]])
    u, _, vt = np.linalg.svd(rotations)
    placed = zip(u @ vt, matrices[:, :3, 3], strict=True)
    poses = (gtsam.Pose3(gtsam.Rot3(rotation), position) for rotation, position in placed)
    return dict(sorted(by_identifier(file, "camera", table, poses).items()))


def _calibration(path: Path) -> gtsam.Cal3_S2Stereo:
    file = read_lines(path)
    table = file.rows(ids=0, widths=[6])
    if len(table.numbers) != 1 or min(table.numbers[0, [0, 1, 5]]) <= 0.0:
        raise file.error("expected one line fx fy skew u0 v0 baseline with positive fx, fy and baseline")
    return gtsam.Cal3_S2Stereo(*table.numbers[0].tolist())


def _odometry(poses: dict[int, gtsam.Pose3]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array(ODOMETRY_SIGMAS))
    for (i, before), (j, after) in pairwise(poses.items()):
        step = before.between(after)
        graph.push_back(gtsam.BetweenFactorPose3(gtsam.symbol("x", i), gtsam.symbol("x", j), step, model))
    return graph


def _add_observations(graph: gtsam.NonlinearFactorGraph, table: Table, calibration: gtsam.Cal3_S2Stereo) -> None:
    model = gtsam.noiseModel.Isotropic.Sigma(3, PIXEL_SIGMA)
    pixels: Sequence[Sequence[float]] = table.numbers[:, :3].tolist()
    for (camera, landmark), (u_left, u_right, v) in zip(table.ids.tolist(), pixels, strict=True):
        x, point = gtsam.symbol("x", camera), gtsam.symbol("l", landmark)
        seen = gtsam.StereoPoint2(u_left, u_right, v)
        graph.push_back(gtsam.GenericStereoFactor3D(seen, model, x, point, calibration))


def _values(poses: dict[int, gtsam.Pose3], table: Table) -> gtsam.Values:
    values = gtsam.Values()
    for camera, pose in poses.items():
        values.insert(gtsam.symbol("x", camera), pose)
    _, first = np.unique(table.ids[:, 1], return_index=True)
    for camera, landmark, point in zip(*table.ids[first].T.tolist(), table.numbers[first, 3:], strict=True):
        values.insertPoint3(gtsam.symbol("l", landmark), poses[camera].transformFrom(point))
    return values


def _recognises(source: Source) -> bool:
    first = source.first
    return len(first) == WIDTH and all(map(is_number, first)) and first[0].isdecimal() and first[1].isdecimal()


FORMAT = Format(NAME, _recognises, parse)
