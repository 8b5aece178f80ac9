"""How well ties hold a map: the truth's net against GTSAM's marginals, and what counts as evidence once."""

import gtsam
import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam.diagnosis.evidence import counted_once
from pgti_gtsam.pose_graph import EdgeSource
from scenarios.diagnosis.held import LEAST_STEP, MATCH, MATCH_RAD, POOR, Held

N = 30
STEPS = np.array([[k, k + 1] for k in range(N - 1)])
CLOSURES = np.array([[0, 20], [5, 25]])


def marginal(poses, pairs, i, j):
    """Largest standard deviation of j's place seen from i, by GTSAM; pairs with deviations of place and turn."""
    planar = isinstance(poses[0], gtsam.Pose2)
    factor, prior = (
        (gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2)
        if planar
        else (gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3)
    )
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def noise(moved, turned):
        return gtsam.noiseModel.Diagonal.Sigmas(
            np.array([moved] * 2 + [turned] if planar else [turned] * 3 + [moved] * 3)
        )

    for k, pose in enumerate(poses):
        values.insert(k, pose)
    for a, b, moved, turned in pairs:
        graph.add(factor(a, b, poses[a].between(poses[b]), noise(moved, turned)))
    graph.add(prior(0, poses[0], noise(1e-4, 1e-4)))
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance([i, j]).fullMatrix()
    d = len(joint) // 2
    carry = np.hstack([-poses[j].between(poses[i]).AdjointMap(), np.eye(d)])
    own = slice(0, 2) if planar else slice(3, 6)
    return np.sqrt(np.linalg.eigvalsh((carry @ joint @ carry.T)[own, own])[-1])


@pytest.mark.parametrize("n_axes", [2, 3])
def test_a_net_of_ties_holds_a_map_as_gtsam_says(n_axes):
    random = np.random.default_rng(n_axes)
    places = 3 * random.normal(size=(N, n_axes))
    poses = [
        gtsam.Pose2(*place, random.normal())
        if n_axes == 2
        else gtsam.Pose3(gtsam.Rot3.Expmap(random.normal(size=3)), place)
        for place in places
    ]
    ways = POOR * np.sqrt(np.maximum(np.linalg.norm(np.diff(places, axis=0), axis=1), LEAST_STEP))
    pairs = [(i, j, way, way) for (i, j), way in zip(STEPS.tolist(), ways, strict=True)]
    pairs += [(i, j, MATCH, MATCH_RAD) for i, j in CLOSURES.tolist()]
    asked = np.array([[3, 22], [10, 28], [0, 29]])
    expected = [marginal(poses, pairs, i, j) for i, j in asked.tolist()]
    np.testing.assert_allclose(Held.by(places, STEPS, CLOSURES).deviations(asked), expected, rtol=1e-5)


def test_nothing_holds_two_parts_to_each_other():
    places = np.column_stack([np.arange(N), np.zeros(N)]).astype(float)
    held = Held.by(places, np.delete(STEPS, 14, axis=0), np.empty((0, 2), dtype=np.int64))
    assert np.isinf(held.deviations(np.array([[3, 20]]))).all()
    assert np.isfinite(held.deviations(np.array([[3, 10]]))).all()


def test_what_neighbours_on_the_track_see_in_common_is_counted_once():
    """Neighbours are five radii of way apart at most: here eight keyframes."""
    both = EdgeSource.COVISIBILITY | EdgeSource.ODOMETRY
    seen = [(i, j) for i in range(N) for j in range(i + 2, min(i + 9, N))]
    edges = np.array([*STEPS.tolist(), *seen, (0, 9), (0, 28)])
    pose_graph = pgti.PoseGraph(
        keys=np.arange(N, dtype=np.uint64),
        positions=np.column_stack([0.625 * np.arange(N), np.zeros(N), np.zeros(N)]),
        edges=edges,
        radii=np.ones(N),
        edge_sources=np.array([both] * len(STEPS) + [EdgeSource.COVISIBILITY] * (len(seen) + 2), dtype=np.uint8),
    )
    kept = counted_once(pose_graph)
    assert kept.edges.tolist() == sorted([*STEPS.tolist(), [0, 9], [0, 28]])
    assert len(kept.edge_slots) == len(kept.edge_sources) == N + 1
