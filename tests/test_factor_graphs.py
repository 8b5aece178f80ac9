"""Graphs at the door: a closure in any form is the same, empty slots change nothing, and nonsense is refused."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import RADIUS, between, block, driven, straight

import pgti_gtsam as pgti
from pgti_gtsam.errors import InvalidClosureError, InvalidGraphError, InvalidOptionError, PgtiError
from pgti_gtsam.factor_graphs import (
    between_factor,
    checked_closure,
    closure_graph,
    factors_of,
    graph_of,
    joined,
    measured_from,
    slots_of,
    without,
)

GATE = pgti.LoopClosureGate()
SMALL, SPATIAL = np.array([0.05, 0.05, 0.01]), np.array([0.01, 0.01, 0.01, 0.05, 0.05, 0.05])
M = gtsam.noiseModel.mEstimator
ROBUST = [M.Huber, M.Cauchy, M.Tukey, M.DCS, M.GemanMcClure, M.Fair, M.Welsch, M.L2WithDeadZone]


@pytest.fixture(scope="module")
def lap():
    return driven(block(20) + straight(10), bias=0.002, noise=0.003)


def with_empty_slots(graph, places):
    """The same factors with an empty slot before each of some of them."""
    spread = gtsam.NonlinearFactorGraph()
    for slot in range(graph.size()):
        if slot in places:
            spread.push_back(graph.at(0))
            spread.remove(spread.size() - 1)
        spread.push_back(graph.at(slot))
    return spread


def ends(world):
    """Two closures of the second pass over the start: pairs of keyframes."""
    last = len(world.truth) - 1
    return (1, last - 2), (2, last - 1)


def two_closures(world):
    return [world.closure(*pair).at(0) for pair in ends(world)]


@pytest.mark.parametrize("form", [lambda f: f, graph_of, tuple, lambda f: [None, *f, None]])
def test_a_closure_in_any_form_is_the_same_closure(lap, form):
    factors = two_closures(lap)
    found = closure_graph(form(factors))
    assert [a is b for a, b in zip(factors_of(found), factors, strict=True)] == [True, True]
    assert found.size() == 2


def test_a_single_factor_is_a_closure(lap):
    factor = two_closures(lap)[0]
    decision = GATE.evaluate(lap.graph, lap.values, factor, RADIUS)
    assert decision.accepted == GATE.evaluate(lap.graph, lap.values, graph_of([factor]), RADIUS).accepted
    assert not GATE.evaluate(lap.graph, lap.values, between(1, 20, gtsam.Pose2()), RADIUS).accepted


def test_a_closure_stays_as_it_was_given(lap):
    factors = two_closures(lap)
    given_graph = without(graph_of(factors), [0])
    closure_graph(given_graph)
    assert given_graph.size() == 2
    assert given_graph.at(0) is None


@settings(deadline=None, max_examples=15)
@given(st.lists(st.integers(0, 40), max_size=8))
def test_empty_slots_change_nothing(places):
    world = driven(block(20) + straight(10), bias=0.002, noise=0.003)
    spread = with_empty_slots(world.graph, places)
    assert all(f is g for f, g in zip(factors_of(spread), factors_of(world.graph), strict=True))
    closure = two_closures(world)
    plain, other = (GATE.evaluate(graph, world.values, closure, RADIUS) for graph in (world.graph, spread))
    assert (plain.accepted, plain.reasons) == (other.accepted, other.reasons)
    tied, tied_spread = joined(world.graph, graph_of(closure)), joined(spread, graph_of(closure))
    ours, theirs = (pgti.gate_graph(graph, world.values, RADIUS) for graph in (tied, tied_spread))
    shift = spread.size() - world.graph.size()
    assert [slot + shift for slot in ours.accepted] == list(theirs.accepted)
    assert slots_of(theirs.graph)[-1][0] == theirs.accepted[-1]


def test_a_closure_with_an_empty_slot_goes_in_and_out_of_the_smoother(lap):
    isam = pgti.GatedISAM2(radii=RADIUS)
    held = joined(lap.graph)
    held.push_back(gtsam.PriorFactorPose2(0, lap.values.atPose2(0), gtsam.noiseModel.Diagonal.Sigmas(SMALL)))
    first = isam.update(with_empty_slots(held, [3]), lap.values)
    assert len(first.factor_slots) == held.size()
    before = isam.estimate()
    update = isam.update(closures=[without(graph_of(two_closures(lap)), [1])])
    assert update.accepted == (0,)
    assert len(update.slots[0]) == 1
    isam.retract(0)
    assert isam.admitted == {}
    assert isam.estimate().equals(before, 1e-3)


@pytest.mark.parametrize("loss", ROBUST)
def test_a_closure_with_a_robust_noise_model_can_be_retracted(lap, loss):
    isam = pgti.GatedISAM2(radii=RADIUS)
    held = joined(lap.graph)
    held.push_back(gtsam.PriorFactorPose2(0, lap.values.atPose2(0), gtsam.noiseModel.Diagonal.Sigmas(SMALL)))
    isam.update(held, lap.values)
    (i, j), base = ends(lap)[0], gtsam.noiseModel.Diagonal.Sigmas(SMALL)
    model = gtsam.noiseModel.Robust.Create(loss.Create(1.345), base)
    measured = lap.values.atPose2(i).between(lap.values.atPose2(j))
    update = isam.update(closures=[between_factor(i, j, measured, model)])
    assert update.accepted == (0,)
    isam.retract(0)
    assert isam.admitted == {}


def pose_3_world():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(5):
        values.insert(k, gtsam.Pose3(gtsam.Rot3(), [k, 0, 0]))
        if k:
            graph.push_back(between(k - 1, k, gtsam.Pose3(gtsam.Rot3(), [1, 0, 0])))
    return graph, values


NOTHING = gtsam.NonlinearFactorGraph()
SPATIAL_WORLD = pose_3_world()


@pytest.mark.parametrize(
    ("closure", "words"),
    [
        (None, "empty slot"),
        ([], "at least one factor"),
        ([None, None], "at least one factor"),
        (NOTHING, "at least one factor"),
        (without(graph_of([between(0, 3, gtsam.Pose3())]), [0]), "at least one factor"),
        (3.0, "got 3.0"),
        ("x1", "got 'x1'"),
        ((0, 3), "got 0"),
        (gtsam.Pose3(), "type Pose3"),
        (gtsam.Values(), "type Values"),
        ([graph_of([between(0, 3, gtsam.Pose3())])], "evaluate_many"),
        (between(0, 3, gtsam.Pose2()), "BetweenFactorPose2 of 0, 3; of the values, 0 a Pose3, 3 a Pose3"),
        (between(0, 77, gtsam.Pose3()), "77 has no value"),
        ([between(0, 3, gtsam.Pose3()), between(77, 3, gtsam.Pose3())], "77 has no value"),
        (between(0, 3, gtsam.Pose3(gtsam.Rot3(), [np.nan, 0, 0])), "finite"),
    ],
)
def test_what_is_no_closure_is_refused_in_one_line(closure, words):
    graph, values = SPATIAL_WORLD
    with pytest.raises(InvalidClosureError, match=words) as refused:
        GATE.evaluate(graph, values, closure, RADIUS)
    assert "\n" not in str(refused.value)
    with pytest.raises(InvalidClosureError):
        checked_closure(closure, values)


@pytest.mark.parametrize("closures", [between(0, 3, gtsam.Pose3()), graph_of([between(0, 3, gtsam.Pose3())]), 3, None])
def test_several_closures_come_in_a_list(closures):
    graph, values = SPATIAL_WORLD
    for call in (GATE.evaluate_many, GATE.evaluate_group):
        with pytest.raises(InvalidClosureError, match="a list of closures"):
            call(graph, values, closures, RADIUS)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda g, v: pgti.GatedISAM2(2.0), r"GatedISAM2\(radii"),
        (lambda g, v: pgti.GatedISAM2(gate=2.0), "LoopClosureGate"),
        (lambda g, v: pgti.GatedISAM2(gtsam.ISAM2(), pgti.GateOptions()), "LoopClosureGate"),
        (lambda g, v: pgti.LoopClosureGate(options=0.5), "GateOptions"),
        (lambda g, v: pgti.from_gtsam(v, g, radii=1.0), "NonlinearFactorGraph"),
        (lambda g, v: pgti.from_gtsam(g, {}, radii=1.0), "Values"),
        (lambda g, v: pgti.from_gtsam(g, v, radii="1"), "radii"),
        (lambda g, v: pgti.from_gtsam(g, v, radii=[1.0] * 5), "radii"),
        (lambda g, v: pgti.gate_graph([g], v, 1.0), "NonlinearFactorGraph"),
        (lambda g, v: GATE.evaluate([], v, between(0, 3, gtsam.Pose3()), 1.0), "NonlinearFactorGraph"),
        (lambda g, v: GATE.evaluate(g, None, between(0, 3, gtsam.Pose3()), 1.0), "Values"),
        (lambda g, v: pgti.GatedISAM2().update([between(0, 3, gtsam.Pose3())]), "NonlinearFactorGraph"),
    ],
)
def test_a_wrong_type_is_one_clear_error(call, words):
    with pytest.raises((InvalidOptionError, InvalidGraphError), match=words) as refused:
        call(*SPATIAL_WORLD)
    assert "\n" not in str(refused.value)


def test_a_planar_factor_in_a_spatial_map_is_an_error_of_ours():
    graph, values = SPATIAL_WORLD
    mixed = joined(graph, graph_of([between(0, 3, gtsam.Pose2())]))
    for call in (
        lambda: pgti.gate_graph(mixed, values, 1.0),
        lambda: GATE.evaluate(mixed, values, between(0, 4, gtsam.Pose3()), 1.0),
    ):
        with pytest.raises(PgtiError, match="Pose2"):
            call()


@given(st.sampled_from([gtsam.Pose2, gtsam.Pose3]), st.integers(0, 2**32 - 1), st.booleans())
def test_a_between_factor_measures_either_way(kind, seed, backwards):
    size = 3 if kind is gtsam.Pose2 else 6
    pose = kind.Expmap(np.random.default_rng(seed).normal(size=size))
    model = gtsam.noiseModel.Diagonal.Sigmas(SMALL if size == 3 else SPATIAL)
    first, second = (7, 3) if backwards else (3, 7)
    factor = between_factor(first, second, pose, model)
    assert measured_from(factor, first).equals(pose, 1e-9)
    assert measured_from(factor, first).compose(measured_from(factor, second)).equals(kind(), 1e-9)


def test_a_factor_that_is_no_between_factor_measures_no_pose():
    model = gtsam.noiseModel.Diagonal.Sigmas(SMALL)
    assert measured_from(gtsam.PriorFactorPose2(3, gtsam.Pose2(), model), 3) is None
    assert measured_from(gtsam.BetweenFactorRot2(3, 7, gtsam.Rot2(), gtsam.noiseModel.Unit.Create(1)), 3) is None
