"""Trajectories of TUM and KITTI, written by evo, and lists of their loops."""

import gtsam
import numpy as np
import pytest

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import between_factors, poses_of
from pgti_gtsam.errors import FileFormatError

file_interface = pytest.importorskip("evo.tools.file_interface")
trajectory = pytest.importorskip("evo.core.trajectory")


def drawn(seed, n=12):
    rng = np.random.default_rng(seed)
    poses = [gtsam.Pose3.Expmap(rng.normal(size=6)) for _ in range(n)]
    return poses, np.cumsum(rng.uniform(0.1, 0.2, n)) + 1.5e9


def write(path, poses, times, kind):
    matrices = [pose.matrix() for pose in poses]
    if kind == "TUM":
        file_interface.write_tum_trajectory_file(
            path, trajectory.PoseTrajectory3D(poses_se3=matrices, timestamps=times)
        )
    else:
        file_interface.write_kitti_poses_file(path, trajectory.PosePath3D(poses_se3=matrices))


@pytest.mark.parametrize("kind", ["TUM", "KITTI"])
@pytest.mark.parametrize("seed", range(3))
def test_poses_that_evo_writes_come_back_and_are_tied_as_a_chain(tmp_path, kind, seed):
    poses, times = drawn(seed)
    write(tmp_path / "poses.txt", poses, times, kind)
    dataset = datasets.read(tmp_path / "poses.txt")
    assert dataset.format == f"{kind} trajectory"
    assert all(found.equals(pose, 1e-6) for found, pose in zip(poses_of(dataset.values).values(), poses, strict=True))
    assert [(b.first, b.second) for b in between_factors(dataset.graph)] == [(i, i + 1) for i in range(11)]
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-6)
    assert dataset.closures == ()
    assert any("--loops" in note for note in dataset.notes)


@pytest.mark.parametrize("ends", ["indices", "timestamps"])
def test_loops_are_named_by_index_or_by_time(tmp_path, ends):
    poses, times = drawn(7)
    write(tmp_path / "poses.txt", poses, times, "TUM")
    pairs = [(0, 9), (11, 2)]
    named = pairs if ends == "indices" else [(times[i] + 0.01, times[j] - 0.01) for i, j in pairs]
    (tmp_path / "loops.txt").write_text("# loops\n" + "".join(f"{i:.6f} {j:.6f}\n" for i, j in named))
    dataset = datasets.read(tmp_path / "poses.txt", loops=tmp_path / "loops.txt")
    assert sorted(tuple(dataset.graph.at(slot).keys()) for slot in dataset.closures) == pairs
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-6)


def test_a_loop_measures_what_its_line_says(tmp_path):
    poses, times = drawn(3)
    write(tmp_path / "poses.txt", poses, times, "TUM")
    measured = gtsam.Pose3(gtsam.Rot3.Rz(0.5), np.array([1.0, 2, 0]))
    turn = measured.rotation().toQuaternion()
    lines = {
        "plane": "0 9 1 2 0.5\n",
        "quaternion": f"0 9 1 2 0 {turn.x()} {turn.y()} {turn.z()} {turn.w()}\n",
        "matrix": "0 9 " + " ".join(map(str, measured.matrix()[:3].ravel())) + "\n",
    }
    for line in lines.values():
        (tmp_path / "loops.txt").write_text(line)
        dataset = datasets.read(tmp_path / "poses.txt", loops=tmp_path / "loops.txt")
        assert dataset.graph.at(dataset.closures[0]).measured().equals(measured, 1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 99\n", "by indices from 0 to 11 or timestamps"),
        ("3 3\n", "a loop between two poses"),
        ("0\n", "expected 2 or 5 or 9 or 14 fields"),
        ("0 9 1 2 0 0 0 0 0\n", "unit quaternion"),
        ("0 9 1 0 0 1 0 2 0 1 0 0 1 1\n", "rigid motion"),
    ],
)
def test_a_malformed_list_of_loops_is_named_with_its_line(tmp_path, text, message):
    poses, times = drawn(3)
    write(tmp_path / "poses.txt", poses, times, "TUM")
    (tmp_path / "loops.txt").write_text(text)
    with pytest.raises(FileFormatError, match=rf"loops.txt, line 1: .*{message}"):
        datasets.read(tmp_path / "poses.txt", loops=tmp_path / "loops.txt")


@pytest.mark.parametrize(("text", "pairs"), [("0,9\n2,11\n", [(0, 9), (2, 11)]), ("3 4\n", [(3, 4)]), ("\n", [])])
def test_a_list_of_loops_is_taken_at_its_word(tmp_path, text, pairs):
    """Between commas, between neighbours, or naming none."""
    poses, times = drawn(3)
    write(tmp_path / "poses.txt", poses, times, "TUM")
    (tmp_path / "loops.txt").write_text(text)
    dataset = datasets.read(tmp_path / "poses.txt", loops=tmp_path / "loops.txt")
    assert [tuple(dataset.graph.at(slot).keys()) for slot in dataset.closures] == pairs


def test_loops_belong_to_trajectories_only(tmp_path):
    (tmp_path / "map.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(FileFormatError, match="leave the list of loops out"):
        datasets.read(tmp_path / "map.g2o", loops=tmp_path / "map.g2o")
