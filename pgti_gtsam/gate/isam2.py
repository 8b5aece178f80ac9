"""iSAM2 behind the gate: closures reach the smoother only when they pass."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import gtsam

from pgti_gtsam import outputs
from pgti_gtsam.adapter import check_radii
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.checks import in_a_line, shown
from pgti_gtsam.errors import InvalidClosureError, InvalidOptionError, UnsolvableGraphError
from pgti_gtsam.factor_graphs import (
    Closure,
    check_map,
    closure_graphs,
    factors_of,
    graph_of,
    joined,
    keys_of,
    without,
)
from pgti_gtsam.gate.decision import ClosureDecision
from pgti_gtsam.gate.gate import Judgement, LoopClosureGate
from pgti_gtsam.gate.history import GatedUpdate, Offer, Review, made_anew
from pgti_gtsam.gate.kept_map import KeptMap, News, check_news
from pgti_gtsam.gate.revisits import revisits
from pgti_gtsam.gate.saved import Parts, State, decoded, encoded, read_state
from pgti_gtsam.gate.ties import free_space_unit
from pgti_gtsam.pose_graph import Radii
from pgti_gtsam.track import track_of


@dataclass(slots=True)
class GatedISAM2:
    """A `gtsam.ISAM2` with the gate in front of its loop closures.

    Everything else that a `gtsam.ISAM2` has (`calculateEstimatePose2`, `marginalCovariance`, …) is had here as well.

    Parameters
    ----------
    smoother : gtsam.ISAM2 or gtsam.ISAM2Params, optional
        A smoother of the caller, or the parameters of a new smoother. The caller may go on using the smoother, but
        must leave the slots of admitted closures alone.
    gate : LoopClosureGate, optional
    radii : float or mapping from key to float, m, optional
        As in `from_gtsam`; a mapping grows by `radii=` of `update`.

    Notes
    -----
    A rejected closure never reaches the smoother: the estimate is bit for bit the estimate without
    the closure. Bad input is refused before the smoother is touched. Where iSAM2 itself fails in the middle of
    a step, `smoother` is made anew, with the factors from before in their slots.

    An undecided closure waits, and is judged again with later closures.

    A map that grows by steps of odometry alone is read once and kept: see `GrownMap`. Decisions by a kept map hold no
    scores; where the gate's options ask for them, the map is read anew each time.
    """

    smoother: gtsam.ISAM2 = field(default_factory=gtsam.ISAM2)
    gate: LoopClosureGate = field(default_factory=LoopClosureGate)
    radii: Radii | None = None
    _offers: list[Offer] = field(default_factory=list, init=False)
    _kept: KeptMap = field(default_factory=KeptMap, init=False)

    def __post_init__(self) -> None:
        if isinstance(self.smoother, gtsam.ISAM2Params):
            self.smoother = gtsam.ISAM2(self.smoother)
        if not isinstance(self.smoother, gtsam.ISAM2):
            raise InvalidOptionError(
                f"expected a gtsam.ISAM2 as the smoother, got {self.smoother!r}; radii have a name: GatedISAM2(radii=…)"
            )
        if not isinstance(self.gate, LoopClosureGate):
            raise InvalidOptionError(f"expected a LoopClosureGate as the gate, got {self.gate!r}")
        check_radii(self.radii)

    def state(self) -> State:
        """The whole state but gate and parameters, as JSON-ready text and numbers; raises as `saved.encoded` does."""
        return encoded(Parts(smoother=self.smoother, radii=self.radii, offers=self._offers, kept=self._kept))

    @classmethod
    def resumed(
        cls, state: State, parameters: gtsam.ISAM2Params | None = None, gate: LoopClosureGate | None = None
    ) -> GatedISAM2:
        """A gated smoother that continues from `state`.

        Parameters
        ----------
        state : dict
        parameters, gate
            As at the first start: parameters are not part of the state.

        Raises
        ------
        InvalidGraphError, PgtiError
            As of `saved.decoded` and of `LoopClosureGate.reference_map`.
        """
        gate = LoopClosureGate() if gate is None else gate
        parts = decoded(state, gtsam.ISAM2Params() if parameters is None else parameters, gate)
        found = cls(parts.smoother, gate, parts.radii)
        found._offers, found._kept = parts.offers, parts.kept
        return found

    def save(self, path: Path | str) -> None:
        """Write `state` to a file; a power failure leaves the old file or the new file."""
        outputs.write_text(path, json.dumps(self.state()))

    @classmethod
    def load(
        cls,
        path: Path | str,
        parameters: gtsam.ISAM2Params | None = None,
        gate: LoopClosureGate | None = None,
    ) -> GatedISAM2:
        """Read the file of `save`; see `resumed`.

        Parameters
        ----------
        path : Path or str
        parameters, gate
            As for `resumed`.
        """
        return cls.resumed(read_state(Path(path)), parameters, gate)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.smoother, name)

    def update(
        self,
        factors: gtsam.NonlinearFactorGraph | None = None,
        values: gtsam.Values | None = None,
        closures: Sequence[Closure] = (),
        *,
        radii: Mapping[int, float] | None = None,
        **options: Any,
    ) -> GatedUpdate:
        """Add factors and values as `gtsam.ISAM2.update` does, and the closures that pass together.

        Parameters
        ----------
        factors, values : optional
            New factors, not gated, and first values of the new variables.
        closures : sequence of gtsam.NonlinearFactorGraph, factors or lists of factors
            Each holds the factors of a closure, which pass or fail together.
        radii : mapping from key to float, m, optional
            Radii of new keyframes.
        **options
            Other arguments of `gtsam.ISAM2.update`, by GTSAM's names.

        Raises
        ------
        InvalidClosureError, PgtiError
            As of `LoopClosureGate.evaluate`; a new factor or value that does not belong. Nothing has changed then.
        UnsolvableGraphError
            A step that iSAM2 fails in. The smoother was made anew, with the state before.
        """
        # what comes in
        values = gtsam.Values() if values is None else values
        factors = gtsam.NonlinearFactorGraph() if factors is None else factors
        check_map(factors, values)
        if factors.nrFactors() < factors.size():
            factors = graph_of(factors_of(factors))
        news = News(self.smoother, factors, values, self._grown_radii(radii))
        check_news(news)
        if closures:
            return self._updated_with(closures, news, options)

        # one step of the smoother, and nothing to judge
        result = self._step(factors, values, options)
        self.radii = news.radii
        self._kept.note(factors, values)
        if options:
            self._kept.forget()
        return GatedUpdate(factor_slots=tuple(result.getNewFactorsIndices()), result=result)

    def _updated_with(self, closures: Sequence[Closure], news: News, options: Mapping[str, Any]) -> GatedUpdate:
        """An update with closures: of the new and the waiting, those that pass together."""
        # judge the closures, and those that wait again
        offered = closure_graphs(closures)
        waiting = {number: offer.closure for number, offer in enumerate(self._offers) if offer.is_waiting}
        judged = self._kept.judged(self.gate, news, waiting, offered)
        changed = {number: decision for number, decision in judged.waiting.items() if decision.verdict != "undecided"}

        # one step of the smoother with those that passed
        numbers = range(len(self._offers), len(self._offers) + len(offered))
        closure_of = waiting | dict(zip(numbers, offered, strict=True))
        verdicts = changed | dict(zip(numbers, judged.decisions, strict=True))
        passed = [number for number, decision in verdicts.items() if decision.accepted]
        graphs = [news.factors, *(closure_of[number] for number in passed)]
        result = self._step(joined(*graphs), news.values, options)
        slots = iter(result.getNewFactorsIndices())
        factor_slots, *own = (tuple(islice(slots, graph.size())) for graph in graphs)

        # remember where they stand, and the map
        slots_of = dict(zip(passed, own, strict=True))
        self._offers += [Offer(closure) for closure in offered]
        for number, decision in verdicts.items():
            self._offers[number] = Offer(
                closure_of[number], slots_of.get(number, ()), is_waiting=decision.verdict == "undecided"
            )
        self.radii = news.radii
        self._kept.keep(None if options else judged.map, self.smoother)
        return GatedUpdate(
            decisions=judged.decisions,
            closures=tuple(numbers),
            slots=tuple(slots_of.get(number, ()) for number in numbers),
            factor_slots=factor_slots,
            changed=changed,
            result=result,
        )

    def estimate(self) -> gtsam.Values:
        """The smoother's estimate."""
        return self.smoother.calculateEstimate()

    @property
    def admitted(self) -> dict[int, tuple[int, ...]]:
        """Slots of the closures that are in, by number."""
        return {number: offer.slots for number, offer in enumerate(self._offers) if offer.slots}

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
        decisions: dict[int, ClosureDecision] = {}
        for revisit in self._revisits():
            if set(revisit).isdisjoint(asked):
                continue
            decisions |= dict(zip(revisit, self._without(revisit).decisions, strict=True))
        return self._review(decisions)

    def review_afresh(self) -> Review:
        """Judge all closures offered so far once more, as a whole.

        Where a wrong closure was admitted early and has shut out right ones elsewhere, no review of one
        revisit at a time can tell. Changes nothing.
        """
        estimate, graph, ends = self.estimate(), self._factors_without(range(len(self._offers))), self._ends()
        closures = [self._offers[number].closure for number in ends]
        judged = self.gate.evaluate_group(graph, estimate, closures, self.radii)
        return self._review(dict(zip(ends, judged.decisions, strict=True)))

    def _review(self, decisions: Mapping[int, ClosureDecision]) -> Review:
        inside = self.admitted
        return Review(
            decisions=decisions,
            condemned=tuple(n for n, d in sorted(decisions.items()) if n in inside and not d.accepted),
            redeemed=tuple(n for n, d in sorted(decisions.items()) if n not in inside and d.accepted),
        )

    def revise(self, review: Review) -> None:
        """Take out the closures that a review condemns and admit those that the review redeems, in a step.

        Raises
        ------
        InvalidClosureError
            Closures came or went since the review was made.
        """
        if not isinstance(review, Review):
            raise InvalidOptionError(f"expected what review() returned, got {shown(review)}")
        self._replace(review.condemned, review.redeemed)

    def _grown_radii(self, radii: Mapping[int, float] | None) -> Radii | None:
        if radii is None:
            return self.radii
        if not isinstance(self.radii, Mapping | None):
            raise InvalidOptionError(f"expected no radii of single keyframes, since all have {self.radii} m, got some")
        return {**(self.radii or {}), **radii}

    def _step(
        self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, options: Mapping[str, Any]
    ) -> gtsam.ISAM2Result:
        """A step of the smoother; a failed step makes the smoother anew."""
        size = self.smoother.getFactorsUnsafe().size()
        try:
            return self.smoother.update(factors, values, **options)
        except (RuntimeError, IndexError) as error:
            self.smoother = made_anew(self.smoother, size, set(values.keys()))
            self._kept.forget()
            raise UnsolvableGraphError(
                f"expected an update that iSAM2 can take, got: {in_a_line(error)}; the smoother was made anew with "
                "the factors from before"
            ) from error

    def _replace(self, leaving: Sequence[int], entering: Sequence[int]) -> None:
        for number in leaving:
            self._check_in(number)
        for number in entering:
            self._check_out(number)
        removed = [slot for number in leaving for slot in self._offers[number].slots]
        self._check_held(removed)
        added = [self._offers[number].closure for number in entering]
        result = self._step(joined(*added), gtsam.Values(), {"removeFactorIndices": removed})
        slots = iter(result.getNewFactorsIndices())
        for number in leaving:
            self._offers[number].slots = ()
        for number, closure in zip(entering, added, strict=True):
            self._offers[number] = Offer(closure, tuple(islice(slots, closure.size())))
        self._kept.forget()

    def _check_in(self, number: int) -> None:
        offer = self._offer(number)
        if not offer.slots:
            raise InvalidClosureError(f"expected the number of a closure that is in, got {number}, which is not")
        standing = offer.standing(self.smoother.getFactorsUnsafe())
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
        """Refuse to remove the last factors of a variable: iSAM2 would silently drop the variable."""
        graph = self.smoother.getFactorsUnsafe()
        held = {key for factor in factors_of(without(graph, removed)) for key in keys_of(factor)}
        free = next((key for slot in removed for key in keys_of(graph.at(slot)) if key not in held), None)
        if free is not None:
            raise InvalidClosureError(
                f"expected a closure that the map holds without, got one on which "
                f"{gtsam.DefaultKeyFormatter(free)} hangs alone"
            )

    def _revisits(self) -> list[list[int]]:
        """Numbers of the closures of every revisit with an admitted closure."""
        ends = self._ends()
        numbers = list(ends)
        pose_graph = self.gate.adapted(self.smoother.getFactorsUnsafe(), self.estimate(), self.radii)
        way = track_of(pose_graph).way_m / free_space_unit(pose_graph)
        groups = [[numbers[k] for k in group] for group in revisits(list(ends.values()), way)]
        return [group for group in groups if any(self._offers[number].slots for number in group)]

    def _ends(self) -> dict[int, tuple[int, int]]:
        """First and last keyframe of every closure on the track, by number."""
        place = read_keyframes(self.estimate()).index
        ends = {}
        for number, offer in enumerate(self._offers):
            places = [place[key] for factor in factors_of(offer.closure) for key in keys_of(factor) if key in place]
            if places:
                ends[number] = (min(places), max(places))
        return ends

    def _factors_without(self, closures: Iterable[int]) -> gtsam.NonlinearFactorGraph:
        graph = self.smoother.getFactorsUnsafe()
        return without(graph, [slot for number in closures for slot in self._offers[number].standing(graph)])

    def _without(self, revisit: Sequence[int]) -> Judgement:
        graph = self._factors_without(revisit)
        closures = [self._offers[number].closure for number in revisit]
        return self.gate.evaluate_group(graph, self.estimate(), closures, self.radii)
