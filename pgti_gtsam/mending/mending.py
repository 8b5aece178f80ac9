"""Mend a map: out with the closures that the gate rejects, in with the ties that the sensors and the gate confirm.

1. The map's own closures go through the gate; closures that do not pass are out.
2. The audit names the untied places, and the drift model says how large the drift may be there.
3. Each place is matched by the scans of its keyframes, within that region.
4. Confirmed ties go through the gate like any other closure; ties that pass are in, and the map is optimised.
5. The better map predicts better: 2 to 4 again, until nothing is left to try.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.diagnosis import ClosureFinding, Diagnosis, diagnose
from pgti_gtsam.drift.ties import OFFSET
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import checked_closure, keys_of, without
from pgti_gtsam.gate import ClosureDecision, LoopClosureGate, gate_graph
from pgti_gtsam.gate.batch import optimum
from pgti_gtsam.gate.decision import metres
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.mending.alignment import Cloud, align, is_thin
from pgti_gtsam.mending.clouds import Clouds, scans_of
from pgti_gtsam.mending.records import Attempt, Mended, Wanted
from pgti_gtsam.mending.submap import Submaps
from pgti_gtsam.mending.verdicts import sensors_say, sigma_unit, tie
from pgti_gtsam.mending.wanted import asked_for, wanted_ties
from pgti_gtsam.pose_graph import Radii, key_label
from pgti_gtsam.track import track_of

MOST_ROUNDS = 40
"""Times that the map is audited anew, and other pairs of its untied places are tried."""

MOST_CHECKS = 3
"""Times that ties which all others put elsewhere are taken out again."""

MISSES = 3.0
"""Standard deviations, of what the others predict and of a match together, beyond which a tie is out again. The gate
alone lets ties in that miss by more, as a map's maker may have reasons; a tie that nobody asked for has none."""

SMALLER = 0.5
"""Part of its former allowance to which a prediction must have come down before a pair is tried again."""

Tell = Callable[[str], None]


def mend(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    clouds: Clouds | None = None,
    *,
    radii: Radii | None = None,
    closures: Collection[int] | None = None,
    matched: Sequence[Any] = (),
    gate: LoopClosureGate | None = None,
    progress: Tell = lambda step: None,
) -> Mended:
    """Mend a map. Graph and values stay untouched.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        An estimate.
    clouds : Clouds, optional
        The scans of the keyframes: `scans_of` or `clouds_in`. Without, ties are only proposed.
    radii : float or mapping of key to float, m, optional
        As in `from_gtsam`.
    closures : collection of int, optional
        Slots of the loop closures; without, those that `track` finds.
    matched : sequence of between factors
        Ties of a matcher, or of a human, which only the gate judges. The ties keep their noise models.
    gate : LoopClosureGate, optional
    progress : callable
        Called with a few words on each step.

    Raises
    ------
    PgtiError
        As of `gate_graph` and `diagnose`; `MissingDependencyError` where clouds are to be matched without
        small_gicp; `InvalidClosureError` for a tie between keys that the map does not have.
    """
    # the map as it came
    gate = gate or LoopClosureGate()
    progress("auditing the map as it came")
    stored = optimised(graph, values)
    before = diagnose(graph, stored, radii=radii)

    # out with what does not pass
    progress("judging the map's closures")
    gated = gate_graph(graph, values, radii, closures=closures, gate=gate)
    out = {slot: decision for slot, decision in gated.decisions.items() if not decision.accepted}
    work = _Mending(
        graph=gated.graph, values=gated.values, radii=radii, gate=gate, clouds=clouds or scans_of({}), progress=progress
    )

    # in with what is confirmed
    if matched:
        work.offer([_answer(factor, values) for factor in matched])
    work.tie_places()
    after = work.audited()
    return Mended(
        graph=work.graph,
        values=work.values,
        out=out,
        attempts=tuple(work.attempts.values()),
        before=before,
        after=after,
        before_values=stored,
        n_rounds=work.round,
    )


