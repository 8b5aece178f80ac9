"""A map that grows by keyframes and closures, against the map made anew."""

from dataclasses import replace
from functools import reduce

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V
from streets import RADIUS, between, block, driven, straight

from pgti_gtsam.drift.ties import Ties
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.kept.grown_map import MOST_CLOSURES, GrownMap, Tail

LAP = 4 * 32  # steps around a block of 60 m
GATE = LoopClosureGate()
NOWHERE = gtsam.Pose2()


def part(world, last, closures=()):
    """The first keyframes of a world, with some closures."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(last):
        graph.push_back(world.graph.at(k))
    for closure in closures:
        graph.push_back(closure)
    for k in range(last + 1):
        pose = world.truth[0]
        (values.insert)(k, world.values.atPose2(k) if isinstance(pose, gtsam.Pose2) else world.values.atPose3(k))
    return graph, values


def news(world, first, last):
    """What brings the keyframes after `first` up to `last`."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    at = world.values.atPose2 if isinstance(world.truth[0], gtsam.Pose2) else world.values.atPose3
    for k in range(first, last):
        graph.push_back(world.graph.at(k))
        values.insert(k + 1, at(k + 1))
    return graph, values


def in_space(steps):
    tilted = [
        gtsam.Pose3(gtsam.Rot3.Ypr(s.theta(), 0.0, 0.01 * (-1) ** k), [s.x(), s.y(), 0.0]) for k, s in enumerate(steps)
    ]
    mount = gtsam.Pose3(gtsam.Rot3(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])), np.zeros(3))
    return [mount.inverse().compose(step).compose(mount) for step in tilted]


STEPS = block(60, times=2) + straight(20)


@pytest.fixture(scope="module", params=["plane", "space"])
def world(request):
    if request.param == "plane":
        return driven(STEPS, bias=0.0005, noise=0.002)
    return driven(in_space(STEPS), noise=0.001)


def predicted(reference, closure):
    """What the map made anew says."""
    offered, [own] = reference.offered([closure])
    return offered.residuals[own], offered.joint_covariances([offered.model.ties.pairs[own]])[0]


@pytest.mark.parametrize("first", [LAP - 40, LAP + 20, LAP + 79])
def test_a_grown_map_predicts_what_the_map_made_anew_does(world, first):
    last = LAP + 80
    passed = [world.closure(4, LAP + 4), world.closure(20, LAP + 21), world.closure(LAP + 30, 30)]
    grown = GrownMap.of(GATE.reference_map(*part(world, first), RADIUS)).grown([news(world, first, last)])
    whole = GATE.reference_map(*part(world, last, passed), RADIUS)
    for closure in passed:
        grown = grown.tied_by(closure)
    for i, j in ((10, LAP + 10), (LAP + 60, 50), (3, LAP - 3), (LAP + 70, LAP + 75), (first, first + 1), (0, last)):
        found = grown.predicted(grown.offered(world.closure(i, j)))
        missed, spread = found.missed, found.spread
        expected, covariance = predicted(whole, world.closure(i, j))
        place = whole.settled.model.units.translation
        for part_ in (np.arange(len(spread))[place], np.delete(np.arange(len(spread)), place)):
            own, other = (np.linalg.eigvalsh(found[np.ix_(part_, part_)]) for found in (spread, covariance))
            np.testing.assert_allclose(own, other, rtol=0.05)  # of both vertical axes' signs
            length, other = (np.linalg.norm(found[0][part_]) for found in (missed, expected))
            assert length == pytest.approx(other, abs=0.1 * np.sqrt(own.max()))


def test_closures_that_are_known_one_by_one_predict_as_all_at_once(world):
    """The law: conditioning on closures one after the other is conditioning on all: e_g − P_gc (R + P_cc)⁻¹ e_c."""
    first, last = LAP + 10, LAP + 80
    start = GrownMap.of(GATE.reference_map(*part(world, first), RADIUS)).grown([news(world, first, last)])
    closures = [world.closure(4, LAP + 4), world.closure(20, LAP + 21), world.closure(30, LAP + 70)]
    offered = start.offered(world.closure(12, LAP + 60))
    grown = start
    for closure in closures:
        grown = grown.tied_by(closure)
    one_by_one = grown.predicted(offered)
    ties = reduce(Ties.joined, [*(start.offered(closure) for closure in closures), offered])
    together, k = start.predicted(ties), ties.variances[:-1].size
    known = together.spread[:k, :k] + np.diag(ties.variances[:-1].ravel())
    gain = np.linalg.solve(known, together.spread[:k, k:]).T
    missed = together.missed.ravel()
    np.testing.assert_allclose(one_by_one.missed.ravel(), missed[k:] - gain @ missed[:k], atol=1e-9)
    expected = together.spread[k:, k:] - gain @ together.spread[:k, k:]
    np.testing.assert_allclose(one_by_one.spread, expected, rtol=1e-6, atol=1e-9)
    assert np.linalg.norm(gain) > 0.1


