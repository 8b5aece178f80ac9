"""The gate's verdicts: scenarios with their expected answer, laws of its evidence, and what it refuses."""

import pickle

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import RADIUS, World, between, block, driven, ramp, straight, turn

import pgti_gtsam as pgti
from pgti_gtsam.errors import (
    InvalidClosureError,
    InvalidOptionError,
    InvalidValueError,
    MissingValueError,
    NoRadiusError,
    UnsolvableGraphError,
)
from pgti_gtsam.gate.batch import gate_graph
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.options import GateOptions
from pgti_gtsam.gate.revisits import revisits

GATE = LoopClosureGate()
LAP = 4 * 32  # steps around a block of 60 m
NOWHERE = gtsam.Pose2()


def judged(world, closure, radii=RADIUS, gate=GATE):
    return gate.evaluate(world.graph, world.values, closure, radii)


@pytest.fixture(scope="module")
def lap():
    """One lap with drift, and twenty metres of the second."""
    return driven(block(60) + straight(20), bias=0.003, noise=0.005)


@pytest.fixture(scope="module")
def two_laps():
    """Two laps, tied once where the second begins."""
    world = driven(block(60, times=2), bias=0.002, noise=0.005)
    world.graph.push_back(world.closure(4, 4 + LAP))
    return world


def test_first_contact_after_drift_is_accepted(lap):
    decision = judged(lap, lap.closure(4, 4 + LAP))
    assert decision.accepted
    assert len(decision.reasons) == len(decision.terms)
    assert decision.probability >= GATE.options.min_probability


@pytest.mark.parametrize(("i", "j"), [(4, 70), (20, LAP + 4), (40, LAP)])
def test_a_false_match_is_rejected_with_its_reasons(lap, i, j):
    decision = judged(lap, lap.closure(i, j, NOWHERE))
    assert not decision.accepted
    assert decision.verdict == "rejected"
    assert "from where the closure does" in decision.reasons[0]


def test_closure_at_the_end_of_the_map(lap):
    last = len(lap.truth) - 1
    assert judged(lap, lap.closure(last - LAP, last)).accepted
    assert not judged(lap, lap.closure(last - 60, last, NOWHERE)).accepted


def test_second_pass(two_laps):
    assert judged(two_laps, two_laps.closure(40, 40 + LAP)).accepted
    assert not judged(two_laps, two_laps.closure(20, 40 + LAP, NOWHERE)).accepted


def test_a_closure_that_repairs_a_collision_is_accepted():
    world = driven(straight(60) + turn(np.pi / 2) + straight(8) + turn(np.pi / 2) + straight(60), bias=0.005)
    decision = judged(world, world.closure(2, len(world.truth) - 3))
    assert decision.accepted
    rise = decision.terms.get("contact_rise")
    assert rise is None or rise.value <= 0


def test_crossing():
    right = turn(-np.pi / 2)
    steps = [*straight(60), *right, *straight(30), *right, *straight(30), *right, *straight(70)]
    world = driven(steps, bias=0.002, noise=0.005)
    assert judged(world, world.closure(15, 82)).accepted
    assert not judged(world, world.closure(15, 70, NOWHERE)).accepted


def test_opposite_direction():
    world = driven(straight(80) + turn(np.pi) + straight(80), bias=0.002, noise=0.005)
    last = len(world.truth) - 1
    assert judged(world, world.closure(5, last - 5)).accepted
    assert not judged(world, world.closure(25, last - 5, gtsam.Pose2(0, 0, np.pi))).accepted


@pytest.mark.parametrize("above", [1, 2])
def test_floors_that_look_alike_are_kept_apart(above):
    """Heading may drift by far more than the height of a floor on such a way, pitch of a level body may not."""
    world, lap = driven(ramp(40, 3.0, 3), noise=0.002), 4 * 22
    decision = judged(world, world.closure(5, 5 + above * lap, gtsam.Pose3()), 1.2)
    assert not decision.accepted
    assert decision.terms["drift"].log_odds < 0


def test_second_pass_of_a_floor_is_accepted():
    world = driven(ramp(20, 0.0, 2), noise=0.002)
    assert judged(world, world.closure(5, 5 + 4 * 12), 1.2).accepted


def test_an_old_defect_masks_nothing():
    """A map that collides elsewhere already: what the closure adds is judged, not what was there."""
    steps = straight(80) + turn(np.pi) + straight(120)  # the way back lies on the way out, untied
    world = driven(steps + turn(np.pi / 2) + block(60), noise=0.003)
    start, first = len(steps) + 2, 5 + len(steps) + 2
    healthy = world.closure(start + 1, start + 1 + LAP - 2)
    assert judged(world, healthy).accepted
    assert not judged(world, world.closure(first, first + 60, NOWHERE)).accepted


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e2])
def test_no_covariance_of_the_callers_changes_the_decision(scale):
    world = driven(block(60) + straight(20), bias=0.003, noise=0.005, model_scale=scale)
    closure = gtsam.NonlinearFactorGraph()
    closure.push_back(between(4, 4 + LAP, world.truth[4].between(world.truth[4 + LAP]), scale))
    found, expected = (
        judged(w, c)
        for w, c in (
            (world, closure),
            (driven(block(60) + straight(20), bias=0.003, noise=0.005), world.closure(4, 4 + LAP)),
        )
    )
    assert found == expected


