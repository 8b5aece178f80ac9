"""The gate in situations of its own, each with its verdict: far, in space, at the ends, singular, refused."""

import gtsam
import numpy as np
import pytest
from streets import RADIUS, STEP, World, between, block, driven, ramp, straight, turn

from pgti_gtsam.errors import InvalidClosureError, UnusedValueError
from pgti_gtsam.factor_graphs import factors_of
from pgti_gtsam.gate import admission
from pgti_gtsam.gate.batch import gate_graph
from pgti_gtsam.gate.decision import Change
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.pair_codes import codes_of

GATE = LoopClosureGate()
LAP = 4 * 32  # steps around a block of 60 m
NOWHERE, NOWHERE_3D = gtsam.Pose2(), gtsam.Pose3()


def judged(world, closure, radii=RADIUS):
    return GATE.evaluate(world.graph, world.values, closure, radii)


def in_space(steps, climb=0.0):
    """Planar steps as steps in space, each of which climbs a little."""
    return [
        gtsam.Pose3(gtsam.Rot3.Yaw(step.theta()), [step.x(), step.y(), climb]) if climb else gtsam.Pose3(step)
        for step in steps
    ]


@pytest.fixture(scope="module")
def lap():
    return driven(block(60) + straight(20), bias=0.003, noise=0.005)


@pytest.mark.parametrize("seed", range(3))
def test_first_contact_after_a_kilometre_of_drift(seed):
    """The estimate has left the place by several radii; a match of another place must not pass for it."""
    side = 250
    world = driven(block(side) + straight(20), bias=0.0005, noise=0.003, seed=seed)
    lap = 4 * (round(side / STEP) + 2)
    off = np.linalg.norm(world.values.atPose2(lap + 4).translation() - world.truth[lap + 4].translation())
    assert off > 2 * RADIUS
    assert judged(world, world.closure(4, lap + 4)).accepted
    assert not judged(world, world.closure(60, lap + 4, NOWHERE)).accepted
    assert not judged(world, world.closure(40, 300, NOWHERE)).accepted


def test_second_pass_in_space():
    world = driven(in_space(block(60, times=2)), bias=0.002, noise=0.003)
    world.graph.push_back(world.closure(4, 4 + LAP))
    assert judged(world, world.closure(40, 40 + LAP)).accepted
    assert not judged(world, world.closure(20, 40 + LAP, NOWHERE_3D)).accepted


def test_crossing_in_space():
    right = turn(-np.pi / 2)
    steps = [*straight(60), *right, *straight(30), *right, *straight(30), *right, *straight(70)]
    world = driven(in_space(steps), noise=0.003)
    assert judged(world, world.closure(15, 82)).accepted
    assert not judged(world, world.closure(15, 70, NOWHERE_3D)).accepted


# What the gate cannot tell: with the bridge pulled down onto the road, free space is that of a crossing, and over
# 134 m of way poor odometry may well drift by two metres. A level body's does not drift by ten, three radii.
@pytest.mark.parametrize(("height", "accepted"), [(2, True), (10, False), (20, False), (40, False)])
def test_a_bridge_is_no_crossing_unless_drift_may_be_as_high(height, accepted):
    right = turn(-np.pi / 2)
    steps = [*straight(60), *right, *straight(30), *right, *straight(30), *right, *straight(70)]
    world = driven(in_space(steps, climb=height / 67), noise=0.003)
    gap = world.truth[82].translation() - world.truth[15].translation()
    assert gap[2] == pytest.approx(height, abs=0.1)
    decision = judged(world, world.closure(15, 82, gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), np.zeros(3))))
    assert decision.accepted is accepted


def test_opposite_direction_in_space():
    world = driven(in_space(straight(80) + turn(np.pi) + straight(80)), noise=0.003)
    last = len(world.truth) - 1
    assert judged(world, world.closure(5, last - 5)).accepted
    assert not judged(world, world.closure(25, last - 5, gtsam.Pose3(gtsam.Rot3.Yaw(np.pi), np.zeros(3)))).accepted


def test_second_pass_of_one_floor_of_several():
    """Up the ramp, and around on the top floor again: the top matches itself, and not the floor below."""
    lap = 4 * 22
    world = driven(ramp(40, 3.0, 2) + ramp(40, 0.0, 2), noise=0.002)
    same, below = 2 * lap + 5, lap + 5
    assert judged(world, world.closure(same, same + lap), 1.2).accepted
    assert not judged(world, world.closure(below, same + lap, NOWHERE_3D), 1.2).accepted


