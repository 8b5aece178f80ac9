"""The track: odometry is what the chain of factors says, per robot and session, whatever the keys are called."""

from itertools import pairwise

import gtsam
import numpy as np
import pytest
from gtsam import symbol
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import between

import pgti_gtsam as pgti
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import graph_of, joined, keys_of, without
from pgti_gtsam.gate.batch import closure_ends
from pgti_gtsam.gate.terms.contact_rise import bridged_overlaps, contacts
from pgti_gtsam.places import places_on
from pgti_gtsam.pose_graph import EdgeSource
from pgti_gtsam.track import closure_edges, track_of
from pgti_gtsam.track.steps import dense_to

STEP = gtsam.Pose2(1, 0, 0)
CORNER = gtsam.Pose2(1, 0, np.pi / 2)
SQUARE = [*[STEP] * 9, CORNER] * 4
SETTINGS = settings(deadline=None, max_examples=40)


def walked(steps, start=None):
    poses = [start or gtsam.Pose2()]
    for step in steps:
        poses.append(poses[-1].compose(step))
    return poses


def tied(poses, pairs, keys=None, error=None):
    """Factors that measure, up to an error each, what poses have, in the order of the pairs."""
    keys = range(len(poses)) if keys is None else keys
    errors = [gtsam.Pose2()] * len(pairs) if error is None else error
    return [
        between(keys[i], keys[j], poses[i].between(poses[j]).compose(e))
        for (i, j), e in zip(pairs, errors, strict=True)
    ]


def world(poses, factors, keys=None):
    graph, values = graph_of(factors), gtsam.Values()
    for key, pose in zip(range(len(poses)) if keys is None else keys, poses, strict=True):
        values.insert(key, pose)
    return graph, values


def chain(n, first=0):
    return [(k, k + 1) for k in range(first, first + n - 1)]


def closures(graph, values, **options):
    """Slots of what is taken for loop closures."""
    return sorted(closure_ends(pgti.from_gtsam(graph, values, radii=0.5, **options), graph))


def small_errors(rng, n):
    return [gtsam.Pose2(*(rng.normal(size=3) * [0.02, 0.02, 0.01])) for _ in range(n)]


def two_robots():
    """Two laps 100 m apart, the second robot's keys behind the first one's."""
    a, b = walked(SQUARE), walked(SQUARE, gtsam.Pose2(100, 0, 0))
    keys = [symbol("a", k) for k in range(41)] + [symbol("b", k) for k in range(41)]
    poses = [*a, *b]
    return poses, keys, tied(poses, chain(41) + chain(41, 41), keys)


@SETTINGS
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(41, 81)), min_size=1, max_size=6, unique=True))
def test_what_ties_two_robots_is_a_closure(links):
    poses, keys, factors = two_robots()
    graph, values = world(poses, [*factors, *tied(poses, links, keys)], keys)
    assert closures(graph, values) == [80 + k for k in range(len(links))]
    assert track_of(pgti.from_gtsam(graph, values, radii=0.5)).chain.tolist() == [0] * 41 + [1] * 41


def test_a_false_link_from_the_last_keyframe_of_a_robot_to_the_first_of_the_next_is_rejected():
    poses, keys, factors = two_robots()
    lies = [between(keys[40], keys[41], gtsam.Pose2()), between(keys[39], keys[42], gtsam.Pose2())]
    held = [gtsam.PriorFactorPose2(keys[k], poses[k], gtsam.noiseModel.Unit.Create(3)) for k in (0, 41)]
    graph, values = world(poses, [*factors, *held, *lies], keys)
    gated = pgti.gate_graph(graph, values, 0.5)
    assert gated.rejected == (82, 83)
    assert gated.accepted == ()


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 3, 10]), st.floats(0.1, 1.0))
def test_odometry_over_several_steps_is_odometry_and_closures_beside_are_not(seed, most, share):
    """Factors over two to `most` steps, all of them or some, on a lap and a half; a true and a false closure."""
    rng, poses = np.random.default_rng(seed), walked(SQUARE + SQUARE[:20])
    n = len(poses)
    skips = [(i, i + gap) for gap in range(2, most + 1) for i in range(n - gap) if rng.random() < share]
    pairs = [*chain(n), *skips]
    factors = tied(poses, pairs, error=small_errors(rng, len(pairs)))
    offered = [*tied(poses, [(5, 45)]), between(3, 25, gtsam.Pose2())]
    graph, values = world(poses, [*factors, *offered])
    assert closures(graph, values) == [len(factors), len(factors) + 1]


