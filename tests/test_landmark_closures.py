"""Closures that are landmarks seen again: judged by the relative pose that they imply."""

import gtsam
import numpy as np
import pytest
from streets import block, driven

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.drift.log_odds import NEAR, NEAR_RAD, NEAR_SHARE, log_normal, log_odds
from pgti_gtsam.drift.ties import OFFSET, OFFSET_RAD, Offered, unobservable_of
from pgti_gtsam.drift.units import Units
from pgti_gtsam.factor_graphs import factors_of, graph_of
from pgti_gtsam.gate.candidates import implied_tie
from pgti_gtsam.gate.gate import LoopClosureGate

SEEN = gtsam.noiseModel.Diagonal.Sigmas([0.02, 0.1])
LAP = 4 * 32
REACH = 12.0


def sightings(truth, places, keyframe, landmarks, names):
    """Bearing and range from a keyframe to some landmarks, under the names that an association gives them."""
    factors = []
    for true, name in zip(landmarks, names, strict=True):
        pose, point = truth[keyframe], places[true]
        factors.append(
            gtsam.BearingRangeFactor2D(keyframe, gtsam.symbol("l", name), pose.bearing(point), pose.range(point), SEEN)
        )
    return factors


@pytest.fixture(scope="module")
def mapped():
    """A lap with drift that saw landmarks on both sides of the way, and twenty metres of the second without any."""
    world = driven(block(60, times=2)[: LAP + 12], bias=0.002, noise=0.003)
    random = np.random.default_rng(0)
    places = np.array([random.normal(p.translation(), 5.0) for p in world.truth[:LAP:2]])
    graph, values = gtsam.NonlinearFactorGraph(world.graph), gtsam.Values(world.values)
    for k in range(LAP - 8):
        near = np.flatnonzero(np.linalg.norm(places - world.truth[k].translation(), axis=1) < REACH)
        for factor in sightings(world.truth, places, k, near, near):
            graph.push_back(factor)
            key = factor.keys()[1]
            if not values.exists(key):
                pose, local = world.values.atPose2(k), world.truth[k].transformTo(places[gtsam.Symbol(key).index()])
                values.insert(key, pose.transformFrom(local))
    return world, places, graph, values


def near(world, places, keyframe, count):
    return np.argsort(np.linalg.norm(places - world.truth[keyframe].translation(), axis=1))[:count]


def test_landmarks_that_are_seen_again_are_a_closure(mapped):
    world, places, graph, values = mapped
    last = LAP + 6
    known = near(world, places, last, 5)
    decision = pgti.LoopClosureGate().evaluate(graph, values, sightings(world.truth, places, last, known, known), 3.0)
    assert decision.accepted
    assert decision.keys[-1] == last
    assert decision.keys[0] < LAP - 8


def test_a_landmark_alone_says_less_than_several(mapped):
    """Bearing and range leave open where around the landmark the keyframe stands; before, any place of that circle was
    taken for measured, and this true sighting rejected with log odds of −33."""
    world, places, graph, values = mapped
    last = LAP + 6
    known = near(world, places, last, 2)
    gate = pgti.LoopClosureGate()
    alone, both = (
        gate.evaluate(graph, values, sightings(world.truth, places, last, own, own), 3.0) for own in (known[:1], known)
    )
    assert 0 < alone.log_odds < both.log_odds - 1
    assert alone.reasons[0].endswith(both.reasons[0][both.reasons[0].index("give or take") :])


@pytest.mark.parametrize("elsewhere", [20, 50, 90])
def test_landmarks_that_are_taken_for_others_are_rejected(mapped, elsewhere):
    """Five landmarks elsewhere are taken for those at hand: at best undecided, as far as the drift allows for it."""
    world, places, graph, values = mapped
    last = LAP + 6
    names = near(world, places, elsewhere, 5)
    alike = gtsam.NonlinearFactorGraph()
    for factor in sightings([*world.truth[:last], world.truth[elsewhere]], places, last, names, names):
        alike.push_back(factor)
    decision = pgti.LoopClosureGate().evaluate(graph, values, alike, 3.0)
    assert not decision.accepted
    assert decision.log_odds < 0


def test_a_landmark_that_nobody_knows_ties_nothing(mapped):
    world, _, graph, values = mapped
    more = gtsam.Values(values)
    more.insert(gtsam.symbol("l", 999), world.values.atPose2(LAP).transformFrom(np.array([1.0, 2.0])))
    pose = world.values.atPose2(LAP)
    point = more.atPoint2(gtsam.symbol("l", 999))
    closure = gtsam.BearingRangeFactor2D(LAP, gtsam.symbol("l", 999), pose.bearing(point), pose.range(point), SEEN)
    decision = pgti.LoopClosureGate().evaluate(graph, more, closure, 3.0)
    assert decision.accepted
    assert decision.keys == ()
    assert np.isnan(decision.log_odds)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("is_planar", [True, False])
