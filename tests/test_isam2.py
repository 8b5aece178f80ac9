"""A gated iSAM2 is iSAM2 of exactly what was admitted, whatever came, went or failed in between."""

import importlib.util
from pathlib import Path

import gtsam
import numpy as np
import pytest
from streets import RADIUS, between, block, driven, straight

from pgti_gtsam.errors import (
    InvalidClosureError,
    InvalidOptionError,
    MissingValueError,
    UnsolvableGraphError,
)
from pgti_gtsam.factor_graphs import graph_of, slots_of
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.options import GateOptions
from pgti_gtsam.gate.smoothers.isam2 import GatedISAM2

LAP = 4 * 12  # steps around a block of 20 m
NOWHERE = gtsam.Pose2()
ORIGIN = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)


def eager():
    """A smoother that relinearises all it can, so that its estimate can be compared with an optimum."""
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(1e-9)
    parameters.relinearizeSkip = 1
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
    return gtsam.ISAM2(parameters)


def started(world, smoother=None, radii=RADIUS):
    isam = GatedISAM2(eager() if smoother is None else smoother, radii=radii)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(gtsam.PriorFactorPose2(0, world.truth[0], ORIGIN))
    values.insert(0, world.truth[0])
    isam.update(factors, values)
    return isam


def step(world, k):
    """Factors and values that bring keyframe k."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(world.graph.at(k - 1))
    values.insert(k, world.values.atPose2(k))
    return factors, values


def driven_to(world, last, **options):
    isam = started(world, **options)
    for k in range(1, last + 1):
        isam.update(*step(world, k))
    return isam


@pytest.fixture(scope="module")
def world():
    return driven(block(20, times=2) + straight(10), bias=0.002, noise=0.005)


def state(isam):
    return isam.smoother.getFactorsUnsafe().serialize(), isam.estimate().serialize(), dict(isam.admitted)


def test_a_rejected_closure_leaves_the_smoother_bit_for_bit(world):
    offered, never = driven_to(world, LAP + 6), driven_to(world, LAP + 6)
    update = offered.update(*step(world, LAP + 7), [world.closure(4, 30, NOWHERE)])
    never.update(*step(world, LAP + 7))
    assert not update.decisions[0].accepted
    assert (update.accepted, update.slots) == ((), ((),))
    for k in range(LAP + 8, LAP + 12):
        for isam in (offered, never):
            isam.update(*step(world, k))
    assert state(offered) == state(never)


def test_an_admitted_closure_is_in_its_slots(world):
    isam = driven_to(world, LAP + 6)
    closures = [world.closure(4, 30, NOWHERE), world.closure(5, LAP + 5), world.closure(6, LAP + 6)]
    update = isam.update(*step(world, LAP + 7), closures)
    assert update.closures == (0, 1, 2)
    assert update.accepted == (1, 2)
    graph = isam.smoother.getFactorsUnsafe()
    assert graph.at(update.factor_slots[0]).equals(world.graph.at(LAP + 6), 0.0)
    for number in (1, 2):
        (slot,) = isam.admitted[number]
        assert graph.at(slot).equals(closures[number].at(0), 0.0)


def test_a_retracted_closure_leaves_no_trace(world):
    isam, never = driven_to(world, LAP + 6), driven_to(world, LAP + 6)
    isam.update(closures=[world.closure(5, LAP + 5)])
    isam.retract(0)
    for _ in range(5):
        isam.smoother.update()
        never.smoother.update()
    assert isam.admitted == {}
    assert isam.estimate().equals(never.estimate(), 1e-9)


def test_around_a_smoother_of_the_callers(world):
    smoother = gtsam.ISAM2()
    factors, values = gtsam.NonlinearFactorGraph(world.graph), gtsam.Values(world.values)
    factors.push_back(gtsam.PriorFactorPose2(0, world.truth[0], ORIGIN))
    smoother.update(factors, values)
    isam = GatedISAM2(smoother, gate=LoopClosureGate(), radii=RADIUS)
    assert isam.update(closures=[world.closure(5, LAP + 5)]).accepted == (0,)
    assert isam.smoother is smoother
    assert smoother.getFactorsUnsafe().at(isam.admitted[0][0]).keys() == [5, LAP + 5]


def test_radii_come_with_their_keyframes(world):
    isam = started(world, radii={0: RADIUS})
    for k in range(1, LAP + 7):
        isam.update(*step(world, k), radii={k: RADIUS})
    assert isam.update(closures=[world.closure(5, LAP + 5)]).accepted == (0,)
    with pytest.raises(InvalidOptionError, match="all have"):
        started(world).update(radii={0: 1.0})


def test_a_review_turns_a_revisit_over_when_the_larger_party_came_later(world):
    isam = driven_to(world, LAP + 10)
    wrong = [world.closure(k, k + LAP, gtsam.Pose2(4.5, 0.0, 0.0)) for k in (1, 2)]
    right = [world.closure(k, k + LAP) for k in (3, 4, 5, 6)]
    for closure in (*wrong, *right):
        isam.update(closures=[closure])
    assert set(isam.admitted) == {0, 1}  # within drift, and first
    assert isam.review([]).decisions == {}
    review = isam.review([5])
    assert (review.leaving, review.entering) == ((0, 1), (2, 3, 4, 5))
    isam.revise(review)
    assert set(isam.admitted) == {2, 3, 4, 5}
    again = isam.review()
    assert (again.leaving, again.entering) == ((), ())
    with pytest.raises(InvalidClosureError):
        isam.revise(review)


def test_a_review_by_the_kept_map_is_that_of_maps_read_anew():
    lap, world = 4 * 32, driven(block(60, times=2) + straight(10), bias=0.0005, noise=0.002)
    anew = GatedISAM2(eager(), radii=RADIUS, gate=LoopClosureGate(options=GateOptions(scores=True)))
    kept = started(world)
    for k in range(1, 2 * lap):
        closures = []
        if k == lap + 1 or (k > lap + 11 and k % 13 < 3):  # the first is off, and alone
            off = gtsam.Pose2(6.0 * (k == lap + 1), 0.0, 0.0)
            closures = [world.closure(k - lap, k, world.truth[k - lap].between(world.truth[k]).compose(off))]
        kept.update(*step(world, k), closures)
    anew.smoother, anew._offers = kept.smoother, kept._offers
    asked = [0, 8, 20, len(kept._offers) - 1]
    one, other = anew.review(asked), kept.review(asked)
    assert one.decisions.keys() == other.decisions.keys()
    for number, decision in one.decisions.items():
        assert decision.verdict == other.decisions[number].verdict
        assert decision.judged_with == other.decisions[number].judged_with
        assert decision.log_odds == pytest.approx(other.decisions[number].log_odds, rel=0.01, abs=0.1)
    assert sum(decision.score is None for decision in other.decisions.values()) >= 7  # which a kept map has none of
    assert (one.leaving, one.entering) == (other.leaving, other.entering) == ((0,), ())


def test_a_review_afresh_agrees_where_nothing_is_wrong(world):
    isam = driven_to(world, LAP + 10)
    isam.update(closures=[world.closure(4, 30, NOWHERE), *(world.closure(k, k + LAP) for k in (3, 4, 5))])
    assert set(isam.admitted) == {1, 2, 3}
    before = state(isam)
    review = isam.review_afresh()
    assert set(review.decisions) == {0, 1, 2, 3}
    assert (review.leaving, review.entering) == ((), ())
    assert state(isam) == before


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (lambda w: (None, None, [gtsam.NonlinearFactorGraph()]), InvalidClosureError),
        (lambda w: (None, None, [w.closure(3, 97)]), InvalidClosureError),
        (lambda w: (None, None, [w.closure(3, 30, gtsam.Pose2(np.nan, 0, 0))]), InvalidClosureError),
        (lambda w: (*step(w, 5), []), InvalidOptionError),
        (lambda w: (*step(w, 5), [w.closure(3, 30)]), InvalidOptionError),
        (lambda w: (step(w, 90)[0], None, []), MissingValueError),
        (lambda w: (step(w, 90)[0], None, [w.closure(3, 30)]), MissingValueError),
    ],
)
def test_an_error_leaves_everything_as_before(world, arguments, error):
    isam = driven_to(world, LAP + 6)
    isam.update(closures=[world.closure(5, LAP + 5)])
    before = state(isam)
    with pytest.raises(error):
        isam.update(*arguments(world))
    assert state(isam) == before


def test_what_cannot_be_retracted(world):
    isam = driven_to(world, LAP + 6)
    isam.update(closures=[world.closure(4, 30, NOWHERE)])
    for number, why in ((0, "which is not"), (7, "one of 1"), (-1, "one of 1")):
        with pytest.raises(InvalidClosureError, match=why):
            isam.retract(number)


def test_a_slot_that_the_caller_reused_is_not_retracted(world):
    isam = driven_to(world, LAP + 6)
    isam.update(closures=[world.closure(5, LAP + 5)])
    isam.smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), list(isam.admitted[0]))
    with pytest.raises(InvalidClosureError, match="changed from outside"):
        isam.retract(0)


def test_a_step_that_isam2_fails_in_leaves_the_map_of_before(world):
    isam = driven_to(world, LAP + 6)
    isam.update(closures=[world.closure(5, LAP + 5)])
    isam.retract(0)
    isam.update(closures=[world.closure(6, LAP + 6)])
    before, admitted = isam.estimate(), dict(isam.admitted)
    filled = [slot for slot, _ in slots_of(isam.smoother.getFactorsUnsafe())]
    spatial, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    spatial.push_back(gtsam.BetweenFactorPose3(LAP + 6, LAP + 7, gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    values.insert(LAP + 7, gtsam.Pose3())
    with pytest.raises(UnsolvableGraphError, match="made anew"):
        isam.update(spatial, values)
    assert isam.admitted == admitted
    assert [slot for slot, _ in slots_of(isam.smoother.getFactorsUnsafe())] == filled
    isam.update(*step(world, LAP + 7), closures=[world.closure(7, LAP + 7)])
    assert isam.estimate().atPose2(20).equals(before.atPose2(20), 0.1)
    assert set(isam.admitted) == {1, 2}
    isam.retract(1)


def test_a_step_that_fails_leaves_slots_empty_that_its_factors_had_taken(world):
    parameters = gtsam.ISAM2Params()
    parameters.findUnusedFactorSlots = True
    isam = driven_to(world, LAP + 6, smoother=gtsam.ISAM2(parameters))
    isam.update(closures=[world.closure(5, LAP + 5)])
    isam.retract(0)
    filled = [slot for slot, _ in slots_of(isam.getFactorsUnsafe())]
    values = gtsam.Values()
    values.insert(LAP + 7, gtsam.Pose3())
    late = gtsam.BetweenFactorPose3(LAP + 6, LAP + 7, gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6))
    with pytest.raises(UnsolvableGraphError, match="made anew"):
        isam.update(graph_of([late]), values)
    assert [slot for slot, _ in slots_of(isam.getFactorsUnsafe())] == filled
    assert not isam.valueExists(LAP + 7)


def test_closures_of_keyframes_that_the_caller_marginalised_are_passed_over(world):
    isam, asked, order, leaving = driven_to(world, LAP + 8), gtsam.ISAM2UpdateParams(), gtsam.KeyGroupMap(), range(4)
    isam.update(closures=[world.closure(2, LAP + 2), world.closure(7, LAP + 7), world.closure(3, 30, NOWHERE)])
    asked.extraReelimKeys = key_list(range(LAP + 9))
    for k in range(LAP + 9):
        order.insert2(k, int(k not in leaving))
    asked.constrainedKeys = order
    isam.smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), asked)
    isam.smoother.marginalizeLeaves(key_list(leaving))
    assert set(isam.review().decisions) == {1}
    assert set(isam.review_afresh().decisions) == {1}
    assert isam.update(*step(world, LAP + 9), [world.closure(9, LAP + 9)]).accepted == (3,)
    with pytest.raises(InvalidClosureError):
        isam.retract(0)


def key_list(keys):
    found = gtsam.KeyList()
    for key in keys:
        found.push_back(key)
    return found


@pytest.mark.parametrize(("bias", "off", "verdict"), [(0.01, 0.0, "accepted"), (0.002, 5.0, "rejected")])
def test_an_undecided_closure_waits_for_more(bias, off, verdict):
    world = driven(block(20, times=2) + straight(10), bias=bias, noise=0.005)
    isam = driven_to(world, LAP + 10)
    measured = world.truth[3].between(world.truth[LAP + 3]).compose(gtsam.Pose2(off, off, 0.0))
    first = isam.update(closures=[world.closure(3, LAP + 3, measured)])
    assert first.decisions[0].verdict == "undecided"
    assert not isam.admitted
    second = isam.update(closures=[world.closure(k, LAP + k) for k in (4, 5, 6, 7, 9)])
    assert second.accepted == (1, 2, 3, 4, 5)
    assert second.changed[0].verdict == verdict
    assert (0 in isam.admitted) is (verdict == "accepted")
    graph = isam.smoother.getFactorsUnsafe()
    assert all(graph.at(slot).keys()[1] - LAP == graph.at(slot).keys()[0] for (slot,) in isam.admitted.values())
    assert isam.update(closures=[world.closure(8, LAP + 8)]).changed == {}


@pytest.mark.parametrize("robust", [False, True])
def test_a_kept_map_decides_as_a_map_that_is_read_anew(robust):
    lap, world = 4 * 32, driven(block(60, times=2), bias=0.0005, noise=0.002)
    anew = GatedISAM2(eager(), radii=RADIUS, gate=LoopClosureGate(options=GateOptions(scores=True)))
    kept = GatedISAM2(eager(), radii=RADIUS)
    foreseen, huber = 0, gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(gtsam.PriorFactorPose2(0, world.truth[0], ORIGIN))
    values.insert(0, world.truth[0])
    for isam in (anew, kept):
        isam.update(factors, values)
    for k in range(1, 2 * lap):
        closures = []
        if k % 5 == 0 and k > lap + 3:
            measured = NOWHERE if k % 20 == 0 else None
            closures = [world.closure(k - lap + 33 * (k % 20 == 0), k, measured).at(0)]
            if robust:
                model = gtsam.noiseModel.Robust.Create(huber, closures[0].noiseModel())
                closures = [gtsam.BetweenFactorPose2(*closures[0].keys(), closures[0].measured(), model)]
        one, other = (isam.update(*step(world, k), closures) for isam in (anew, kept))
        assert [d.verdict for d in one.decisions] == [d.verdict for d in other.decisions]
        foreseen += sum(d.score is None for d in other.decisions)
    assert anew.admitted == kept.admitted
    assert foreseen > 10
    assert len(kept.admitted) > 10
    for number in sorted(kept.admitted)[::5]:
        kept.retract(number)


@pytest.mark.parametrize("reuses_slots", [False, True])
@pytest.mark.parametrize("changed", [False, True])
def test_a_map_that_the_caller_changed_is_read_anew(reuses_slots, changed):
    lap, world = 4 * 32, driven(block(60, times=2), bias=0.0005, noise=0.002)
    parameters = gtsam.ISAM2Params()
    parameters.findUnusedFactorSlots = reuses_slots
    isam = driven_to(world, lap + 9, smoother=gtsam.ISAM2(parameters))
    skip = between(lap + 3, lap + 5, world.truth[lap + 3].between(world.truth[lap + 5]))
    (slot,) = isam.update(graph_of([skip])).getNewFactorsIndices()
    assert isam.update(closures=[world.closure(k, lap + k) for k in range(3, 9)]).accepted == tuple(range(6))
    isam.update(*step(world, lap + 10))
    if changed:  # one factor for another: their number stays
        isam.smoother.update(graph_of([between(lap + 2, lap + 4, skip.measured())]), gtsam.Values(), [slot])
    (decision,) = isam.update(closures=[world.closure(30, lap, NOWHERE)]).decisions
    assert decision.verdict == "rejected"
    assert (decision.score is not None) is changed  # which a kept map has none of


def test_what_isam2_has_is_had_here(world):
    isam, bare = driven_to(world, 9), eager()
    for k in range(10):
        factors, values = step(world, k) if k else (gtsam.NonlinearFactorGraph(), gtsam.Values())
        if not k:
            factors.push_back(gtsam.PriorFactorPose2(0, world.truth[0], ORIGIN))
            values.insert(0, world.truth[0])
        bare.update(factors, values)
    assert isam.calculateEstimatePose2(9).equals(bare.calculateEstimatePose2(9), 1e-12)
    np.testing.assert_allclose(isam.marginalCovariance(9), bare.marginalCovariance(9))
    assert isam.update(force_relinearize=True).result.getVariablesRelinearized() >= 0
    assert isinstance(GatedISAM2(gtsam.ISAM2Params()).smoother, gtsam.ISAM2)
    with pytest.raises(AttributeError):
        _ = isam.nothing_of_the_kind


EXAMPLES = ["Pose2ISAM2Example", "Pose3ISAM2Example", "VisualISAM2Example", "ImuFactorISAM2Example"]


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_of_gtsam_run_with_the_gate_in_front(name, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    monkeypatch.setattr(pyplot, "pause", lambda seconds: None)
    source = Path(importlib.util.find_spec(f"gtsam.examples.{name}").origin).read_text(encoding="utf-8")
    assert " ISAM2(" in source or "gtsam.ISAM2(" in source
    made = []
    gated = source.replace("gtsam.ISAM2(", "GatedISAM2(").replace(" ISAM2(", " GatedISAM2(")
    exec(gated, {"__name__": "__main__", "GatedISAM2": lambda *given: made.append(GatedISAM2(*given)) or made[-1]})
    pyplot.close("all")
    assert made[0].estimate().size() > 2