@pytest.mark.parametrize(("i", "j", "measured"), [(8, LAP + 8, None), (20, LAP, "nowhere"), (LAP + 40, 100, "nowhere")])
def test_what_is_foreseen_is_what_the_gate_decides(world, i, j, measured):
    nowhere = type(world.truth[0])() if measured else None
    closure, first, last = world.closure(i, j, nowhere), LAP - 10, LAP + 60
    passed = world.closure(4, LAP + 4)
    grown = GrownMap.of(GATE.reference_map(*part(world, first), RADIUS)).grown([news(world, first, last)])
    grown = grown.tied_by(passed)
    foreseen, tied = GATE.foreseen(grown, closure)
    graph, values = part(world, last, [passed])
    assert len(tied.closures.pairs) == 1 + foreseen.accepted
    assert foreseen.verdict == GATE.evaluate(graph, values, closure, RADIUS).verdict
    assert foreseen.accepted is (measured is None)
    assert foreseen.keys == tuple(sorted((i, j)))


def test_doubt_is_left_to_the_free_space():
    lap = driven(block(60) + straight(20), bias=0.003, noise=0.005)
    grown = GrownMap.of(GATE.reference_map(lap.graph, lap.values, RADIUS))
    assert GATE.foreseen(grown, lap.closure(4, LAP + 4)) is None
    assert GATE.evaluate(lap.graph, lap.values, lap.closure(4, LAP + 4), RADIUS).accepted


def test_what_is_more_than_appended_is_not_grown(world):
    first = LAP
    grown = GrownMap.of(GATE.reference_map(*part(world, first), RADIUS))
    at = world.values.atPose2 if isinstance(world.truth[0], gtsam.Pose2) else world.values.atPose3
    step, prior = (
        world.graph.at(first),
        gtsam.PriorFactorPose2 if isinstance(world.truth[0], gtsam.Pose2) else gtsam.PriorFactorPose3,
    )
    skip = between(first - 1, first + 1, world.truth[first - 1].between(world.truth[first + 1]))
    unit = gtsam.noiseModel.Unit.Create(3 if isinstance(world.truth[0], gtsam.Pose2) else 6)
    for factors, keys in (
        ([], [first + 1]),
        ([step, skip], [first + 1]),
        ([skip], [first + 1]),
        ([step, prior(first + 1, at(first + 1), unit)], [first + 1]),
        ([world.closure(4, LAP).at(0)], []),
    ):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in factors:
            graph.push_back(factor)
        for key in keys:
            values.insert(key, at(key))
        assert grown.grown([(graph, values)]) is None
    assert grown.grown([news(world, first, first + 1)]).places[first + 1] == first + 1


def beside(world, k):
    """Factors and values that a map is read without: velocities, biases, attitudes, and the motion beside a step."""
    unit = {n: gtsam.noiseModel.Unit.Create(n) for n in (1, 2, 3, 6)}
    if isinstance(world.truth[0], gtsam.Pose2):
        return [gtsam.PriorFactorVector(V(k), np.zeros(3), unit[3])], [(V(k), np.zeros(3))]
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    motion = gtsam.PreintegratedCombinedMeasurements(parameters, gtsam.imuBias.ConstantBias())
    motion.integrateMeasurement(np.array([0.0, 0.0, 9.81]), np.zeros(3), 0.5)
    factors = [
        gtsam.CombinedImuFactor(k - 1, V(k - 1), k, V(k), B(k - 1), B(k), motion),
        gtsam.AttitudeFactorPose3(k, gtsam.Unit3(0, 0, 1), unit[2], gtsam.Unit3(0, 0, 1)),
        gtsam.BetweenFactorConstantBias(B(k - 1), B(k), gtsam.imuBias.ConstantBias(), unit[6]),
    ]
    return factors, [(V(k), np.zeros(3)), (B(k), gtsam.imuBias.ConstantBias())]


def test_what_a_map_is_read_without_is_appended_without(world):
    first, last = LAP, LAP + 6
    start, plain, more = GrownMap.of(GATE.reference_map(*part(world, first), RADIUS)), [], []
    for k in range(first, last):
        plain.append(news(world, k, k + 1))
        factors, values = news(world, k, k + 1)
        factors, values = gtsam.NonlinearFactorGraph(factors), gtsam.Values(values)
        own, extra = beside(world, k + 1)
        for factor in own:
            factors.push_back(factor)
        for key, value in extra:
            values.insert(key, value)
        more.append((factors, values))
    expected, found = start.grown(plain), start.grown(more)
    assert dict(found.places) == dict(expected.places)
    np.testing.assert_array_equal(found.tail.gathered, expected.tail.gathered)
    assert found.ends == expected.ends


