"""A diagnosis names what was done to a map: nothing, a closure dropped, a false one, a drive out and back, a gap."""

from types import SimpleNamespace

import gtsam
import numpy as np
import pytest
import streets

import pgti_gtsam as pgti
from pgti_gtsam.diagnosis import contacts
from pgti_gtsam.diagnosis.contacts import by_later_stretch
from pgti_gtsam.diagnosis.proposals import proposal_graph
from pgti_gtsam.errors import NoRadiusError
from pgti_gtsam.estimate import convergence, optimised
from pgti_gtsam.places import tied_radius_m

RADIUS = 3.0


def tied(world, closures):
    """The map of a driven world with closures, at its optimum."""
    graph = gtsam.NonlinearFactorGraph(world.graph)
    for closure in closures:
        graph.push_back(closure)
    return graph, optimised(graph, world.values)


def two_laps(*, drift=1e-4, seed=2):
    """Two laps around a block of 60 m, and the keyframes of a lap."""
    world = streets.driven(streets.block(60, 2), bias=drift, noise=0.002, seed=seed)
    return world, len(world.truth) // 2


def all_ties(world, lap):
    return [world.closure(i, i + lap) for i in range(0, lap, 5)]


def diagnosed(graph, values, radius=RADIUS):
    return pgti.diagnose(graph, values, radii=radius)


def kinds(diagnosis):
    return [place.kind for place in diagnosis.places if place.kind != "incomplete fusion"]


def test_a_map_that_is_tied_where_it_passes_again_is_consistent():
    world, lap = two_laps()
    found = diagnosed(*tied(world, all_ties(world, lap)))
    assert found.verdict == "consistent"
    assert kinds(found) == []
    assert not len(found.integrity.collision_edges)
    assert all(closure.probability > 0.99 for closure in found.closures)


def test_a_common_way_with_few_ties_is_incomplete_fusion_which_is_told_and_harmless():
    world, lap = two_laps()
    found = diagnosed(*tied(world, [world.closure(i, i + lap) for i in range(0, lap, 40)]))
    (place,) = (place for place in found.places if place.kind == "incomplete fusion")
    assert found.verdict == "consistent"
    assert place.score == pytest.approx(found.integrity.fusion.keyframe_scores[place.revisit.keyframes].max())
    assert place.proposal is None
    assert not any(place.kind == "incomplete fusion" for place in diagnosed(*tied(world, []), radius=0.5).places)


def test_a_second_pass_without_a_tie_is_a_missed_closure_with_a_proposal_that_holds():
    world, _ = two_laps()
    found = diagnosed(*tied(world, []))
    assert found.verdict == "incomplete"
    assert "one place that the track passes again is not tied." in found.reason
    assert kinds(found) == ["missed closure"]
    place = found.places[0]
    i, j = place.proposal.keyframes
    true = world.truth[i].between(world.truth[j])
    missed = type(true).Logmap(place.proposal.pose.between(true))
    assert missed @ np.linalg.solve(place.proposal.covariance, missed) < 16
    assert np.linalg.norm(missed[:2]) < place.proposal.search_m
    (first, last), (again, end) = place.keyframes
    assert first < again
    assert last < end
    assert str(again) in place.sentence
    assert set(map(tuple, place.edges.tolist())) == set(map(tuple, found.integrity.collision_edges.tolist()))


def test_one_untied_pass_is_one_place_however_many_tied_passes_it_meets():
    world = streets.driven(streets.block(60, 4), bias=1e-5, noise=0.001, seed=3)
    lap = len(world.truth) // 4
    ties = [world.closure(i, i + k * lap) for k in (1, 2) for i in range(0, lap, 6)]
    found = diagnosed(*tied(world, ties))
    assert found.verdict == "incomplete"
    assert kinds(found) == ["untied second pass"]  # the last lap goes on from the third, and so is contractible
    assert found.places[0].keyframes[1][1] >= 3 * lap


@pytest.mark.parametrize(
    ("first", "last", "sizes"),
    [(15, 25, [2]), (16, 26, [1, 1]), (15, 35, [2]), (16, 40, [1, 1]), (12, 17, [2])],
)
def test_one_tie_holds_passes_of_which_half_of_the_shorter_later_stretch_is_common(first, last, sizes):
    """The later stretch of one pass are the ten keyframes from 10 on; both run beside earlier passes of their own."""
    overlaps = np.array([(0, 10), (9, 19), (50, first), (50 + last - 1 - first, last - 1)])
    passes = [np.array([0, 1]), np.array([2, 3])]
    groups = by_later_stretch(passes, overlaps)
    assert [len(group) for group in groups] == sizes