@pytest.mark.parametrize("ends", [(0, LAP), (0, LAP + 10), (10, LAP + 10)])
def test_closures_at_the_first_and_at_the_last_keyframe(lap, ends):
    assert ends[1] <= len(lap.truth) - 1
    assert judged(lap, lap.closure(*ends)).accepted


def test_a_closure_to_the_last_keyframe_of_a_dead_end():
    """Nothing is behind the last keyframe that could touch anything: its false match still bends the map."""
    world = driven(straight(100), noise=0.005)
    last = len(world.truth) - 1
    assert not judged(world, world.closure(last - 20, last, NOWHERE)).accepted


@pytest.mark.parametrize(("rounds", "accepted"), [(0, (1,)), (admission.MOST_ROUNDS, (0, 1))])
def test_a_revisit_that_the_free_space_refused_is_asked_again_when_another_is_tied(monkeypatch, rounds, accepted):
    """The free space speaks against the one revisit until the other is tied."""
    world = driven(block(60, times=2), bias=0.002, noise=0.003)
    one, other = (4, 4 + LAP), (40, 40 + LAP)

    def rise(before, after):
        ties, tied = codes_of(np.array([one, other]), len(world.truth)), (before.connected, after.connected)
        is_refused = ties[0] in tied[1] and ties[1] not in tied[0]
        return Change(before=0.0, after=5.0 if is_refused else 0.0), None

    monkeypatch.setattr(admission, "DOUBT", np.inf)
    monkeypatch.setattr(admission, "MOST_ROUNDS", rounds)
    monkeypatch.setattr(admission, "local_rise", rise)
    closures = [world.closure(*one), world.closure(*other)]
    assert GATE.evaluate_group(world.graph, world.values, closures, RADIUS).accepted == accepted


@pytest.mark.parametrize("at_fault", range(0, 16, 5))
def test_one_at_fault_of_many_in_doubt_is_found_by_halves(monkeypatch, at_fault):
    """The free space speaks against one of sixteen revisits."""
    world, asked = driven(block(60, times=3), noise=0.003), []
    ends = [(k, k + lap) for k in range(0, LAP, 16) for lap in (LAP, 2 * LAP)]
    code = codes_of(np.array([ends[at_fault]]), len(world.truth))[0]

    def rise(before, after):
        asked.append(after)
        return Change(before=0.0, after=5.0 if code in after.connected else 0.0), None

    monkeypatch.setattr(admission, "DOUBT", np.inf)
    monkeypatch.setattr(admission, "MOST_ROUNDS", 0)
    monkeypatch.setattr(admission, "local_rise", rise)
    judged_ = GATE.evaluate_group(world.graph, world.values, [world.closure(*each) for each in ends], RADIUS)
    assert judged_.accepted == tuple(k for k in range(16) if k != at_fault)
    assert len(asked) == 2 + 2 * 4  # with what is sure, all in doubt, and two at each of four levels


@pytest.mark.parametrize("many", [1, 3])
def test_where_many_are_open_few_are_weighed_at_a_time_with_the_same_verdicts(monkeypatch, many):
    """True and false closures, revisits far enough apart to be judged one by one."""
    world = driven(block(60, times=3), bias=0.001, noise=0.003)
    true = [world.closure(k, k + lap) for k in range(0, LAP, 16) for lap in (LAP, 2 * LAP)]
    false = [world.closure(k, k + LAP + 40, NOWHERE) for k in range(8, LAP - 40, 16)]
    closures = [each for pair in zip(true, [*false, *true[: len(true) - len(false)]], strict=True) for each in pair]
    whole = GATE.evaluate_group(world.graph, world.values, closures, RADIUS)
    monkeypatch.setattr(admission, "WEIGHED", many)
    monkeypatch.setattr(admission, "AT_ONCE", many)
    by_parts = GATE.evaluate_group(world.graph, world.values, closures, RADIUS)
    assert by_parts.accepted == whole.accepted
    assert 0 < len(whole.accepted) < len(closures)


def test_what_a_revisit_turns_waits_for_the_next_optimum_and_the_rest_does_not(monkeypatch):
    """Two blocks far apart, each driven twice and off by 0.3 rad a lap: two revisits of the one, one of the other."""
    world = driven([*block(60, times=2), *straight(400), *block(60), *straight(20)], bias=0.0025)
    other = 2 * LAP + 200
    near, apart = [world.closure(k, k + LAP) for k in (4, 60)], world.closure(other + 4, other + 4 + LAP)
    rounds, take = [], admission.Admission._take
    monkeypatch.setattr(admission.Admission, "_take", lambda self, chosen: rounds.append(chosen) or take(self, chosen))
    assert GATE.evaluate_group(world.graph, world.values, [*near, apart], RADIUS).accepted == (0, 1, 2)
    assert [len(chosen) for chosen in rounds if chosen] == [2, 1]