@settings(derandomize=True, deadline=None, max_examples=10)
@given(st.floats(-3, 3), st.floats(-100, 100), st.sampled_from([0.01, 1.0, 50.0]))
def test_neither_where_a_map_lies_nor_how_large_it_is_matters(angle, offset, scale):
    steps = [*straight(30), *turn(np.pi / 2)] * 4
    world, moved = driven(steps, noise=0.005), driven(steps, noise=0.005)
    there = gtsam.Pose2(offset, -offset, angle)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(moved.values.size()):
        values.insert(k, scaled(there.compose(moved.values.atPose2(k)), scale))
    for k in range(moved.graph.size()):
        graph.push_back(scaled_factor(moved.graph.at(k), scale))
    expected = judged(world, world.closure(2, 62, NOWHERE))
    closure = gtsam.NonlinearFactorGraph()
    closure.push_back(scaled_factor(world.closure(2, 62, NOWHERE).at(0), scale))
    found = GATE.evaluate(graph, values, closure, RADIUS * scale)
    assert found.verdict == expected.verdict
    assert found.log_odds == pytest.approx(expected.log_odds, rel=0.01, abs=0.05)
    assert found.terms["drift"].value == pytest.approx(expected.terms["drift"].value * scale, rel=0.01)


def scaled(pose, scale):
    return gtsam.Pose2(scale * pose.x(), scale * pose.y(), pose.theta())


def scaled_factor(factor, scale):
    model = gtsam.noiseModel.Diagonal.Sigmas([0.05 * scale, 0.05 * scale, 0.01])
    return gtsam.BetweenFactorPose2(*factor.keys(), scaled(factor.measured(), scale), model)


def test_nothing_of_the_callers_is_touched(lap):
    closure = lap.closure(4, 4 + LAP)
    before = lap.graph.serialize(), lap.values.serialize(), closure.serialize()
    judged(lap, closure)
    GATE.evaluate_group(lap.graph, lap.values, [closure, lap.closure(4, 70, NOWHERE)], RADIUS)
    assert (lap.graph.serialize(), lap.values.serialize(), closure.serialize()) == before


def test_scores_before_and_after_are_those_of_both_maps(lap):
    closure = lap.closure(4, 4 + LAP)
    decision = judged(lap, closure)
    before = pgti.assess(pgti.from_gtsam(lap.graph, lap.values, radii=RADIUS))
    assert decision.score.before == pytest.approx(before.score, rel=1e-6)
    assert decision.global_score.before == pytest.approx(before.split().global_, rel=1e-6)
    assert decision.score.after < decision.score.before  # what overlapped by drift is tied now
    assert judged(lap, closure, gate=LoopClosureGate(options=GateOptions(scores=False))).score is None


@pytest.mark.parametrize(
    ("rule", "name"), [("global_rise", "Λ_glob"), ("keyframe_rise", "ζ"), ("keyframe_global_rise", "ζ_glob")]
)
def test_the_papers_rule_alone_follows_its_score(rule, name):
    healthy = driven([*straight(100), *turn(1.0)] * 3)
    closure = healthy.closure(4, 120, NOWHERE)
    asked = LoopClosureGate(options=GateOptions(rule=rule, max_rise=1.0))
    rise = judged(healthy, closure, gate=asked).terms[rule].value
    strict, lenient = (
        LoopClosureGate(options=GateOptions(rule=rule, max_rise=limit)) for limit in (rise * 0.9, rise * 1.1)
    )
    assert rise > 0
    assert judged(healthy, closure, gate=strict).verdict == "rejected"
    assert name in judged(healthy, closure, gate=strict).reasons[0]
    assert judged(healthy, closure, gate=lenient).accepted


@pytest.mark.parametrize(
    ("rule", "accepted"), [("global_rise", True), ("keyframe_rise", False), ("keyframe_global_rise", False)]
)
def test_an_old_defect_masks_the_jump_of_the_largest_score_and_of_no_keyframes_own(rule, accepted):
    """A keyframe without any tie, in the free space of others, has an infinite score before and after."""
    world = driven([*straight(100), *turn(1.0)] * 3)
    near, untied = world.values.atPose2(30), len(world.truth)
    world.values.insert(untied, near)
    world.graph.push_back(gtsam.PriorFactorPose2(untied, near, gtsam.noiseModel.Unit.Create(3)))
    asked = LoopClosureGate(options=GateOptions(rule=rule))
    assert judged(world, world.closure(4, 120, NOWHERE), gate=asked).accepted is accepted


