"""The map that a running pipeline keeps between closures, and the verdicts that it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import gtsam
import numpy as np

from pgti_gtsam.errors import InvalidOptionError, MissingValueError, UnsolvableGraphError
from pgti_gtsam.factor_graphs import checked_closure, factors_of, joined, keys_of
from pgti_gtsam.gate.decision import ClosureDecision
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.grown_map import GrownMap
from pgti_gtsam.pose_graph import Radii


class News(NamedTuple):
    """A smoother before a step, the new factors and values, and the radii of all keyframes."""

    smoother: gtsam.ISAM2
    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    radii: Radii | None


def check_news(news: News) -> None:
    """Refuse input on which iSAM2 would fail."""
    has, new = news.smoother.valueExists, set(news.values.keys())
    known = next(filter(has, new), None)
    if known is not None:
        raise InvalidOptionError(
            f"expected values of new variables only, got one for {gtsam.DefaultKeyFormatter(known)}, which the "
            "smoother has; leave it out"
        )
    missing = next((key for key in news.factors.keyVector() if key not in new and not has(key)), None)
    if missing is not None:
        raise MissingValueError(
            f"expected a value for every key, got none for {gtsam.DefaultKeyFormatter(missing)}; "
            "add it to the values or leave its factors out"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """Verdicts on new closures and, by number, on waiting closures; the map with passed closures, where known."""

    decisions: tuple[ClosureDecision, ...] = ()
    waiting: Mapping[int, ClosureDecision] = field(default_factory=dict)
    map: GrownMap | None = None


@dataclass(slots=True)
class KeptMap:
    """The map at the last closure with the growth since; empty where the next closure needs a new map.

    An update without closures only notes the growth.
    """

    map: GrownMap | None = None
    news: list[tuple[gtsam.NonlinearFactorGraph, gtsam.Values]] = field(default_factory=list)
    n_factors: int = 0

    def judged(
        self,
        gate: LoopClosureGate,
        new: News,
        waiting: Mapping[int, gtsam.NonlinearFactorGraph],
        closures: Sequence[gtsam.NonlinearFactorGraph],
    ) -> Judged:
        """Verdicts by the kept map where that suffices, else by a new map.

        Parameters
        ----------
        gate : LoopClosureGate
        new : News
        waiting : mapping from int to gtsam.NonlinearFactorGraph
            Undecided closures, judged again where the map is made anew.
        closures : sequence of gtsam.NonlinearFactorGraph

        Raises
        ------
        InvalidClosureError, PgtiError
            As of `LoopClosureGate.evaluate`.
        UnsolvableGraphError
            Measurements so far apart in scale that their sums are rounding.
        """
        try:
            return self._judged(gate, new, waiting, closures)
        except np.linalg.LinAlgError as error:
            raise UnsolvableGraphError(
                "expected odometry and closures of one scale, got a map in which rounding hides what they say; "
                "look for measurements far beyond the map"
            ) from error

    def _judged(
        self,
        gate: LoopClosureGate,
        new: News,
        waiting: Mapping[int, gtsam.NonlinearFactorGraph],
        closures: Sequence[gtsam.NonlinearFactorGraph],
    ) -> Judged:
        grown = self._grown(new) if len(closures) == 1 and not gate.options.scores else None
        checked = None if grown is None else _checked_between(grown, closures[0], new)
        foreseen = None if grown is None or checked is None else gate.foreseen(grown, checked)
        if foreseen is not None and not (waiting and foreseen[0].accepted):
            decision, tied = foreseen
            return Judged(decisions=(decision,), map=tied)
        return _judged_anew(gate, new, waiting, closures)

    def note(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        """Note the growth of a step without closures.

        Parameters
        ----------
        factors, values
            Of the step.
        """
        self.n_factors += factors.size()
        if self.map is not None:
            self.news.append((factors, values))

    def keep(self, map_: GrownMap | None, smoother: gtsam.ISAM2) -> None:
        """The map with all that a step with closures brought.

        Parameters
        ----------
        map_ : GrownMap, optional
            The map with the closures of the step, if known.
        smoother : gtsam.ISAM2
            The smoother after the step.
        """
        self.map, self.news, self.n_factors = map_, [], smoother.getFactorsUnsafe().nrFactors()

    def forget(self) -> None:
        """Let the next closure make the map anew."""
        self.map, self.news = None, []

    def _grown(self, new: News) -> GrownMap | None:
        """The map with all that came since; None where that takes more than appending."""
        if self.map is None or self.map.is_worn:
            return None
        if new.smoother.getFactorsUnsafe().nrFactors() != self.n_factors:  # the caller changed it
            return None
        grown: GrownMap | None = self.map
        for factors, values in (*self.news, (new.factors, new.values)):
            grown = None if grown is None else grown.grown(factors, values)
        return grown


def _judged_anew(
    gate: LoopClosureGate,
    new: News,
    waiting: Mapping[int, gtsam.NonlinearFactorGraph],
    closures: Sequence[gtsam.NonlinearFactorGraph],
) -> Judged:
    """Verdicts by the whole map of the smoother."""
    estimate = new.smoother.calculateEstimate()
    estimate.insert(new.values)
    graph = joined(new.smoother.getFactorsUnsafe(), new.factors)
    checked = [checked_closure(closure, estimate) for closure in (*waiting.values(), *closures)]
    reference = gate.reference_map(graph, estimate, new.radii)
    decisions = gate.judge(reference, checked).decisions

    # the map with those that passed, as far as linear steps lead
    grown: GrownMap | None = GrownMap.of(reference)
    for closure, decision in zip(checked, decisions, strict=True):
        if grown is not None and decision.accepted:
            grown = grown.tied_by(closure)
    verdicts = dict(zip(waiting, decisions, strict=False))
    return Judged(decisions=decisions[len(waiting) :], waiting=verdicts, map=grown)


def _checked_between(
    grown: GrownMap, closure: gtsam.NonlinearFactorGraph, new: News
) -> gtsam.NonlinearFactorGraph | None:
    """A closure between keyframes of the kept map, checked at their values; None for any other closure."""
    keys = {key for factor in factors_of(closure) for key in keys_of(factor)}
    if not all(key in grown.places for key in keys):
        return None
    kind, own = "Pose2" if grown.is_planar else "Pose3", gtsam.Values()
    for key in keys:
        is_new = new.values.exists(key)
        at = getattr(new.values, f"at{kind}") if is_new else getattr(new.smoother, f"calculateEstimate{kind}")
        own.insert(key, at(key))
    return checked_closure(closure, own)
