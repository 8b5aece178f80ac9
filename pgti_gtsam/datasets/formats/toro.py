"""TORO ``.graph`` files and iSAM relatives, planar and spatial.

``VERTEX2 id x y θ``, ``EDGE2 i j x y θ I11 I12 I22 I33 I13 I23`` (TORO) or ``I11 I12 I13 I22 I23 I33`` (iSAM
and others): the order is the first in which all matrices of the file are positive semidefinite, TORO's order first.
``VERTEX3 id x y z roll pitch yaw``, ``EDGE3 i j x y z roll pitch yaw`` with nothing or the upper triangle of
the information behind the measurement, translation before rotation (GTSAM's reader does not swap the two; the g2o
version of ``sphere2500`` shows the swap). ``BR pose landmark bearing range σ_bearing σ_range`` is a landmark.
``EQUIV i j`` says that two poses lie in one grid cell, up to a cell's width apart (1.05 m in ``w100.graph``),
and each has an EDGE2 of its own: the line adds no measurement and is ignored.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, assemble, between_entries, euler_poses, planar_poses
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting, landmark_key
from pgti_gtsam.datasets.noise import SPACE, TORO_3, UPPER_3, information, information_models, is_semidefinite
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import TextFile, by_identifier, note_ignored

NAME = "TORO graph"
TAGS = {"VERTEX2", "EDGE2", "VERTEX3", "EDGE3", "BR"}


def parse(source: Source) -> Dataset:
    """The graph of a TORO file.

    Raises
    ------
    FileFormatError
        A malformed line, a vertex defined twice or not at all, a landmark at no positive range, an unknown line
        that ties two poses.
    """
    file = source.file
    poses, entries, seen = vertices(file), edges(file), sightings(file)
    note_ignored(file, TAGS)
    return assemble(file, format=NAME, poses=poses, entries=entries, sightings=seen, known={*TAGS, "EQUIV"})


def vertices(file: TextFile) -> dict[int, Pose]:
    """Poses of VERTEX2 and VERTEX3 lines."""
    poses: dict[int, Pose] = {}
    for tag, width, make in (("VERTEX2", 3, planar_poses), ("VERTEX3", 6, euler_poses)):
        table = file.table(tag, ids=1, widths=[width], poses=1)
        made: list[Pose] = make(table.numbers)
        poses |= by_identifier(file, tag, table, made, poses)
    return poses


def edges(file: TextFile) -> list[Entry]:
    """Between factors of EDGE2 and EDGE3 lines."""
    planar = file.table("EDGE2", ids=2, widths=[3, 3 + 6], poses=2)
    order = _order(file, planar.numbers[:, 3:])
    matrices = information(file, planar, planar.numbers[:, 3:], {6: order}, "EDGE2")
    entries = between_entries(file, planar, planar_poses(planar.numbers), information_models(file, planar, matrices))

    spatial = file.table("EDGE3", ids=2, widths=[6 + width for width in (0, *SPACE)], poses=2)
    matrices = information(file, spatial, spatial.numbers[:, 6:], SPACE, "EDGE3")
    models = information_models(file, spatial, matrices)
    return [*entries, *between_entries(file, spatial, euler_poses(spatial.numbers), models)]


def _order(file: TextFile, rows: NDArray[np.float64]) -> NDArray[np.int64]:
    """The order that makes the information of all rows semidefinite, TORO's if both do."""
    if not rows.size or is_semidefinite(rows[:, TORO_3]).all() or not is_semidefinite(rows[:, UPPER_3]).all():
        return TORO_3
    file.notes.append("EDGE2 information is read as an upper triangle by rows: in TORO's order it is not semidefinite")
    return UPPER_3


def sightings(file: TextFile) -> list[Sighting]:
    """BR lines: bearing and its sigma in radians, range and its sigma in metres."""
    table = file.table("BR", ids=2, widths=[4], poses=1)
    bad = np.flatnonzero((table.numbers[:, 1:] <= 0.0).any(axis=1))
    if bad.size:
        raise file.error("expected BR with positive range and sigmas", table.lines[bad[0]])
    found = []
    for line, (pose, identifier), row in zip(table.lines.tolist(), table.ids.tolist(), table.numbers, strict=True):
        bearing, range_m, sigmas = gtsam.Rot2(row[0]), float(row[1]), row[2:]
        point = range_m * np.array([bearing.c(), bearing.s()])
        model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        landmark = landmark_key(identifier)
        factor = gtsam.BearingRangeFactor2D(pose, landmark, bearing, range_m, model)
        found.append(Sighting(line, pose, landmark, point, factor))
    return found


FORMAT = Format(NAME, lambda source: bool(TAGS & source.tags), parse)