@dataclass(slots=True, kw_only=True, eq=False)
class _Mending:
    """A map while ties come in."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    radii: Radii | None
    gate: LoopClosureGate
    clouds: Clouds
    progress: Tell
    attempts: dict[tuple[int, int], Attempt] = field(default_factory=dict)
    slots: dict[int, tuple[int, int]] = field(default_factory=dict)
    asked: set[tuple[int, int]] = field(default_factory=set)
    round: int = 0

    def tie_places(self) -> None:
        """Rounds of audit, matching and gate, until nothing is left to try."""
        while self.round < MOST_ROUNDS:
            self.round += 1
            self.progress(f"round {self.round}: auditing")
            diagnosis, reference = self._diagnosis(), self._reference()
            wanted = wanted_ties(diagnosis, reference, self.asked, self._is_known)
            self.asked |= asked_for(diagnosis).keys()
            submaps, unit = self._submaps(reference), sigma_unit(self.graph, reference)
            found = [
                self._matched(each, submaps, unit, f"round {self.round}: matching {k} of {len(wanted)}")
                for k, each in enumerate(wanted, start=1)
            ]
            if not found:
                break
            self.offer(found, reference)

    def _is_known(self, keys: tuple[int, int], allowance_m: float) -> bool:
        """Whether a pair is tied, or was tried within a region that was about as small."""
        known = self.attempts.get(keys)
        if known is None:
            return False
        return known.outcome == "confirmed" or known.wanted is None or allowance_m > SMALLER * known.wanted.allowance_m

    def _matched(self, wanted: Wanted, submaps: Submaps, sigmas: float, said: str) -> Attempt:
        """A tie tried by the scans of its keyframes."""
        self.progress(said)
        unseen = [key for key in wanted.keys if key not in submaps.clouds]
        if unseen:
            return _untried(wanted, f"There is no scan or cloud of {key_label(unseen[0])}.", self.round)

        # align what both saw, and ask what the sensors say of it
        unit, ends = submaps.unit_m, (submaps.at(wanted.keyframes[0]), submaps.at(wanted.keyframes[1]))
        found = None
        if not any(map(is_thin, ends)):
            first, second = (Cloud.of(submap, unit) for submap in ends)
            found = align(first, second, wanted.pose, wanted.covariance)
        outcome, reason = sensors_say(wanted, found, unit)
        return Attempt(
            wanted=wanted,
            keys=wanted.keys,
            pose=None if found is None else found.pose,
            factor=None if found is None else tie(wanted, found, unit, sigmas),
            alignment=found,
            submaps=ends,
            decision=None,
            outcome=outcome,
            reason=reason,
            round=self.round,
        )

    def offer(self, found: Sequence[Attempt], reference: ReferenceMap | None = None) -> None:
        """Let the gate judge ties, tie those that pass, and optimise."""
        offered = [attempt for attempt in found if attempt.outcome == "confirmed"]
        self.attempts |= {attempt.keys: attempt for attempt in found}
        if not offered:
            return
        reference = reference or self._reference()
        judged = self.gate.judge(reference, [checked_closure(attempt.factor, self.values) for attempt in offered])
        decided = [_decided(attempt, decision) for attempt, decision in zip(offered, judged.decisions, strict=True)]
        self.attempts |= {attempt.keys: attempt for attempt in decided}

        # what passed
        passed = [attempt for attempt in decided if attempt.outcome == "confirmed"]
        if not passed:
            return
        grown = gtsam.NonlinearFactorGraph(self.graph)
        for attempt in passed:
            self.slots[grown.size()] = attempt.keys
            grown.push_back(attempt.factor)
        self.graph, self.values = grown, optimum(grown, self.values, judged.settled, reference.pose_graph)

    def audited(self) -> Diagnosis:
        """The audit of the mended map, without ties that the others contradict after all."""
        self.progress("auditing the mended map")
        diagnosis = self._diagnosis()
        for _ in range(MOST_CHECKS):
            missing = {
                closure.slot: closure for closure in diagnosis.closures if _is_missing(closure, diagnosis.unit_m)
            }
            regretted = [slot for slot in self.slots if slot in missing]
            if not regretted:
                break
            for slot in regretted:
                attempt = self.attempts[self.slots.pop(slot)]
                far, allowed = metres(missing[slot].missed_m), metres(missing[slot].allowed_m)
                reason = f"Out again: all other ties put its later keyframe {far} away, give or take {allowed}."
                self.attempts[attempt.keys] = replace(attempt, outcome="refused", reason=reason)
            self.graph = without(self.graph, regretted)
            self.values = optimised(self.graph, self.values)
            diagnosis = self._diagnosis()
        return diagnosis

    def _diagnosis(self) -> Diagnosis:
        return diagnose(self.graph, self.values, radii=self.radii)

    def _reference(self) -> ReferenceMap:
        return self.gate.reference_map(self.graph, self.values, self.radii)

    def _submaps(self, reference: ReferenceMap) -> Submaps:
        keyframes, pose_graph = read_keyframes(self.values), reference.pose_graph
        keys = pose_graph.keys.tolist()
        return Submaps(
            clouds=self.clouds,
            keys=keys,
            poses=[keyframes.pose(key) for key in keys],
            track=track_of(pose_graph),
            unit_m=reference.settled.model.units.unit_m,
        )


def _is_missing(closure: ClosureFinding, unit_m: float) -> bool:
    """Whether the other ties contradict a tie."""
    expected = np.hypot(closure.allowed_m, OFFSET * unit_m)
    return closure.is_false or bool(closure.missed_m > MISSES * expected)


def _untried(wanted: Wanted, reason: str, number: int) -> Attempt:
    """A tie that only others can match."""
    return Attempt(
        wanted=wanted,
        keys=wanted.keys,
        pose=None,
        factor=None,
        alignment=None,
        submaps=None,
        decision=None,
        outcome="undecided",
        reason=reason,
        round=number,
    )


def _answer(factor: Any, values: gtsam.Values) -> Attempt:
    """A matcher's tie, to be judged."""
    checked_closure(factor, values)
    first, second = keys_of(factor)
    return Attempt(
        wanted=None,
        keys=(first, second),
        pose=factor.measured(),
        factor=factor,
        alignment=None,
        submaps=None,
        decision=None,
        outcome="confirmed",
        reason="",
        round=0,
    )


def _decided(attempt: Attempt, decision: ClosureDecision) -> Attempt:
    """An attempt with the gate's verdict; undecided ties are not tied."""
    reason = " ".join([attempt.reason, *decision.reasons[:1]]).strip()
    if decision.accepted:
        return replace(attempt, decision=decision, outcome="confirmed", reason=reason)
    outcome: Any = "refused" if decision.verdict == "rejected" else "undecided"
    return replace(attempt, decision=decision, outcome=outcome, reason=" ".join(decision.reasons[:1]))
