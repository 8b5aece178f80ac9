"""A smoother of any kind behind the gate: closures are judged, admitted, taken out and judged again."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import gtsam

from pgti_gtsam.adapter import check_radii
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.checks import shown
from pgti_gtsam.drift.ties import free_space_unit
from pgti_gtsam.errors import InvalidClosureError, InvalidOptionError
from pgti_gtsam.factor_graphs import Closure, check_map, closure_graphs, factors_of, graph_of, joined, keys_of, without
from pgti_gtsam.gate.decision import ClosureDecision
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.kept.grown_map import GrownMap
from pgti_gtsam.gate.revisits import revisits
from pgti_gtsam.gate.smoothers.history import GatedUpdate, Offer, Review, Step
from pgti_gtsam.gate.smoothers.kept_map import KeptMap, News, WholeMap, check_news
from pgti_gtsam.gate.smoothers.saved import SCHEMA, VERSION, Parts, State, read_state, write_state
from pgti_gtsam.pose_graph import Radii
from pgti_gtsam.track import track_of


@dataclass(slots=True)
class GatedSmoother(ABC):
    """The common part of the gates in front of all kinds of smoothers.

    Closures are weighed against the map, and their slots are slots of the map.
    """

    smoother: Any
    gate: LoopClosureGate = field(default_factory=LoopClosureGate)
    radii: Radii | None = None
    _offers: list[Offer] = field(default_factory=list, init=False)
    _waiting: set[int] = field(default_factory=set, init=False)
    _kept: KeptMap = field(default_factory=KeptMap, init=False)

    def __post_init__(self) -> None:
        self._check_smoother()
        if not isinstance(self.gate, LoopClosureGate):
            raise InvalidOptionError(f"expected a LoopClosureGate as the gate, got {self.gate!r}")
        check_radii(self.radii)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.smoother, name)

    @property
    @abstractmethod
    def _map(self) -> WholeMap:
        """The map as it stands."""

    @abstractmethod
    def _check_smoother(self) -> None:
        """Refuse another kind of smoother."""

    @abstractmethod
    def _step(
        self,
        graphs: Sequence[gtsam.NonlinearFactorGraph],
        values: gtsam.Values,
        options: Mapping[str, Any],
        removed: Sequence[int] = (),
    ) -> Step:
        """A step of the smoother with some graphs; slots of the map to be emptied."""

    @abstractmethod
    def state(self) -> State:
        """The whole state but gate and parameters, as JSON-ready text and numbers."""

    def save(self, path: Path | str) -> None:
        """Write `state` to a file; a power failure leaves the old file or the new file.

        Raises
        ------
        InvalidGraphError
            A factor that GTSAM has no archive of, a `gtsam.CustomFactor` say.
        """
        write_state(path, self.state())

    @classmethod
    @abstractmethod
    def resumed(cls, state: State, parameters: Any | None = None, gate: LoopClosureGate | None = None) -> Self:
        """A gated smoother that continues from `state`.

        Parameters
        ----------
        state : dict
        parameters : optional
            Of the smoother, as at the first start: parameters are not part of the state.
        gate : LoopClosureGate, optional
        """

    @classmethod
    def load(cls, path: Path | str, parameters: Any | None = None, gate: LoopClosureGate | None = None) -> Self:
        """Read the file of `save`; FileFormatError for any other content. See `resumed`.

        Parameters
        ----------
        path : Path or str
        parameters, gate
            As for `resumed`.
        """
        return cls.resumed(read_state(Path(path), SCHEMA, VERSION), parameters, gate)

    @property
    def _parts(self) -> Parts:
        return Parts(
            graph=self._map.getFactorsUnsafe(),
            radii=self.radii,
            offers=self._offers,
            waiting=self._waiting,
            kept=self._kept,
        )

    def _check_news(self, news: News, options: Mapping[str, Any]) -> None:
        """Refuse input on which the smoother would fail."""
        check_news(news)

    @property
    def _reuses_slots(self) -> bool:
        """Whether new factors take the map's empty slots."""
        return False

    def _is_fixed(self, number: int) -> bool:
        """Whether a closure is part of a smoother's prior for good."""
        return False

    def _slots_of(self, offers: Iterable[Offer]) -> list[tuple[int, ...]]:
        """Slots of the smoother that hold closures."""
        return [offer.slots for offer in offers]

    def _updated(
        self,
        factors: gtsam.NonlinearFactorGraph | None,
        values: gtsam.Values | None,
        closures: Sequence[Closure],
        radii: Mapping[int, float] | None,
        options: Mapping[str, Any],
    ) -> GatedUpdate:
        """An update, with closures or without."""
        # what comes in
        values = gtsam.Values() if values is None else values
        factors = gtsam.NonlinearFactorGraph() if factors is None else factors
        check_map(factors, values)
        if factors.nrFactors() < factors.size():
            factors = graph_of(factors_of(factors))
        news = News(self._map, factors, values, self.radii if radii is None else self._grown_radii(radii))
        self._check_news(news, options)
        if closures:
            return self._updated_with(closures, news, options)

        # one step of the smoother, and nothing to judge
        result, (slots,), is_appended = self._step((factors,), values, options)
        self.radii = news.radii
        self._kept.note(factors, values, slots)
        if not is_appended:
            self._kept.forget()
        return GatedUpdate(factor_slots=slots, result=result)

    def _updated_with(self, closures: Sequence[Closure], news: News, options: Mapping[str, Any]) -> GatedUpdate:
        """An update with closures: of the new and the waiting, those that pass together."""
        # judge the closures, and those that wait again
        offered = closure_graphs(closures)
        undecided = {number: self._offers[number] for number in sorted(self._waiting)}
        waiting = {number: offer.closure for number, offer in undecided.items() if self._has(offer)}
        judged = self._kept.judged(self.gate, news, waiting, offered)
        changed = {number: decision for number, decision in judged.waiting.items() if decision.verdict != "undecided"}

        # one step of the smoother with those that passed
        numbers = range(len(self._offers), len(self._offers) + len(offered))
        closure_of = waiting | dict(zip(numbers, offered, strict=True))
        verdicts = changed | dict(zip(numbers, judged.decisions, strict=True))
        passed = [number for number, decision in verdicts.items() if decision.accepted]
        step = self._step([news.factors, *(closure_of[number] for number in passed)], news.values, options)

        # remember where they stand, and the map
        factor_slots, *own = step.slots
        slots_of = dict(zip(passed, own, strict=True))
        self._offers += [Offer(closure) for closure in offered]
        for number, decision in verdicts.items():
            self._offers[number].slots = slots_of.get(number, ())
            (self._waiting.add if decision.verdict == "undecided" else self._waiting.discard)(number)
        self.radii = news.radii
        self._kept.keep(judged.map if step.is_appended else None, self._map, reuses_slots=self._reuses_slots)
        return GatedUpdate(
            decisions=judged.decisions,
            closures=tuple(numbers),
            slots=tuple(self._slots_of([self._offers[number] for number in numbers])),
            factor_slots=factor_slots,
            changed=changed,
            result=step.result,
        )

    def estimate(self) -> gtsam.Values:
        """The estimate of the whole map."""
        return self._map.calculateEstimate()

    def factors(self) -> gtsam.NonlinearFactorGraph:
        """The factors of the whole map with the admitted closures, in a graph that later updates leave alone."""
        return joined(self._map.getFactorsUnsafe())

    @property
    def admitted(self) -> dict[int, tuple[int, ...]]:
        """Slots of the closures that are in the smoother, by number."""
        return {number: slots for number, slots in enumerate(self._slots_of(self._offers)) if slots}

    def retract(self, closure: int) -> None:
        """Take an admitted closure out again.

        Raises
        ------
        InvalidClosureError
            No such closure is in; its slots hold other factors by now; or a variable depends on the closure alone.
        """
        self._replace([closure], [])

    def review(self, closures: Collection[int] | None = None) -> Review:
        """Judge again every revisit with an admitted closure, by all later evidence.

        Parameters
        ----------
        closures : collection of int, optional
            Only the revisits of these closures: those of the last update, say, after a rejection.

        Returns
        -------
        Review

        Notes
        -----
        Each revisit is left out of the map and offered anew, its rejected closures
        included: leave-one-out for a single closure, and a fresh vote where several came in
        turn and the first had only each other to agree with. Changes nothing: see `revise`.
        """
        asked = range(len(self._offers)) if closures is None else closures
        grown = None if self.gate.options.scores else self._kept.whole(self.gate, self._news(), self._reuses_slots)
        decisions: dict[int, ClosureDecision] = {}
        for revisit in self._revisits(grown):
            if not set(revisit).isdisjoint(asked):
                decisions |= dict(zip(revisit, self._without(revisit, grown), strict=True))
        return self._review(decisions)

    def review_afresh(self) -> Review:
        """Judge all closures offered so far once more, as a whole.

        Where a wrong closure was admitted early and has shut out right ones elsewhere, no review of one
        revisit at a time can tell. Changes nothing.
        """
        estimate, graph = self.estimate(), self._factors_without(range(len(self._offers)))
        ends = self._ends(read_keyframes(estimate).index)
        closures = [self._offers[number].closure for number in ends]
        judged = self.gate.evaluate_group(graph, estimate, closures, self.radii)
        return self._review(dict(zip(ends, judged.decisions, strict=True)))

    def _review(self, decisions: Mapping[int, ClosureDecision]) -> Review:
        holds = {number: bool(self._offers[number].slots) for number in decisions}
        turned = {number for number, decision in sorted(decisions.items()) if decision.accepted is not holds[number]}
        return Review(
            decisions=decisions,
            leaving=tuple(number for number in sorted(turned) if holds[number] and not self._is_fixed(number)),
            entering=tuple(number for number in sorted(turned) if not holds[number]),
        )

    def revise(self, review: Review) -> None:
        """Take out the closures that a review says leave, and admit those that enter, in a step.

        Raises
        ------
        InvalidClosureError
            Closures came or went since the review was made.
        """
        if not isinstance(review, Review):
            raise InvalidOptionError(f"expected what review() returned, got {shown(review)}")
        self._replace(review.leaving, review.entering)

    def _grown_radii(self, radii: Mapping[int, float]) -> Radii:
        if not isinstance(self.radii, Mapping | None):
            raise InvalidOptionError(f"expected no radii of single keyframes, since all have {self.radii} m, got some")
        return {**(self.radii or {}), **radii}

    def _replace(self, leaving: Sequence[int], entering: Sequence[int]) -> None:
        # what goes, and what comes
        for number in leaving:
            self._check_in(number)
        for number in entering:
            self._check_out(number)
        removed = [slot for number in leaving for slot in self._offers[number].slots]
        self._check_held(removed)
        added = [self._offers[number].closure for number in entering]

        # one step of the smoother, and where they stand
        step = self._step(added, gtsam.Values(), {}, removed)
        for number in leaving:
            self._offers[number].slots = ()
        for number, closure, slots in zip(entering, added, step.slots, strict=True):
            self._offers[number] = Offer(closure, slots)
        self._waiting.difference_update(entering)
        self._kept.forget()

    def _check_in(self, number: int) -> None:
        """Refuse a closure that cannot be taken out."""
        self._check_standing(number)

    def _check_standing(self, number: int) -> None:
        offer = self._offer(number)
        if not offer.slots:
            raise InvalidClosureError(f"expected the number of a closure that is in, got {number}, which is not")
        standing = offer.standing(self._map.getFactorsUnsafe())
        gone = next((slot for slot in offer.slots if slot not in standing), None)
        if gone is not None:
            raise InvalidClosureError(
                f"expected closure {number} in slot {gone}, got another factor or none: "
                "the smoother was changed from outside"
            )

    def _check_out(self, number: int) -> None:
        if self._offer(number).slots:
            raise InvalidClosureError(f"expected the number of a closure that is not in, got {number}, which is")

    def _offer(self, number: int) -> Offer:
        if not 0 <= number < len(self._offers):
            raise InvalidClosureError(f"expected the number of one of {len(self._offers)} closures, got {number}")
        return self._offers[number]

    def _check_held(self, removed: Sequence[int]) -> None:
        """Refuse to remove the last factors of a variable: a smoother would silently drop the variable."""
        graph = self._map.getFactorsUnsafe()
        held = {key for factor in factors_of(without(graph, removed)) for key in keys_of(factor)}
        free = next((key for slot in removed for key in keys_of(graph.at(slot)) if key not in held), None)
        if free is not None:
            raise InvalidClosureError(
                f"expected a closure that the map holds without, got one on which "
                f"{gtsam.DefaultKeyFormatter(free)} hangs alone"
            )

    def _news(self) -> News:
        """The map as it stands, and nothing new."""
        return News(self._map, gtsam.NonlinearFactorGraph(), gtsam.Values(), self.radii)

    def _revisits(self, grown: GrownMap | None) -> list[list[int]]:
        """Numbers of the closures of every revisit with an admitted closure."""
        # the keyframes along the track, by the kept map if that has them in order
        way = None if grown is None else grown.way
        if grown is None or way is None:
            pose_graph = self.gate.adapted(self._map.getFactorsUnsafe(), self.estimate(), self.radii)
            ends = self._ends(read_keyframes(self.estimate()).index)
            way = track_of(pose_graph).way_m / free_space_unit(pose_graph)
        else:
            ends = self._ends(grown.places)

        # the closures along them
        numbers = list(ends)
        groups = [[numbers[k] for k in group] for group in revisits(list(ends.values()), way)]
        return [group for group in groups if any(self._offers[number].slots for number in group)]

    def _ends(self, place: Mapping[int, int]) -> dict[int, tuple[int, int]]:
        """First and last keyframe of every closure on the track, by number, at the places of some keyframes."""
        ends = {}
        for number, offer in enumerate(self._offers):
            if not self._has(offer):
                continue
            places = [place[key] for factor in factors_of(offer.closure) for key in keys_of(factor) if key in place]
            if places:
                ends[number] = (min(places), max(places))
        return ends

    def _has(self, offer: Offer) -> bool:
        """Whether all variables of a closure are there: a caller may have marginalised some."""
        return all(self._map.valueExists(key) for factor in factors_of(offer.closure) for key in keys_of(factor))

    def _factors_without(self, closures: Iterable[int]) -> gtsam.NonlinearFactorGraph:
        graph = self._map.getFactorsUnsafe()
        return without(graph, [slot for number in closures for slot in self._offers[number].standing(graph)])

    def _without(self, revisit: Sequence[int], grown: GrownMap | None) -> tuple[ClosureDecision, ...]:
        """Verdicts on the closures of a revisit by the map without them: the kept map where that suffices."""
        offers, whole = [self._offers[number] for number in revisit], self._map.getFactorsUnsafe()
        closures = [offer.closure for offer in offers]
        held = [bool(offer.standing(whole)) for offer in offers]
        foreseen = None if grown is None else self.gate.reviewed(grown, closures, held)
        if foreseen is not None:
            return foreseen
        graph = self._factors_without(revisit)
        return self.gate.evaluate_group(graph, self.estimate(), closures, self.radii).decisions
