"""g2o dialects, sessions and identifiers: laws that need no file beside the checkout."""

import gzip
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import gtsam
import numpy as np
import pytest
from small_files import G2O, read_text

from pgti_gtsam import cli, datasets
from pgti_gtsam.datasets import read_one_map, write_g2o
from pgti_gtsam.datasets.chain import between_factors, closure_slots, poses_of
from pgti_gtsam.errors import FileFormatError, InvalidOptionError

UPPER_2D, UPPER_3D = "1 0 0 1 0 1", "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
TURN = np.pi / 2
VERTICES = "".join(f"VERTEX_SE2 {i} {x} {y} {i * TURN}\n" for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)]))
CHAIN = "".join(f"EDGE_SE2 {i} {i + 1} 1 0 {TURN} {UPPER_2D}\n" for i in range(3))


def ends_of_closures(dataset):
    return [tuple(dataset.graph.at(slot).keys()) for slot in closure_slots(dataset)]


@pytest.mark.parametrize(
    "line",
    [
        f"EDGE_SE2_SWITCHABLE 3 0 99 1 0 {TURN} {UPPER_2D}\n",
        f"EDGE_SE2_MAXMIX 3 0 1e-9 1 0 {TURN} {UPPER_2D}\n",
        f"TUTORIAL_EDGE_SE2 3 0 1 0 {TURN} {UPPER_2D}\n",
        f"EDGE2 3 0 1 0 {TURN} {UPPER_2D}\n",
        f"EDGE_SE2 3 0 1 0 {TURN} {UPPER_2D}\n",
    ],
)
def test_a_closure_is_one_whatever_its_tag(tmp_path, line):
    dataset = read_text(tmp_path, VERTICES + CHAIN + "VERTEX_SWITCH 99 1\nEDGE_SWITCH_PRIOR 99 1 1\n" + line)
    assert ends_of_closures(dataset) == [(3, 0)]
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-12)
    assert not any("ignored" in note for note in dataset.notes)


def test_unknown_lines_that_tie_two_poses_are_refused_or_counted(tmp_path):
    text = VERTICES + CHAIN + "EDGE_SE2_FANCY 0 3 7 7 7\nEDGE_SE2_FANCY 1 3 7 7 7\nEDGE_SE2_PRIOR_FANCY 0 3 1 0 0\n"
    with pytest.raises(FileFormatError, match=r"line 8: 2 'EDGE_SE2_FANCY' tie two poses.*--ignore-unknown") as caught:
        read_text(tmp_path, text)
    assert any("ignored lines" in note for note in caught.value.__notes__)
    dataset = datasets.read(tmp_path / "graph.txt", ignore_unknown=True)
    assert dataset.ignored_edges == 2
    assert dataset.title == "graph without 2 unknown edges"


@pytest.mark.parametrize(("dimension", "upper"), [(3, UPPER_2D), (6, UPPER_3D)])
def test_information_is_an_upper_triangle_a_full_matrix_or_none(tmp_path, dimension, upper):
    rng = np.random.default_rng(dimension)
    root = rng.normal(size=(dimension, dimension))
    matrix = root @ root.T + np.eye(dimension)
    tag, pose = ("EDGE_SE2", "1 0 0") if dimension == 3 else ("EDGE_SE3:QUAT", "1 0 0 0 0 0 1")
    shapes = {"upper": matrix[np.triu_indices(dimension)], "full": matrix.ravel(), "none": []}
    found = {}
    for shape, numbers in shapes.items():
        dataset = read_text(tmp_path, f"{tag} 0 1 {pose} {' '.join(map(repr, map(float, numbers)))}\n")
        found[shape] = dataset.graph.at(0).noiseModel().information()
    np.testing.assert_allclose(found["upper"], found["full"], rtol=1e-9)
    np.testing.assert_allclose(found["none"], np.eye(dimension))
    assert any("unit information assumed" in note for note in dataset.notes)


def test_indefinite_information_becomes_the_nearest_semidefinite_one(tmp_path):
    dataset = read_text(tmp_path, "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n")
    found = dataset.graph.at(0).noiseModel().information()
    np.testing.assert_allclose(found, [[1.5, 1.5, 0], [1.5, 1.5, 0], [0, 0, 1]], atol=1e-9)
    assert any("1 information matrices have a negative eigenvalue (first on line 1)" in note for note in dataset.notes)


