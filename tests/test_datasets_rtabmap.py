"""RTAB-Map databases, made by sqlite3 after the documented schema."""

import gzip
import json
import sqlite3
import struct
import zlib

import gtsam
import numpy as np
import pytest

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import poses_of
from pgti_gtsam.errors import FileFormatError

SCHEMA = """
CREATE TABLE Node (id INTEGER NOT NULL, map_id INTEGER NOT NULL, weight INTEGER, stamp FLOAT, pose BLOB,
    ground_truth_pose BLOB, velocity BLOB, label TEXT, gps BLOB, env_sensors BLOB, time_enter DATE, PRIMARY KEY (id));
CREATE TABLE Link (from_id INTEGER NOT NULL, to_id INTEGER NOT NULL, type INTEGER NOT NULL,
    information_matrix BLOB NOT NULL, transform BLOB, user_data BLOB);
CREATE TABLE Admin (version TEXT, preview_image BLOB, opt_ids BLOB, opt_poses BLOB, time_enter DATE);
"""
INFORMATION = np.diag([100.0, 100, 100, 400, 400, 400])  # x y z roll pitch yaw
LAPS, STEPS = 3, 100


def blob(pose):
    return pose.matrix()[:3].astype("<f4").tobytes()


def deflated(array, kind):
    """RTAB-Map's compressed matrix: deflated bytes, then rows, columns and OpenCV's type."""
    return zlib.compress(array.tobytes()) + struct.pack("<iii", 1, array.size, kind)


def truth(i):
    angle = 2 * np.pi * i / STEPS
    place = 20 * np.array([np.cos(angle), np.sin(angle), 0])
    return gtsam.Pose3(gtsam.Rot3.Rz(angle + np.pi / 2), place)


def drifted(n, seed=0):
    """Steps of odometry with small errors."""
    rng = np.random.default_rng(seed)
    sigmas = np.array([1e-4, 1e-4, 5e-4, 0.01, 0.01, 1e-3])
    return [
        truth(i).between(truth(i + 1)).compose(gtsam.Pose3.Expmap(rng.normal(size=6) * sigmas)) for i in range(n - 1)
    ]


class Database:
    """A database that is written link by link, each in both directions as RTAB-Map does."""

    def __init__(self, path):
        self.connection = sqlite3.connect(path)
        self.connection.executescript(SCHEMA)

    def node(self, number, pose, session=0):
        row = (number, session, 0, float(number), None if pose is None else blob(pose))
        self.connection.execute("INSERT INTO Node (id, map_id, weight, stamp, pose) VALUES (?, ?, ?, ?, ?)", row)

    def link(self, first, second, kind, pose, both=True, information=INFORMATION):
        query = "INSERT INTO Link (from_id, to_id, type, information_matrix, transform) VALUES (?, ?, ?, ?, ?)"
        matrix = information.astype("<f8").tobytes()
        self.connection.execute(query, (first, second, kind, matrix, blob(pose)))
        if both:
            self.connection.execute(query, (second, first, kind, matrix, blob(pose.inverse())))

    def optimised(self, poses):
        ids = deflated(np.array(list(poses), "<i4"), 4)
        rows = deflated(np.concatenate([pose.matrix()[:3].ravel() for pose in poses.values()]).astype("<f4"), 5)
        self.connection.execute("INSERT INTO Admin (version, opt_ids, opt_poses) VALUES ('0.21', ?, ?)", (ids, rows))

    def close(self):
        self.connection.commit()
        self.connection.close()


TRUE = [(10 + k, 110 + k) for k in range(0, 60, 15)] + [(120 + k, 220 + k) for k in range(0, 60, 15)]
FALSE = [(20, 165), (40, 290)]


@pytest.fixture
def laps(tmp_path):
    """Three laps of 100 keyframes, numbered from 1, with true closures, false ones and a tag that two nodes see."""
    path = tmp_path / "rtabmap.db"
    database, pose = Database(path), truth(0)
    steps = drifted(LAPS * STEPS)
    for i in range(LAPS * STEPS):
        database.node(i + 1, pose)
        if i < len(steps):
            database.link(i + 1, i + 2, 0, steps[i])
            pose = pose.compose(steps[i])
    for i, j in TRUE:
        database.link(j + 1, i + 1, 1, truth(j).between(truth(i)))
    for i, j in FALSE:
        database.link(j + 1, i + 1, 1, gtsam.Pose3())
    for i in (5, 7):
        database.link(
            i + 1, -3, 8, truth(i).between(gtsam.Pose3(gtsam.Rot3.Rx(1), truth(6).translation() * 1.1)), False
        )
    database.link(9, 9, 7, truth(8), both=False)
    database.link(12, 50, 5, truth(11).between(truth(49)))
    database.close()
    return path


def test_a_database_is_a_graph_whose_links_are_told_by_type(laps):
    dataset = datasets.read(laps)
    assert (dataset.name, dataset.format) == ("rtabmap", "RTAB-Map database")
    assert list(poses_of(dataset.values)) == list(range(1, 301))
    assert dataset.graph.size() == 299 + len(TRUE) + len(FALSE) + 2
    ends = {tuple(sorted(dataset.graph.at(slot).keys())) for slot in dataset.closures}
    assert ends == {(i + 1, j + 1) for i, j in TRUE + FALSE}
    tag = dataset.values.atPoint3(gtsam.symbol("l", 3))
    np.testing.assert_allclose(tag, truth(6).translation() * 1.1, atol=0.1)
    assert any("1 pose priors" in note for note in dataset.notes)
    assert any("virtual links left out" in note for note in dataset.notes)