def test_what_a_map_is_read_from_is_not_appended(world):
    first = LAP
    start = GrownMap.of(GATE.reference_map(*part(world, first), RADIUS))
    planar = isinstance(world.truth[0], gtsam.Pose2)
    d, n = (2, 3) if planar else (3, 6)
    unit, place = gtsam.noiseModel.Unit.Create(d), np.ones(d)
    position = gtsam.PoseTranslationPrior2D if planar else gtsam.PoseTranslationPrior3D
    sighting = gtsam.BearingRangeFactor2D if planar else gtsam.BearingRangeFactor3D
    bearing = gtsam.Rot2() if planar else gtsam.Unit3(1, 0, 0)
    prior = gtsam.PriorFactorPose2 if planar else gtsam.PriorFactorPose3
    insert_point = gtsam.Values.insert if planar else gtsam.Values.insertPoint3
    for factor in (
        position(first + 1, place, unit),
        prior(first + 1, world.truth[0], gtsam.noiseModel.Unit.Create(n)),
        sighting(first + 1, gtsam.symbol("l", 0), bearing, 2.0, gtsam.noiseModel.Unit.Create(d)),
        gtsam.CustomFactor(unit, [first + 1], lambda *_: np.zeros(d)),
    ):
        factors, values = news(world, first, first + 1)
        factors.push_back(factor)
        insert_point(values, gtsam.symbol("l", 0), place)
        assert start.grown([(factors, values)]) is None, type(factor).__name__
    if not planar:  # a keyframe that the motion alone ties
        alone = gtsam.NonlinearFactorGraph()
        alone.push_back(beside(world, first + 1)[0][0])
        assert start.grown([(alone, news(world, first, first + 1)[1])]) is None


def test_a_map_that_grows_at_once_is_the_map_that_grows_step_by_step(world):
    """Steps of two robots in turn, whose keys do not ascend from update to update; the older map stays as it is."""
    first, last, other = LAP, LAP + 9, gtsam.symbol("b", 0)
    graph, values = part(world, first)
    graph.push_back(between(0, other, world.truth[0].between(world.truth[1])))
    values.insert(other, world.truth[1])
    start = GrownMap.of(GATE.reference_map(graph, values, RADIUS))
    steps = []
    for k in range(first, last):
        own, more = gtsam.NonlinearFactorGraph(), gtsam.Values()
        beside = other + k - first
        own.push_back(between(beside, beside + 1, world.truth[0].between(world.truth[1])))
        more.insert(beside + 1, world.truth[k])
        steps += [(own, more), news(world, k, k + 1)]
    by_step = start
    for step in steps:
        by_step = by_step.grown([step])
    at_once = start.grown(steps)
    assert dict(at_once.places) == dict(by_step.places)
    assert list(at_once.places) == [*start.places, *(key for _, own in steps for key in own.keys())]  # noqa: SIM118
    assert at_once.ends == by_step.ends == {0: last, other >> 56: other + last - first}
    np.testing.assert_array_equal(at_once.tail.roots, by_step.tail.roots)
    np.testing.assert_array_equal(at_once.tail.gathered, by_step.tail.gathered)
    assert all(one.equals(two, 0) for one, two in zip(at_once.tail.poses, by_step.tail.poses, strict=True))
    assert len(start.places) == first + 2
    assert start.grown([]) is start


def test_a_closure_that_bends_the_map_asks_for_a_new_one(world):
    grown = GrownMap.of(GATE.reference_map(*part(world, LAP + 60), RADIUS))
    assert grown.tied_by(world.closure(8, LAP + 8)) is not None
    assert grown.tied_by(world.closure(20, LAP, type(world.truth[0])())) is None


def test_the_map_is_made_anew_after_many_closures_or_when_the_tail_is_longer_than_the_map():
    world = driven(straight(8))
    grown = GrownMap.of(GATE.reference_map(*part(world, 4), RADIUS))
    tie = grown.offered(world.closure(0, 4))
    many = reduce(Ties.joined, [tie] * (MOST_CLOSURES + 1))
    long = Tail(poses=(gtsam.Pose2(),) * 6, roots=np.zeros(6, dtype=np.int64), gathered=np.zeros((6, 3, 3)))
    assert not grown.is_worn
    assert not replace(grown, known=replace(grown.known, ties=many.only(slice(1, None)))).is_worn
    assert replace(grown, known=replace(grown.known, ties=many)).is_worn
    assert replace(grown, tail=long).is_worn


def test_where_the_way_is_not_known_a_lone_closure_agrees_and_several_are_left_to_the_whole_map(world):
    grown = GrownMap.of(GATE.reference_map(*part(world, LAP + 60), RADIUS))
    one, other = (grown.offered(world.closure(i, LAP + i)) for i in (8, 9))
    both = one.joined(other)
    unknown = replace(grown, way_m=None)
    assert unknown.way is None
    assert unknown.agree(one, grown.predicted(one).missed)
    assert not unknown.agree(both, grown.predicted(both).missed)
    assert grown.agree(both, grown.predicted(both).missed)