def test_multi_frame_odometry_is_not_judged():
    poses = walked([STEP] * 59)
    graph, values = world(poses, tied(poses, [*chain(60), *((i, i + 2) for i in range(58))]))
    gated = pgti.gate_graph(graph, values, 0.5)
    assert gated.decisions == {}
    assert gated.graph.size() == graph.size()


def test_registration_against_ten_neighbours_is_odometry_even_where_the_sensor_turns_back():
    there = [STEP] * 20
    poses = walked([*there, gtsam.Pose2(0, 0, np.pi), *there])
    n = len(poses)
    pairs = [(i, i + gap) for gap in range(1, 11) for i in range(n - gap)]
    graph, values = world(poses, tied(poses, pairs))
    assert closures(graph, values) == []
    alone = [*chain(n), (17, 24)]
    assert closures(*world(poses, tied(poses, alone))) == [n - 1]


def test_where_all_keyframes_are_registered_to_their_neighbours_only_the_loops_are_judged():
    """A lap and a half in space, every keyframe tied to its ten neighbours: of 1249 factors four are loops."""
    rng, turn = np.random.default_rng(0), gtsam.Rot3.Rz(2 * np.pi / 80)
    poses = [gtsam.Pose3()]
    for _ in range(129):
        poses.append(poses[-1].compose(gtsam.Pose3(turn, [1, 0, 0])))
    model, sigmas = gtsam.noiseModel.Isotropic.Sigma(6, 0.02), np.array([1e-3] * 3 + [0.01] * 3)
    pairs = [(i, i + gap) for i in range(130) for gap in range(1, 11) if i + gap < 130]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    for i, j in pairs:
        error = gtsam.Pose3.Expmap(rng.normal(size=6) * sigmas)
        graph.push_back(gtsam.BetweenFactorPose3(i, j, poses[i].between(poses[j]).compose(error), model))
    for i, j in [(5, 85), (25, 105), (45, 125)]:
        graph.push_back(gtsam.BetweenFactorPose3(i, j, poses[i].between(poses[j]), model))
    graph.push_back(gtsam.BetweenFactorPose3(3, 43, gtsam.Pose3(), model))
    gated = pgti.gate_graph(graph, values, 1.0)
    n = len(pairs)
    assert sorted(gated.decisions) == [n, n + 1, n + 2, n + 3]
    assert (sorted(gated.accepted), gated.rejected) == ([n, n + 1, n + 2], (n + 3,))


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.4))
def test_registrations_that_fail_here_and_there_break_no_chain(seed, failing):
    rng, poses = np.random.default_rng(seed), walked(SQUARE + SQUARE[:20])
    n = len(poses)
    pairs = [(i, i + gap) for gap in range(1, 11) for i in range(n - gap) if rng.random() >= failing]
    factors = tied(poses, pairs, error=small_errors(rng, len(pairs)))
    offered = [*tied(poses, [(5, 45)]), between(3, 25, gtsam.Pose2())]
    graph, values = world(poses, [*factors, *offered])
    assert closures(graph, values) == [len(factors), len(factors) + 1]
    assert track_of(pgti.from_gtsam(graph, values, radii=0.5)).n_chains == 1


@pytest.mark.parametrize("miss", [gtsam.Pose2(-2, 0, 0), gtsam.Pose2(0, 0, 1.0), gtsam.Pose2(0.5, 0.5, 0)])
def test_a_skip_that_the_way_does_not_explain_is_a_closure(miss):
    poses = walked([STEP] * 30)
    factors = tied(poses, [*chain(31), *((i, i + 2) for i in range(29))])
    factors[30 + 12] = between(12, 14, poses[12].between(poses[14]).compose(miss))
    assert closures(*world(poses, factors)) == [42]


