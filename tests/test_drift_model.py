"""The drift model: closed forms on a chain, covariances as GTSAM has them, residuals as leaving out gives them."""

import gtsam
import numpy as np
import pytest
import streets

import pgti_gtsam as pgti
from pgti_gtsam.drift.left_out import left_out
from pgti_gtsam.drift.model import drift_model
from pgti_gtsam.drift.own_closures import own_closures
from pgti_gtsam.drift.settled import ANCHOR, settle
from pgti_gtsam.drift.ties import DRIFT, OFFSET, STRETCH
from pgti_gtsam.drift.units import Units

RADIUS = 2.0


def model_of(world, closures=()):
    """The drift model of a driven world with closures, at its optimum."""
    graph = gtsam.NonlinearFactorGraph(world.graph)
    for closure in closures:
        graph.push_back(closure)
    values = streets.optimum(graph, world.values)
    return drift_model(graph, values, pgti.from_gtsam(graph, values, radii=RADIUS))


def test_a_straight_chain_drifts_as_white_steps_do():
    n, step = 40, streets.STEP
    model = model_of(streets.driven(streets.straight(n * step)))
    pairs = np.array([[0, k] for k in range(1, n + 1)])
    found = settle(model).covariances(pairs)
    k = np.arange(1, n + 1)
    square = DRIFT**2 * step / model.units.unit_m
    along = k * square * (1 + (STRETCH / DRIFT) ** 2) * model.units.unit_m**2
    np.testing.assert_allclose(found[:, 0, 0], along, rtol=1e-6)
    np.testing.assert_allclose(found[:, 2, 2], k * square, rtol=1e-6)  # heading
    across = k * square * model.units.unit_m**2 + square * step**2 * (k - 1) * k * (2 * k - 1) / 6
    np.testing.assert_allclose(found[:, 1, 1], across, rtol=1e-6)


