"""TORO ``.graph`` files and their iSAM relatives, planar and spatial.

``VERTEX2 id x y θ``, ``EDGE2 i j x y θ I11 I12 I22 I33 I13 I23`` (TORO) or ``I11 I12 I13 I22 I23 I33`` (iSAM
and others): the order is the one in which all matrices of the file are positive semidefinite, TORO's first.
``VERTEX3 id x y z roll pitch yaw``, ``EDGE3 i j x y z roll pitch yaw`` with nothing or the upper triangle of
the information behind it, translation before rotation (GTSAM's reader does not swap them; the g2o version of
``sphere2500`` shows that it should). ``BR pose landmark bearing range σ_bearing σ_range`` is a landmark.
``EQUIV i j`` says that two poses lie in one grid cell, up to a cell's width apart (1.05 m in ``w100.graph``),
and each has its own EDGE2: it adds no measurement and is ignored.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, assemble, between_entries, euler_poses, planar_poses
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting, landmark_key
from pgti_gtsam.datasets.noise import TORO_3, UPPER_3, UPPER_6_SWAPPED, information_models, is_semidefinite
from pgti_gtsam.datasets.text import TextFile, by_identifier, note_ignored

FORMAT = "TORO graph"
TAGS = {"VERTEX2", "EDGE2", "VERTEX3", "EDGE3", "BR"}


def parse(file: TextFile) -> Dataset:
    """The graph of a TORO file.

    Raises
    ------
    FileFormatError
        A malformed line, a vertex defined twice or not at all, an information matrix with a negative
        eigenvalue, a landmark at no positive range.
    """
    planar, planar_notes = planar_edges(file)
    spatial, spatial_notes = _spatial_edges(file)
    return assemble(
        file,
        format=FORMAT,
        poses=vertices(file),
        entries=[*planar, *spatial],
        sightings=_sightings(file),
        notes=[*planar_notes, *spatial_notes, *note_ignored(file, TAGS)],
    )


def vertices(file: TextFile) -> dict[int, Pose]:
    """Poses of VERTEX2 and VERTEX3 lines."""
    poses: dict[int, Pose] = {}
    for tag, width, make in (("VERTEX2", 3, planar_poses), ("VERTEX3", 6, euler_poses)):
        table = file.table(tag, ids=1, widths=[width])
        made: list[Pose] = make(table.numbers)
        poses |= by_identifier(file, tag, table, made, poses)
    return poses


def planar_edges(file: TextFile) -> tuple[list[Entry], list[str]]:
    """Between factors of EDGE2 lines, and a sentence where their information is not in TORO's order."""
    table = file.table("EDGE2", ids=2, widths=[3 + 6])
    information, notes = _ordered_information(table.numbers[:, 3:])
    models = information_models(file, table, information)
    return between_entries(file, table, planar_poses(table.numbers[:, :3]), models), notes


def _ordered_information(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[str]]:
    as_toro, as_triangle = rows[:, TORO_3], rows[:, UPPER_3]
    if is_semidefinite(as_toro).all() or not is_semidefinite(as_triangle).all():
        return as_toro, []
    note = "EDGE2 information is read as an upper triangle by rows: in TORO's order it is not semidefinite"
    return as_triangle, [note]


def _spatial_edges(file: TextFile) -> tuple[list[Entry], list[str]]:
    table = file.table("EDGE3", ids=2, widths=[6, 6 + 21])
    notes, information = [], table.numbers[:, 6:]
    if table.ids.size and not information.size:
        notes = ["the EDGE3 lines hold no information: unit matrices are assumed"]
        information = np.tile(np.eye(6)[np.triu_indices(6)], (len(table.ids), 1))
    models = information_models(file, table, information[:, UPPER_6_SWAPPED]) if table.ids.size else []
    return between_entries(file, table, euler_poses(table.numbers), models), notes


def _sightings(file: TextFile) -> list[Sighting]:
    """BR lines: bearing and its sigma in radians, range and its sigma in metres."""
    table = file.table("BR", ids=2, widths=[4])
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
