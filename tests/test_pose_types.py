"""Keyframes of every type that has a pose: what their between factors measure, and closures among them."""

import gtsam
import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam.adapter.values import measures_pose, read_keyframes

SIDE, LAP = 32, 4 * 32
LENGTH_M = 2.0


def true_pose(k):
    """Around a block, a lap of 128 steps."""
    side, on = divmod(k % LAP, SIDE)
    corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    (x0, y0), (x1, y1) = corners[side], corners[side + 1]
    place = LENGTH_M * np.array([x0 * SIDE + (x1 - x0) * on, y0 * SIDE + (y1 - y0) * on, 0.0])
    return gtsam.Pose3(gtsam.Rot3.Yaw(side * np.pi / 2), place)


def similarity(pose, scale):
    return gtsam.Similarity3(pose.rotation(), pose.translation() / scale, scale)


def flat(pose):
    return gtsam.Pose2(pose.x(), pose.y(), pose.rotation().yaw())


TYPES = {
    "Similarity3": (similarity, gtsam.BetweenFactorSimilarity3, 7),
    "Similarity2": (
        lambda pose, scale: gtsam.Similarity2(flat(pose).rotation(), flat(pose).translation() / scale, scale),
        gtsam.BetweenFactorSimilarity2,
        4,
    ),
    "NavState": (lambda pose, _: gtsam.NavState(pose, np.zeros(3)), gtsam.BetweenFactorNavState, 9),
    "Gal3": (
        lambda pose, _: gtsam.Gal3(pose.rotation(), pose.translation(), np.zeros(3), 0.0),
        gtsam.BetweenFactorGal3,
        10,
    ),
}
"""A value from a pose and a scale, the between factor, and its dimension."""


def driven(name, n):
    """Factors and values of a drive whose odometry drifts, and, of similarities, the scale."""
    value_of, between, dimension = TYPES[name]
    random, noise = np.random.default_rng(1), gtsam.noiseModel.Isotropic.Sigma(dimension, 0.05)
    graph, values, placed = gtsam.NonlinearFactorGraph(), gtsam.Values(), [true_pose(0)]
    for k in range(1, n):
        error = gtsam.Pose3.Expmap(random.normal(0, [2e-4, 2e-4, 2e-3, 0.02, 0.02, 5e-3]))
        placed.append(placed[-1].compose(true_pose(k - 1).between(true_pose(k))).compose(error))
    own = [value_of(pose, 0.5 + 0.001 * k) for k, pose in enumerate(placed)]
    for k, value in enumerate(own):
        values.insert(k, value)
        if k:
            graph.push_back(between(k - 1, k, own[k - 1].between(value), noise))

    def closure(i, j, seen_at=None):
        """What says that j sees the place of `seen_at`, or of i, from where the sensor truly is."""
        motion = true_pose(i if seen_at is None else seen_at).between(true_pose(j))
        here = value_of(gtsam.Pose3(), 0.5 + 0.001 * i)
        return between(i, j, here.between(value_of(motion, 0.5 + 0.001 * j)), noise)

    return graph, values, closure


@pytest.mark.parametrize("name", list(TYPES))
def test_what_a_factor_measures_is_the_relative_pose_that_the_values_would_have(name):
    graph, values, closure = driven(name, 40)
    keyframes = read_keyframes(values)
    for k, factor in enumerate((graph.at(4), graph.at(30))):
        i, j = factor.keys()
        assert measures_pose(factor), k
        expected = keyframes.pose(i).between(keyframes.pose(j))
        assert keyframes.measured(factor, i).equals(expected, 1e-9)
        assert keyframes.measured(factor, j).equals(expected.inverse(), 1e-9)
    found = keyframes.measured(closure(3, 33), 3)
    true = true_pose(3).between(true_pose(33))
    assert found.equals(true if isinstance(found, gtsam.Pose3) else flat(true), 1e-9)


def test_what_measures_no_pose_is_told():
    unit = gtsam.noiseModel.Isotropic.Sigma(1, 1.0)
    values = gtsam.Values()
    for k in range(2):
        values.insert(k, gtsam.Pose3())
    for factor in (
        gtsam.RangeFactorPose3(0, 1, 2.0, unit),
        gtsam.PriorFactorNavState(0, gtsam.NavState(), gtsam.noiseModel.Isotropic.Sigma(9, 1.0)),
        gtsam.BetweenFactorPoint3(0, 1, np.ones(3), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)),
    ):
        assert not measures_pose(factor)
        assert read_keyframes(values).measured(factor, 0) is None


@pytest.mark.parametrize("name", list(TYPES))
def test_closures_are_weighed_whatever_the_type_of_the_keyframes(name):
    """Before, those between similarities, NavStates and their like tied nothing, and all passed."""
    graph, values, closure = driven(name, LAP + 30)
    gate, last = pgti.LoopClosureGate(), LAP + 20
    true = gate.evaluate(graph, values, closure(20, last), 3.0)
    false = gate.evaluate(graph, values, closure(70, last, seen_at=20), 3.0)
    assert (true.verdict, false.verdict) == ("accepted", "rejected")
    assert true.keys == (20, last)


