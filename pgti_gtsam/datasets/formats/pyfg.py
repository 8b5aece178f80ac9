"""PyFG text (PyFactorGraph, CORA): g2o's tags with timestamps, names in place of numbers, and COVARIANCES.

``VERTEX_SE2 time A0 x y θ``, ``VERTEX_SE3:QUAT time A0 x y z qx qy qz qw``, ``VERTEX_XY L0 x y``, ``VERTEX_XYZ``;
``EDGE_SE2 time A0 A1 x y θ C``, ``EDGE_SE3:QUAT``, ``EDGE_SE2_XY time A0 L0 x y C``, ``EDGE_SE3_XYZ``,
``EDGE_RANGE time A0 L0 range variance``. C is an upper triangle by rows, translation first. A name is a letter and a
number, and so the key of a GTSAM symbol: robots are told by letter.
"""

from __future__ import annotations

import re
from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, assemble, between_entries, planar_poses, quaternion_poses
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting, sightings
from pgti_gtsam.datasets.noise import SPACE, UPPER_2, UPPER_3, information_models, inverse_covariances
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import Line, Table, TextFile, by_identifier, note_ignored, parse_table, quote
from pgti_gtsam.pose_graph import key_label

NAME = "PyFG graph"
VERTICES = {"VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7}
POINTS = {"VERTEX_XY": 2, "VERTEX_XYZ": 3}
EDGES = {"EDGE_SE2": (3, UPPER_3), "EDGE_SE3:QUAT": (7, SPACE[21])}  # numbers of the pose, where those of C stand
SIGHTINGS = {"EDGE_SE2_XY": (2, UPPER_2), "EDGE_SE3_XYZ": (3, UPPER_3)}
RANGE = "EDGE_RANGE"
TAGS = {*VERTICES, *POINTS, *EDGES, *SIGHTINGS, RANGE}
SYMBOL = re.compile(r"([A-Za-z])([0-9]{1,15})", re.ASCII)


def parse(source: Source) -> Dataset:
    """The graph of a PyFG file.

    Raises
    ------
    FileFormatError
        A malformed line, a name that is no letter with a number, a covariance that is not positive definite.
    """
    file = source.file
    poses: dict[int, Pose] = {}
    for tag, width in VERTICES.items():
        table = _table(file, tag, names=1, width=width)
        made = planar_poses(table.numbers) if width == 3 else quaternion_poses(file, table)
        poses |= by_identifier(file, tag, table, made, poses)
    points: dict[int, NDArray[np.float64]] = {}
    for tag, width in POINTS.items():
        table = _table(file, tag, names=1, width=width, timed=False)
        points |= by_identifier(file, tag, table, table.numbers, points)
    entries, seen = _edges(file), [*_sightings(file), *_ranges(file, poses)]
    ignored = _unknown_edges(file)
    note_ignored(file, TAGS)
    dataset = assemble(
        file, format=NAME, poses=poses, points=points, entries=entries, sightings=seen, known={*TAGS, *file.tags}
    )
    return replace(dataset, ignored_edges=ignored, names={key: key_label(key) for key in dataset.values.keys()})  # noqa: SIM118  no mapping


def _unknown_edges(file: TextFile) -> int:
    """Edges of unknown tags: refused, or counted where that is asked for."""
    unknown = [line for tag in file.tags.keys() - TAGS if "EDGE" in tag for line in file.tags[tag]]
    if unknown and not file.ignore_unknown:
        tags = ", ".join(sorted({quote(line.fields[0]) for line in unknown}))
        raise file.error(f"{tags} is not known; leave such edges out with --ignore-unknown", unknown[0].number)
    return len(unknown)


def _edges(file: TextFile) -> list[Entry]:
    entries = []
    for tag, (size, places) in EDGES.items():
        table = _table(file, tag, names=2, width=size + _triangle(places))
        information = inverse_covariances(file, table, table.numbers[:, size:][:, places])
        measured: list[Pose] = planar_poses(table.numbers) if size == 3 else quaternion_poses(file, table)
        entries += between_entries(file, table, measured, information_models(file, table, information))
    return entries


def _sightings(file: TextFile) -> list[Sighting]:
    found = []
    for tag, (size, places) in SIGHTINGS.items():
        table = _table(file, tag, names=2, width=size + _triangle(places))
        information = inverse_covariances(file, table, table.numbers[:, size:][:, places])
        found += sightings(file, table, table.numbers[:, :size], information)
    return found


def _ranges(file: TextFile, poses: dict[int, Pose]) -> list[Sighting]:
    """Ranges to landmarks; a range between two poses says nothing of free space and is left out."""
    table = _table(file, RANGE, names=2, width=2)
    is_landmark = ~np.isin(table.ids[:, 1], list(poses))
    if lost := int((~is_landmark).sum()):
        file.notes.append(f"{lost} ranges between two poses are left out")
    kept = table.where(is_landmark)
    models = information_models(file, kept, inverse_covariances(file, kept, kept.numbers[:, 1:, None]))
    make = gtsam.RangeFactor2D if isinstance(next(iter(poses.values()), None), gtsam.Pose2) else gtsam.RangeFactor3D
    rows = zip(kept.lines.tolist(), kept.ids.tolist(), kept.numbers[:, 0].tolist(), models, strict=True)
    return [Sighting(line, i, j, None, make(i, j, range_m, model)) for line, (i, j), range_m, model in rows]


def _table(file: TextFile, tag: str, *, names: int, width: int, timed: bool = True) -> Table:
    """Lines of a tag with keys in place of names, timestamps left out."""
    lines = []
    for line in file.tags.get(tag, ()):
        fields = line.fields[2 if timed else 1 :]
        keys = [_key(file, line, name) for name in fields[:names]]
        lines.append(Line(line.number, " ".join([tag, *map(str, keys), *fields[names:]])))
    return parse_table(file, lines, ids=names, widths=[width], first=1)


def _key(file: TextFile, line: Line, name: str) -> int:
    match = SYMBOL.fullmatch(name)
    if not match:
        raise file.error("expected a name of a letter and a number, as A0", line.number)
    return int(gtsam.symbol(match[1], int(match[2])))


def _triangle(places: NDArray[np.int64]) -> int:
    return int(places.max()) + 1


def _recognises(source: Source) -> bool:
    lines = [source.file.tags[tag][0] for tag in (*VERTICES, *EDGES) if tag in source.tags]
    return bool(lines) and len(lines[0].fields) > 2 and SYMBOL.fullmatch(lines[0].fields[2]) is not None


FORMAT = Format(NAME, _recognises, parse)
