"""A gated iSAM2 through every fault in any order. `python tests/test_isam2_machine.py 300` goes on for 300 s."""

import json
import sys
import time

import gtsam
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from streets import RADIUS, between, block, driven

from pgti_gtsam.errors import InvalidClosureError, PgtiError, UnsolvableGraphError
from pgti_gtsam.factor_graphs import factors_of, graph_of, joined, keys_of
from pgti_gtsam.gate import GatedISAM2

LAP = 4 * 12  # steps around a block of 20 m
KEPT = LAP - 10  # keyframes that marginalising leaves
LOSSES = {
    "none": None,
    "huber": gtsam.noiseModel.mEstimator.Huber.Create(1.345),
    "cauchy": gtsam.noiseModel.mEstimator.Cauchy.Create(1.0),
    "dcs": gtsam.noiseModel.mEstimator.DCS.Create(1.0),
}
CAMERA = gtsam.Cal3_S2(500.0, 500.0, 0.0, 320.0, 240.0)
STEPS = {"taken": 0}


def eager(reuses_slots):
    """A smoother that relinearises all it can, so that its estimate can be compared with an optimum."""
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(1e-9)
    parameters.relinearizeSkip = 1
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
    parameters.findUnusedFactorSlots = reuses_slots
    return parameters


def told(isam):
    """All that a gated smoother holds, in numbers."""
    return isam.getFactorsUnsafe().size(), isam.estimate().serialize(), dict(isam.admitted)


