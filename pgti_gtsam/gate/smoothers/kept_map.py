"""The map that a running pipeline keeps between closures, and the verdicts that it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import gtsam

from pgti_gtsam.drift.settled import solvable
from pgti_gtsam.errors import InvalidOptionError, MissingValueError
from pgti_gtsam.factor_graphs import BETWEEN, checked_closure, factors_of, joined, keys_of, slots_of
from pgti_gtsam.gate.decision import ClosureDecision
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.kept.grown_map import GrownMap
from pgti_gtsam.pose_graph import Radii


class WholeMap(Protocol):
    """All factors and variables of a map, by the names of `gtsam.ISAM2`."""

    def valueExists(self, key: int) -> bool:
        """Whether the map has a variable."""

    def getFactorsUnsafe(self) -> gtsam.NonlinearFactorGraph:
        """The factors, without a copy."""

    def calculateEstimate(self) -> gtsam.Values:
        """The estimate of all variables."""


class News(NamedTuple):
    """A map before a step, the new factors and values, and the radii of all keyframes."""

    map: WholeMap
    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    radii: Radii | None


def check_news(news: News) -> None:
    """Refuse new factors and values that do not belong to a map."""
    has, is_new = news.map.valueExists, news.values.exists
    for key in news.values.keys():  # noqa: SIM118, which Values is no dict for
        if has(key):
            raise InvalidOptionError(
                f"expected values of new variables only, got one for {gtsam.DefaultKeyFormatter(key)}, which the "
                "smoother has; leave it out"
            )
    for key in news.factors.keyVector():
        if not is_new(key) and not has(key):
            raise MissingValueError(
                f"expected a value for every key, got none for {gtsam.DefaultKeyFormatter(key)}; "
                "add it to the values or leave its factors out"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """Verdicts on new closures and, by number, on waiting closures; the map with passed closures, where known."""

    decisions: tuple[ClosureDecision, ...] = ()
    waiting: Mapping[int, ClosureDecision] = field(default_factory=dict)
    map: GrownMap | None = None


@dataclass(slots=True)
class Standing:
    """The content of a map's slots, by which a change from outside is noticed.

    Where no slot is used twice, each factor that comes or goes changes the number of slots or of factors.
    Where slots are used again, the factors themselves are compared.
    """

    n_slots: int = 0
    n_factors: int = 0
    factors: dict[int, Any] | None = None

    @classmethod
    def of(cls, graph: gtsam.NonlinearFactorGraph, *, reuses_slots: bool) -> Standing:
        """The content of a graph.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
        reuses_slots : bool
            Whether new factors take empty slots.
        """
        return cls(graph.size(), graph.nrFactors(), dict(slots_of(graph)) if reuses_slots else None)

    def grow(self, factors: gtsam.NonlinearFactorGraph, slots: Sequence[int]) -> None:
        """Note new factors.

        Parameters
        ----------
        factors : gtsam.NonlinearFactorGraph
        slots : sequence of int
            The slot of each factor.
        """
        self.n_slots = max(self.n_slots, max(slots, default=-1) + 1)
        self.n_factors += len(slots)
        if self.factors is not None:
            self.factors |= dict(zip(slots, factors_of(factors), strict=True))

    def is_that_of(self, graph: gtsam.NonlinearFactorGraph) -> bool:
        """Whether a graph has the same content."""
        if (graph.size(), graph.nrFactors()) != (self.n_slots, self.n_factors):
            return False
        return self.factors is None or all(graph.at(slot) is factor for slot, factor in self.factors.items())


@dataclass(slots=True)
class KeptMap:
    """The map at the last closure with the growth since; empty where the next closure needs a new map.

    An update without closures only notes the growth.
    """

    map: GrownMap | None = None
    news: list[tuple[gtsam.NonlinearFactorGraph, gtsam.Values]] = field(default_factory=list)
    standing: Standing = field(default_factory=Standing)

    @solvable()
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
            As of `solvable`.
        """
        grown = self._grown(new) if len(closures) == 1 and not gate.options.scores else None
        checked = None if grown is None else _checked_between(grown, closures[0])
        foreseen = None if grown is None or checked is None else gate.foreseen(grown, checked)
        if foreseen is not None and not (waiting and foreseen[0].accepted):
            decision, tied = foreseen
            return Judged(decisions=(decision,), map=tied)
        return _judged_anew(gate, new, waiting, closures)

    def whole(self, gate: LoopClosureGate, news: News, reuses_slots: bool) -> GrownMap | None:
        """The kept map with the growth since, made anew where there is none.

        Parameters
        ----------
        gate : LoopClosureGate
        news : News
            Without new factors.
        reuses_slots : bool
            Whether new factors take empty slots.

        Raises
        ------
        PgtiError
            As of `LoopClosureGate.reference_map`.
        """
        grown = self._grown(news)
        if grown is None:
            graph, estimate = joined(news.map.getFactorsUnsafe()), news.map.calculateEstimate()
            grown = GrownMap.of(gate.reference_map(graph, estimate, news.radii))
            self.keep(grown, news.map, reuses_slots=reuses_slots)
        return grown

    def note(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, slots: Sequence[int]) -> None:
        """Note the growth of a step without closures.

        Parameters
        ----------
        factors, values
            Of the step.
        slots : sequence of int
            The slot of each factor.
        """
        if self.map is not None:
            self.news.append((factors, values))
            self.standing.grow(factors, slots)

    def keep(self, map_: GrownMap | None, whole: WholeMap, *, reuses_slots: bool) -> None:
        """The map with all that a step with closures brought.

        Parameters
        ----------
        map_ : GrownMap, optional
            The map with the closures of the step, if known.
        whole : WholeMap
            The whole map after the step.
        reuses_slots : bool
            Whether new factors take empty slots.
        """
        self.map, self.news = map_, []
        if map_ is not None:
            self.standing = Standing.of(whole.getFactorsUnsafe(), reuses_slots=reuses_slots)

    def forget(self) -> None:
        """Let the next closure make the map anew."""
        self.map, self.news = None, []

    def _grown(self, new: News) -> GrownMap | None:
        """The map with all that came since; None where that takes more than appending."""
        if self.map is None or self.map.is_worn:
            return None
        if not self.standing.is_that_of(new.map.getFactorsUnsafe()):  # the caller changed it
            return None
        return self.map.grown([*self.news, (new.factors, new.values)])


def _judged_anew(
    gate: LoopClosureGate,
    new: News,
    waiting: Mapping[int, gtsam.NonlinearFactorGraph],
    closures: Sequence[gtsam.NonlinearFactorGraph],
) -> Judged:
    """Verdicts by the whole map of the smoother."""
    estimate = new.map.calculateEstimate()
    estimate.insert(new.values)
    graph = joined(new.map.getFactorsUnsafe(), new.factors)
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


def _checked_between(grown: GrownMap, closure: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph | None:
    """A closure between keyframes of the kept map, checked at their poses there; None for any other closure."""
    factors, kind = factors_of(closure), gtsam.Pose2 if grown.units.is_planar else gtsam.Pose3
    if not all(isinstance(factor, BETWEEN) and isinstance(factor.measured(), kind) for factor in factors):
        return None
    keys, own = {key for factor in factors for key in keys_of(factor)}, gtsam.Values()
    if not keys <= grown.places.keys():
        return None
    for key in keys:
        own.insert(key, grown.pose(grown.places[key]))
    return checked_closure(closure, own)