@pytest.mark.parametrize("steps", [streets.block(40, 2), streets.ramp(12, 3, 3)], ids=["planar", "in space"])
def test_covariances_are_those_of_gtsams_bayes_tree(steps):
    world = streets.driven(steps, noise=0.002, seed=3)
    ends = [(0, len(steps) // 2), (3, len(steps) - 2)]
    model = model_of(world, [world.closure(*pair) for pair in ends])
    asked = np.array([[1, len(steps) - 5], [7, 9], [20, 5]])
    settled = settle(model)
    d, graph, values = len(model.units.spread), gtsam.NonlinearFactorGraph(), gtsam.Values()
    kinds = (gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2) if model.units.is_planar else (
        gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3)  # fmt: skip
    for (i, j), variances in zip(model.ties.pairs.tolist(), model.ties.variances, strict=True):
        exact = settled.poses[i].between(settled.poses[j])  # without a residual GTSAM's Jacobians are ours
        graph.push_back(kinds[0](i, j, exact, gtsam.noiseModel.Diagonal.Variances(variances)))
    graph.push_back(
        kinds[1](0, settled.poses[0], gtsam.noiseModel.Diagonal.Variances(model.units.variances(ANCHOR, ANCHOR)))
    )
    for i, pose in enumerate(settled.poses):
        values.insert(i, pose)
    tree = graph.linearize(values).eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)
    for (i, j), found in zip(asked.tolist(), settled.covariances(asked), strict=True):
        joint = tree.jointMarginalCovariance([i, j])
        both = np.block([[joint.at(a, b) for b in (i, j)] for a in (i, j)])
        jacobian = np.hstack([-settled.poses[j].between(settled.poses[i]).AdjointMap(), np.eye(d)])
        np.testing.assert_allclose(found, jacobian @ both @ jacobian.T, rtol=1e-5, atol=1e-7)


def test_what_a_tie_misses_is_what_the_map_without_it_predicts():
    world = streets.driven(streets.block(40, 2), bias=2e-4, noise=0.002, seed=1)
    n = len(world.truth)
    closures = [world.closure(i, i + n // 2) for i in range(2, 40, 9)]
    model = model_of(world, closures)
    settled = settle(model)
    ties = model.ties.closures
    for k, missed, others in zip(ties.tolist(), *left_out(settled, ties), strict=True):
        active = np.ones(len(model.ties.pairs), dtype=bool)
        active[k] = False
        without = settle(model, active, settled)
        expected = without.covariances(model.ties.pairs[k : k + 1])[0]
        scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
        np.testing.assert_allclose(others / scale, expected / scale, atol=0.02)  # linearised elsewhere
        np.testing.assert_allclose(missed, without.residuals[k], atol=0.02 * model.units.unit_m)


def test_parts_that_no_tie_joins_may_lie_anywhere():
    world = streets.driven(streets.straight(40))
    graph = gtsam.NonlinearFactorGraph(world.graph)
    graph.remove(10)
    pose_graph = pgti.from_gtsam(graph, world.values, radii=RADIUS)
    settled = settle(drift_model(graph, world.values, pose_graph))
    allowances = settled.model.units.allowances_m(settled.covariances(np.array([[0, 20], [0, 5]])))
    assert allowances[0] == np.inf
    assert 0 < allowances[1] < np.inf
    [joint] = settled.joint_covariances([np.array([[0, 20], [0, 5]])])
    assert np.isnan(joint[:3]).all()
    assert np.isnan(joint[:, :3]).all()
    np.testing.assert_allclose(joint[3:, 3:], settled.covariances(np.array([[0, 5]]))[0], rtol=1e-6, atol=1e-12)


def false_closure(world, i, j):
    """Says that two keyframes are at one place."""
    return world.closure(i, j, type(world.truth[0])())


@pytest.mark.parametrize("steps", [streets.block(60, 2), streets.ramp(15, 3, 3)], ids=["planar", "in space"])
@pytest.mark.parametrize("model_scale", [0.1, 1.0, 30.0])
def test_a_false_closure_is_the_least_probable_whatever_sigmas_the_caller_told(steps, model_scale):
    world = streets.driven(steps, bias=1e-4, noise=0.002, seed=2, model_scale=model_scale)
    n = len(world.truth)
    lap = len(steps) // (2 if world.graph.at(0).dim() == 3 else 3)
    true = [world.closure(i, i + lap) for i in range(0, n - lap, 7)]
    intact = own_closures(model_of(world, true))
    assert not intact.is_false.any()
    assert intact.probabilities.min() > 0.99
    torn = own_closures(model_of(world, [*true, false_closure(world, 4, 4 + lap // 2)]))
    assert torn.slots[torn.is_false].tolist() == [world.graph.size() + len(true)]
    assert np.argmin(torn.log_odds) == len(true) or torn.slots[np.argmin(torn.log_odds)] == torn.slots.max()


def test_false_closures_that_agree_are_found_together():
    world = streets.driven(streets.block(60, 2), bias=1e-4, noise=0.002, seed=2)
    n = len(world.truth)
    true = [world.closure(i, i + n // 2) for i in range(0, n // 2, 5)]
    false = [false_closure(world, 4 + k, 4 + k + n // 4) for k in range(3)]
    found = own_closures(model_of(world, [*true, *false]))
    first = world.graph.size() + len(true)
    assert found.slots[found.is_false].tolist() == [first, first + 1, first + 2]
    assert found.n_rounds >= 1


def test_a_closure_that_alone_holds_two_parts_together_is_not_judged():
    world = streets.driven(streets.straight(60))
    graph = gtsam.NonlinearFactorGraph(world.graph)
    graph.remove(10)
    graph.push_back(world.closure(5, 20))
    found = own_closures(drift_model(graph, world.values, pgti.from_gtsam(graph, world.values, radii=RADIUS)))
    assert np.isnan(found.log_odds).all()
    assert not found.is_false.any()


def test_a_closure_is_granted_an_offset_and_near_misses():
    world = streets.driven(streets.block(60, 2), noise=0.001, seed=5)
    n = len(world.truth)
    lap = n // 2
    shifts = [0.5 * OFFSET, 0.5, 8.0]  # in ρ: a good match, a match of places, another place
    for shift, is_false in zip(shifts, (False, False, True), strict=True):
        off = world.truth[10].between(world.truth[10 + lap]).compose(gtsam.Pose2(shift * RADIUS, 0, 0))
        closures = [world.closure(i, i + lap) for i in (2, 18, 30)] + [world.closure(10, 10 + lap, off)]
        found = own_closures(model_of(world, closures))
        assert found.is_false.tolist() == [False, False, False, is_false] or (
            found.slots[found.is_false].tolist() == ([found.slots.max()] if is_false else [])
        )


@pytest.mark.parametrize("sigmas", [(2.0, 3.0), (3.0, 2.0)])
def test_a_prediction_is_as_uncertain_as_along_its_least_certain_axis(sigmas):
    units = Units(unit_m=1.0, levelling=gtsam.Pose2(), tilt=1.0, spread=np.eye(3))
    turned = np.diag([*np.square(sigmas), 100.0])
    turned[:2, :2] = gtsam.Rot2(0.4).matrix() @ turned[:2, :2] @ gtsam.Rot2(0.4).matrix().T
    found = units.allowances_m(np.stack([turned, np.full((3, 3), np.nan)]))
    assert found.tolist() == pytest.approx([3.0, np.inf])


def test_a_factor_over_two_steps_is_no_closure_of_the_drift_model():
    world = streets.driven(streets.straight(20 * streets.STEP))
    graph = gtsam.NonlinearFactorGraph(world.graph)
    for k in range(0, 18, 2):
        graph.push_back(streets.between(k, k + 2, world.truth[k].between(world.truth[k + 2])))
    pose_graph = pgti.from_gtsam(graph, world.values, radii=RADIUS)
    ties = drift_model(graph, world.values, pose_graph).ties
    assert (ties.slots < 0).all()
    assert len(ties.pairs) == graph.size()
    assert (ties.drifts > 0).sum() == 20


@pytest.mark.parametrize("still", [False, True])
def test_a_range_between_keyframes_fixes_no_pose(still):
    """Before, a range counted as a match of places, and ranges across a map seemed to hold the map as closures do."""
    world = streets.driven(streets.block(60, times=2)[:160], bias=0.002, noise=0.006)
    values, noise = gtsam.Values(world.values), gtsam.noiseModel.Isotropic.Sigma(1, 0.1)
    if still:  # all at one place
        for k in range(len(world.truth)):
            values.update(k, gtsam.Pose2())
    graph = gtsam.NonlinearFactorGraph(world.graph)
    for i, j in ((5, 133), (10, 120), (30, 100)):
        apart = world.truth[i].range(world.truth[j].translation())
        graph.push_back(gtsam.RangeFactorPose2(i, j, apart, noise))
    bare, ranged = (
        settle(drift_model(own, values, pgti.from_gtsam(own, values, radii=RADIUS))) for own in (world.graph, graph)
    )
    pairs = np.array([[20, 148], [0, 100]])
    np.testing.assert_allclose(ranged.covariances(pairs), bare.covariances(pairs), rtol=0.02)


def test_a_range_joins_parts_and_says_nothing_of_where_they_lie():
    world = streets.driven(streets.straight(20 * streets.STEP))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values(world.values)
    for k in (k for k in range(20) if k != 10):
        graph.push_back(world.graph.at(k))
    ranged = gtsam.NonlinearFactorGraph(graph)
    ranged.push_back(gtsam.RangeFactorPose2(3, 15, 12 * streets.STEP, gtsam.noiseModel.Isotropic.Sigma(1, 0.1)))
    settled = settle(drift_model(ranged, values, pgti.from_gtsam(ranged, values, radii=RADIUS)))
    assert np.sqrt(settled.covariances(np.array([[5, 18]]))[0, 0, 0]) > 20 * streets.STEP


def crossing(n):
    """Keyframes on a line, passed twice, so that two of them stand at one place."""
    noise, graph, values = gtsam.noiseModel.Isotropic.Sigma(6, 0.1), gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(n):
        values.insert(k, gtsam.Pose3(gtsam.Rot3(), [k % (n // 2), 0, 0]))
        if k:
            step = values.atPose3(k - 1).between(values.atPose3(k))
            graph.push_back(gtsam.BetweenFactorPose3(k - 1, k, step, noise))
    return graph, values


@pytest.mark.parametrize(
    ("factors", "fixes"),
    [
        ([gtsam.RangeFactorPose3(3, 13, 1.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.1))] * 7, False),
        ([gtsam.BearingRangeFactorPose3(3, 13, gtsam.Unit3(1, 0, 0), 1.0, gtsam.noiseModel.Unit.Create(3))], False),
        (
            [
                gtsam.EssentialMatrixConstraint(
                    3, 13, gtsam.EssentialMatrix(gtsam.Rot3(), gtsam.Unit3(1, 0, 0)), gtsam.noiseModel.Unit.Create(5)
                )
            ],
            False,
        ),
        ([gtsam.NonlinearEquality2Pose3(3, 13)], True),
        ([gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(6), [3, 13], lambda *_: np.zeros(6))], True),
    ],
    ids=["seven ranges", "bearing and range", "essential matrix", "equality", "of the caller"],
)
def test_factors_of_fewer_numbers_than_a_pose_fix_none_even_where_they_have_no_derivative(factors, fixes):
    """The two keyframes stand at one place, where bearings and essential matrices have no derivative."""
    graph, values = crossing(20)
    for factor in factors:
        graph.push_back(factor)
    settled = settle(drift_model(graph, values, pgti.from_gtsam(graph, values, radii=RADIUS)))
    bare = settle(drift_model(*crossing(20), pgti.from_gtsam(*crossing(20), radii=RADIUS)))
    across = np.array([[3, 13]])
    ratio = settled.covariances(across)[0, 3, 3] / bare.covariances(across)[0, 3, 3]
    assert ratio < 0.5 if fixes else ratio > 0.98