@pytest.mark.parametrize("seed", range(3))
def test_an_edge_between_sensors_says_the_same_of_the_bodies(tmp_path, seed):
    """The cost of moving either body is that of moving its sensor, to second order."""
    rng = np.random.default_rng(seed)
    offsets = [gtsam.Pose3.Expmap(rng.normal(size=6)) for _ in range(2)]
    bodies = [gtsam.Pose3.Expmap(rng.normal(size=6)) for _ in range(2)]
    sensors = [body * offset for body, offset in zip(bodies, offsets, strict=True)]
    root = rng.normal(size=(6, 6))
    information = root @ root.T + np.eye(6)
    text = "".join(f"PARAMS_SE3OFFSET {i} {numbers(offset)}\n" for i, offset in enumerate(offsets))
    text += "".join(f"VERTEX_SE3:QUAT {i} {numbers(body)}\n" for i, body in enumerate(bodies))
    triangle = " ".join(map(repr, information[np.triu_indices(6)].tolist()))
    text += f"EDGE_SE3_OFFSET 0 1 0 1 {numbers(sensors[0].between(sensors[1]))} {triangle}\n"
    factor = read_text(tmp_path, text).graph.at(0)
    swapped = information[np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])]
    for step in 1e-4 * rng.normal(size=(5, 6)):
        moved = gtsam.Values()
        moved.insert(0, bodies[0])
        moved.insert(1, bodies[1] * gtsam.Pose3.Expmap(step))
        seen = sensors[0].between(sensors[1]).logmap(sensors[0].between(moved.atPose3(1) * offsets[1]))
        assert factor.error(moved) == pytest.approx(0.5 * seen @ swapped @ seen, rel=1e-3)


def numbers(pose):
    turn = pose.rotation().toQuaternion()
    return " ".join(map(repr, map(float, [*pose.translation(), turn.x(), turn.y(), turn.z(), turn.w()])))


@pytest.mark.parametrize("convention", ["camera to world", "world to camera"])
def test_the_edges_of_cameras_tell_which_way_their_poses_are_written(tmp_path, convention):
    rng = np.random.default_rng(4)
    poses = [gtsam.Pose3.Expmap(rng.normal(size=6)) for _ in range(4)]
    steps = [a.between(b) for a, b in pairwise(poses)]
    written = poses, steps
    if convention == "world to camera":
        written = [pose.inverse() for pose in poses], [step.inverse() for step in steps]
    text = "".join(f"VERTEX_SE3:EXPMAP {i} {numbers(pose)}\n" for i, pose in enumerate(written[0]))
    text += "".join(f"EDGE_SE3:EXPMAP {i} {i + 1} {numbers(step)} {UPPER_3D}\n" for i, step in enumerate(written[1]))
    dataset = read_text(tmp_path, text)
    assert all(found.equals(poses[key], 1e-9) for key, found in poses_of(dataset.values).items())
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-12)
    assert any("inverted" in note for note in dataset.notes) == (convention == "world to camera")


@pytest.mark.parametrize("kind", ["EXPMAP", "QUAT"])
def test_similarities_are_read_without_their_scale(tmp_path, kind):
    """Camera i is drawn 1.1^i times too large; its edges are in units of their first camera."""
    poses = [gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1 * i, 0.2, 0.3 * i), np.array([i, 2.0 * i, -i])) for i in range(3)]
    scales = [1.0, 1.1, 1.21]
    text, triangle = "", " ".join("1" if i == j else "0" for i in range(7) for j in range(i, 7))
    for i, (pose, scale) in enumerate(zip(poses, scales, strict=True)):
        camera = " 500 500 320 240" if kind == "EXPMAP" else ""
        text += f"VERTEX_SIM3:{kind} {i} {similarity(pose, scale, kind)}{camera}\n"
    for i in range(2):
        step = poses[i].between(poses[i + 1])
        local = gtsam.Pose3(step.rotation(), step.translation() / scales[i])
        text += f"EDGE_SIM3:{kind} {i} {i + 1} {similarity(local, 1.1, kind)} {triangle}\n"
    dataset = read_text(tmp_path, text)
    assert all(found.equals(poses[key], 1e-6) for key, found in poses_of(dataset.values).items())
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-9)
    assert any("without their scale" in note for note in dataset.notes)


