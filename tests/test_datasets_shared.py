"""The field's data, where they are at hand: counts that were found by parsing them another way."""

from pathlib import Path

import gtsam
import numpy as np
import pytest

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import between_factors, closure_slots, poses_of

DATA = Path(__file__).parents[1] / ".." / "shared" / "data"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the development data are not beside the checkout")


@pytest.mark.parametrize(
    ("name", "poses", "factors", "closures"),
    [
        ("CSAIL", 1045, 1172, 128),
        ("MIT", 808, 827, 20),
        ("intel", 1728, 2512, 785 - 13),
        ("ring", 434, 459, 26),
        ("manhattan_olson3500", 3500, 5598, 2099 - 62),
        ("city10000", 10000, 20687, 10688 - 21),
        ("parking-garage", 1661, 6275, 4615),
        ("sphere2500", 2500, 4949, 2450),
        ("torus3D", 5000, 9048, 4049),
        ("hdl_graph_gps", 666, 727 + 664, 63),
    ],
)
def test_standard_graphs_agree_with_gtsam(name, poses, factors, closures):
    path = DATA / "pose_graphs" / f"{name}.g2o"
    dataset = datasets.read(path)
    found = poses_of(dataset.values)
    assert (len(found), dataset.graph.size(), len(closure_slots(dataset))) == (poses, factors, closures)
    graph, values = gtsam.readG2o(str(path), isinstance(next(iter(found.values())), gtsam.Pose3))
    assert dataset.values.equals(values, 1e-9)
    betweens = [between.factor for between in between_factors(dataset.graph)]
    assert len(betweens) == graph.size()
    for i in range(0, graph.size(), 97):
        assert betweens[i].equals(graph.at(i), 1e-9)


def test_no_closure_is_lost_where_all_are_switchable(tmp_path):
    lines, switch = [], 10_000
    for line in (DATA / "pose_graphs" / "intel.g2o").read_text().splitlines():
        fields = line.split()
        if fields[0] == "EDGE_SE2" and abs(int(fields[1]) - int(fields[2])) > 1:
            switch += 1
            lines += [f"VERTEX_SWITCH {switch} 1", f"EDGE_SWITCH_PRIOR {switch} 1 1"]
            fields = ["EDGE_SE2_SWITCHABLE", *fields[1:3], str(switch), *fields[3:]]
        lines.append(" ".join(fields))
    (tmp_path / "intel.g2o").write_text("\n".join(lines) + "\n")
    dataset = datasets.read(tmp_path / "intel.g2o")
    plain = datasets.read(DATA / "pose_graphs" / "intel.g2o")
    assert switch == 10_785
    assert len(closure_slots(dataset)) == len(closure_slots(plain))
    assert sum(b.factor.equals(p.factor, 1e-9) for b, p in zip(*map(_ordered, (dataset, plain)), strict=True)) == 2512


def _ordered(dataset):
    return sorted(between_factors(dataset.graph), key=lambda between: (between.first, between.second))


@pytest.mark.parametrize(
    ("name", "poses", "closures", "true"),
    [
        ("00/kitti_00_alpha_0.15", 4541, 433, 117),
        ("00/kitti_00_alpha_0.85", 4541, 169, 125),
        ("06/kitti_06_alpha_0.15", 1101, 150, 45),
        ("06/kitti_06_alpha_0.95", 1101, 52, 48),
        ("07/kitti_07_alpha_0.25", 1101, 124, 6),
        ("07/kitti_07_alpha_0.80", 1101, 8, 1),
    ],
)
def test_kitti_loops_are_labelled_and_survive_subsampling(name, poses, closures, true):
    dataset = datasets.read(DATA / "kitti_robustslam" / f"{name}.g2o")
    assert len(poses_of(dataset.values)) == dataset.truth.size() == poses
    assert (len(closure_slots(dataset)), len(dataset.true_closures)) == (closures, true)
    closures = set(closure_slots(dataset))
    is_identity = {slot for slot in closures if dataset.graph.at(slot).measured().equals(gtsam.Pose2(), 1e-9)}
    assert is_identity == closures - dataset.true_closures
    fewer = datasets.subsample(dataset)
    assert list(poses_of(fewer.values)) == list(range(0, poses, 5))
    assert (len(fewer.closures), len(fewer.true_closures)) == (len(closures), true)
    assert datasets.chain_odometry(fewer).equals(fewer.values, 1e-6)


def test_true_kitti_loops_join_places_that_the_truth_has_near():
    dataset = datasets.read(DATA / "kitti_robustslam" / "06" / "kitti_06_alpha_0.15.g2o")
    place = {key: np.array(pose.translation()) for key, pose in poses_of(dataset.truth).items()}
    for slot in dataset.true_closures:
        first, second = dataset.graph.at(slot).keys()
        assert np.linalg.norm(place[first] - place[second]) < 10.0


@pytest.mark.parametrize(
    ("name", "poses", "factors", "closures", "median"),
    [("fr079", 1464, 2307, 844, 0.76), ("mit-cscail", 1051, 1189, 139, 0.74)],
)
def test_scan_graphs_bring_radii_and_chaining_brings_drift(name, poses, factors, closures, median):
    dataset = datasets.read(DATA / "scan_pose_graphs" / f"{name}.log")
    assert len(poses_of(dataset.values)) == len(dataset.radii) == poses
    assert (dataset.graph.size(), len(closure_slots(dataset))) == (factors, closures)
    assert np.median(list(dataset.radii.values())) == pytest.approx(median)
    assert max(dataset.radii.values()) < 50.0
    drift = dataset.graph.error(datasets.chain_odometry(dataset)) / dataset.graph.error(dataset.values)
    assert drift > 100.0


def test_aces_becomes_a_pose_graph_with_true_loops():
    dataset = datasets.read(DATA / "radish_aces" / "aces.clf.bz2")
    assert (dataset.name, dataset.format) == ("aces", "CARMEN log")
    assert len(closure_slots(dataset)) == len(dataset.true_closures) == 88
    assert len(dataset.radii) == len(poses_of(dataset.values))
    steps = np.diff([pose.translation() for pose in poses_of(dataset.values).values()], axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 2.0
    assert any("7375 'ODOM'" in note for note in dataset.notes)