@pytest.mark.parametrize("n", [4, 6, 8, 11])
def test_the_closure_of_a_small_ring_is_a_closure(n):
    poses = walked([gtsam.Pose2(2, 0, 2 * np.pi / n)] * (n - 1))
    assert closures(*world(poses, tied(poses, [*chain(n), (0, n - 1)]))) == [n - 1]


def random_graph(seed, n=40):
    """A chain with skips, a gap, and closures far apart, each in a random direction and order."""
    rng, poses = np.random.default_rng(seed), walked(SQUARE[: n - 1])
    gap = int(rng.integers(12, n - 12))
    skips = [(i, i + 2) for i in range(n - 2) if not i < gap <= i + 2 and rng.random() < 0.3]
    far = [(i, j) for i, j in rng.integers(n, size=(6, 2)).tolist() if j - i > 11]
    pairs = [pair for pair in chain(n) if pair[1] != gap] + skips + far
    pairs = [pairs[k] for k in rng.permutation(len(pairs))]
    return rng, poses, [pair if rng.random() < 0.7 else pair[::-1] for pair in pairs]


def closing_pairs(graph, values, place):
    """Closures as pairs of places, smaller first."""
    return sorted(tuple(sorted(place[key] for key in keys_of(graph.at(slot)))) for slot in closures(graph, values))


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.sampled_from(["", "a", "x", "Z"]))
def test_renaming_keys_in_their_order_changes_nothing(seed, letter):
    rng, poses, pairs = random_graph(seed)
    numbers = np.cumsum(rng.integers(1, 50, size=len(poses))).tolist()
    keys = [symbol(letter, k) if letter else k for k in numbers]
    plain = closing_pairs(*world(poses, tied(poses, pairs)), list(range(len(poses))))
    renamed = closing_pairs(*world(poses, tied(poses, pairs, keys), keys), {key: k for k, key in enumerate(keys)})
    assert renamed == plain


@SETTINGS
@given(st.integers(0, 2**32 - 1))
def test_turning_and_mixing_factors_and_empty_slots_change_nothing(seed):
    rng, poses, pairs = random_graph(seed)
    place, n = list(range(len(poses))), len(poses)
    plain = closing_pairs(*world(poses, tied(poses, pairs)), place)
    turned = [pairs[k][:: int(rng.choice([1, -1]))] for k in rng.permutation(len(pairs))]
    assert closing_pairs(*world(poses, tied(poses, turned)), place) == plain
    graph, values = world(poses, tied(poses, [*pairs, (0, n - 1), (0, n - 1)]))
    empty = without(joined(gtsam.NonlinearFactorGraph(graph), graph), range(graph.size() - 2, 2 * graph.size()))
    assert closing_pairs(empty, values, place) == plain


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.integers(2, 3))
def test_robots_whose_plain_numbers_interleave_are_told_apart(seed, robots):
    """Splitting the keys of robots that take turns into letters of their own changes nothing."""
    rng, size = np.random.default_rng(seed), 20
    turns = np.concatenate([rng.permutation(robots) for _ in range(size)])
    paths = [walked(SQUARE[: size - 1], gtsam.Pose2(0, 30 * r, 0)) for r in range(robots)]
    count = np.array([(turns[:k] == turns[k]).sum() for k in range(len(turns))])
    poses = [paths[r][k] for r, k in zip(turns.tolist(), count.tolist(), strict=True)]
    own = [np.flatnonzero(turns == r).tolist() for r in range(robots)]
    pairs = [pair for rows in own for pair in pairwise(rows)]
    links = [(i, j) for i, j in rng.integers(len(turns), size=(8, 2)).tolist() if j - i > 11 * robots]
    factors = tied(poses, pairs + links)
    graph, values = world(poses, factors)
    assert closures(graph, values) == list(range(len(pairs), len(factors)))
    found = track_of(pgti.from_gtsam(graph, values, radii=0.5))
    assert [len(set(found.chain[rows])) for rows in own] == [1] * robots
    assert found.n_chains == robots

    # the same robots under letters of their own
    keys = [symbol(chr(ord("a") + r), k) for r, k in zip(turns.tolist(), count.tolist(), strict=True)]
    lettered = world(poses, tied(poses, pairs + links, keys), keys)
    assert closures(*lettered) == list(range(len(pairs), len(factors)))


