"""The tables of RTAB-Map: nodes with poses, links, and the optimised poses of Admin.

A pose is twelve float32, the upper 3x4 of a matrix by rows; the information of a link is 36 float64, translation first.
Every link is stored in both directions. Optimised poses are a float32 matrix, deflated, with rows, columns and
OpenCV's type as three int32 behind (DatabaseSchema.sql, Link.h).
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from string import ascii_lowercase
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.noise import ROTATION_FIRST
from pgti_gtsam.datasets.source import Source
from pgti_gtsam.datasets.text import TextFile

MAGIC = b"SQLite format 3\0"
LANDMARK = 8  # the type of a link that leads to a tag, whose identifier is negative
UNARY = "SELECT COUNT(*) FROM Link WHERE from_id = to_id"
MOST_BYTES = 1 << 28  # of inflated poses: 48 for each
LETTERS = ascii_lowercase.replace("l", "")
OTHERS = {
    "topics": "is a ROS bag (SQLite); run the SLAM program on it and give its map",
    "landmarks": "looks like a map of stella_vslam in SQLite, which is not read; save it as .msg",
}
OLD = "it may be of an old version: open and save it with rtabmap-databaseViewer"


class Link(NamedTuple):
    """Ends, type, pose of the second end from the first, information in the order of gtsam.Pose3."""

    first: int
    second: int
    type: int
    pose: gtsam.Pose3
    information: NDArray[np.float64]


@contextmanager
def opened(source: Source) -> Iterator[sqlite3.Connection]:
    """The database in a source, opened for reading; a compressed database is unpacked into memory.

    Raises
    ------
    FileFormatError
        No database of RTAB-Map, a damaged database, or an old version.
    """
    with source.path.open("rb") as file:
        is_plain = file.read(len(MAGIC)) == MAGIC
    uri = f"{source.path.resolve().as_uri()}?mode=ro&immutable=1" if is_plain else ":memory:"
    with closing(sqlite3.connect(uri, uri=True)) as database:
        try:
            if not is_plain:
                database.deserialize(source.data)
            _check_tables(source, database)
            yield database
        except sqlite3.OperationalError as error:
            raise source.error(f"is no database of RTAB-Map that is understood: {error}; {OLD}") from error
        except (sqlite3.Error, ValueError, zlib.error) as error:
            raise source.error(f"is no database of RTAB-Map, or a damaged one: {error}") from error


def _check_tables(source: Source, database: sqlite3.Connection) -> None:
    tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for table, message in OTHERS.items():
        if table in tables and "Node" not in tables:
            raise source.error(message)
    if not {"Node", "Link"} <= tables:
        raise source.error("is no database of RTAB-Map: expected the tables Node and Link")


def nodes(database: sqlite3.Connection, file: TextFile) -> tuple[dict[int, int], dict[int, gtsam.Pose3]]:
    """Keys and poses of nodes: the optimised poses where the database holds such poses, else the odometry's.

    Parameters
    ----------
    database : sqlite3.Connection
    file : TextFile
        Named in errors.
    """
    rows = database.execute("SELECT id, map_id, pose FROM Node ORDER BY id").fetchall()
    stored = {node: blob for node, _, blob in rows if blob is not None and len(blob) == 48 and any(blob)}
    poses = optimised(database)
    if poses:
        file.notes.append(f"poses are the optimised ones that RTAB-Map saved, {len(poses)} of {len(rows)} nodes")
    else:
        poses = {node: pose_of(np.frombuffer(blob, "<f4")) for node, blob in stored.items()}
        file.notes.append("poses are the odometry's, as no optimised ones are saved; --optimise audits the optimum")
    letters = dict(zip(sorted({row[1] for row in rows}), LETTERS, strict=False))
    if len(letters) > 1:
        file.notes.append(f"{len(letters)} sessions are told by letters of their keys: {', '.join(letters.values())}")
    keys = {node: gtsam.symbol(letters[session], node) if len(letters) > 1 else node for node, session, _ in rows}
    return {node: key for node, key in keys.items() if node in poses}, poses


def optimised(database: sqlite3.Connection) -> dict[int, gtsam.Pose3]:
    """The optimised poses that RTAB-Map saved, by node; empty without."""
    if not {"opt_ids", "opt_poses"} <= {row[1] for row in database.execute("PRAGMA table_info(Admin)")}:
        return {}
    for ids, poses in database.execute("SELECT opt_ids, opt_poses FROM Admin WHERE opt_poses IS NOT NULL"):
        nodes = np.frombuffer(zlib.decompressobj().decompress(ids, MOST_BYTES), "<i4").tolist()
        matrices = np.frombuffer(zlib.decompressobj().decompress(poses, MOST_BYTES), "<f4").reshape(len(nodes), 12)
        return {node: pose_of(row) for node, row in zip(nodes, matrices, strict=True) if node > 0}
    return {}


def links(database: sqlite3.Connection, nodes: Collection[int]) -> list[Link]:
    """Links between nodes that have a pose, and to landmarks, each pair and type once.

    Parameters
    ----------
    database : sqlite3.Connection
    nodes : collection of int
        Nodes with a pose.
    """
    query = "SELECT from_id, to_id, type, transform, information_matrix FROM Link ORDER BY rowid"
    found: dict[tuple[int, int, int], Link] = {}
    for first, second, kind, transform, information in database.execute(query):
        is_known = first in nodes and (second in nodes or kind == LANDMARK)
        if is_known and first != second and transform is not None and any(transform):
            matrix = np.frombuffer(information, "<f8").reshape(6, 6)[np.ix_(ROTATION_FIRST, ROTATION_FIRST)]
            link = Link(first, second, kind, pose_of(np.frombuffer(transform, "<f4")), matrix)
            found.setdefault((min(first, second), max(first, second), kind), link)
    return list(found.values())


def pose_of(row: NDArray[np.float32]) -> gtsam.Pose3:
    """The pose of twelve numbers, with the rotation brought to the nearest rotation."""
    matrix = row.astype(float).reshape(3, 4)
    u, _, vt = np.linalg.svd(matrix[:, :3])
    return gtsam.Pose3(gtsam.Rot3(u @ vt), matrix[:, 3])
