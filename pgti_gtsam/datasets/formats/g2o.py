"""g2o text files, planar and spatial, with landmarks.

Lines that are read: ``VERTEX_SE2``, ``VERTEX_SE3:QUAT``, ``VERTEX_XY``, ``VERTEX_TRACKXYZ`` (also
``VERTEX_POINT_XYZ``), ``EDGE_SE2``, ``EDGE_SE3:QUAT``, ``EDGE_SE2_XY`` (also ``LANDMARK2``),
``EDGE_SE3_TRACKXYZ`` with its ``PARAMS_SE3OFFSET``, ``EDGE_SE3_PRIORXYZ``. ``FIX`` is a wish to the
optimiser, not a factor. GTSAM's own reader drops LANDMARK2, EDGE_SE3_PRIORXYZ and refuses sensor offsets.
A comment ``# 3 7 ROBUST Huber 1.345`` gives the edge on the next line a robust loss (see `losses`).

Information matrices are taken as written, as GTSAM takes them. Two traps in them are the user's to judge:
g2o counts the rotation of an EDGE_SE3:QUAT in the quaternion's vector part, four times the information of
the rotation vector, and files that come from iSAM hold the square root of the information (the wheel's
``victoriaPark_reduced_1k.g2o`` does, compared with ``victoria_park.txt``).
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, assemble, between_entries, planar_poses, quaternion_poses
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting, landmark_key, sightings
from pgti_gtsam.datasets.noise import UPPER_2, UPPER_3, UPPER_6_SWAPPED, information_models
from pgti_gtsam.datasets.text import TextFile, by_identifier, note_ignored

FORMAT = "g2o"
POSES = {"VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7}
POINTS = {"VERTEX_XY": 2, "VERTEX_TRACKXYZ": 3, "VERTEX_POINT_XYZ": 3}
PLANAR_SIGHTINGS = ("EDGE_SE2_XY", "LANDMARK2")
TAGS = {*POSES, *POINTS, *PLANAR_SIGHTINGS}
TAGS |= {"EDGE_SE2", "EDGE_SE3:QUAT", "EDGE_SE3_TRACKXYZ", "EDGE_SE3_PRIORXYZ"}
QUIET = {*TAGS, "PARAMS_SE3OFFSET", "FIX"}


def parse(file: TextFile) -> Dataset:
    """The graph of a g2o file.

    Raises
    ------
    FileFormatError
        A malformed line, a vertex defined twice or not at all, an information matrix with a negative
        eigenvalue, a zero quaternion, a sensor offset without its parameter.
    """
    planar, planar_notes = _planar_sightings(file)
    spatial, spatial_notes = _spatial_sightings(file)
    return assemble(
        file,
        format=FORMAT,
        poses=_poses(file),
        points=_points(file),
        entries=[*_planar_edges(file), *_spatial_edges(file), *_positions(file)],
        sightings=[*planar, *spatial],
        notes=[*_remarks(file), *planar_notes, *spatial_notes, *note_ignored(file, QUIET)],
    )


def _poses(file: TextFile) -> dict[int, Pose]:
    poses: dict[int, Pose] = {}
    for tag, width in POSES.items():
        table = file.table(tag, ids=1, widths=[width])
        made = planar_poses(table.numbers) if width == 3 else quaternion_poses(file, table)
        poses |= by_identifier(file, tag, table, made, poses)
    return poses


def _points(file: TextFile) -> dict[int, NDArray[np.float64]]:
    points: dict[int, NDArray[np.float64]] = {}
    for tag, width in POINTS.items():
        table = file.table(tag, ids=1, widths=[width])
        points |= by_identifier(file, tag, table, table.numbers, points)
    return {landmark_key(identifier): point for identifier, point in points.items()}


def _planar_edges(file: TextFile) -> list[Entry]:
    table = file.table("EDGE_SE2", ids=2, widths=[3 + 6])
    models = information_models(file, table, table.numbers[:, 3:][:, UPPER_3])
    return between_entries(file, table, planar_poses(table.numbers[:, :3]), models)


def _spatial_edges(file: TextFile) -> list[Entry]:
    table = file.table("EDGE_SE3:QUAT", ids=2, widths=[7 + 21])
    models = information_models(file, table, table.numbers[:, 7:][:, UPPER_6_SWAPPED])
    return between_entries(file, table, quaternion_poses(file, table), models)


def _positions(file: TextFile) -> list[Entry]:
    """EDGE_SE3_PRIORXYZ: the position of a pose in the world, measured by a satellite receiver."""
    table = file.table("EDGE_SE3_PRIORXYZ", ids=1, widths=[3 + 6])
    models = information_models(file, table, table.numbers[:, 3:][:, UPPER_3])
    return [
        Entry(line, (key,), gtsam.GPSFactor(key, position, model))
        for line, (key,), position, model in zip(
            table.lines.tolist(), table.ids.tolist(), table.numbers[:, :3], models, strict=True
        )
    ]


def _planar_sightings(file: TextFile) -> tuple[list[Sighting], list[str]]:
    found, notes = [], []
    for tag in PLANAR_SIGHTINGS:
        table = file.table(tag, ids=2, widths=[2 + 3])
        more, remarks = sightings(file, table, table.numbers[:, :2], table.numbers[:, 2:][:, UPPER_2])
        found += more
        notes += remarks
    return found, notes


def _spatial_sightings(file: TextFile) -> tuple[list[Sighting], list[str]]:
    """EDGE_SE3_TRACKXYZ: pose, landmark, offset parameter, a point seen by a sensor that sits off the body."""
    table = file.table("EDGE_SE3_TRACKXYZ", ids=3, widths=[3 + 6])
    offsets = _sensor_offsets(file)
    for line, offset in zip(table.lines.tolist(), table.ids[:, 2].tolist(), strict=True):
        if offset not in offsets:
            raise file.error(f"sensor offset {offset} has no PARAMS_SE3OFFSET line", line)
    sensors = [offsets[offset] for offset in table.ids[:, 2].tolist()]
    seen = zip(sensors, table.numbers[:, :3], strict=True)
    points = np.array([sensor.transformFrom(point) for sensor, point in seen]).reshape(-1, 3)
    rotations = np.array([sensor.rotation().matrix() for sensor in sensors]).reshape(-1, 3, 3)
    information = rotations @ table.numbers[:, 3:][:, UPPER_3] @ rotations.transpose(0, 2, 1)
    return sightings(file, table, points, information)


def _sensor_offsets(file: TextFile) -> dict[int, gtsam.Pose3]:
    table = file.table("PARAMS_SE3OFFSET", ids=1, widths=[7])
    return by_identifier(file, "PARAMS_SE3OFFSET", table, quaternion_poses(file, table))


def _remarks(file: TextFile) -> list[str]:
    notes = []
    if fixed := len(file.tags.get("FIX", ())):
        notes.append(f"{fixed} FIX lines are wishes to the optimiser and make no factor")
    if positions := len(file.tags.get("EDGE_SE3_PRIORXYZ", ())):
        notes.append(f"{positions} EDGE_SE3_PRIORXYZ lines are read as GPS factors")
    if any(tag in file.tags for tag in (*PLANAR_SIGHTINGS, "EDGE_SE3_TRACKXYZ")):
        notes.append("sightings of landmarks are read as bearing-range factors")
    return notes
