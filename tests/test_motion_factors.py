"""Maps whose odometry is inertial: no factor measures a pose, and the factors of the motion are the steps."""

from itertools import pairwise

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X

import pgti_gtsam as pgti
from pgti_gtsam.errors import InvalidOptionError, MissingValueError, UnsolvableGraphError
from pgti_gtsam.pose_graph import EdgeSource
from pgti_gtsam.track import closure_edges, track_of

ROUND_M, SPEED, PERIOD_S, RATE_S = 30.0, 5.0, 0.5, 0.01
TURNING = SPEED / ROUND_M
LAP = round(2 * np.pi / TURNING / PERIOD_S)
NO_BIAS, TIGHT = gtsam.imuBias.ConstantBias(), gtsam.noiseModel.Isotropic.Sigma(6, 0.05)


def true_pose(k):
    angle = TURNING * PERIOD_S * k
    place = [ROUND_M * np.cos(angle), ROUND_M * np.sin(angle), 0.0]
    return gtsam.Pose3(gtsam.Rot3.Yaw(angle + np.pi / 2), place)


def measured(kind, random):
    """What an accelerometer and a gyroscope with noise say of a step on the circle: forward, left, up."""
    parameters = kind[1].MakeSharedU(9.81)
    parameters.setAccelerometerCovariance(1e-4 * np.eye(3))
    parameters.setGyroscopeCovariance(1e-6 * np.eye(3))
    parameters.setIntegrationCovariance(1e-8 * np.eye(3))
    if kind[1] is gtsam.PreintegrationCombinedParams:
        parameters.setBiasAccCovariance(1e-6 * np.eye(3))
        parameters.setBiasOmegaCovariance(1e-8 * np.eye(3))
    found = kind[0](parameters, NO_BIAS)
    for _ in range(round(PERIOD_S / RATE_S)):
        acceleration = np.array([0.0, SPEED * TURNING, 9.81]) + random.normal(0, 0.02, 3)
        found.integrateMeasurement(acceleration, np.array([0.0, 0.0, TURNING]) + random.normal(0, 0.002, 3), RATE_S)
    return found


KINDS = {
    "CombinedImuFactor": (gtsam.PreintegratedCombinedMeasurements, gtsam.PreintegrationCombinedParams),
    "ImuFactor": (gtsam.PreintegratedImuMeasurements, gtsam.PreintegrationParams),
}


def driven(name, n, seed=0):
    """Factors and values of a round and more."""
    random, graph, values = np.random.default_rng(seed), gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.PriorFactorPose3(X(0), true_pose(0), TIGHT))
    state = gtsam.NavState(true_pose(0), true_pose(0).rotation().rotate(np.array([SPEED, 0.0, 0.0])))
    for k in range(n):
        if k:
            step = measured(KINDS[name], random)
            state = step.predict(state, NO_BIAS)
            keys = [X(k - 1), V(k - 1), X(k), V(k), B(k - 1)]
            graph.push_back(
                gtsam.CombinedImuFactor(*keys, B(k), step)
                if name == "CombinedImuFactor"
                else gtsam.ImuFactor(*keys, step)
            )
        values.insert(X(k), state.pose())
        values.insert(V(k), state.velocity())
        values.insert(B(k), NO_BIAS)
    return graph, values


@pytest.mark.parametrize("name", list(KINDS))
def test_inertial_factors_are_the_steps_of_the_track(name):
    graph, values = driven(name, 12)
    closing = gtsam.BetweenFactorPose3(X(1), X(9), gtsam.Pose3(), TIGHT)
    graph.push_back(closing)
    found = pgti.from_gtsam(graph, values, radii=1.0)
    assert found.adaptation.used == {name: 11, "BetweenFactorPose3": 1}
    assert found.adaptation.ignored == {"PriorFactorPose3": 1}
    steps = found.edges[found.edge_sources & EdgeSource.ODOMETRY > 0]
    np.testing.assert_array_equal(steps, [(k, k + 1) for k in range(11)])
    np.testing.assert_array_equal(found.edges[closure_edges(found)], [(1, 9)])
    assert track_of(found).n_chains == 1

    # a factor of the motion is no closure; a velocity may lack, a pose not
    with pytest.raises(InvalidOptionError, match="got slot 3, which holds none"):
        pgti.from_gtsam(graph, values, radii=1.0, closures=[3])
    values.erase(V(4))
    np.testing.assert_array_equal(pgti.from_gtsam(graph, values, radii=1.0).edges, found.edges)
    values.erase(X(4))
    with pytest.raises(MissingValueError, match=f"factor 4 \\({name}\\) with x4"):
        pgti.from_gtsam(graph, values, radii=1.0)


