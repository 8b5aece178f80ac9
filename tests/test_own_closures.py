"""A map's own closures, judged from one factorisation, against slow oracles that optimise without each of them."""

import gtsam
import numpy as np
import pytest
import streets

import pgti_gtsam as pgti
from pgti_gtsam.drift.model import drift_model
from pgti_gtsam.drift.own_closures import own_closures
from pgti_gtsam.drift.settled import ANCHOR
from pgti_gtsam.drift.ties import errors_of
from pgti_gtsam.gate.batch import leave_one_out

RADIUS = 2.0
KINDS, SEEDS = ("planar", "in space"), range(6)
STOPPED = 1e-3 * RADIUS  # the model's optimiser stops where the error falls by less than a thousandth


def drawn(kind, seed, n_true, *, is_torn):
    """Two laps with true closures between them, and as the last factor one that takes two distant places for one."""
    random = np.random.default_rng([seed, KINDS.index(kind)])
    side, bias, noise = random.choice([12.0, 20.0, 28.0]), random.uniform(-2e-4, 2e-4), random.uniform(5e-4, 3e-3)
    steps = streets.block(side, 2) if kind == "planar" else streets.ramp(side, 3.0, 2)
    world, lap = streets.driven(steps, bias=bias, noise=noise, seed=seed), len(steps) // 2
    firsts = random.choice(np.arange(1, lap), size=n_true, replace=False)
    closures = [world.closure(i, i + lap) for i in np.sort(firsts).tolist()]
    if is_torn:
        i = int(random.integers(lap // 2))
        j = i + int(random.integers(lap // 4, lap // 2))
        closures.append(world.closure(i, j, type(world.truth[0])()))
    graph = gtsam.NonlinearFactorGraph(world.graph)
    for closure in closures:
        graph.push_back(closure)
    return graph, streets.optimum(graph, world.values)


def settled_by_gtsam(model, start, active):
    """Poses at the optimum of some of the model's ties, by GTSAM to convergence."""
    between, prior = (
        (gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2)
        if model.units.is_planar
        else (gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3)
    )
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in np.flatnonzero(active).tolist():
        i, j = model.ties.pairs[k].tolist()
        told = gtsam.noiseModel.Diagonal.Variances(model.ties.variances[k])
        graph.push_back(between(i, j, model.ties.measured[k], told))
    graph.push_back(prior(0, start[0], gtsam.noiseModel.Isotropic.Sigma(len(model.units.spread), ANCHOR)))
    for i, pose in enumerate(start):
        values.insert(i, pose)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(200)
    parameters.setRelativeErrorTol(1e-12)
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    at = found.atPose2 if model.units.is_planar else found.atPose3
    return [at(i) for i in range(len(start))]


def judged(graph, values):
    """The drift model of a map, and what is made of its closures."""
    model = drift_model(graph, values, pgti.from_gtsam(graph, values, radii=RADIUS))
    return model, own_closures(model)


def left_out_by_gtsam(model, own, row):
    """Distance and angle by which a closure misses the optimum of all others that were not taken out."""
    tie = own.ties[[row]]
    active = np.ones(len(model.ties.pairs), dtype=bool)
    active[own.ties[own.is_false]] = active[tie] = False
    poses = settled_by_gtsam(model, own.settled.poses, active)
    missed = errors_of(poses, model.ties.pairs[tie], [model.ties.measured[k] for k in tie])[0]
    own_axes = np.arange(len(missed))[model.units.translation]
    return np.linalg.norm(missed[own_axes]), np.linalg.norm(np.delete(missed, own_axes))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("n_true", "is_torn"), [(6, False), (6, True), (1, False), (1, True), (2, False), (2, True)])
def test_what_a_closure_misses_is_what_gtsam_finds_without_it(kind, n_true, is_torn):
    """The law: `missed_m` and `missed_rad` of a closure that holds are those of a full optimisation of the drift model
    without it.

    The one factorisation is linear at the optimum with the closure. Without it the map moves by the missed distance m
    and turns by the missed angle a, and what a linear step leaves out of that is of the order a m, and of a² in angle.
    """
    for seed in SEEDS:
        model, own = judged(*drawn(kind, seed, n_true, is_torn=is_torn))
        assert own.is_false.sum() == is_torn
        for row in np.flatnonzero(~own.is_false).tolist():
            distance, angle = left_out_by_gtsam(model, own, row)
            assert own.missed_m[row] == pytest.approx(distance, rel=0, abs=STOPPED + angle * distance)
            assert own.missed_rad[row] == pytest.approx(angle, rel=0, abs=1e-3 + angle**2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n_true", [1, 2])
def test_the_rest_of_a_torn_map_settles_at_gtsams_optimum(kind, n_true):
    """The law: the poses without the closure that was taken out are those of GTSAM's optimum of the other ties."""
    for seed in SEEDS:
        model, own = judged(*drawn(kind, seed, n_true, is_torn=True))
        active = np.ones(len(model.ties.pairs), dtype=bool)
        active[own.ties[own.is_false]] = False
        poses = settled_by_gtsam(model, own.settled.poses, active)
        apart = [
            np.linalg.norm(one.translation() - other.translation())
            for one, other in zip(own.settled.poses, poses, strict=True)
        ]
        assert max(apart) < 0.1 * RADIUS


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n_true", [1, 2, 6])
def test_the_closure_that_the_full_optimisation_doubts_most_is_the_least_probable(kind, n_true):
    """The law: with one false closure, the one that `leave_one_out` doubts most, and rejects, is the least probable one
    and the only one taken out. True closures that `leave_one_out` rejects beside, since the false one tears the map
    that they are weighed against, are acquitted."""
    for seed in SEEDS:
        graph, values = drawn(kind, seed, n_true, is_torn=True)
        decisions, alone = leave_one_out(graph, values, RADIUS)
        worst = min(decisions, key=lambda slot: decisions[slot].log_odds)
        _, own = judged(graph, values)
        assert not alone
        assert not decisions[worst].accepted
        assert own.slots[np.argmin(own.log_odds)] == worst
        assert own.slots[own.is_false].tolist() == [worst]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n_true", [0, 1, 2, 6])
def test_neither_condemns_a_closure_of_an_intact_map(kind, n_true):
    """The law: where all closures are true, none, one alone and two that agree among them, `leave_one_out` accepts and
    `own_closures` keeps each of them."""
    for seed in SEEDS:
        graph, values = drawn(kind, seed, n_true, is_torn=False)
        decisions, alone = leave_one_out(graph, values, RADIUS)
        _, own = judged(graph, values)
        assert sorted([*decisions, *alone]) == sorted(own.slots.tolist())
        assert all(decision.accepted for decision in decisions.values())
        assert len(own.slots) == n_true
        assert (own.log_odds > 0).all()
        assert not own.is_false.any()


@pytest.mark.parametrize("kind", KINDS)
def test_held_positions_contradict_a_closure_that_agrees_with_short_odometry(kind):
    """A step of the second pass was measured 20 m short, and so was the closure: the receiver knows."""
    n, in_space = 40, kind == "in space"
    alone, held = (along_a_road(n, in_space=in_space, is_held=is_held) for is_held in (False, True))
    assert own_closures(alone).log_odds.min() > 0
    found = own_closures(held)
    assert found.is_false.tolist() == [True, False, False]  # in the order of their keyframes
    assert found.missed_m[0] == pytest.approx(20.0, abs=3.0)
    places, true = (np.array([pose.translation() for pose in poses]) for poses in (found.settled.poses, held.poses))
    assert np.median(np.linalg.norm(places - true, axis=1)) < 0.1 * RADIUS


def along_a_road(n, *, in_space, is_held):
    """The model of a drive of 2 m steps along a road and back, whose poses are true; the first closure is not."""
    way = 2.0 * np.concatenate([np.arange(n), np.arange(n)[::-1]])
    pose_of = (lambda x: gtsam.Pose3(gtsam.Rot3(), [x, 0, 0])) if in_space else (lambda x: gtsam.Pose2(x, 0, 0))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, x in enumerate(way):
        values.insert(k, pose_of(x))
        if is_held:
            position = gtsam.PriorFactorPose3 if in_space else gtsam.PriorFactorPose2
            graph.add(position(k, pose_of(x), gtsam.noiseModel.Isotropic.Sigma(6 if in_space else 3, 1.0)))
    lost = n + n // 2
    for k in range(2 * n - 1):
        step = way[k + 1] - way[k]
        graph.add(streets.between(k, k + 1, pose_of(step + (20.0 if k == lost else 0.0))))
    for i, short in ((n - 5, 0.0), (n - 10, 0.0), (10, 20.0)):
        j = 2 * n - 1 - i
        graph.add(streets.between(i, j, pose_of(way[j] - way[i] + short)))
    pose_graph = pgti.from_gtsam(graph, values, radii=RADIUS)
    return drift_model(graph, values, pose_graph)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n_true", [0, 6])
def test_two_false_closures_that_agree_are_judged_as_one(kind, n_true):
    """Each is what the other predicts; the odometry and all the other revisits contradict both."""
    for seed in SEEDS:
        graph, _ = drawn(kind, seed, n_true, is_torn=True)
        false = graph.at(graph.size() - 1)
        i, j = false.keys()
        ways = [graph.at(k).measured() for k in (i, j)]  # the steps that lead on from either keyframe
        again = ways[0].inverse().compose(false.measured()).compose(ways[1])
        graph.push_back(streets.between(i + 1, j + 1, again))
        start = gtsam.Values()
        start.insert(0, type(ways[0])())
        for k in range(max(key for key in graph.keyVector())):
            start.insert(k + 1, pose_of(start, k).compose(graph.at(k).measured()))
        _, own = judged(graph, streets.optimum(graph, start))
        assert own.slots[own.is_false].tolist() == [graph.size() - 2, graph.size() - 1]


def pose_of(values, key):
    return values.atPose2(key) if gtsam.utilities.allPose2s(values).size() else values.atPose3(key)


def test_each_closure_that_was_left_out_is_counted():
    told = []
    leave_one_out(*drawn("planar", 0, 2, is_torn=False), RADIUS, progress=lambda done, of: told.append((done, of)))
    assert told == [(1, 2), (2, 2)]
