"""Landmarks of g2o files.

``VERTEX_XY``, ``VERTEX_TRACKXYZ`` (also ``VERTEX_POINT_XYZ``) and those of g2o's tutorial; sightings ``EDGE_SE2_XY``
(also ``LANDMARK2``), ``EDGE_SE3_XYZ``, ``EDGE_SE3_TRACKXYZ`` with its ``PARAMS_SE3OFFSET``, ``EDGE_BEARING_SE2_XY``.
GTSAM's reader drops LANDMARK2 and refuses sensor offsets. RTAB-Map writes a tag (AprilTag, ArUco) as one more pose and
its sightings as ``EDGE_SE3``: the tag becomes a landmark at that pose's position; the orientation is of no use here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, quaternion_poses
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.landmarks import Sighting, landmark_key, sightings
from pgti_gtsam.datasets.noise import POINT_2, POINT_3, information, information_models
from pgti_gtsam.datasets.text import Table, TextFile, by_identifier

POINTS = {
    "VERTEX_XY": 2,
    "TUTORIAL_VERTEX_POINT_XY": 2,
    "VERTEX_TRACKXYZ": 3,
    "VERTEX_POINT_XYZ": 3,
    "VERTEX_XYZ": 3,
}
PLANAR = {"EDGE_SE2_XY": 2, "LANDMARK2": 2, "TUTORIAL_EDGE_SE2_POINT_XY": 3}  # identifiers
SPATIAL, CENTRED, BEARING, TAGGED = "EDGE_SE3_TRACKXYZ", "EDGE_SE3_XYZ", "EDGE_BEARING_SE2_XY", "EDGE_SE3"
SIGHTING_TAGS = {*PLANAR, SPATIAL, CENTRED, BEARING}
LANDMARK_TAGS = {*POINTS, *SIGHTING_TAGS}


def points(file: TextFile) -> dict[int, NDArray[np.float64]]:
    """Stored landmarks by key."""
    found: dict[int, NDArray[np.float64]] = {}
    for tag, width in POINTS.items():
        table = file.table(tag, ids=1, widths=[width])
        found |= by_identifier(file, tag, table, table.numbers, found)
    return {landmark_key(identifier): point for identifier, point in found.items()}


def landmarks(file: TextFile) -> list[Sighting]:
    """All sightings of points."""
    found = []
    for tag, ids in PLANAR.items():
        table = file.table(tag, ids=ids, widths=[2 + width for width in (0, *POINT_2)], poses=1)
        matrices = information(file, table, table.numbers[:, 2:], POINT_2, tag)
        found += sightings(file, table, table.numbers[:, :2], matrices)
    centred = file.table(CENTRED, ids=2, widths=[3 + width for width in (0, *POINT_3)], poses=1)
    matrices = information(file, centred, centred.numbers[:, 3:], POINT_3, CENTRED)
    found += sightings(file, centred, centred.numbers[:, :3], matrices)
    return [*found, *_spatial(file), *_bearings(file)]


def _spatial(file: TextFile) -> list[Sighting]:
    """EDGE_SE3_TRACKXYZ: pose, landmark, offset parameter, a point seen by a sensor that sits off the body."""
    table = file.table(SPATIAL, ids=3, widths=[3 + width for width in (0, *POINT_3)], poses=1)
    offsets = _sensor_offsets(file)
    for line, offset in zip(table.lines.tolist(), table.ids[:, 2].tolist(), strict=True):
        if offset not in offsets:
            advice = f"add 'PARAMS_SE3OFFSET {offset} 0 0 0 0 0 0 1' if the sensor sits where the body is"
            raise file.error(f"sensor offset {offset} has no PARAMS_SE3OFFSET line; {advice}", line)
    sensors = [offsets[offset] for offset in table.ids[:, 2].tolist()]
    seen = zip(sensors, table.numbers[:, :3], strict=True)
    places = np.array([sensor.transformFrom(point) for sensor, point in seen]).reshape(-1, 3)
    rotations = np.array([sensor.rotation().matrix() for sensor in sensors]).reshape(-1, 3, 3)
    matrices = information(file, table, table.numbers[:, 3:], POINT_3, SPATIAL)
    return sightings(file, table, places, rotations @ matrices @ rotations.transpose(0, 2, 1))


def _sensor_offsets(file: TextFile) -> dict[int, gtsam.Pose3]:
    table = file.table("PARAMS_SE3OFFSET", ids=1, widths=[7])
    return by_identifier(file, "PARAMS_SE3OFFSET", table, quaternion_poses(file, table))


def _bearings(file: TextFile) -> list[Sighting]:
    """EDGE_BEARING_SE2_XY: pose, landmark, bearing in radians, information; the landmark needs a vertex."""
    table = file.table(BEARING, ids=2, widths=[1 + 1], poses=1)
    models = information_models(file, table, table.numbers[:, 1:, None])
    found = []
    for line, (pose, identifier), bearing, model in zip(
        table.lines.tolist(), table.ids.tolist(), table.numbers[:, 0].tolist(), models, strict=True
    ):
        landmark = landmark_key(identifier)
        factor = gtsam.BearingFactor2D(pose, landmark, gtsam.Rot2(bearing), model)
        found.append(Sighting(line, pose, landmark, None, factor))
    return found


class Tagged(NamedTuple):
    """Poses and factors of a graph without its tags, the tags as points by key, and their sightings."""

    poses: dict[int, Pose]
    entries: list[Entry]
    points: dict[int, NDArray[np.float64]]
    sightings: list[Sighting]


def without_tags(file: TextFile, poses: Mapping[int, Pose], entries: Sequence[Entry]) -> Tagged:
    """The tags of a graph that RTAB-Map wrote, as landmarks.

    RTAB-Map writes the parameters of a sensor in any graph and a tag behind the last keyframe. So a tag is a vertex
    from which no edge leads away, with an identifier beyond the keyframe that the last edge leads to.

    Parameters
    ----------
    file : TextFile
    poses : mapping
        Poses by key.
    entries : sequence of Entry
        Factors.
    """
    sources = [entry.poses[0] for entry in entries if len(entry.poses) == 2]
    last = max(sources, default=0) + 1
    targets = {entry.poses[-1] for entry in entries if len(entry.poses) == 2}
    tags = {key for key in targets & poses.keys() if key > last}
    if not tags or not ({"PARAMS_SE2OFFSET", "PARAMS_SE3OFFSET", TAGGED} & file.tags.keys()):
        return Tagged(dict(poses), list(entries), {}, [])

    # the translation of such an edge is a sighting of a point
    seen = [entry for entry in entries if entry.poses[-1] in tags]
    factors: list[Any] = [entry.factor for entry in seen]
    rotations = [factor.measured().rotation().matrix() for factor in factors]
    places = np.array([factor.measured().translation() for factor in factors])
    d = places.shape[1]
    blocks = [factor.noiseModel().information()[-3:, -3:][:d, :d] for factor in factors]
    matrices = np.array([turn @ block @ turn.T for turn, block in zip(rotations, blocks, strict=True)])
    ids = np.array([entry.poses for entry in seen], np.int64)
    table = Table(lines=np.array([entry.line for entry in seen]), ids=ids, numbers=places)
    file.notes.append(f"{len(tags)} tags with an orientation are read as landmarks, in {len(seen)} sightings")
    return Tagged(
        {key: pose for key, pose in poses.items() if key not in tags},
        [entry for entry in entries if entry.poses[-1] not in tags],
        {landmark_key(key): np.asarray(poses[key].translation()) for key in tags},
        sightings(file, table, places, matrices),
    )