@pytest.mark.parametrize("is_earlier", [True, False])
def test_directions_that_landmarks_leave_open_change_nothing_that_is_seen(count, is_planar, is_earlier):
    """To first order: bearing and range of one landmark in the plane leave one direction, one point in space leaves
    three turns, two leave the turn about the line between them."""
    random, unit_m = np.random.default_rng(7), 2.0
    sees, knows = (0, 1) if is_earlier else (1, 0)
    if is_planar:
        poses, points = [gtsam.Pose2(1, 2, 0.5), gtsam.Pose2(9, 1, -2)], random.normal(0, 4, (count, 2))
        noise = gtsam.noiseModel.Diagonal.Sigmas([0.02, 0.1])
    else:
        poses = [gtsam.Pose3(gtsam.Rot3.Ypr(0.3, 0.2, 0.1), [1, 2, 3]), gtsam.Pose3(gtsam.Rot3.Ypr(2, 0, 1), [9, 1, 2])]
        points, noise = random.normal(0, 4, (count, 3)), gtsam.noiseModel.Diagonal.Sigmas([0.02, 0.02, 0.1])
    kind = gtsam.BearingRangeFactor2D if is_planar else gtsam.BearingRangeFactor3D

    # both see all; the closure is what the one sees, whose estimate is right
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, pose)
    seen = {k: gtsam.NonlinearFactorGraph() for k in (0, 1)}
    for n, point in enumerate(points):
        values.insert(gtsam.symbol("l", n), point)
        for k, pose in enumerate(poses):
            seen[k].push_back(kind(k, gtsam.symbol("l", n), pose.bearing(point), pose.range(point), noise))
    tie = implied_tie(seen[sees], seen[knows], read_keyframes(values), unit_m)
    assert (tie.first, tie.second) == (0, 1)
    assert tie.measured.equals(poses[0].between(poses[1]), 1e-6)
    n_open = {1: 1 if is_planar else 3, 2: 0 if is_planar else 1, 3: 0}[count]
    if n_open == 0:
        assert tie.unobservable is None
        return
    assert tie.unobservable.shape == (3 if is_planar else 6, n_open)
    np.testing.assert_allclose(tie.unobservable.T @ tie.unobservable, np.eye(n_open), atol=1e-9)

    # the second keyframe moves against the first; what the one sees stays
    lengths = np.array([unit_m, unit_m, 1.0] if is_planar else [1.0] * 3 + [unit_m] * 3)
    for direction in tie.unobservable.T:
        step = 1e-3
        measured = tie.measured.compose(type(tie.measured).Expmap(step * lengths * direction))
        moved = gtsam.Values(values)
        moved.update(sees, poses[1].compose(measured.inverse()) if is_earlier else poses[0].compose(measured))
        assert np.sqrt(2 * seen[sees].error(moved)) < 1e-3  # 0.02 to 0.1 are a sigma: a step of any other kind shows
        across = np.linalg.svd(tie.unobservable)[0][:, -1]
        other = tie.measured.compose(type(tie.measured).Expmap(step * lengths * across))
        moved.update(sees, poses[1].compose(other.inverse()) if is_earlier else poses[0].compose(other))
        assert np.sqrt(2 * seen[sees].error(moved)) > 5e-3


def test_a_closure_without_derivative_where_the_keyframe_stands_says_nothing():
    graph, values, noise = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    for k in range(20):
        values.insert(k, gtsam.Pose3(gtsam.Rot3(), [k % 10, 0, 0]))
        if k:
            step = values.atPose3(k - 1).between(values.atPose3(k))
            graph.push_back(gtsam.BetweenFactorPose3(k - 1, k, step, noise))
    turned = gtsam.EssentialMatrix(gtsam.Rot3(), gtsam.Unit3(1, 0, 0))
    closure = gtsam.EssentialMatrixConstraint(3, 13, turned, gtsam.noiseModel.Unit.Create(5))
    decision = pgti.LoopClosureGate().evaluate(graph, values, closure, 1.0)
    assert decision.verdict == "undecided"
    assert abs(decision.terms["drift"].log_odds) < 1e-3