def test_a_closure_that_repairs_a_collision_in_a_whole_graph():
    """The way back lies on the way out until the closure comes: it is accepted, in time order as well."""
    world = driven(straight(60) + turn(np.pi / 2) + straight(8) + turn(np.pi / 2) + straight(60), bias=0.005)
    graph = gtsam.NonlinearFactorGraph(world.graph)
    graph.push_back(world.closure(2, len(world.truth) - 3).at(0))
    gated = gate_graph(graph, world.values, RADIUS)
    assert gated.accepted == (graph.size() - 1,)


def test_a_duplicate_of_odometry_that_closes_nothing(lap):
    """A factor that odometry has already: nothing changes, and no overlap is explained by it."""
    closure = gtsam.NonlinearFactorGraph()
    closure.push_back(lap.graph.at(7))
    decision = judged(lap, closure)
    assert decision.accepted
    assert decision.terms["drift"].value < 0.1


def test_a_closure_twice_in_one(lap):
    """Two factors of one closure say one thing: as one of them alone."""
    twice = lap.closure(4, 4 + LAP)
    twice.push_back(lap.closure(4, 4 + LAP).at(0))
    assert judged(lap, twice).accepted


@pytest.mark.parametrize(
    ("ends", "measured", "accepted"),
    [((4, 4 + LAP), None, True), ((4, 70), NOWHERE, False), ((20, LAP + 4), NOWHERE, False)],
)
def test_a_singular_map_without_a_prior_is_judged_all_the_same(lap, ends, measured, accepted):
    """Nothing measures the length of one step: it stays what the estimate says until a closure tells."""
    root = gtsam.noiseModel.Gaussian.SqrtInformation(np.diag([0.0, 20.0, 100.0]), False)
    graph = gtsam.NonlinearFactorGraph(lap.graph)
    graph.replace(60, lap.graph.at(60).cloneWithNewNoiseModel(root))
    assert GATE.evaluate(graph, lap.values, lap.closure(*ends, measured), RADIUS).accepted is accepted


def test_a_keyframe_that_nothing_ties(lap):
    values = gtsam.Values(lap.values)
    values.insert(999, gtsam.Pose2(500, 0, 0))
    with pytest.raises(UnusedValueError, match="999"):
        GATE.evaluate(lap.graph, values, lap.closure(4, 4 + LAP), RADIUS)


BAD = {
    "empty": (lambda w: gtsam.NonlinearFactorGraph(), "at least one factor"),
    "unknown key": (lambda w: one(between(3, 4711, NOWHERE)), "4711"),
    "no number": (lambda w: w.closure(3, 80, gtsam.Pose2(np.nan, 0, 0)), "finite"),
}


def one(factor):
    closure = gtsam.NonlinearFactorGraph()
    closure.push_back(factor)
    return closure


@pytest.mark.parametrize("name", BAD)
def test_one_bad_closure_among_good_ones_is_refused_before_any_is_judged(lap, name):
    make, words = BAD[name]
    closures = [lap.closure(4, 4 + LAP), make(lap)]
    for judge in (GATE.evaluate_many, GATE.evaluate_group):
        with pytest.raises(InvalidClosureError, match=words):
            judge(lap.graph, lap.values, closures, RADIUS)


# x to the right, y down, z ahead; and one that hangs upside down and looks to the left
OPTICAL = gtsam.Rot3(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
HANGING = gtsam.Rot3(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]))


@pytest.mark.parametrize("mount", [OPTICAL, HANGING])
def test_how_the_sensor_is_mounted_says_nothing(mount):
    plain = driven(in_space(block(60) + straight(20)), bias=0.003, noise=0.003)
    turned = gtsam.Pose3(mount, np.zeros(3))
    mounted = World([pose.compose(turned) for pose in plain.truth])
    for key in range(len(plain.truth)):
        mounted.values.insert(key, plain.values.atPose3(key).compose(turned))
    for factor in factors_of(plain.graph):
        measured = turned.inverse().compose(factor.measured()).compose(turned)
        mounted.graph.push_back(between(*factor.keys(), measured))
    for i, j in ((4, 4 + LAP), (8, 8 + LAP)):
        odds = [judged(world, world.closure(i, j)).terms["drift"].log_odds for world in (plain, mounted)]
        assert odds[1] == pytest.approx(odds[0], abs=0.05)
    false = [judged(world, world.closure(20, LAP, NOWHERE_3D)).terms["drift"].log_odds for world in (plain, mounted)]
    assert false[1] == pytest.approx(false[0], rel=0.02)
