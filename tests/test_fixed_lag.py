"""Fixed-lag smoothers behind the gate: judged by the whole track, closed within the window."""

import importlib.util
import math
import unittest
from pathlib import Path

import gtsam
import pytest
from streets import RADIUS, between, block, driven, straight

from pgti_gtsam.errors import InvalidClosureError, InvalidOptionError, MissingValueError, UnsolvableGraphError
from pgti_gtsam.factor_graphs import factors_of
from pgti_gtsam.gate import GatedFixedLagSmoother, GatedISAM2, GateOptions, LoopClosureGate

LAP = 4 * 12  # steps around a block of 20 m
LAG = LAP + 20.0
NOWHERE = gtsam.Pose2()
ORIGIN = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)
KINDS = [gtsam.IncrementalFixedLagSmoother, gtsam.BatchFixedLagSmoother]


@pytest.fixture(scope="module")
def world():
    return driven(block(20, times=2) + straight(50), bias=0.002, noise=0.005)


@pytest.fixture(params=KINDS, ids=["incremental", "batch"])
def kind(request):
    return request.param


def step(world, k):
    """Factors, values and times that bring keyframe k."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(gtsam.PriorFactorPose2(0, world.truth[0], ORIGIN) if k == 0 else world.graph.at(k - 1))
    values.insert(k, world.values.atPose2(k))
    return factors, values, {k: float(k)}


def driven_to(world, last, kind, lag=LAG, **options):
    gated = GatedFixedLagSmoother(kind(lag), radii=RADIUS, **options)
    for k in range(last + 1):
        gated.update(*step(world, k))
    return gated


def held(gated):
    """All that the smoother holds, in numbers."""
    return gated.getFactors().serialize(), gated.calculateEstimate().serialize(), dict(gated.timestamps())


def test_an_accepted_closure_is_in_the_smoother_and_a_rejected_one_leaves_no_trace(world, kind):
    gated, never = (driven_to(world, LAP + 6, kind) for _ in range(2))
    update = gated.update(*step(world, LAP + 7), closures=[world.closure(4, 30, NOWHERE)])
    never.update(*step(world, LAP + 7))
    assert (update.accepted, update.rejected, update.slots) == ((), (0,), ((),))
    assert held(gated) == held(never)
    closure = world.closure(5, LAP + 5)
    update = gated.update(closures=[closure])
    assert update.accepted == (1,)
    ((slot,),) = update.slots
    assert gated.getFactors().at(slot) is closure.at(0)
    assert gated.admitted == {1: (slot,)}
    assert update.getIterations() == update.result.getIterations() >= 1
    gated.retract(1)
    assert gated.admitted == {}
    assert gated.getFactors().nrFactors() == never.getFactors().nrFactors()


@pytest.mark.parametrize("scores", [None, True])
def test_the_verdicts_are_those_of_a_smoother_that_forgets_nothing(world, kind, scores):
    gate = LoopClosureGate(options=GateOptions(scores=scores))
    isam, lagged = GatedISAM2(radii=RADIUS, gate=gate), GatedFixedLagSmoother(kind(20.0), radii=RADIUS, gate=gate)
    offered = {LAP + k: (k, None) for k in (3, 4, 9)} | {LAP + 22: (LAP + 12, None)}
    offered |= {LAP + 6: (30, NOWHERE), LAP + 20: (LAP + 8, NOWHERE)}
    for k in range(LAP + 24):
        factors, values, times = step(world, k)
        i, measured = offered.get(k, (0, None))
        closures = [world.closure(i, k, measured)] if k in offered else []
        whole, part = isam.update(factors, values, closures), lagged.update(factors, values, times, closures=closures)
        assert [d.verdict for d in part.decisions] == [d.verdict for d in whole.decisions]
        assert [len(slots) for slots in part.slots] == [int(k == LAP + 22)] * len(closures)
    assert lagged.timestamps().keys() == set(range(LAP + 3, LAP + 24))
    assert set(isam.admitted) == {0, 1, 3, 5}
    assert set(lagged.admitted) == {5}
    assert lagged.absorbed == ()
    assert lagged.estimate().size() == LAP + 24


def test_a_closure_that_reaches_behind_the_window_is_judged_and_said_to_be_out(world, kind):
    gated, never = (driven_to(world, LAP + 6, kind, lag=20.0) for _ in range(2))
    update = gated.update(closures=[world.closure(5, LAP + 5)])
    never.update()
    assert (update.decisions[0].verdict, update.accepted, update.slots) == ("accepted", (0,), ((),))
    assert "5 has left the window" in update.decisions[0].reasons[-1]
    assert held(gated) == held(never)
    (again,) = gated.review().decisions.values()
    assert again.verdict == "accepted"
    gated.retract(0)
    assert gated.review().decisions == {}
    with pytest.raises(InvalidClosureError, match="which is not"):
        gated.retract(0)


def test_a_closure_whose_keyframe_leaves_is_part_of_the_prior_for_good(world, kind):
    gated = driven_to(world, LAP + 6, kind)
    assert gated.update(closures=[world.closure(5, LAP + 5)]).accepted == (0,)
    for k in range(LAP + 7, LAP + 30):
        gated.update(*step(world, k))
    assert (gated.admitted, gated.absorbed) == ({}, (0,))
    before = held(gated)
    with pytest.raises(InvalidClosureError, match="5 has left"):
        gated.retract(0)
    review = gated.review()
    assert set(review.decisions) == {0}
    assert (review.leaving, review.entering) == ((), ())
    gated.revise(review)
    assert held(gated)[2] == before[2]


def test_what_has_left_stays_where_it_was_last(world, kind):
    gated, bare, last = GatedFixedLagSmoother(kind(10.0), radii=RADIUS), kind(10.0), {}
    for k in range(30):
        for key in bare.timestamps():
            last[key] = bare.calculateEstimatePose2(key)
        gated.update(*step(world, k))
        bare.update(*step(world, k))
    assert bare.calculateEstimate().equals(gated.calculateEstimate(), 1e-9)
    assert gated.timestamps() == bare.timestamps()
    whole = gated.estimate()
    assert all(whole.atPose2(k).equals(last[k], 1e-9) for k in range(30 - 11))
    with pytest.raises(IndexError):
        gated.calculateEstimatePose2(3)


def test_a_variable_that_is_seen_again_stays(world, kind):
    gated = driven_to(world, 4, kind, lag=10.0)
    for k in range(5, 40):
        factors, values, times = step(world, k)
        gated.update(factors, values, times | {4: float(k)})
    assert set(gated.timestamps()) == {4, *range(29, 40)}
    update = gated.update(closures=[world.closure(4, 39)])
    assert bool(update.slots[0]) is update.decisions[0].accepted


def test_factors_that_the_caller_takes_out_are_forgotten(world, kind):
    gated = driven_to(world, LAP + 6, kind)
    skip = between(LAP + 4, LAP + 6, world.truth[LAP + 4].between(world.truth[LAP + 6]))
    factors = gtsam.NonlinearFactorGraph()
    factors.push_back(skip)
    gated.update(factors)
    graph = gated.getFactors()
    (slot,) = (s for s in range(graph.size()) if graph.at(s) is skip)
    gated.update(factorsToRemove=[slot])
    assert not any(factor is skip for factor in factors_of(gated.getFactors()))
    gated.update(closures=[world.closure(5, LAP + 5)])
    assert set(gated.admitted) == {0}


@pytest.mark.parametrize(
    ("arguments", "error", "said"),
    [
        (lambda w: (step(w, 5)[0],), MissingValueError, "has left"),
        (lambda w: (None, step(w, 5)[1]), InvalidOptionError, "new variables only"),
        (lambda w: (step(w, 90)[0],), MissingValueError, "every key"),
        (lambda w: (None, None, {3: 80.0}), MissingValueError, "times of variables"),
    ],
)
def test_what_does_not_belong_is_refused_and_changes_nothing(world, kind, arguments, error, said):
    gated = driven_to(world, LAP + 6, kind, lag=20.0)
    before = held(gated)
    with pytest.raises(error, match=said):
        gated.update(*arguments(world))
    with pytest.raises(InvalidClosureError):
        gated.update(closures=[world.closure(3, 97)])
    assert held(gated) == before


def test_a_step_that_the_smoother_fails_in_leaves_the_map_of_before(world, kind):
    gated, never = (driven_to(world, LAP + 6, kind, lag=30.0) for _ in range(2))
    for each in (gated, never):
        each.update(closures=[world.closure(LAP - 10, LAP + 5)])
    spatial, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    spatial.push_back(gtsam.BetweenFactorPose3(LAP + 6, LAP + 7, gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    values.insert(LAP + 7, gtsam.Pose3())
    with pytest.raises(UnsolvableGraphError, match="made anew"):
        gated.update(spatial, values, {LAP + 7: LAP + 7.0})
    assert gated.timestamps() == never.timestamps()
    assert set(gated.admitted) == set(never.admitted) != set()
    for each in (gated, never):
        for k in range(LAP + 7, LAP + 12):
            each.update(*step(world, k))
    assert gated.calculateEstimate().equals(never.calculateEstimate(), 1e-2)
    assert gated.estimate().size() == never.estimate().size()
    gated.retract(0)


def test_only_fixed_lag_smoothers_are_taken():
    assert isinstance(GatedFixedLagSmoother().smoother, gtsam.IncrementalFixedLagSmoother)
    with pytest.raises(InvalidOptionError, match="BatchFixedLagSmoother"):
        GatedFixedLagSmoother(gtsam.ISAM2())
    assert math.isclose(GatedFixedLagSmoother(gtsam.BatchFixedLagSmoother(3.0)).smootherLag(), 3.0)


@pytest.mark.parametrize("name", ["test_FixedLagSmootherExample", "test_FixedLagSmootherAccessors"])
def test_what_gtsam_runs_with_its_own_runs_with_the_gate_in_front(name):
    source = Path(importlib.util.find_spec(f"gtsam.tests.{name}").origin).read_text(encoding="utf-8")
    gated, made = source, []
    for kind in KINDS:
        gated = gated.replace(f"gtsam.{kind.__name__}(", f"{kind.__name__}(")

    def in_front_of(kind):
        return lambda lag: made.append(GatedFixedLagSmoother(kind(lag), radii=1.0)) or made[-1]

    names = {"__name__": name, **{kind.__name__: in_front_of(kind) for kind in KINDS}}
    exec(gated, names)
    cases = [case for case in names.values() if isinstance(case, type) and issubclass(case, unittest.TestCase)]
    suite = unittest.TestSuite(unittest.defaultTestLoader.loadTestsFromTestCase(case) for case in cases)
    result = suite.run(unittest.TestResult())
    assert result.wasSuccessful(), result.errors + result.failures
    assert result.testsRun == (1 if name.endswith("Example") else 8)
    assert made[0].estimate().size() == (13 if name.endswith("Example") else 2)