@pytest.mark.parametrize("meeting", [4, 5, 17])
def test_two_interleaved_robots_that_meet_are_tied_by_a_closure(meeting):
    """A factor between numbers that follow each other, on the chains of two robots, is no step of either."""
    poses = [
        p for pair in zip(walked([STEP] * 14), walked([STEP] * 14, gtsam.Pose2(0, 9, 0)), strict=True) for p in pair
    ]
    pairs = [(k, k + 2) for k in range(28)]
    graph, values = world(poses, tied(poses, [*pairs, (meeting, meeting + 1)]))
    assert closures(graph, values) == [28]
    assert track_of(pgti.from_gtsam(graph, values, radii=0.5)).chain.tolist() == [0, 1] * 15


@pytest.mark.parametrize(("n", "n_chains"), [(11, 1), (12, 2)])
def test_ties_between_neighbours_are_steps_from_three_in_ten_on_and_between_two_robots_below(n, n_chains):
    """Every second keyframe is tied to the next but one, and so the others among them; three ties lead across."""
    poses = walked([STEP] * (n - 1))
    across = [(1, 2), (4, 5), (7, 8)]
    graph, values = world(poses, tied(poses, [*((k, k + 2) for k in range(n - 2)), *across]))
    assert track_of(pgti.from_gtsam(graph, values, radii=0.5)).n_chains == n_chains
    assert closures(graph, values) == ([] if n_chains == 1 else [n - 2, n - 1, n])


def test_sessions_are_chains_of_their_own_and_the_link_between_them_is_judged():
    out = walked([gtsam.Pose2(2, 0, 0)] * 9)
    back = [gtsam.Pose2(pose.x(), 1.5, 0) for pose in out[::-1]]
    poses = [*out, *back]
    graph, values = world(poses, tied(poses, [*chain(10), *chain(10, 10), (8, 10), (0, 19)]))
    gated = pgti.gate_graph(graph, values, 0.5)
    assert gated.accepted == (18, 19)
    assert gated.rejected == ()
    assert track_of(pgti.from_gtsam(graph, values, radii=0.5)).chain.tolist() == [0] * 10 + [1] * 10


def test_a_keyframe_that_only_a_skip_ties_hangs_on_that():
    """Edges 0-2 and 1-2 and none 0-1, as submaps are tied."""
    poses = walked([gtsam.Pose2(2, 0, 0), gtsam.Pose2(2, 0, np.pi / 2)] * 4)[:8]
    pairs = [(0, 2), *chain(7, 1), (1, 3), (2, 4), (0, 7)]
    graph, values = world(poses, tied(poses, pairs))
    assert closures(graph, values) == [len(pairs) - 1]
    assert pgti.gate_graph(graph, values, 0.5).accepted == (len(pairs) - 1,)