def test_a_step_of_the_motion_may_leave_out_keys():
    """Keyframes chosen from a denser track: no keys follow each other."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    random, places = np.random.default_rng(0), [0, 20, 45, 60]
    for first, second in pairwise(places):
        step = measured(KINDS["ImuFactor"], random)
        graph.push_back(gtsam.ImuFactor(X(first), V(first), X(second), V(second), B(0), step))
    values.insert(B(0), NO_BIAS)
    for k in places:
        values.insert(X(k), true_pose(k / 20))
        values.insert(V(k), np.zeros(3))
    found = pgti.from_gtsam(graph, values, radii=1.0)
    assert (found.edge_sources & EdgeSource.ODOMETRY > 0).sum() == 3
    assert not closure_edges(found).any()


@pytest.mark.parametrize("name", list(KINDS))
def test_closures_on_inertial_odometry_are_weighed(name):
    """Before, no tie led between any keyframes, and every closure passed."""
    graph, values = driven(name, LAP + 40)
    gate, last = pgti.LoopClosureGate(), LAP + 39
    apart = true_pose(last - LAP).between(true_pose(last))
    true = gate.evaluate(graph, values, gtsam.BetweenFactorPose3(X(last - LAP), X(last), apart, TIGHT), 4.0)
    false = gate.evaluate(graph, values, gtsam.BetweenFactorPose3(X(last - LAP + 20), X(last), apart, TIGHT), 4.0)
    assert (true.verdict, false.verdict) == ("accepted", "rejected")
    assert np.isfinite(true.log_odds)


def updates(graph, values, n):
    """Factors, values and closures of every keyframe of a drive: a true closure, and a false one."""
    for k in range(n):
        factors, own = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            for prior in (
                graph.at(0),
                gtsam.PriorFactorVector(V(0), values.atVector(V(0)), gtsam.noiseModel.Isotropic.Sigma(3, 0.01)),
                gtsam.PriorFactorConstantBias(B(0), NO_BIAS, gtsam.noiseModel.Isotropic.Sigma(6, 0.01)),
            ):
                factors.push_back(prior)
        else:
            factors.push_back(graph.at(k))
        own.insert(X(k), values.atPose3(X(k)))
        own.insert(V(k), values.atVector(V(k)))
        own.insert(B(k), values.atConstantBias(B(k)))
        closures = []
        if k in (LAP + 20, LAP + 25):
            wrong = 20 * (k == LAP + 25)
            apart = true_pose(k - LAP).between(true_pose(k))
            closures = [gtsam.BetweenFactorPose3(X(k - LAP + wrong), X(k), apart, TIGHT)]
        yield k, factors, own, closures


def test_a_gated_smoother_takes_inertial_odometry():
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    isam, told = pgti.GatedISAM2(parameters, radii=4.0), []
    for _, factors, own, closures in updates(*driven("CombinedImuFactor", LAP + 30), LAP + 30):
        told += [decision.verdict for decision in isam.update(factors, own, closures).decisions]
    assert told == ["accepted", "rejected"]


def test_a_window_of_inertial_odometry_is_gated_and_resumed_with_its_parameters(tmp_path):
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    window = pgti.GatedFixedLagSmoother(gtsam.BatchFixedLagSmoother(20.0, parameters), radii=4.0)
    told = []
    for k, factors, own, closures in updates(*driven("CombinedImuFactor", LAP + 30), LAP + 30):
        times = dict.fromkeys((X(k), V(k), B(k)), k * PERIOD_S)
        told += [decision.verdict for decision in window.update(factors, own, times, closures=closures).decisions]
    assert told == ["accepted", "rejected"]

    # the window is too poorly conditioned for GTSAM's default
    window.save(tmp_path / "window.json")
    with pytest.raises(UnsolvableGraphError, match="give the parameters of the first start"):
        pgti.GatedFixedLagSmoother.load(tmp_path / "window.json")
    resumed = pgti.GatedFixedLagSmoother.load(tmp_path / "window.json", parameters)
    last = X(LAP + 29)
    assert resumed.estimate().atPose3(last).equals(window.estimate().atPose3(last), 1e-6)


@pytest.mark.parametrize("name", list(KINDS))
def test_a_whole_graph_on_inertial_odometry_is_gated(name):
    graph, values = driven(name, LAP + 40)
    first = graph.size()
    for earlier, later in ((5, LAP + 5), (15, LAP + 15), (25, LAP + 25), (50, LAP + 20)):
        motion = true_pose(later - LAP).between(true_pose(later))
        graph.push_back(gtsam.BetweenFactorPose3(X(earlier), X(later), motion, TIGHT))
    gated = pgti.gate_graph(graph, values, 4.0)
    assert gated.accepted == (first, first + 1, first + 2)
    assert gated.rejected == (first + 3,)
    assert gated.graph.error(gated.values) < gated.graph.error(values)
