"""g2o text files, planar and spatial, with landmarks, in the dialects of the writing programs.

Edges: ``EDGE_SE2``, ``EDGE_SE3:QUAT``, the same with a switch or a weight in front of the measurement (Vertigo, also
written by RTAB-Map), between sensors that sit off their bodies (``EDGE_SE3_OFFSET``), of cameras (see `g2o_cameras`),
and TORO's (SLAM++). Information is an upper triangle, a full matrix, or left out. Landmarks: see `g2o_landmarks`.
``EDGE_SE3_PRIORXYZ`` is a position. Identifiers may be GTSAM symbols or negative. ``FIX`` is a wish to the optimiser,
not a factor. A comment ``# 3 7 ROBUST Huber 1.345`` gives the edge on the next line a robust loss (see `losses`).

Information matrices are taken as written, as GTSAM takes them. Two traps in them are the user's to judge:
g2o counts the rotation of an EDGE_SE3:QUAT in the quaternion's vector part, four times the information of
the rotation vector, and files that come from iSAM hold the square root of the information (the wheel's
``victoriaPark_reduced_1k.g2o`` does, compared with ``victoria_park.txt``).
"""

from __future__ import annotations

import re
from collections.abc import Set
from dataclasses import replace

import gtsam

from pgti_gtsam.datasets.assembly import Entry, assemble, planar_poses, quaternion_poses
from pgti_gtsam.datasets.chain import LETTER, Pose
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.formats import toro
from pgti_gtsam.datasets.g2o_cameras import CAMERA_TAGS, camera_edges, camera_poses
from pgti_gtsam.datasets.g2o_edges import EDGES, pose_edges
from pgti_gtsam.datasets.g2o_landmarks import LANDMARK_TAGS, SIGHTING_TAGS, landmarks, points, without_tags
from pgti_gtsam.datasets.landmarks import landmark_identifier
from pgti_gtsam.datasets.noise import POINT_3, information, information_models
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import TextFile, by_identifier, note_ignored

NAME = "g2o"
POSES = {"VERTEX_SE2": 3, "TUTORIAL_VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7, "VERTEX_SE3": 7}
POSITION = "EDGE_SE3_PRIORXYZ"
NEGATIVE = re.compile(r"-[0-9]{1,19}")  # identifiers of more digits are refused
TAGS = {*POSES, *EDGES, *LANDMARK_TAGS, *CAMERA_TAGS, POSITION}
QUIET = {*TAGS, *toro.TAGS, "FIX", "VERTEX_SWITCH", "EDGE_SWITCH_PRIOR", "PARAMS_SE2OFFSET", "PARAMS_SE3OFFSET"}
QUIET |= {"TUTORIAL_PARAMS_SE2_OFFSET", "PARAMS_CAMERAPARAMETERS"}


def parse(source: Source) -> Dataset:
    """The graph of a g2o file.

    Raises
    ------
    FileFormatError
        A malformed line, a vertex defined twice or not at all, a zero quaternion, a sensor offset without its
        parameter, a full information matrix that is not symmetric, an unknown line that ties two poses.
    """
    # poses and what ties them, in all dialects
    file = _without_negative_ids(source.file)
    cameras = camera_poses(file)
    poses = {**pose_vertices(file), **toro.vertices(file), **cameras.poses}
    entries = [*pose_edges(file), *toro.edges(file), *camera_edges(file, cameras), *positions(file)]

    # landmarks
    tagged = without_tags(file, poses, entries)
    sightings = [*landmarks(file), *toro.sightings(file), *tagged.sightings]

    _remark(file)
    dataset = assemble(
        file,
        format=NAME,
        poses=tagged.poses,
        points={**points(file), **tagged.points},
        entries=tagged.entries,
        sightings=sightings,
        known=QUIET,
    )
    keys = {*tagged.poses, *(key for entry in tagged.entries for key in entry.poses)}
    return replace(dataset, names=_names(dataset.values, keys, file.shift))


def pose_vertices(file: TextFile) -> dict[int, Pose]:
    """Stored poses by key; raises as `parse` does."""
    poses: dict[int, Pose] = {}
    for tag, width in POSES.items():
        if tag not in file.tags:
            continue
        table = file.table(tag, ids=1, widths=[width], poses=1)
        made = planar_poses(table.numbers) if width == 3 else quaternion_poses(file, table)
        poses |= by_identifier(file, tag, table, made, poses)
    return poses


def positions(file: TextFile) -> list[Entry]:
    """EDGE_SE3_PRIORXYZ: the position of a pose in the world, measured by a satellite receiver."""
    table = file.table(POSITION, ids=1, widths=[3 + width for width in (0, *POINT_3)], poses=1)
    models = information_models(file, table, information(file, table, table.numbers[:, 3:], POINT_3, POSITION))
    rows = zip(table.lines.tolist(), table.ids[:, 0].tolist(), table.numbers[:, :3], models, strict=True)
    return [Entry(line, (key,), gtsam.GPSFactor(key, position, model)) for line, key, position, model in rows]


def _names(values: gtsam.Values, poses: Set[int], shift: int) -> dict[int, str]:
    """Identifiers by key, where the identifiers of poses differ from the keys."""
    if not shift and max(poses, default=0) >> LETTER == 0:
        return {}
    keys = values.keys()
    return {key: str(key - shift if key in poses else landmark_identifier(key)) for key in keys}


def _without_negative_ids(file: TextFile) -> TextFile:
    tags = [tag for tag in POSES if tag in file.tags] or [tag for tag in EDGES if tag in file.tags]
    ends = slice(1, 2 if tags and tags[0] in POSES else 3)
    words = [word for tag in tags for line in file.tags[tag] for word in line.text.split(None, 3)[ends]]
    lowest = min((int(word) for word in words if NEGATIVE.fullmatch(word)), default=0)
    if lowest < 0:
        file.notes.append(f"identifiers are negative: keys of poses are identifiers + {-lowest}")
    return replace(file, shift=-lowest)


def _remark(file: TextFile) -> None:
    if fixed := len(file.tags.get("FIX", ())):
        file.notes.append(f"{fixed} FIX lines are wishes to the optimiser and make no factor")
    if positions := len(file.tags.get(POSITION, ())):
        file.notes.append(f"{positions} {POSITION} lines are read as GPS factors")
    if SIGHTING_TAGS & file.tags.keys():
        file.notes.append("sightings of landmarks are read as bearing-range factors")
    note_ignored(file, QUIET)


FORMAT = Format(NAME, lambda source: bool(TAGS & source.tags), parse)