def test_closures_that_only_satellites_hold_are_no_steps():
    """Where other factors place the keyframes, the only factor between two is a closure however near the numbers."""
    poses = walked([STEP] * 20)
    noise = gtsam.noiseModel.Unit.Create(2)
    bearings = [gtsam.BearingRangeFactor2D(k, symbol("l", k // 10), gtsam.Rot2(), 1.0, noise) for k in range(21)]
    graph, values = world(poses, [*tied(poses, [(3, 9), (5, 12)]), *bearings])
    for k in range(3):
        values.insert(symbol("l", k), np.array([10.0 * k, 5.0]))
    pose_graph = pgti.from_gtsam(graph, values, radii=0.5, min_shared_landmarks=2)
    assert closure_edges(pose_graph).sum() == 2
    assert not (pose_graph.edge_sources & EdgeSource.ODOMETRY).any()


def test_the_caller_may_say_what_is_a_closure():
    poses = walked(SQUARE[:20])
    pairs = [*chain(21), (3, 4), (2, 5), (0, 19)]
    graph, values = world(poses, tied(poses, pairs))
    assert closures(graph, values) == [22]
    for chosen in ([20], [21, 22], []):
        assert sorted(pgti.gate_graph(graph, values, 0.5, closures=chosen).decisions) == chosen
        pose_graph = pgti.from_gtsam(graph, values, radii=0.5, closures=chosen)
        named = {slot for k in np.flatnonzero(closure_edges(pose_graph)) for slot in pose_graph.edge_slots[k]}
        assert named <= set(chosen)


@pytest.mark.parametrize("slot", [-1, 21, 4711])
def test_a_closure_that_is_no_factor_between_keyframes_is_refused(slot):
    poses = walked(SQUARE[:20])
    graph, values = world(poses, tied(poses, chain(21)[:-1]))
    graph.push_back(between(19, 20, STEP))
    graph.push_back(gtsam.PriorFactorPose2(0, poses[0], gtsam.noiseModel.Unit.Create(3)))
    with pytest.raises(InvalidOptionError, match=str(slot)):
        pgti.gate_graph(graph, values, 0.5, closures=[slot])


def strands(rng, robots=2, size=12):
    """A pose graph of robots one behind the other, and how to permute it so that they take turns."""
    poses = np.concatenate([[[k, 1.5 * r, 0] for k in range(size)] for r in range(robots)]).astype(float)
    edges = [(r * size + k, r * size + k + 1) for r in range(robots) for k in range(size - 1)]
    across = [(int(rng.integers(size)), size + int(rng.integers(size))) for _ in range(2)]
    sources = [EdgeSource.BETWEEN | EdgeSource.ODOMETRY] * len(edges) + [EdgeSource.BETWEEN] * len(across)
    turns = np.argsort(np.argsort(rng.permutation(np.repeat(np.arange(robots), size)), kind="stable"))
    return poses, np.array(edges + across), np.array(sources, dtype=np.uint8), turns


@SETTINGS
@given(st.integers(0, 2**32 - 1))
def test_chains_need_not_be_contiguous(seed):
    """The law: a track of robots that take turns is that of robots one behind the other, keyframe by keyframe."""
    poses, edges, sources, turns = strands(np.random.default_rng(seed))
    n, place = len(poses), np.argsort(turns)
    behind = pgti.PoseGraph(keys=range(n), positions=poses, edges=edges, edge_sources=sources, radii=1.2)
    mixed = pgti.PoseGraph(keys=range(n), positions=poses[turns], edges=place[edges], edge_sources=sources, radii=1.2)
    one, other = track_of(behind), track_of(mixed)
    assert one.n_chains == other.n_chains == 2
    if turns[0] == 0:  # chains are counted by their first keyframes
        assert one.chain[turns].tolist() == other.chain.tolist()
        np.testing.assert_allclose(one.way_m[turns], other.way_m)
        np.testing.assert_allclose(places_on(behind, one)[turns], places_on(mixed, other))
    as_pairs = lambda pairs: {frozenset(pair) for pair in pairs.tolist()}  # noqa: E731
    assert as_pairs(bridged_overlaps(behind)) == as_pairs(turns[bridged_overlaps(mixed)])
    assert contacts(behind).unexplained == contacts(mixed).unexplained


def test_a_pose_graph_made_by_hand_is_one_chain():
    graph = pgti.PoseGraph(keys=range(4), positions=np.eye(4, 3), edges=[(0, 1), (2, 3)], radii=1.0)
    track = track_of(graph)
    assert track.chain.tolist() == [0, 0, 0, 0]
    assert track.order.tolist() == [0, 1, 2, 3]
    assert track.n_chains == 1


@pytest.mark.parametrize(
    ("n", "tied", "expected"), [(5, [0, 1, 2], 2), (5, [0, 2], 1), (4, [0, 1], 1), (20, range(5), 1)]
)
def test_neighbours_are_dense_where_three_at_least_and_three_in_ten_are_tied(n, tied, expected):
    pairs = np.array([(k, k + 2) for k in tied])
    assert dense_to(np.zeros(n, dtype=np.int64), pairs, pairs).tolist() == [expected]