def test_information_is_turned_to_rotation_first(laps):
    np.testing.assert_allclose(
        datasets.read(laps).graph.at(0).noiseModel().information(), np.diag([400.0, 400, 400, 100, 100, 100])
    )


def test_the_saved_optimum_is_taken_where_there_is_one(tmp_path):
    database = Database(tmp_path / "map.db")
    for i in range(4):
        database.node(i + 1, truth(0))
    for i in range(3):
        database.link(i + 1, i + 2, 0, truth(i).between(truth(i + 1)))
    database.optimised({i + 1: truth(i) for i in range(4)})
    database.close()
    poses = poses_of(datasets.read(tmp_path / "map.db").values)
    assert all(poses[i + 1].equals(truth(i), 1e-5) for i in range(4))


def test_sessions_are_told_by_letters_and_a_closure_between_their_ends_is_one(tmp_path):
    """The second session's first node closes a loop to the first one's last: next in number, but no odometry."""
    database = Database(tmp_path / "map.db")
    for i in range(6):
        database.node(i + 1, truth(i), session=i // 3)
    for i in (0, 1, 3, 4):
        database.link(i + 1, i + 2, 0, truth(i).between(truth(i + 1)))
    database.link(4, 3, 1, truth(3).between(truth(2)))
    database.close()
    dataset = datasets.read(tmp_path / "map.db")
    assert list(poses_of(dataset.values)) == [gtsam.symbol("ab"[i // 3], i + 1) for i in range(6)]
    (slot,) = dataset.closures
    assert [dataset.names[key] for key in list(dataset.graph.at(slot).keys())] == ["4", "3"]


def test_nodes_and_links_without_a_pose_are_left_out(tmp_path):
    database = Database(tmp_path / "map.db")
    for i in range(4):
        database.node(i + 1, None if i == 3 else truth(i))
    for i in range(3):
        database.link(i + 1, i + 2, 0, truth(i).between(truth(i + 1)))
    database.close()
    dataset = datasets.read(tmp_path / "map.db")
    assert (list(poses_of(dataset.values)), dataset.graph.size()) == ([1, 2, 3], 2)


@pytest.mark.parametrize("damage", ["other", "cut", "empty"])
def test_what_is_no_database_of_rtabmap_is_refused_in_one_sentence(tmp_path, laps, damage):
    path = tmp_path / "bad.db"
    if damage == "other":
        connection = sqlite3.connect(path)
        connection.execute("CREATE TABLE Other (id INTEGER)")
        connection.close()
    else:
        path.write_bytes(laps.read_bytes()[: 20000 if damage == "cut" else 100])
    with pytest.raises(FileFormatError, match="no database of RTAB-Map"):
        datasets.read(path)


def test_a_database_is_audited_and_gated_and_its_rejected_links_are_named(run, laps, tmp_path):
    before = laps.read_bytes()
    code, _, _ = run("audit", laps, "--radius", 0.5, "--json", tmp_path / "found.json")
    assert code == 0
    assert json.loads((tmp_path / "found.json").read_text())["summary"]["n_keyframes"] == 300
    code, out, _ = run("gate", laps, "--radius", 0.5, "--rejected", tmp_path / "rejected.txt")
    assert code == 0, out
    assert f"{len(TRUE)} accepted, 0 undecided, {len(FALSE)} rejected" in out
    rows = {tuple(map(int, line.split())) for line in (tmp_path / "rejected.txt").read_text().splitlines()}
    assert rows == {(j + 1, i + 1) for i, j in FALSE}
    assert laps.read_bytes() == before


def test_links_of_an_unknown_type_are_refused_or_counted(tmp_path):
    database = Database(tmp_path / "map.db")
    for i in range(4):
        database.node(i + 1, truth(i))
    for i in range(3):
        database.link(i + 1, i + 2, 0, truth(i).between(truth(i + 1)))
    database.link(4, 1, 77, truth(3).between(truth(0)))
    database.close()
    with pytest.raises(FileFormatError, match="not known: 1 of type 77; leave them out with --ignore-unknown"):
        datasets.read(tmp_path / "map.db")
    dataset = datasets.read(tmp_path / "map.db", ignore_unknown=True)
    assert (dataset.graph.size(), dataset.ignored_edges) == (3, 1)


def test_a_compressed_database_is_read_as_it_is(laps, tmp_path):
    path = tmp_path / "packed.db.gz"
    path.write_bytes(gzip.compress(laps.read_bytes()))
    assert datasets.read(path).graph.equals(datasets.read(laps).graph, 1e-12)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (("topics", "messages"), "is a ROS bag"),
        (("keyframes", "landmarks"), "a map of stella_vslam in SQLite.*save it as .msg"),
        (("Node (id, map_id, pose)", "Link (from_id, to_id)"), "no such column.*rtabmap-databaseViewer"),
    ],
)
def test_other_databases_are_named(tmp_path, tables, message):
    connection = sqlite3.connect(tmp_path / "other.db")
    for table in tables:
        connection.execute(f"CREATE TABLE {table if '(' in table else f'{table} (id)'}")
    connection.close()
    with pytest.raises(FileFormatError, match=message):
        datasets.read(tmp_path / "other.db")
