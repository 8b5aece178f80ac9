"""Odometry chained, and every k-th pose kept: laws that hold for any track."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_files import FLIRTLIB, G2O, read_text

from pgti_gtsam import datasets
from pgti_gtsam.datasets import Dataset, chain_odometry, subsample
from pgti_gtsam.datasets.chain import between_factors, closure_slots, poses_of
from pgti_gtsam.datasets.subsample import Step, compose
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError


@st.composite
def tracks(draw):
    """A track in the plane or in space: odometry exact, stored either way round; keys skip numbers."""
    n = draw(st.integers(1, 12))
    spatial = draw(st.booleans())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    keys = np.cumsum(rng.integers(1, 4, n)).tolist()
    make = gtsam.Pose3.Expmap if spatial else gtsam.Pose2.Expmap
    poses = [make(rng.normal(size=6 if spatial else 3)) for _ in keys]
    values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
    for key, pose in zip(keys, poses, strict=True):
        values.insert(key, pose)
    between = gtsam.BetweenFactorPose3 if spatial else gtsam.BetweenFactorPose2
    for i in range(n - 1):
        a, b = (i, i + 1) if rng.random() < 0.5 else (i + 1, i)
        root = rng.normal(size=(6, 6) if spatial else (3, 3))
        model = gtsam.noiseModel.Gaussian.Covariance(root @ root.T + 0.1 * np.eye(len(root)))
        graph.push_back(between(keys[a], keys[b], poses[a].between(poses[b]), model))
    return Dataset(name="drawn", format="drawn", graph=graph, values=values)


@settings(derandomize=True, deadline=None)
@given(dataset=tracks())
def test_chaining_exact_odometry_gives_the_poses_back(dataset):
    assert chain_odometry(dataset).equals(dataset.values, 1e-6)


@settings(derandomize=True, deadline=None)
@given(dataset=tracks(), every=st.integers(1, 5))
def test_composed_odometry_measures_what_the_poses_say(dataset, every):
    fewer = subsample(dataset, every)
    keys = list(poses_of(dataset.values))[::every]
    assert list(poses_of(fewer.values)) == keys
    assert fewer.graph.size() == len(keys) - 1
    assert fewer.graph.error(fewer.values) == pytest.approx(0.0, abs=1e-12)
    assert chain_odometry(fewer).equals(fewer.values, 1e-6)


@settings(derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_composition_is_associative(seed):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(3, 6, 6))
    a, b, c = (Step(gtsam.Pose3.Expmap(rng.normal(size=6)), root @ root.T) for root in roots)
    one, other = compose(compose(a, b), c), compose(a, compose(b, c))
    assert one.pose.equals(other.pose, 1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9, atol=1e-9)


def test_composed_covariance_is_that_of_samples():
    """200 000 pairs of noisy steps, drawn small enough for first order to hold."""
    rng = np.random.default_rng(0)
    covariance = np.diag([1e-4, 4e-4, 1e-4])
    step = gtsam.Pose2(2.0, 0.5, 0.7)
    both = compose(Step(step, covariance), Step(step, covariance))
    xi = rng.multivariate_normal(np.zeros(3), covariance, size=(2, 200_000))
    first, second = (np.array([step.x(), step.y(), step.theta()]) + _moved(step, noise) for noise in xi)
    x = first[:, 0] + np.cos(first[:, 2]) * second[:, 0] - np.sin(first[:, 2]) * second[:, 1]
    y = first[:, 1] + np.sin(first[:, 2]) * second[:, 0] + np.cos(first[:, 2]) * second[:, 1]
    rotation = both.pose.rotation().matrix()
    in_body = np.stack([x - both.pose.x(), y - both.pose.y()], axis=1) @ rotation
    error = np.column_stack([in_body, first[:, 2] + second[:, 2] - both.pose.theta()])
    np.testing.assert_allclose(np.cov(error.T), both.covariance, rtol=0.03, atol=4e-6)


def _moved(step, noise):
    """Small body-frame errors (n, 3) as changes of x, y, θ."""
    return np.column_stack([noise[:, :2] @ step.rotation().matrix().T, noise[:, 2]])


def test_the_first_pose_and_all_stretches_without_odometry_keep_their_place(tmp_path):
    text = "".join(f"VERTEX_SE2 {i} {10 * i} 0 0\n" for i in range(4))
    text += "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 3 2 -1 0 0 1 0 0 1 0 1\nEDGE_SE2 3 0 -1 0 0 1 0 0 1 0 1\n"
    dataset = read_text(tmp_path, text)
    chained = poses_of(chain_odometry(dataset))
    assert [pose.x() for pose in chained.values()] == [0, 1, 20, 21]
    assert [pose.x() for pose in poses_of(dataset.values).values()] == [0, 10, 20, 30]


def test_landmarks_move_with_the_pose_that_saw_them_first(tmp_path):
    text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 5 0 0\nVERTEX_SE2 2 9 0 0\nVERTEX_XY 0 5 1\n"
    text += "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n"
    text += "EDGE_SE2_XY 2 0 -4 1 1 0 1\nEDGE_SE2_XY 1 0 0 1 1 0 1\n"
    chained = chain_odometry(read_text(tmp_path, text))
    np.testing.assert_allclose(chained.atPoint2(gtsam.symbol("l", 0)), [1, 1], atol=1e-12)


def test_spatial_landmarks_move_too():
    path = gtsam.findExampleDataFile("known_landmark_localization_20.g2o")
    dataset = datasets.read(path)
    chained = chain_odometry(dataset)
    assert set(chained.keys()) == set(dataset.values.keys())
    moved = [chained.atPoint3(gtsam.symbol("l", i)) - dataset.values.atPoint3(gtsam.symbol("l", i)) for i in range(4)]
    np.testing.assert_allclose(moved, np.zeros((4, 3)), atol=1e-9)  # pose 0 sees all four and does not move


def test_subsampling_keeps_closures_between_the_poses_that_stay(tmp_path):
    dataset = read_text(tmp_path, FLIRTLIB)
    fewer = subsample(dataset, 2)
    assert [tuple(fewer.graph.at(slot).keys()) for slot in closure_slots(fewer)] == [(0, 2)]
    assert dict(fewer.radii) == {0: 1.5, 2: 0.75}
    assert fewer.graph.size() == 2  # the composed step and the closure
    assert subsample(dataset, 1) is dataset
    assert subsample(dataset, 99).graph.size() == 0


def test_subsampling_drops_landmarks_that_nobody_sees_any_more(tmp_path):
    fewer = subsample(read_text(tmp_path, G2O), 2)
    assert set(fewer.values.keys()) == {0, 2, gtsam.symbol("l", 0)}
    assert set(fewer.graph.keyVector()) == set(fewer.values.keys())


def test_a_missing_step_is_not_bridged(tmp_path):
    text = "".join(f"VERTEX_SE2 {i} {i} 0 0\n" for i in range(5)) + "EDGE_SE2 0 4 4 0 0 1 0 0 1 0 1\n"
    text += "".join(f"EDGE_SE2 {i} {i + 1} 1 0 0 1 0 0 1 0 1\n" for i in (0, 2, 3))
    fewer = subsample(read_text(tmp_path, text), 2)
    assert [tuple(f.factor.keys()) for f in between_factors(fewer.graph)] == [(2, 4), (0, 4)]


def test_robust_odometry_is_unwrapped_and_true_closures_follow():
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    base = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    model = gtsam.noiseModel.Robust.Create(huber, base)
    for i in range(5):
        values.insert(i, gtsam.Pose2(i, 0, 0))
    for i, j in [(0, 4), (0, 1), (1, 2), (3, 0), (2, 3), (3, 4), (2, 0)]:
        graph.push_back(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(j - i, 0, 0), model))
    dataset = Dataset(
        name="drawn",
        format="drawn",
        graph=graph,
        values=values,
        closures=(6, 3, 0),
        true_closures=frozenset({0, 3}),
        truth=values,
    )
    fewer = subsample(dataset, 2)
    assert [tuple(fewer.graph.at(s).keys()) for s in closure_slots(fewer)] == [(2, 0), (0, 4)]
    assert [tuple(fewer.graph.at(s).keys()) for s in fewer.true_closures] == [(0, 4)]
    assert list(fewer.truth.keys()) == [0, 2, 4]
    expected = np.diag([0.5, 0.5 + 0.25, 0.5])
    expected[1, 2] = expected[2, 1] = 0.25  # a turn after the first step carries the second one sideways
    np.testing.assert_allclose(fewer.graph.at(0).noiseModel().covariance(), expected, atol=1e-12)


def test_a_closure_between_neighbours_does_not_become_odometry(tmp_path):
    """Once the poses between its ends are gone, a closure links neighbours, and still is none of the odometry."""
    text = "".join(f"VERTEX_SE2 {i} {i} 0 0\n" for i in range(3)) + "EDGE_SE2 0 2 9 0 0 1 0 0 1 0 1\n"
    text += "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n"
    fewer = subsample(read_text(tmp_path, text), 2)
    assert fewer.closures == (1,)
    assert chain_odometry(fewer).atPose2(2).x() == 2
    assert subsample(fewer, 2).graph.size() == 0


def test_every_chain_keeps_its_first_pose(tmp_path):
    """Two sessions under plain numbers, 0 to 4 and 5 to 8: each is thinned out by itself, and stays in one piece."""
    text = "".join(f"VERTEX_SE2 {i} {i % 5} {i // 5} 0\n" for i in range(9))
    text += "".join(f"EDGE_SE2 {i} {i + 1} 1 0 0 1 0 0 1 0 1\n" for i in range(8) if i != 4)
    fewer = subsample(read_text(tmp_path, text + "EDGE_SE2 0 7 2 1 0 1 0 0 1 0 1\n"), 2)
    assert list(poses_of(fewer.values)) == [0, 2, 4, 5, 7]
    assert [b.ends for b in between_factors(fewer.graph)] == [(0, 2), (2, 4), (5, 7), (0, 7)]
    assert fewer.closures == (3,)


def test_robots_that_take_turns_are_chained_each_along_its_own_steps(tmp_path):
    """Even and odd numbers are two robots; no factor leads from one number to the next."""
    text = "".join(f"VERTEX_SE2 {i} {7 * i} {i % 2} 0\n" for i in range(6))
    text += "".join(f"EDGE_SE2 {i} {i + 2} 1 0 0 1 0 0 1 0 1\n" for i in range(4))
    chained = poses_of(chain_odometry(read_text(tmp_path, text)))
    assert [pose.x() for pose in chained.values()] == [0, 7, 1, 8, 2, 9]


def test_what_cannot_be_done_is_said(tmp_path):
    with pytest.raises(InvalidOptionError, match="every=0"):
        subsample(read_text(tmp_path, FLIRTLIB), 0)
    text = "EDGE_SE2 0 1 1 0 0 1 0 0 0 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n"
    with pytest.raises(InvalidGraphError, match="from 0 to 1"):
        subsample(read_text(tmp_path, text), 2)