def test_a_decision_is_plain_and_small(lap):
    decision = judged(lap, lap.closure(4, 4 + LAP), gate=LoopClosureGate(options=GateOptions(scores=True)))
    packed = pickle.dumps(decision)
    assert len(packed) < 10_000
    assert pickle.loads(packed) == decision


def test_the_free_space_of_a_closure_that_ties_nothing_new_is_not_asked(two_laps):
    assert "contact_rise" not in judged(two_laps, two_laps.closure(20, 40 + LAP, NOWHERE)).terms


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("whose", ["odometry", "closures"])
def test_scaling_the_information_of_either_alone_changes_no_decision(scale, whose):
    plain = driven(block(60) + straight(20), bias=0.003, noise=0.005)
    scaled_ = driven(block(60) + straight(20), bias=0.003, noise=0.005, model_scale=scale if whose == "odometry" else 1)
    for i, j, measured in ((4, 4 + LAP, None), (20, LAP + 4, NOWHERE)):
        z = plain.truth[i].between(plain.truth[j]) if measured is None else measured
        closure = gtsam.NonlinearFactorGraph()
        closure.push_back(between(i, j, z, scale if whose == "closures" else 1.0))
        expected = gtsam.NonlinearFactorGraph()
        expected.push_back(between(i, j, z))
        assert judged(scaled_, closure) == judged(plain, expected)


def test_many_candidates_are_judged_as_each_alone(lap):
    closures = [lap.closure(4, 4 + LAP), lap.closure(4, 70, NOWHERE), lap.closure(9, 9 + LAP)]
    many = GATE.evaluate_many(lap.graph, lap.values, closures, RADIUS)
    assert [decision.accepted for decision in many] == [True, False, True]
    alone = [judged(lap, closure) for closure in closures]
    assert [d.log_odds for d in many] == [d.log_odds for d in alone]
    assert GATE.evaluate_many(lap.graph, lap.values, [], RADIUS) == []


@pytest.mark.parametrize("bad", [0, 4, 9])
def test_one_bad_match_does_not_sink_nine_good_ones(two_laps, bad):
    closures = [two_laps.closure(20 + k, 20 + k + LAP) for k in range(10)]
    closures[bad] = two_laps.closure(20 + bad, 28 + bad + LAP, NOWHERE)
    group = GATE.evaluate_group(two_laps.graph, two_laps.values, closures, RADIUS)
    assert group.accepted == tuple(k for k in range(10) if k != bad)
    assert not group.decisions[bad].accepted


def test_the_larger_party_wins_where_a_group_is_divided(lap):
    """Within drift both could be true; the map alone cannot tell, the others can."""
    off = [lap.closure(k, k + LAP, gtsam.Pose2(5.0, 0.0, 0.0)) for k in (1, 2)]
    good = [lap.closure(k, k + LAP) for k in (3, 4, 5)]
    assert judged(lap, off[0]).accepted
    group = GATE.evaluate_group(lap.graph, lap.values, [*off, *good], RADIUS)
    assert group.accepted == (2, 3, 4)


def test_an_empty_group_leaves_the_map(lap):
    group = GATE.evaluate_group(lap.graph, lap.values, [], RADIUS)
    assert group.decisions == ()
    assert group.accepted == ()


def test_a_duplicate_changes_nothing_and_is_accepted(two_laps):
    decision = judged(two_laps, two_laps.closure(4, 4 + LAP))
    assert decision.accepted
    assert decision.terms["drift"].value < 0.1


def test_odometry_is_judged_like_any_other_closure(lap):
    assert judged(lap, lap.closure(7, 8)).accepted
    assert not judged(lap, lap.closure(7, 8, gtsam.Pose2(9.0, 0.0, 0.0))).accepted


def test_empty_closure(lap):
    with pytest.raises(InvalidClosureError, match="at least one factor"):
        judged(lap, gtsam.NonlinearFactorGraph())


def test_closure_to_an_unknown_key(lap):
    closure = gtsam.NonlinearFactorGraph()
    closure.push_back(between(3, 4711, NOWHERE))
    with pytest.raises(InvalidClosureError, match="4711"):
        judged(lap, closure)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_closure_that_measures_no_number(lap, number):
    with pytest.raises(InvalidClosureError, match="finite"):
        judged(lap, lap.closure(3, 80, gtsam.Pose2(number, 0.0, 0.0)))


def test_map_with_a_missing_value(lap):
    values = gtsam.Values(lap.values)
    values.erase(17)
    with pytest.raises(MissingValueError, match="17"):
        GATE.evaluate(lap.graph, values, lap.closure(4, 4 + LAP), RADIUS)