def similarity(pose, scale, kind):
    if kind == "QUAT":
        return f"{numbers(pose)} {scale!r}"
    from scipy.linalg import logm

    matrix = pose.matrix()
    matrix[:3, :3] *= scale
    log = np.real(logm(matrix))
    turn = [log[2, 1], log[0, 2], log[1, 0]]
    return " ".join(map(repr, map(float, [*turn, *log[:3, 3], np.trace(log[:3, :3]) / 3])))


def shifted(text, name):
    """The text with other identifiers of poses 0 to 3 of its lines."""
    lines = [line.split() for line in text.splitlines()]
    for fields in lines:
        for place in (1, 2) if fields[0].startswith("EDGE") else (1,):
            fields[place] = str(name(int(fields[place])))
    return "\n".join(" ".join(fields) for fields in lines) + "\n"


@pytest.mark.parametrize(
    "name", [lambda i: i - 2, lambda i: gtsam.symbol("b", i), lambda i: 1_500_000_000_000_000_000 + i]
)
def test_any_identifier_is_read_and_written_back(tmp_path, name):
    closure = f"EDGE_SE2 3 0 1 0 {TURN} {UPPER_2D}\n"
    plain = read_text(tmp_path, VERTICES + CHAIN + closure, "plain.g2o")
    dataset = read_text(tmp_path, shifted(VERTICES + CHAIN + closure, name), "named.g2o")
    assert len(ends_of_closures(dataset)) == len(ends_of_closures(plain)) == 1
    written = write_g2o(dataset.graph, dataset.values, tmp_path / "out.g2o", names=dataset.names)
    assert written.renumbered == ()
    lines = (tmp_path / "out.g2o").read_text().splitlines()
    assert [int(line.split()[1]) for line in lines[:4]] == [name(i) for i in range(4)]
    again = datasets.read(tmp_path / "out.g2o")
    assert again.graph.equals(dataset.graph, 1e-9)
    assert again.values.equals(dataset.values, 1e-9)


# Several files


def session(letter, n=3, y=0.0):
    key = [gtsam.symbol(letter, i) if letter else i for i in range(n)]
    text = "".join(f"VERTEX_SE2 {key[i]} {i} {y} 0\n" for i in range(n))
    return text + "".join(f"EDGE_SE2 {key[i]} {key[i + 1]} 1 0 0 {UPPER_2D}\n" for i in range(n - 1)), key


def test_files_with_identifiers_of_their_own_are_one_graph_and_tie_each_other(tmp_path):
    (first, a), (second, b) = session("a"), session("b", y=1.0)
    (tmp_path / "a.g2o").write_text(first)
    (tmp_path / "b.g2o").write_text(second + f"EDGE_SE2 {b[0]} {a[2]} 2 -1 0 {UPPER_2D}\n")
    dataset = read_one_map([tmp_path / "a.g2o", tmp_path / "b.g2o"])
    assert list(poses_of(dataset.values)) == [*a, *b]
    assert ends_of_closures(dataset) == [(b[0], a[2])]
    assert any("2 files are one map: a.g2o, b.g2o" in note for note in dataset.notes)
    (tmp_path / "b.g2o").write_text(second + "# a comment\nEDGE_SE2 0 1\n")
    with pytest.raises(FileFormatError, match=r"b.g2o, line 7: expected"):
        read_one_map([tmp_path / "a.g2o", tmp_path / "b.g2o"])


def test_files_with_the_same_identifiers_become_sessions_told_by_letter(tmp_path):
    for name, y in (("one", 0.0), ("two", 5.0)):
        (tmp_path / f"{name}.g2o").write_text(session("", y=y)[0] + "EDGE_SE2_XY 0 1 1 1 1 0 1\n")
    dataset = read_one_map([tmp_path / "one.g2o", tmp_path / "two.g2o"])
    expected = [gtsam.symbol(letter, i) for letter in "ab" for i in range(3)]
    assert list(poses_of(dataset.values)) == expected
    assert {tuple(b.factor.keys()) for b in between_factors(dataset.graph)} == {
        (expected[i], expected[i + 1]) for i in (0, 1, 3, 4)
    }
    np.testing.assert_allclose(dataset.values.atPoint2(gtsam.symbol("B", 1)), [1, 6], atol=1e-9)
    assert closure_slots(dataset) == ()
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-12)


