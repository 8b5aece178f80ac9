"""Fixed-lag smoothers behind the gate: closures within the window reach the smoother when they pass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import gtsam

from pgti_gtsam.checks import in_a_line
from pgti_gtsam.errors import InvalidClosureError, InvalidOptionError, MissingValueError, UnsolvableGraphError
from pgti_gtsam.factor_graphs import Closure, factors_of, graph_of, joined, slots_of
from pgti_gtsam.gate.decision import ClosureDecision
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.smoothers.gated import GatedSmoother
from pgti_gtsam.gate.smoothers.history import GatedUpdate, Offer, Step
from pgti_gtsam.gate.smoothers.kept_map import News, WholeMap, check_news
from pgti_gtsam.gate.smoothers.remembered import Remembered
from pgti_gtsam.gate.smoothers.saved import State, decoded, encoded
from pgti_gtsam.pose_graph import key_label

KINDS = (gtsam.IncrementalFixedLagSmoother, gtsam.BatchFixedLagSmoother)


@dataclass(slots=True)
class GatedFixedLagSmoother(GatedSmoother):
    """A fixed-lag smoother of GTSAM's with the gate in front of its loop closures.

    All other methods of the smoother (`calculateEstimatePose2`, `marginalCovariance`, `timestamps`, …) work here too.

    Parameters
    ----------
    smoother : gtsam.IncrementalFixedLagSmoother or gtsam.BatchFixedLagSmoother
        To be updated through the gate alone from here on.
    gate : LoopClosureGate, optional
    radii : float or mapping from key to float, m, optional
        As in `from_gtsam`; a mapping grows by `radii=` of `update`.

    Notes
    -----
    The gate remembers all factors, and the last estimate of every variable that left the window: closures are judged
    by the whole track, and `estimate` covers the whole track.

    A closure that reaches a variable behind the window is judged like any other. If the closure passes, the gate goes
    on with the closure and the smoother without: the decision says so, and the closure has no slots.

    An admitted closure becomes part of the smoother's prior when a variable of the closure leaves the window. The
    closure is `absorbed` then: no smoother can take the closure out, and `retract` says so.

    A rejected closure never reaches the smoother. Where the smoother itself fails in the middle of a step, `smoother`
    is made anew, with the factors from before.
    """

    smoother: Any = field(default_factory=gtsam.IncrementalFixedLagSmoother)
    _remembered: Remembered = field(init=False)

    def _check_smoother(self) -> None:
        if not isinstance(self.smoother, KINDS):
            raise InvalidOptionError(
                f"expected a gtsam.IncrementalFixedLagSmoother or a gtsam.BatchFixedLagSmoother, got {self.smoother!r}"
            )
        self._remembered = Remembered(self.smoother)

    def update(
        self,
        factors: gtsam.NonlinearFactorGraph | None = None,
        values: gtsam.Values | None = None,
        timestamps: Mapping[int, float] | None = None,
        factorsToRemove: Sequence[int] = (),
        *,
        closures: Sequence[Closure] = (),
        radii: Mapping[int, float] | None = None,
    ) -> GatedUpdate:
        """Add factors and values as the smoother does, and the closures that pass together.

        Parameters
        ----------
        factors, values : optional
            New factors, not gated, and first values of the new variables.
        timestamps : mapping from key to float, optional
            Times of the new variables, and of earlier variables that are to stay longer.
        factorsToRemove : sequence of int
            Slots in `getFactors()`.
        closures : sequence of gtsam.NonlinearFactorGraph, factors or lists of factors
            Each holds the factors of a closure, which pass or fail together.
        radii : mapping from key to float, m, optional
            Radii of new keyframes.

        Returns
        -------
        GatedUpdate
            With slots of closures alone, in `getFactors()` after the step: the smoother tells no other slots.

        Raises
        ------
        InvalidClosureError, PgtiError
            As of `LoopClosureGate.evaluate`; a new factor, value or time that does not belong. Nothing has changed
            then.
        UnsolvableGraphError
            A step that the smoother fails in. The smoother was made anew, with the state before.
        """
        options = {"timestamps": dict(timestamps or {}), "factorsToRemove": list(factorsToRemove)}
        update = self._updated(factors, values, closures, radii, options)
        told = {n: self._told(n, decision) for n, decision in zip(update.closures, update.decisions, strict=True)}
        changed = {n: self._told(n, decision) for n, decision in update.changed.items()}
        return replace(update, decisions=tuple(told.values()), changed=changed, factor_slots=())

    def state(self) -> State:
        """The whole state but gate and parameters, as JSON-ready text and numbers; raises as `saved.encoded` does."""
        return encoded(self._parts, self._remembered.state())

    @classmethod
    def resumed(cls, state: State, parameters: Any | None = None, gate: LoopClosureGate | None = None) -> Self:
        """A gated smoother that continues from `state`.

        Parameters
        ----------
        state : dict
        parameters : gtsam.ISAM2Params or gtsam.LevenbergMarquardtParams, optional
            Of the smoother, as at the first start: parameters are not part of the state.
        gate : LoopClosureGate, optional

        Raises
        ------
        InvalidGraphError
            As of `saved.decoded`.
        """
        gate = LoopClosureGate() if gate is None else gate
        parts = decoded(state, [kind.__name__ for kind in KINDS])
        remembered = Remembered.resumed(state["smoother"], parts.graph, parameters)
        found = cls(remembered.smoother, gate, parts.radii)
        found._offers, found._waiting, found._kept = parts.offers, parts.waiting, parts.kept
        found._remembered = remembered
        return found

    @property
    def absorbed(self) -> tuple[int, ...]:
        """Numbers of the closures that have become part of the smoother's prior."""
        inside = self._slots_of(self._offers)
        return tuple(n for n, offer in enumerate(self._offers) if self._is_known(offer) and not inside[n])

    def _is_known(self, offer: Offer) -> bool:
        """Whether the smoother was told of a closure."""
        return bool(offer.slots) and self._remembered.beyond.isdisjoint(offer.slots)

    @property
    def _map(self) -> WholeMap:
        return self._remembered

    def _check_news(self, news: News, options: Mapping[str, Any]) -> None:
        check_news(news)
        behind = self._remembered.keys_behind(news.factors, news.values)
        if behind:
            raise MissingValueError(
                f"expected factors between variables of the window, got one of {key_label(behind[0])}, which has left "
                "it; offer it as a closure if it is one"
            )
        timed = options.get("timestamps", {})
        lost = next((k for k in timed if not news.values.exists(k) and not self._remembered.has_in_window(k)), None)
        if lost is not None:
            raise MissingValueError(
                f"expected times of variables of the window and of new ones, got one of {key_label(lost)}; add its "
                "value or leave it out"
            )

    def _slots_of(self, offers: Iterable[Offer]) -> list[tuple[int, ...]]:
        """Slots of the smoother that hold closures: none where a factor of the closure is missing."""
        standing = slots_of(self.smoother.getFactors())
        slots = {id(factor): slot for slot, factor in standing}
        found = ([slots.get(id(factor), -1) for factor in factors_of(offer.closure)] for offer in offers)
        return [tuple(own) if min(own) >= 0 else () for own in found]

    def _is_fixed(self, number: int) -> bool:
        offer = self._offers[number]
        return self._is_known(offer) and not self._slots_of([offer])[0]

    def _check_in(self, number: int) -> None:
        self._check_standing(number)
        if self._is_fixed(number):
            left = self._remembered.keys_behind(self._offers[number].closure, gtsam.Values())
            raise InvalidClosureError(
                f"expected a closure within the window, got closure {number}, of which {key_label(left[0])} has left: "
                "it is part of the smoother's prior, and cannot be taken out"
            )

    def _step(
        self,
        graphs: Sequence[gtsam.NonlinearFactorGraph],
        values: gtsam.Values,
        options: Mapping[str, Any],
        removed: Sequence[int] = (),
    ) -> Step:
        """A step of the smoother with all factors inside the window; a failed step makes the smoother anew."""
        # the smoother's part of the step
        remembered, timestamps = self._remembered, options.get("timestamps", {})
        gone = [remembered.graph.at(slot) for slot in removed]
        gone += [self.smoother.getFactors().at(slot) for slot in options.get("factorsToRemove", ())]
        inside = [graph for graph in graphs if not remembered.keys_behind(graph, values)]
        slots = self._slots_with(gone) if gone else []

        # the step
        times, left = dict(remembered.times), remembered.leaving(values, timestamps)
        try:
            result = self.smoother.update(joined(*inside), values, timestamps, slots)
        except (RuntimeError, IndexError) as error:
            self._make_anew(joined(*inside), values, gone, times)
            raise UnsolvableGraphError(
                f"expected an update that the smoother can take, got: {in_a_line(error)}; it was made anew with the "
                "factors from before"
            ) from error
        if gone:
            remembered.forgot(gone)
        return Step(result=result, slots=remembered.took(graphs, left, values), is_appended=not gone)

    def _slots_with(self, factors: Sequence[Any]) -> list[int]:
        """Slots of the smoother that hold some factors."""
        return [slot for slot, own in slots_of(self.smoother.getFactors()) if any(own is factor for factor in factors)]

    def _make_anew(
        self, new: gtsam.NonlinearFactorGraph, values: gtsam.Values, gone: Sequence[Any], times: Mapping[int, float]
    ) -> None:
        """Replace a smoother that failed by a smoother of its factors and values before that step."""
        added = factors_of(new)
        factors = [own for own in factors_of(self.smoother.getFactors()) if not any(own is other for other in added)]
        factors += [own for own in gone if not any(own is other for other in factors)]
        before = gtsam.Values(self.smoother.getLinearizationPoint())
        for key in values.keys():  # noqa: SIM118, which Values is no dict for
            if before.exists(key):
                before.erase(key)
        self.smoother = type(self.smoother)(self.smoother.smootherLag(), self.smoother.params())
        self.smoother.update(graph_of(factors), before, dict(times))
        self._remembered.follow(self.smoother)
        self._kept.forget()

    def _told(self, number: int, decision: ClosureDecision) -> ClosureDecision:
        """A decision that says whether the smoother goes on without the closure."""
        offer = self._offers[number]
        if not offer.slots or self._is_known(offer):
            return decision
        left = self._remembered.keys_behind(offer.closure, gtsam.Values())
        sentence = f"{key_label(left[0])} has left the window: the gate goes on with the closure, the smoother without."
        return replace(decision, reasons=(*decision.reasons, sentence))