def test_a_false_closure_is_named_and_places_that_it_folds_are_laid_to_its_charge():
    world, lap = two_laps()
    n_true = len(all_ties(world, lap))
    false = world.closure(4, 4 + lap // 2, gtsam.Pose2())
    graph, values = tied(world, [*all_ties(world, lap), false])
    found = diagnosed(graph, values)
    assert found.verdict == "inconsistent"
    assert found.reason == "One closure contradicts all others."
    assert found.closures[0].slot == world.graph.size() + n_true
    assert [closure.is_false for closure in found.closures[:2]] == [True, False]
    assert set(kinds(found)) <= {"likely false closure"}
    for place in found.places:
        is_folded = place.kind == "likely false closure"
        assert place.closure == ((4, 4 + lap // 2) if is_folded else None)
        assert (f"4 – {4 + lap // 2}" in place.remedy) == is_folded


def test_stretches_that_touch_only_with_a_false_closure_are_a_fold_that_it_makes():
    world = streets.driven(streets.block(60), bias=1e-4, noise=0.002, seed=2)
    last = len(world.truth) - 1
    false = world.closure(16, 80, gtsam.Pose2())  # one side of the block laid on the opposite side
    found = diagnosed(*tied(world, [world.closure(0, last), world.closure(1, last - 1), false]))
    assert kinds(found) == ["likely false closure"]
    (place,) = (place for place in found.places if place.kind == "likely false closure")
    assert place.closure == found.closures[0].keyframes == (16, 80)
    assert "16 – 80" in place.remedy
    apart = [np.linalg.norm(world.truth[i].translation() - world.truth[j].translation()) for i, j in place.edges]
    assert min(apart) > 2 * RADIUS


@pytest.mark.parametrize("shift", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("length", [10, 60, 200, 1000])
def test_a_drive_out_and_back_is_consistent_only_while_the_drift_is_small_against_the_spheres(length, shift):
    """The way is contractible at its turn: all overlaps are explained, whatever the drift."""
    step, radius, n = 1.0, 1.5, length
    out = np.c_[np.arange(n) * step, np.zeros(n)]
    back = out[::-1] + np.c_[np.zeros(n), np.linspace(0, shift * radius, n)]
    graph, values = straight_map(np.concatenate([out, back]))
    found = diagnosed(graph, values, radius)
    assert not len(found.integrity.collision_edges)
    if length <= 10:
        assert found.verdict == "consistent"
        return
    assert found.verdict == "incomplete"
    assert kinds(found) == ["untied second pass"]
    (first, _), (_, last) = found.places[0].keyframes
    assert first <= 2
    assert last >= 2 * n - 3
    assert found.places[0].allowance_m > found.places[0].reach_m


def straight_map(positions):
    """Odometry that measures exactly the way between positions in the plane, all headings zero."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i, (x, y) in enumerate(positions):
        values.insert(i, gtsam.Pose2(x, y, 0.0))
        if i:
            graph.push_back(streets.between(i - 1, i, values.atPose2(i - 1).between(values.atPose2(i))))
    return graph, values


def test_a_track_that_breaks_off_beside_itself_is_a_gap():
    graph, values = straight_map(np.c_[np.arange(40.0), np.zeros(40)])
    graph.remove(19)
    found = diagnosed(graph, values, 0.6)
    assert kinds(found) == ["tracking gap"]
    assert found.places[0].proposal is None
    assert found.n_chains == 2


def beside(noise=0.002):
    """A drive around a block and on beside its first street, 4 m from there; keyframes of the two stretches."""
    corner = streets.turn(np.pi / 2)
    first, second = streets.straight(60), streets.straight(50)
    around = [*first, *corner, *streets.straight(60), *corner, *streets.straight(60), *corner, *streets.straight(56)]
    world = streets.driven([*around, *corner, *second], noise=noise, seed=2)
    n = len(world.truth)
    return world, range(len(first)), range(n - len(second), n)


def sees(world, keyframes, *walls):
    """Keyframes see walls beside them ahead, so many metres to the left, below zero to the right: own landmarks."""
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 0.1)
    for k in keyframes:
        for n, at in enumerate((x, y) for y in walls for x in range(1, 17)):
            key, pose = gtsam.symbol("l", 100 * k + n), world.values.atPose2(k)
            bearing = gtsam.Rot2.fromAngle(np.arctan2(at[1], at[0]))
            world.graph.push_back(gtsam.BearingRangeFactor2D(k, key, bearing, np.hypot(*at), noise))
            world.values.insert(key, pose.transformFrom(np.array(at)))


@pytest.mark.parametrize(
    ("first", "second", "kind", "verdict"),
    [
        ((7, -3), (3, -7), "missed closure", "incomplete"),  # one hall
        ((2, -3), (3, -2), "different view", "consistent"),  # a wall between
        ((-3,), (3,), "different view", "consistent"),  # one hall, of which one sees the right, the other the left
        ((), (3, -7), "missed closure", "incomplete"),  # nothing is known of the first view
    ],
)
def test_passes_without_a_common_view_are_nothing_to_tie(first, second, kind, verdict):
    world, early, late = beside()
    sees(world, early, *first)
    sees(world, late, *second)
    found = diagnosed(world.graph, world.values, 7.0)
    assert (kinds(found), found.verdict) == ([kind], verdict)
    assert (found.places[0].proposal is None) == (kind == "different view")


def test_a_drift_that_may_hide_a_common_view_leaves_a_pass_untied():
    world, early, late = beside()
    sees(world, early, 2, -3)
    sees(world, late, 3, -2)
    found = diagnosed(world.graph, world.values)
    assert found.places[0].allowance_m > found.places[0].reach_m
    assert (kinds(found), found.verdict) == (["missed closure"], "incomplete")


def test_two_parts_in_contact_that_nothing_ties_are_undecided():
    graph, values = straight_map(np.c_[np.arange(40.0), np.zeros(40)])
    other = gtsam.Pose2(3.0, 0.5, 1.0)
    for i in range(40):
        key = gtsam.symbol("b", i)
        values.insert(key, other.compose(gtsam.Pose2(0, 1.0 * i, 0)))
        if i:
            graph.push_back(streets.between(gtsam.symbol("b", i - 1), key, gtsam.Pose2(0, 1.0, 0)))
    found = diagnosed(graph, values, 0.6)
    assert found.verdict == "undecided"
    assert kinds(found) == ["undecided contact"]
    assert "no chain of ties" in found.places[0].sentence


def test_two_parts_without_a_contact_are_told():
    graph, values = straight_map(np.c_[np.arange(40.0), np.zeros(40)])
    for i in range(20):
        key = gtsam.symbol("b", i)
        values.insert(key, gtsam.Pose2(1.0 * i, 50.0, 0))
        if i:
            graph.push_back(streets.between(gtsam.symbol("b", i - 1), key, gtsam.Pose2(1.0, 0, 0)))
    found = diagnosed(graph, values, 0.6)
    assert found.verdict == "consistent"
    assert "The pose graph is in 2 parts, whose places to each other nothing says." in found.reason


def test_a_map_without_an_edge_is_not_called_consistent():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i in range(3):
        values.insert(i, gtsam.Pose2(10.0 * i, 0, 0))
        graph.push_back(gtsam.PriorFactorPose2(i, values.atPose2(i), gtsam.noiseModel.Unit.Create(3)))
    assert diagnosed(graph, values, 1.0).verdict == "undecided"


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_moving_turning_and_scaling_a_map_with_its_radii_changes_nothing(scale):
    world, lap = two_laps()
    graph, values = tied(world, all_ties(world, lap)[:1])
    moved_graph, moved = gtsam.NonlinearFactorGraph(), gtsam.Values()
    frame = gtsam.Pose2(5.0, -3.0, 0.7)
    for slot in range(graph.size()):
        factor = graph.at(slot)
        z = factor.measured()
        scaled = gtsam.Pose2(scale * z.x(), scale * z.y(), z.theta())
        moved_graph.push_back(gtsam.BetweenFactorPose2(*factor.keys(), scaled, factor.noiseModel()))
    for i in range(len(world.truth)):
        pose = values.atPose2(i)
        moved.insert(i, frame.compose(gtsam.Pose2(scale * pose.x(), scale * pose.y(), pose.theta())))
    one, other = (
        diagnosed(graph, values, RADIUS * (1 + 1e-9)),
        diagnosed(moved_graph, moved, scale * RADIUS * (1 + 1e-9)),
    )
    assert one.verdict == other.verdict
    assert [(place.kind, place.keyframes) for place in one.places] == [
        (place.kind, place.keyframes) for place in other.places
    ]
    for mine, theirs in zip(one.places, other.places, strict=True):
        assert theirs.allowance_m == pytest.approx(scale * mine.allowance_m, rel=1e-3)


def test_graph_and_values_stay_untouched():
    world, lap = two_laps()
    graph, values = tied(world, all_ties(world, lap))
    before = graph.serialize(), values.serialize()
    diagnosed(graph, values)
    assert (graph.serialize(), values.serialize()) == before


def test_proposals_are_a_graph_that_a_matcher_can_read(tmp_path):
    world, _ = two_laps()
    graph, values = tied(world, [])
    found = diagnosed(graph, values)
    proposed, poses = proposal_graph(found, values)
    assert proposed.size() == 1
    assert sorted(proposed.at(0).keys()) == sorted(found.places[0].proposal.keyframes)
    assert set(poses.keys()) == set(proposed.at(0).keys())


def test_an_estimate_that_is_no_optimum_is_told_from_one_that_is():
    world, lap = two_laps()
    graph, best = tied(world, all_ties(world, lap))
    assert convergence(graph, best).is_optimum(RADIUS)
    stale = convergence(graph, world.values)
    assert not stale.is_optimum(0.1)
    assert stale.error_after < stale.error
    assert diagnosed(graph, best).convergence.is_optimum(RADIUS)


def test_a_radius_is_taken_from_what_closures_tie():
    graph, values = straight_map(
        np.concatenate([np.c_[np.arange(30.0), np.zeros(30)], np.c_[np.arange(30.0)[::-1], np.full(30, 0.8)]])
    )
    bare = pgti.from_gtsam(graph, values, radii=1.0)
    with pytest.raises(NoRadiusError, match="--radius"):
        tied_radius_m(bare)
    graph.push_back(streets.between(5, 54, values.atPose2(5).between(values.atPose2(54))))
    assert tied_radius_m(pgti.from_gtsam(graph, values, radii=1.0)) == pytest.approx(0.8)


def climbed(rise_m, *, tumbling=False):
    """Around a square of 60 m and again to its last side, where the way climbs in between: odometry alone, in space."""
    side = np.arange(15.0)
    ring = np.concatenate([np.c_[side, 0 * side], np.c_[0 * side + 15, side]])
    ring = np.concatenate([ring, 15 - ring])
    heights = np.concatenate([np.zeros(45), np.linspace(0, rise_m, 15), np.full(45, rise_m)])
    rng, poses = np.random.default_rng(0), []
    for x, y, z in np.c_[np.concatenate([ring, ring[:45]]), heights]:
        turn = gtsam.Rot3.Expmap(rng.normal(0, 1, 3)) if tumbling else gtsam.Rot3.Yaw(0.1 * len(poses))
        poses.append(gtsam.Pose3(turn, np.array([x, y, z])))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, pose)
        if k:
            noise = gtsam.noiseModel.Unit.Create(6)
            graph.add(gtsam.BetweenFactorPose3(k - 1, k, poses[k - 1].between(pose), noise))
    return graph, values


def test_a_pass_over_another_one_needs_no_tie_where_the_body_keeps_upright():
    found = diagnosed(*climbed(3.0), 1.6)
    assert found.verdict == "consistent"
    assert kinds(found) == ["different view"]
    assert 2.5 < found.places[0].rise_m <= 3.0  # at the top of the ramp
    assert "59–104 passes 2.8 m above 0–46" in found.places[0].sentence
    assert found.places[0].proposal is None
    for level in (climbed(0.0), climbed(0.3), climbed(3.0, tumbling=True)):
        found = diagnosed(*level, 1.6)
        assert found.verdict in ("incomplete", "undecided")
        assert "different view" not in kinds(found)
        assert all(place.rise_m == 0 for place in found.places)


@pytest.mark.parametrize(("shared", "is_fixed"), [(1, False), (2, True)])
def test_keyframes_that_share_too_few_landmarks_are_not_tied_by_these(shared, is_fixed):
    """Two points fix a pose in the plane; a single point leaves a turn about it."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 0.1)
    for k in range(10):
        values.insert(k, gtsam.Pose2(2.0 * k, 0, 0))
        for n in range(shared):
            for seen in (k, k + 1):
                x, y = 2.0 * seen + 1, 1.0 + n
                if not values.exists(gtsam.symbol("l", 10 * seen + n)):
                    values.insert(gtsam.symbol("l", 10 * seen + n), np.array([x, y]))
                bearing = gtsam.Rot2.fromAngle(np.arctan2(y, x - 2.0 * k))
                reach = np.hypot(x - 2.0 * k, y)
                graph.push_back(gtsam.BearingRangeFactor2D(k, gtsam.symbol("l", 10 * seen + n), bearing, reach, noise))
    found = pgti.diagnose(graph, values)
    assert ("share the 2 landmarks" in found.reason) is not is_fixed
    assert (found.verdict == "undecided") is not is_fixed


@pytest.mark.parametrize(("gap", "is_tied"), [(4, False), (7, True), (40, True)])
def test_a_tie_over_more_than_five_keyframes_explains_what_lies_beside_it(gap, is_tied):
    """Ties over fewer are steps along the track, and say nothing of two stretches."""
    along, tie = np.arange(100) / 5, [20, 20 + gap]
    model = SimpleNamespace(along=along, ties=SimpleNamespace(pairs=np.array([tie])), units=SimpleNamespace(unit_m=1.0))
    overlaps, radii = np.array([[18, 22 + gap], [5, 22 + gap]]), np.full(100, 2.0)
    found = contacts._tied_near_by(overlaps, radii, model, np.ones(1, dtype=bool))
    assert found.tolist() == [is_tied, False]
    assert not contacts._tied_near_by(overlaps, radii / 10, model, np.ones(1, dtype=bool)).any()