def test_one_map_needs_several_files_and_several_files_the_word(tmp_path, monkeypatch, capsys):
    (tmp_path / "a.g2o").write_text(G2O)
    with pytest.raises(InvalidOptionError, match="expected 2 to"):
        read_one_map([tmp_path / "a.g2o"])
    monkeypatch.setattr(sys, "argv", ["pgti-gtsam", "audit", *[str(tmp_path / "a.g2o")] * 2])
    with pytest.raises(SystemExit):
        cli.main()
    assert "--one-map" in capsys.readouterr().err


# Large files and traps

LARGE = """
import sys
from pathlib import Path
from pgti_gtsam import datasets
path = Path(sys.argv[1])
peak = lambda: int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
before = peak()
datasets.read(path)
print((peak() - before) * 1024 / path.stat().st_size)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is asked of Linux")
def test_a_large_graph_takes_less_memory_than_ten_times_its_file(tmp_path):
    rng = np.random.default_rng(0)
    n, triangle = 50_000, " ".join(f"{x:.6f}" for x in np.diag([1e2, 1e2, 1e2, 4e2, 4e2, 4e2])[np.triu_indices(6)])
    drawn = rng.normal(size=(n, 3))
    with (tmp_path / "large.g2o").open("w") as file:
        for i, (x, y, z) in enumerate(drawn):
            file.write(f"VERTEX_SE3:QUAT {i} {x:.6f} {y:.6f} {z:.6f} 0.000000 0.000000 0.099833 0.995004\n")
        for i, (x, y, z) in enumerate(drawn[1:]):
            file.write(f"EDGE_SE3:QUAT {i} {i + 1} {x:.6f} {y:.6f} {z:.6f} 0.0 0.0 0.0 1.0 {triangle}\n")
    ran = subprocess.run([sys.executable, "-c", LARGE, tmp_path / "large.g2o"], capture_output=True, check=True)
    assert float(ran.stdout) < 10.0


def test_what_unpacks_to_more_than_any_map_is_refused(tmp_path):
    path = tmp_path / "trap.g2o.gz"
    path.write_bytes(gzip.compress(b" " * (1 << 25)))
    with pytest.raises(FileFormatError, match="unpacks to more than 16 MB, which no map does"):
        datasets.read(path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b\0\0", "Cartographer state"),
        (b"\x8bCSimpleMap\0\0", "MRPT simple map"),
        (b"#ROSBAG V2.0\n", "a ROS bag"),
        (b"# .PCD v0.7\n", "point cloud.*--cloud"),
        (b"PK\x03\x04\0", "cannot be read: File is not a zip file"),
        (b'{"nodes": []}\n', "looks like JSON"),
        (b"<osm>\n", "looks like XML"),
    ],
)
def test_what_cannot_be_read_is_known_by_its_first_bytes(tmp_path, data, message):
    path = tmp_path / "file"
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=message):
        datasets.read(path)


@pytest.mark.parametrize(("ending", "program"), [("osa", "ORB-SLAM3"), ("posegraph", "slam_toolbox")])
def test_boost_archives_of_other_programs_are_known_by_their_ending(tmp_path, ending, program):
    path = tmp_path / f"map.{ending}"
    path.write_bytes(b"\x16\0\0\0\0\0\0\0serialization::archive\x13\0\x04\x08")
    with pytest.raises(FileFormatError, match=rf"looks like .* of {program}.* not read"):
        datasets.read(path)


def test_empty_labels_mean_that_no_loop_is_true(tmp_path):
    (tmp_path / "map_GT_LC.txt").write_text("")
    dataset = read_text(tmp_path, VERTICES + CHAIN + f"EDGE_SE2 3 0 1 0 {TURN} {UPPER_2D}\n", "map.g2o")
    assert (len(closure_slots(dataset)), dataset.true_closures) == (1, frozenset())