def test_map_with_a_pose_that_is_no_number(lap):
    values = gtsam.Values(lap.values)
    values.update(17, gtsam.Pose2(np.nan, 0.0, 0.0))
    with pytest.raises(InvalidValueError, match="17"):
        GATE.evaluate(lap.graph, values, lap.closure(4, 4 + LAP), RADIUS)


def test_map_without_radii(lap):
    with pytest.raises(NoRadiusError):
        GATE.evaluate(lap.graph, lap.values, lap.closure(4, 4 + LAP))


def test_map_without_an_optimum(lap):
    graph = gtsam.NonlinearFactorGraph(lap.graph)
    graph.push_back(between(3, 30, gtsam.Pose2(np.nan, 0.0, 0.0)))
    with pytest.raises(UnsolvableGraphError):
        GATE.evaluate(graph, lap.values, lap.closure(4, 4 + LAP), RADIUS)


def test_a_prior_makes_no_difference(lap):
    graph = gtsam.NonlinearFactorGraph(lap.graph)
    graph.push_back(gtsam.PriorFactorPose2(0, lap.values.atPose2(0), gtsam.noiseModel.Unit.Create(3)))
    closure = lap.closure(4, 4 + LAP)
    found, expected = GATE.evaluate(graph, lap.values, closure, RADIUS), judged(lap, closure)
    assert found.log_odds == pytest.approx(expected.log_odds, rel=1e-2)
    assert found.verdict == expected.verdict


def test_a_closure_may_join_maps_that_nothing_tied():
    one, other = driven(straight(40)), driven(straight(40))
    there = gtsam.Pose2(500.0, 300.0, 1.0)
    world = World([*one.truth, *(there.compose(pose) for pose in other.truth)], one.graph, one.values)
    for k, pose in enumerate(other.truth):
        world.values.insert(100 + k, there.compose(pose))
    for k in range(len(other.truth) - 1):
        world.graph.push_back(between(100 + k, 101 + k, other.truth[k].between(other.truth[k + 1])))
    closure = gtsam.NonlinearFactorGraph()
    closure.push_back(between(10, 110, NOWHERE))
    assert judged(world, closure).accepted


def test_a_whole_graph():
    world = driven(block(60, times=2), bias=0.002, noise=0.005)
    true = {world.graph.size() + k: (20 + k, 20 + k + LAP) for k in range(0, 12, 3)}
    false = {20 + world.graph.size() + k: (20 + 7 * k, 110 + 6 * k) for k in range(5)}
    graph = gtsam.NonlinearFactorGraph(world.graph)
    graph.resize(world.graph.size() + 25)
    for slot, ends in true.items():
        graph.replace(slot, world.closure(*ends).at(0))
    for slot, ends in false.items():
        graph.replace(slot, world.closure(*ends, NOWHERE).at(0))
    torn = gtsam.LevenbergMarquardtOptimizer(graph, world.values).optimize()
    told = []
    gated = gate_graph(graph, torn, RADIUS, progress=lambda done, of: told.append((done, of)))
    assert set(gated.accepted) == set(true)
    assert set(gated.rejected) == set(false)
    assert told[-1] == (9, 9)
    assert gated.graph.size() == graph.size()
    assert gated.graph.error(gated.values) < 1.01 * gated.graph.error(
        gtsam.LevenbergMarquardtOptimizer(gated.graph, world.values).optimize()
    )
    assert all((gated.graph.at(slot) is None) == (slot in false) for slot in (*true, *false))


def test_a_keyframe_that_only_closures_tie(lap):
    graph, values = gtsam.NonlinearFactorGraph(lap.graph), gtsam.Values(lap.values)
    values.insert(999, lap.values.atPose2(4))
    graph.push_back(between(4, 999, NOWHERE))
    with pytest.raises(InvalidOptionError, match="999"):
        gate_graph(graph, values, RADIUS)


def test_revisits():
    ends = [(10, 100), (11, 101), (50, 102), (13, 104), (13, 160), (14, 161)]
    sparse = 10.0 * np.arange(400)
    assert revisits(ends, sparse) == [[2], [0, 1, 3], [4, 5]]
    assert revisits([(20, 80), (19, 81), (18, 82)], sparse) == [[0, 1, 2]]  # the other direction
    assert revisits([], sparse) == []
    long = [(k, 50 + k) for k in range(25)]  # one revisit, but longer than any is judged at once
    assert [len(group) for group in revisits(long, np.arange(100.0))] == [11, 11, 3]


def test_a_revisit_is_told_by_the_way_where_keyframes_are_dense():
    dense = 0.1 * np.arange(400)
    assert revisits([(20, 280), (60, 320), (111, 371)], dense) == [[0, 1], [2]]
