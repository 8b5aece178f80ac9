"""What the audit finds on well-known graphs: passes that nobody tied, and nothing on those that are tied."""

from pathlib import Path

import gtsam
import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.estimate import optimised

DATA = Path(__file__).parents[1] / "../shared/data"

TIED = {
    "scan_pose_graphs/mit-cscail.log": None,
    "pose_graphs/manhattan_olson3500.g2o": 1.0,
    "kitti_robustslam/07/kitti_07_odom_GT_LC.g2o": 4.0,
}
UNTIED = {  # radius and the largest missed closures: stretches that pass through each other
    "pose_graphs/intel.g2o": (0.5, [((1468, 1500), (1705, 1727))]),
    "pose_graphs/CSAIL.g2o": (0.5, [((417, 456), (472, 505)), ((338, 355), (550, 568))]),
    "scan_pose_graphs/fr079.log": (None, [((164, 167), (458, 461)), ((851, 864), (1172, 1187))]),
}


def at_optimum(name, radius):
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{path} is not here")
    dataset = datasets.read(path)
    if "kitti" in name:
        dataset = datasets.subsample(dataset, 5)
    return dataset.graph, optimised(dataset.graph, dataset.values), dataset.radii if radius is None else radius


@pytest.mark.parametrize("name", TIED)
def test_a_graph_that_is_tied_is_consistent(name):
    graph, values, radii = at_optimum(name, TIED[name])
    found = pgti.diagnose(graph, values, radii=radii)
    assert found.verdict == "consistent"
    assert not len(found.integrity.collision_edges)
    assert min(closure.probability for closure in found.closures) > 0.99


@pytest.mark.parametrize("name", UNTIED)
def test_the_passes_that_a_graph_leaves_untied_are_named(name):
    radius, expected = UNTIED[name]
    graph, values, radii = at_optimum(name, radius)
    found = pgti.diagnose(graph, values, radii=radii)
    assert found.verdict == "incomplete"
    assert [place.kind for place in found.places[: len(expected)]] == ["missed closure"] * len(expected)
    assert [place.keyframes for place in found.places[: len(expected)]] == expected


@pytest.mark.parametrize("name", ["victoria_park_1k", "kitti00"])
def test_landmarks_tie_what_passes_again(name):
    dataset = datasets.builtin(name)
    found = pgti.diagnose(dataset.graph, optimised(dataset.graph, dataset.values), radii=dataset.radii)
    assert found.verdict == "consistent"
    assert not len(found.integrity.collision_edges)


def test_a_false_closure_is_the_least_probable_of_a_scan_graph():
    graph, values, radii = at_optimum("scan_pose_graphs/mit-cscail.log", None)
    torn = gtsam.NonlinearFactorGraph(graph)
    torn.push_back(gtsam.BetweenFactorPose2(100, 500, gtsam.Pose2(0.2, 0.1, 0.1), graph.at(0).noiseModel()))
    assert np.linalg.norm(values.atPose2(100).translation() - values.atPose2(500).translation()) > 5
    found = pgti.diagnose(torn, optimised(torn, values), radii=radii)
    assert found.verdict == "inconsistent"
    assert found.closures[0].slot == graph.size()