def test_open_directions_add_nothing_to_the_log_odds():
    """The law: with R + F, F wider than the map along some directions, the odds are those of the other directions."""
    random = np.random.default_rng(3)
    spread = np.diag([40.0, 70.0, 3.0])
    units = Units(unit_m=2.0, levelling=gtsam.Pose2(), tilt=1.0, spread=spread)
    for _ in range(20):
        root = random.normal(size=(3, 3))
        predicted, missed = root @ root.T, random.normal(size=3)
        basis = np.linalg.qr(random.normal(size=(3, 3)))[0]
        offered = Offered(0, 1, gtsam.Pose2(), basis[:, :1])
        far = unobservable_of([offered], units)[0]
        found = log_odds(units, missed[None], (predicted + far)[None])[0]

        # the same along the directions that F leaves alone
        lengths = np.array([2.0, 2.0, 1.0])
        rest = np.linalg.svd((lengths * basis[:, 0])[None])[2][1:]
        exact, close = (np.diag(units.variances(*each)) for each in ((OFFSET, OFFSET_RAD), (NEAR, NEAR_RAD)))
        seen = (rest @ missed)[None]
        density = []
        for false in (np.zeros((3, 3)), spread):
            own = [log_normal(seen, (rest @ (predicted + r + false) @ rest.T)[None])[0] for r in (exact, close)]
            density.append(np.logaddexp(np.log(1 - NEAR_SHARE) + own[0], np.log(NEAR_SHARE) + own[1]))
        assert found == pytest.approx(density[0] - density[1], abs=2e-3)


@pytest.fixture(scope="module")
def two_passes():
    """KITTI 00 by stereo, whose later half sees none of the landmarks of the earlier one; what it saw of them."""
    dataset, split = datasets.builtin(), 88
    keyframes = read_keyframes(dataset.values)
    sightings = [f for f in factors_of(dataset.graph) if isinstance(f, gtsam.GenericStereoFactor3D)]
    seen_from = {}
    for factor in sightings:
        keyframe, landmark = factor.keys()
        seen_from.setdefault(landmark, []).append(keyframes.index[keyframe])
    graph, values, revisits, relabelled = gtsam.NonlinearFactorGraph(), gtsam.Values(dataset.values), {}, {}
    for factor in factors_of(dataset.graph):
        keyframe, landmark = factor.keys()
        k = keyframes.index[keyframe]
        if landmark not in seen_from or k < split or min(seen_from[landmark]) >= split:
            graph.push_back(factor)
            continue
        if landmark not in relabelled:
            relabelled[landmark] = gtsam.symbol("z", len(relabelled))
            values.insert(relabelled[landmark], values.atPoint3(landmark))
        graph.push_back(seen(factor, relabelled[landmark]))
        if min(seen_from[landmark]) < k - 12:
            revisits.setdefault(k, []).append(factor)
    elsewhere = [landmark for landmark, rows in seen_from.items() if rows[0] == 10]
    return LoopClosureGate().reference_map(graph, values), revisits, elsewhere


def seen(factor, landmark):
    """The same sighting of another landmark."""
    keyframe, calibration = factor.keys()[0], factor.calibration()
    return gtsam.GenericStereoFactor3D(factor.measured(), factor.noiseModel(), keyframe, landmark, calibration)


@pytest.mark.parametrize("keyframe", [90, 93, 96])
@pytest.mark.parametrize("association", ["true", "permuted", "elsewhere"])
def test_landmarks_of_a_real_drive_seen_again(two_passes, keyframe, association):
    reference, revisits, elsewhere = two_passes
    factors = revisits[keyframe]
    landmarks = [factor.keys()[1] for factor in factors]
    labels = {"true": landmarks, "permuted": landmarks[1:] + landmarks[:1], "elsewhere": elsewhere}[association]
    closure = [seen(factor, landmark) for factor, landmark in zip(factors, labels, strict=False)]
    decision = LoopClosureGate().judge(reference, [graph_of(closure)]).decisions[0]
    assert decision.verdict == ("accepted" if association == "true" else "rejected")


def test_a_keyframe_is_placed_from_where_its_camera_sees_the_landmarks():
    """The keyframe that knows the points looked the other way: from its pose no search for the camera can begin."""
    graph, values, corners = gtsam.NonlinearFactorGraph(), gtsam.Values(), [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    for k in range(12):
        values.insert(k, gtsam.Pose3(gtsam.Rot3.Ry(np.pi if k == 2 else 0.0), [0.2 * k, 0, 0]))
        if k:
            step = values.atPose3(k - 1).between(values.atPose3(k))
            graph.push_back(gtsam.BetweenFactorPose3(k - 1, k, step, gtsam.noiseModel.Isotropic.Sigma(6, 0.05)))
    camera = gtsam.Cal3_S2(500, 500, 0, 320, 240)
    closure = gtsam.NonlinearFactorGraph()
    for n, (x, y) in enumerate(corners):
        key, point, pose = gtsam.symbol("l", n), np.array([x, y, 5.0]), values.atPose3(2)
        values.insertPoint3(key, point)
        noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
        graph.push_back(gtsam.BearingRangeFactor3D(2, key, pose.bearing(point), pose.range(point), noise))
        pixel = gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
        seen = gtsam.PinholeCameraCal3_S2(values.atPose3(11), camera).project(point)
        closure.push_back(gtsam.GenericProjectionFactorCal3_S2(seen, pixel, 11, key, camera, True, False))
    decision = pgti.LoopClosureGate().evaluate(graph, values, closure, 1.0)
    assert decision.accepted
    assert decision.keys == (2, 11)