class GatedSmoother(RuleBasedStateMachine):
    """Drives around a block in the plane or in space, and closes it, while callers and smoothers fail."""

    @initialize(seed=st.integers(0, 3), spatial=st.booleans(), reuses_slots=st.booleans())
    def start(self, seed, spatial, reuses_slots):
        steps = block(20, times=2)
        self.world = driven([gtsam.Pose3(s) for s in steps] if spatial else steps, bias=0.002, noise=0.005, seed=seed)
        self.kind = "Pose3" if spatial else "Pose2"
        self.parameters = eager(reuses_slots)
        self.isam = GatedISAM2(gtsam.ISAM2(self.parameters), radii=RADIUS)
        prior = getattr(gtsam, f"PriorFactor{self.kind}")
        model = gtsam.noiseModel.Isotropic.Sigma(6 if spatial else 3, 1e-3)
        factors, values = graph_of([prior(0, self.world.truth[0], model)]), gtsam.Values()
        values.insert(0, self.world.truth[0])
        self.isam.update(factors, values)
        self.first, self.last = 0, 0
        self.ungated = factors_of(factors)  # that are in, closures apart
        self.closures = []  # all that were offered
        self.broken = set()  # numbers of those that a caller took out or marginalised
        self.is_smart = False
        for _ in range(LAP):
            self.drive_on([])

    def drive_on(self, closures):
        k, values = self.last + 1, gtsam.Values()
        values.insert(k, getattr(self.world.values, f"at{self.kind}")(k))
        factor = self.world.graph.at(k - 1)
        self.last = k
        self.ungated.append(factor)
        self.offer(graph_of([factor]), values, closures)

    def offer(self, factors, values, closures):
        update = self.isam.update(factors, values, closures)
        self.closures += closures
        assert [bool(slots) for slots in update.slots] == [d.accepted for d in update.decisions]
        STEPS["taken"] += 1

    def closure(self, i, j, loss="none", measured=None):
        factor = self.world.closure(i, j, measured).at(0)
        if LOSSES[loss] is None:
            return factor
        model = gtsam.noiseModel.Robust.Create(LOSSES[loss], factor.noiseModel())
        return type(factor)(*factor.keys(), factor.measured(), model)

    @property
    def can_drive(self):
        return self.last < 2 * LAP - 2

    @precondition(lambda self: self.can_drive)
    @rule(data=st.data(), loss=st.sampled_from(sorted(LOSSES)))
    def drive(self, data, loss):
        closures, k = [], self.last + 1
        if data.draw(st.booleans()) and k - LAP >= self.first:
            closures.append(self.closure(k - LAP, k, loss))
        if data.draw(st.booleans()):
            nowhere = getattr(gtsam, self.kind)()
            i, j = data.draw(st.integers(10, 19)), data.draw(st.integers(30, 40))
            if min(i, j) >= self.first:
                closures.append(self.closure(i, j, loss, nowhere))
        self.drive_on(closures)

    @rule(back=st.integers(0, 5), copies=st.integers(1, 2), loss=st.sampled_from(sorted(LOSSES)))
    def close(self, back, copies, loss):
        i = max(self.last - back - LAP + 5, self.first)
        self.offer(None, None, [self.closure(i, self.last - back, loss) for _ in range(copies)])

    @property
    def is_robust(self):
        """Whether a robust loss is in, whose optimum is found by many small steps."""
        return any(isinstance(self.closures[n].noiseModel(), gtsam.noiseModel.Robust) for n in self.isam.admitted)

    def inside(self):
        return sorted(set(self.isam.admitted) - self.broken)

    @precondition(lambda self: self.inside())
    @rule(data=st.data())
    def retract(self, data):
        number = data.draw(st.sampled_from(self.inside()))
        self.isam.retract(number)
        assert number not in self.isam.admitted

    @precondition(lambda self: self.closures)
    @rule(data=st.data())
    def review(self, data):
        before = told(self.isam)
        review = self.isam.review([data.draw(st.sampled_from(range(len(self.closures))))])
        assert told(self.isam) == before
        if self.broken.isdisjoint([*review.leaving, *review.entering]):
            self.isam.revise(review)
            assert set(review.entering) <= set(self.isam.admitted)
            assert set(review.leaving).isdisjoint(self.isam.admitted)

    @rule()
    def restart(self):
        state = json.loads(json.dumps(self.isam.state()))
        self.isam = GatedISAM2.resumed(state, self.parameters)

    @precondition(lambda self: self.inside())
    @rule(data=st.data())
    def caller_takes_a_closure_out(self, data):
        number = data.draw(st.sampled_from(self.inside()))
        self.isam.smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), list(self.isam.admitted[number]))
        self.broken.add(number)
        with pytest.raises(InvalidClosureError, match="changed from outside"):
            self.isam.retract(number)

    @rule()
    def caller_adds_a_factor(self):
        measured = self.world.truth[self.last - 2].between(self.world.truth[self.last])
        skip = between(self.last - 2, self.last, measured)
        self.isam.smoother.update(graph_of([skip]), gtsam.Values())
        self.ungated.append(skip)

    @precondition(lambda self: self.first == 0 and self.last > LAP + 5 and not self.is_smart)
    @rule()
    def caller_marginalises(self):
        old = range(self.last - KEPT)
        asked, order, leaving = gtsam.ISAM2UpdateParams(), gtsam.KeyGroupMap(), gtsam.KeyList()
        for k in range(self.last + 1):
            order.insert2(k, 0 if k in old else 1)
        asked.constrainedKeys = order
        again = gtsam.KeyList()
        for k in range(self.last + 1):
            again.push_back(k)
        asked.extraReelimKeys = again
        for k in old:
            leaving.push_back(k)
        self.isam.smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), asked)
        self.isam.smoother.marginalizeLeaves(leaving)
        self.first = len(old)
        self.ungated = [factor for factor in self.ungated if min(keys_of(factor)) >= self.first]
        self.broken |= {n for n, c in enumerate(self.closures) if min(keys_of(c)) < self.first}

    @precondition(lambda self: self.kind == "Pose3" and self.can_drive)
    @rule()
    def see_a_smart_landmark(self):
        smart = gtsam.SmartProjectionPoseFactorCal3_S2(gtsam.noiseModel.Isotropic.Sigma(2, 1.0), CAMERA)
        for k in (self.last - 3, self.last):
            smart.add(np.array([300.0 + k, 250.0]), k)
        self.is_smart = True
        self.ungated.append(smart)
        self.offer(graph_of([smart]), None, [])

    @precondition(lambda self: self.can_drive and not self.is_smart)
    @rule(with_a_closure=st.booleans())
    def fail_late(self, with_a_closure):
        """A factor of the other kind of poses, which iSAM2 finds out when it is half through."""
        other = "Pose2" if self.kind == "Pose3" else "Pose3"
        factors, values, k = gtsam.NonlinearFactorGraph(), gtsam.Values(), self.last + 1
        unit = gtsam.noiseModel.Unit.Create(3 if other == "Pose2" else 6)
        factors.push_back(getattr(gtsam, f"BetweenFactor{other}")(k - 1, k, getattr(gtsam, other)(), unit))
        values.insert(k, getattr(gtsam, other)())
        before, closures = told(self.isam), [self.closure(k - 1 - KEPT + 4, k - 1)] if with_a_closure else []
        with pytest.raises(PgtiError):
            self.isam.update(factors, values, closures)
        assert told(self.isam)[::2] == before[::2]

    @rule(fault=st.sampled_from(["unknown", "empty", "nan", "again", "loose", "retract", "left"]))
    def fail(self, fault):
        before, nowhere = told(self.isam), getattr(gtsam, self.kind)()
        values = gtsam.Values()
        values.insert(self.last, nowhere)
        nan = type(nowhere)(nowhere.rotation(), np.full(len(nowhere.translation()), np.nan))
        bad = {
            "unknown": lambda: self.isam.update(closures=[self.closure(20, 41), between(30, 4711, nowhere)]),
            "empty": lambda: self.isam.update(closures=[gtsam.NonlinearFactorGraph()]),
            "nan": lambda: self.isam.update(closures=[self.closure(20, 41, measured=nan)]),
            "again": lambda: self.isam.update(None, values),
            "loose": lambda: self.isam.update(graph_of([self.world.graph.at(2 * LAP - 1)])),
            "retract": lambda: self.isam.retract(len(self.closures)),
            "left": lambda: (
                self.isam.update(graph_of([between(self.first - 1, self.last, nowhere)]))
                if self.first
                else self.isam.retract(-1)
            ),
        }
        with pytest.raises(PgtiError) as error:
            bad[fault]()
        assert not isinstance(error.value, UnsolvableGraphError)
        assert told(self.isam) == before

    @invariant()
    def slots_hold_the_admitted_closures_and_all_else_that_came(self):
        if not hasattr(self, "isam"):
            return
        graph = self.isam.smoother.getFactorsUnsafe()
        inside = self.inside()
        for number in inside:
            (slot,) = self.isam.admitted[number]
            assert keys_of(graph.at(slot)) == keys_of(self.closures[number])
            assert graph.at(slot).measured().equals(self.closures[number].measured(), 0.0)
        marginals = [factor for factor in factors_of(graph) if isinstance(factor, gtsam.LinearContainerFactor)]
        assert len(factors_of(graph)) - len(marginals) == len(self.ungated) + len(inside)

    @invariant()
    def estimate_is_the_optimum_of_what_is_in(self):
        if not hasattr(self, "isam") or self.is_smart or self.is_robust:
            return
        rehearsal = gtsam.ISAM2(self.isam.smoother)
        for _ in range(8):
            rehearsal.update()
        found = rehearsal.calculateEstimate()
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(1e-14)
        parameters.setAbsoluteErrorTol(1e-14)
        graph = joined(graph_of(factors_of(self.isam.smoother.getFactorsUnsafe())))
        best = gtsam.LevenbergMarquardtOptimizer(graph, found, parameters).optimize()
        assert found.equals(best, 1e-5)


TestGatedSmoother = GatedSmoother.TestCase
TestGatedSmoother.settings = settings(derandomize=True, deadline=None, max_examples=12, stateful_step_count=12)


def main(seconds):
    """Run random days until the time is over, and tell how many steps that were."""
    ends, days = time.monotonic() + seconds, 0
    chosen = settings(
        deadline=None,
        max_examples=5,
        stateful_step_count=30,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    while time.monotonic() < ends:
        run_state_machine_as_test(GatedSmoother, settings=chosen)
        days += 5
    print(f"{STEPS['taken']} updates in {days} days")  # noqa: T201


if __name__ == "__main__":
    main(float(sys.argv[1]))