@pytest.mark.parametrize("name", ["Similarity3", "NavState"])
def test_a_whole_graph_of_other_types_is_gated_and_audited(name):
    graph, values, closure = driven(name, LAP + 30)
    true = [graph.size() + k for k in range(3)]
    for k in (10, 18, 26):
        graph.push_back(closure(k, k + LAP))
    graph.push_back(closure(70, LAP + 22, seen_at=22))
    gated = pgti.gate_graph(graph, values, 3.0)
    assert gated.accepted == tuple(true)
    assert gated.rejected == (true[-1] + 1,)

    # the map's own closures, each by the others
    own = pgti.diagnose(graph, values, radii=3.0).closures
    assert own[0].slot == true[-1] + 1
    assert own[0].probability < 0.01
    assert min(each.probability for each in own[1:]) > 0.9


def holding(name):
    """Factors that fix where keyframe 25 is, by the type of the keyframes."""
    pose, three = true_pose(25), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
    value, noise = TYPES[name][0](pose, 0.525), gtsam.noiseModel.Isotropic.Sigma(TYPES[name][2], 1.0)
    found = [getattr(gtsam, f"PriorFactor{name}")(25, value, noise)]
    if name == "NavState":
        found.append(gtsam.GPSFactor2(25, pose.translation(), three))
        found.append(gtsam.GPSFactor2Arm(25, pose.translation(), np.zeros(3), three))
    else:
        found.append(getattr(gtsam, f"NonlinearEquality{name}")(25, value))
    return found


@pytest.mark.parametrize("name", list(TYPES))
def test_positions_in_the_world_hold_keyframes_of_every_type(name):
    graph, values, closure = driven(name, 60)
    gate, offered = pgti.LoopClosureGate(), closure(0, 50)
    free = gate.evaluate(graph, values, offered, 1.0)
    for factor in holding(name):
        held = gtsam.NonlinearFactorGraph(graph)
        held.push_back(getattr(gtsam, f"PriorFactor{name}")(0, value_at(values, name, 0), noise_of(name)))
        held.push_back(factor)
        model = gate.reference_map(held, values, 1.0).settled.model
        assert np.flatnonzero(model.held).tolist() == [0, 25], type(factor).__name__
        assert allowed_m(gate.evaluate(held, values, offered, 1.0)) < 0.8 * allowed_m(free)


def test_what_says_nothing_of_the_position_holds_no_keyframe():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(3):
        values.insert(k, true_pose(k))
        if k:
            between = gtsam.BetweenFactorPose3(k - 1, k, true_pose(k - 1).between(true_pose(k)), noise_of("Pose3"))
            graph.push_back(between)
    graph.push_back(gtsam.PoseRotationPrior3D(1, gtsam.Rot3(), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    graph.push_back(gtsam.PoseTranslationPrior3D(2, np.array([4.0, 0, 0]), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    model = pgti.LoopClosureGate().reference_map(graph, values, 1.0).settled.model
    assert model.held.tolist() == [False, False, True]


def value_at(values, name, key):
    return getattr(values, f"at{name}")(key)


def noise_of(name):
    return gtsam.noiseModel.Isotropic.Sigma(TYPES[name][2] if name in TYPES else 6, 0.01)


def allowed_m(decision):
    """The standard deviation that the decision's first reason names."""
    return float(decision.terms["drift"].sentence.rsplit("give or take ", 1)[1].split()[0])


def registered(first, second, motion):
    """A factor of the caller's own class, a registration of scans, say, between two Pose3."""

    def error(factor, values, jacobians):
        one, two = (values.atPose3(key) for key in factor.keys())  # noqa: SIM118
        found = one.between(two)
        if jacobians is not None:
            jacobians[0], jacobians[1] = -found.inverse().AdjointMap(), np.eye(6)
        return motion.localCoordinates(found)

    return gtsam.CustomFactor(noise_of("Pose3"), [first, second], error)


def test_factors_of_the_callers_own_class_are_odometry_and_closures():
    graph, values, placed = gtsam.NonlinearFactorGraph(), gtsam.Values(), [true_pose(0)]
    random = np.random.default_rng(1)
    for k in range(LAP + 30):
        if k:
            error = gtsam.Pose3.Expmap(random.normal(0, [2e-4, 2e-4, 2e-3, 0.02, 0.02, 5e-3]))
            placed.append(placed[-1].compose(true_pose(k - 1).between(true_pose(k))).compose(error))
            graph.push_back(registered(k - 1, k, placed[-2].between(placed[-1])))
        values.insert(k, placed[-1])
    true = [graph.size() + k for k in range(3)]
    for k in (10, 18, 26):
        graph.push_back(registered(k, k + LAP, true_pose(k).between(true_pose(k + LAP))))
    graph.push_back(registered(70, LAP + 22, true_pose(22).between(true_pose(LAP + 22))))
    unary = gtsam.CustomFactor(noise_of("Pose3"), [3], lambda *_: np.zeros(6))
    graph.push_back(unary)
    adapted = pgti.from_gtsam(graph, values, radii=3.0).adaptation
    assert adapted.used == {"CustomFactor": graph.size() - 1}
    assert adapted.unknown == {"CustomFactor": 1}
    graph.remove(graph.size() - 1)  # GTSAM asks a factor for its Jacobians, which this one has not
    gated = pgti.gate_graph(graph, values, 3.0)
    assert gated.accepted == tuple(true)
    assert gated.rejected == (true[-1] + 1,)
