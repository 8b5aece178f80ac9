"""RTAB-Map databases (``.db``, SQLite): the tables Node and Link, and the optimised poses of Admin.

A pose is twelve float32, the upper 3x4 of a matrix by rows; the information of a link is 36 float64, translation first.
Every link is stored in both directions. Optimised poses are one float32 matrix, deflated, with rows, columns and
OpenCV's type as three int32 behind. Landmarks (tags) have negative identifiers (DatabaseSchema.sql, Link.h).
Sessions (``map_id``) are told by the letter of their keys where there are several.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from string import ascii_lowercase
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry, assemble
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting, sightings
from pgti_gtsam.datasets.noise import ROTATION_FIRST, information_models
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import Table, TextFile
from pgti_gtsam.factor_graphs import between_factor

NAME = "RTAB-Map database"
MAGIC = b"SQLite format 3\0"
ODOMETRY, LANDMARK = (0, 6), 8  # neighbour and merged neighbour; 8 leads to a tag
CLOSURES = {1: "global closures", 2: "closures local in space", 3: "closures local in time", 4: "closures by the user"}
KINDS = {0: "neighbours", 6: "merged neighbours", 8: "sightings of tags", 5: "virtual links left out", **CLOSURES}
UNKNOWN = "links of an unknown type left out"
UNARY = "SELECT COUNT(*) FROM Link WHERE from_id = to_id"
MOST_BYTES = 1 << 28  # of inflated poses: 48 for each
LETTERS = ascii_lowercase.replace("l", "")


class Link(NamedTuple):
    """Ends, type, pose of the second end from the first, information in the order of gtsam.Pose3."""

    first: int
    second: int
    type: int
    pose: gtsam.Pose3
    information: NDArray[np.float64]


def parse(source: Source) -> Dataset:
    """The graph of a database, its closures told by the types of its links.

    Raises
    ------
    FileFormatError
        No database of RTAB-Map, a damaged one, or one without poses or links.
    """
    file = source.blank()
    try:
        with closing(sqlite3.connect(f"{source.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            keys, poses = _nodes(database, file)
            links = _links(database, poses)
            unary = database.execute(UNARY).fetchone()[0]
    except (sqlite3.Error, ValueError, zlib.error) as error:
        raise source.error(f"is no database of RTAB-Map, or a damaged one: {error}") from error
    file.notes.extend([f"{unary} pose priors and gravity links left out"] if unary else [])
    counts = Counter(link.type for link in links)
    file.notes.extend(f"{counts[kind]} {KINDS.get(kind, UNKNOWN)}" for kind in sorted(counts))
    ties, tags = ([link for link in links if link.type in kinds] for kinds in ((*ODOMETRY, *CLOSURES), (LANDMARK,)))
    information = np.array([link.information for link in ties]).reshape(-1, 6, 6)
    models = information_models(file, _table(ties, keys), information)
    ends = [(keys[link.first], keys[link.second]) for link in ties]
    rows = enumerate(zip(ends, ties, models, strict=True))
    entries = [Entry(slot, pair, between_factor(*pair, link.pose, model)) for slot, (pair, link, model) in rows]
    odometry, loops = (
        [entry for entry, link in zip(entries, ties, strict=True) if link.type in kinds]
        for kinds in (ODOMETRY, CLOSURES)
    )
    dataset = assemble(
        file,
        format=NAME,
        poses={keys[node]: pose for node, pose in poses.items() if node in keys},
        entries=odometry,
        loops=loops,
        sightings=[seen._replace(line=len(entries)) for seen in _sightings(file, tags, keys)],
    )
    return replace(dataset, names={key: str(node) for node, key in keys.items()})


def _nodes(database: sqlite3.Connection, file: TextFile) -> tuple[dict[int, int], dict[int, gtsam.Pose3]]:
    """Keys and poses of nodes: the optimised poses where the database holds them, else the odometry's."""
    rows = database.execute("SELECT id, map_id, pose FROM Node ORDER BY id").fetchall()
    stored = {node: blob for node, _, blob in rows if blob is not None and len(blob) == 48 and any(blob)}
    poses = _optimised(database)
    if poses:
        file.notes.append(f"poses are the optimised ones that RTAB-Map saved, {len(poses)} of {len(rows)} nodes")
    else:
        poses = {node: _pose(np.frombuffer(blob, "<f4")) for node, blob in stored.items()}
        file.notes.append("poses are the odometry's, as no optimised ones are saved; --optimise audits the optimum")
    letters = dict(zip(sorted({row[1] for row in rows}), LETTERS, strict=False))
    if len(letters) > 1:
        file.notes.append(f"{len(letters)} sessions are told by letters of their keys: {', '.join(letters.values())}")
    keys = {node: gtsam.symbol(letters[session], node) if len(letters) > 1 else node for node, session, _ in rows}
    return {node: key for node, key in keys.items() if node in poses}, poses


def _optimised(database: sqlite3.Connection) -> dict[int, gtsam.Pose3]:
    if not {"opt_ids", "opt_poses"} <= {row[1] for row in database.execute("PRAGMA table_info(Admin)")}:
        return {}
    for ids, poses in database.execute("SELECT opt_ids, opt_poses FROM Admin WHERE opt_poses IS NOT NULL"):
        nodes = np.frombuffer(zlib.decompressobj().decompress(ids, MOST_BYTES), "<i4").tolist()
        matrices = np.frombuffer(zlib.decompressobj().decompress(poses, MOST_BYTES), "<f4").reshape(len(nodes), 12)
        return {node: _pose(row) for node, row in zip(nodes, matrices, strict=True) if node > 0}
    return {}


def _links(database: sqlite3.Connection, nodes: Collection[int]) -> list[Link]:
    """Links between nodes that have a pose, and to landmarks, each pair and type once."""
    query = "SELECT from_id, to_id, type, transform, information_matrix FROM Link ORDER BY rowid"
    found: dict[tuple[int, int, int], Link] = {}
    for first, second, kind, transform, information in database.execute(query):
        is_known = first in nodes and (second in nodes or kind == LANDMARK)
        if is_known and first != second and transform is not None and any(transform):
            matrix = np.frombuffer(information, "<f8").reshape(6, 6)[np.ix_(ROTATION_FIRST, ROTATION_FIRST)]
            link = Link(first, second, kind, _pose(np.frombuffer(transform, "<f4")), matrix)
            found.setdefault((min(first, second), max(first, second), kind), link)
    return list(found.values())


def _pose(row: NDArray[np.float32]) -> gtsam.Pose3:
    matrix = row.astype(float).reshape(3, 4)
    u, _, vt = np.linalg.svd(matrix[:, :3])
    return gtsam.Pose3(gtsam.Rot3(u @ vt), matrix[:, 3])


def _table(links: Sequence[Link], keys: Mapping[int, int]) -> Table:
    ids = np.array([(keys[link.first], keys.get(link.second, abs(link.second))) for link in links], np.int64)
    return Table(lines=np.arange(len(links)), ids=ids.reshape(-1, 2), numbers=np.empty((len(links), 0)))


def _sightings(file: TextFile, tags: Sequence[Link], keys: Mapping[int, int]) -> list[Sighting]:
    matrices = np.array([link.pose.matrix() for link in tags]).reshape(-1, 4, 4)
    turns, blocks = matrices[:, :3, :3], np.array([link.information[3:, 3:] for link in tags]).reshape(-1, 3, 3)
    return sightings(file, _table(tags, keys), matrices[:, :3, 3], turns @ blocks @ turns.transpose(0, 2, 1))


FORMAT = Format(NAME, lambda source: source.head.startswith(MAGIC), parse)
