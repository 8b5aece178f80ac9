"""iSAM2 behind the gate: closures reach the smoother only when they pass."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import gtsam

from pgti_gtsam.adapter.values import read_keyframes
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
from pgti_gtsam.gate.revisits import revisits
from pgti_gtsam.gate.ties import free_space_unit
from pgti_gtsam.pose_graph import Radii
from pgti_gtsam.track import track_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GatedUpdate:
    """What one update did.

    Attributes
    ----------
    decisions : tuple of ClosureDecision
        One per closure, in the order given.
    closures : tuple of int
        Number of each closure, for `GatedISAM2.retract`: closures are counted from 0 as they are offered.
    slots : tuple of tuples of int
        Slots of the factors of each closure in the smoother; none for a rejected one.
    factor_slots : tuple of int
        Slots of the other factors, empty ones left out.
    """

    decisions: tuple[ClosureDecision, ...]
    closures: tuple[int, ...]
    slots: tuple[tuple[int, ...], ...]
    factor_slots: tuple[int, ...]

    @property
    def accepted(self) -> tuple[int, ...]:
        """Numbers of the closures that were admitted."""
        return tuple(number for number, slots in zip(self.closures, self.slots, strict=True) if slots)

    @property
    def rejected(self) -> tuple[int, ...]:
        """Numbers of the closures that were kept out."""
        return tuple(number for number, slots in zip(self.closures, self.slots, strict=True) if not slots)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Review:
    """What the closures offered so far are worth by all that has been seen since.

    Attributes
    ----------
    decisions : dict of int to ClosureDecision
        By number, of every closure judged again.
    condemned : tuple of int
        Numbers of admitted closures that would now be rejected.
    redeemed : tuple of int
        Numbers of closures kept out that would now be accepted.
    """

    decisions: Mapping[int, ClosureDecision]
    condemned: tuple[int, ...]
    redeemed: tuple[int, ...]


@dataclass(slots=True)
class _Offer:
    """A closure that was offered, and where its factors stand if it is in."""

    closure: gtsam.NonlinearFactorGraph
    slots: tuple[int, ...] = ()

    def standing(self, graph: gtsam.NonlinearFactorGraph) -> list[int]:
        """Slots of a smoother's graph that hold the closure's own factors still.

        The factors themselves are compared and not what they measure: two robust noise models are never equal to GTSAM.
        """
        pairs = zip(self.slots, factors_of(self.closure), strict=False)
        return [slot for slot, factor in pairs if slot < graph.size() and graph.at(slot) is factor]


@dataclass(slots=True)
class GatedISAM2:
    """A `gtsam.ISAM2` with the gate in front of its loop closures.

    Parameters
    ----------
    smoother : gtsam.ISAM2, optional
        One that the caller owns; a new one when left out. The caller may go on using it, as long as
        it leaves the slots of admitted closures alone.
    gate : LoopClosureGate, optional
    radii : float or mapping from key to float, m, optional
        As in `from_gtsam`; a mapping grows by `radii=` of `update`.

    Notes
    -----
    A rejected closure never reaches the smoother, whose estimate is then bit for bit what it would be had
    the closure not come. Whatever may fail is tried beforehand: the gate works on a copy of the map, and a
    copy of the smoother rehearses the step. An exception leaves everything as before the call.
    """

    smoother: gtsam.ISAM2 = field(default_factory=gtsam.ISAM2)
    gate: LoopClosureGate = field(default_factory=LoopClosureGate)
    radii: Radii | None = None
    _offers: list[_Offer] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.smoother, gtsam.ISAM2):
            raise InvalidOptionError(
                f"expected a gtsam.ISAM2 as the smoother, got {self.smoother!r}; radii have a name: GatedISAM2(radii=…)"
            )
        if not isinstance(self.gate, LoopClosureGate):
            raise InvalidOptionError(f"expected a LoopClosureGate as the gate, got {self.gate!r}")

    def update(
        self,
        factors: gtsam.NonlinearFactorGraph | None = None,
        values: gtsam.Values | None = None,
        closures: Sequence[Closure] = (),
        *,
        radii: Mapping[int, float] | None = None,
    ) -> GatedUpdate:
        """Add factors and values as `gtsam.ISAM2.update` does, and of the closures those that pass together.

        Parameters
        ----------
        factors, values : optional
            New factors, not gated, and first values of the new variables.
        closures : sequence of gtsam.NonlinearFactorGraph, factors or lists of factors
            Each holds the factors of one closure, which stand or fall together.
        radii : mapping from key to float, m, optional
            Radii of new keyframes.

        Raises
        ------
        InvalidClosureError, UnsolvableGraphError, PgtiError
            Those of `LoopClosureGate.evaluate`, and an update that iSAM2 refuses. Nothing has changed then.
        """
        # judge the closures on a copy
        values = gtsam.Values() if values is None else values
        factors = gtsam.NonlinearFactorGraph() if factors is None else factors
        check_map(factors, values)
        factors, offered = graph_of(factors_of(factors)), closure_graphs(closures)
        grown = self._grown_radii(radii)
        group = self._judged(factors, values, offered, grown) if offered else None
        accepted = [offered[k] for k in group.accepted] if group else []

        # one step of the smoother with those that passed
        slots = self._step(joined(factors, *accepted), values, [])
        own, rest = slots[: factors.size()], slots[factors.size() :]

        # remember where they stand
        first = len(self._offers)
        self._offers += [_Offer(closure) for closure in offered]
        for k in group.accepted if group else ():
            self._offers[first + k].slots, rest = rest[: offered[k].size()], rest[offered[k].size() :]
        self.radii = grown
        numbers = range(first, len(self._offers))
        return GatedUpdate(
            decisions=group.decisions if group else (),
            closures=tuple(numbers),
            slots=tuple(self._offers[number].slots for number in numbers),
            factor_slots=own,
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
            No such closure is in; its slots hold other factors by now; or a variable hangs on it alone.
        """
        self._replace([closure], [])

    def review(self, closures: Collection[int] | None = None) -> Review:
        """Judge again every revisit of which a closure is in, by all that has been seen since.

        Parameters
        ----------
        closures : collection of int, optional
            Only the revisits that these belong to: those of the last update, say, when it rejected one.

        Returns
        -------
        Review

        Notes
        -----
        Each revisit is left out of the map and offered anew, those of its closures that were rejected
        included: leave-one-out for a closure that stands alone, and a fresh vote where several came one
        after another and the first ones had only themselves to agree with. Changes nothing: see `revise`.
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
        """Take out what a review condemns and admit what it redeems, in one step.

        Raises
        ------
        InvalidClosureError
            Closures came or went since the review was made.
        """
        self._replace(review.condemned, review.redeemed)

    def _judged(
        self,
        factors: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[gtsam.NonlinearFactorGraph],
        radii: Radii | None,
    ) -> Judgement:
        estimate = self.estimate()
        known = next(filter(estimate.exists, values.keys()), None)
        if known is not None:
            raise InvalidOptionError(
                f"expected values of new variables only, got one for {gtsam.DefaultKeyFormatter(known)}, which the "
                "smoother has; leave it out"
            )
        estimate.insert(values)
        return self.gate.evaluate_group(joined(self.smoother.getFactorsUnsafe(), factors), estimate, closures, radii)

    def _grown_radii(self, radii: Mapping[int, float] | None) -> Radii | None:
        if radii is None:
            return self.radii
        if not isinstance(self.radii, Mapping | None):
            raise InvalidOptionError(f"expected no radii of single keyframes, since all have {self.radii} m, got some")
        return {**(self.radii or {}), **radii}

    def _step(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, removed: list[int]) -> tuple[int, ...]:
        """One step of the smoother, rehearsed on a copy; returns the new factors' slots."""
        try:
            gtsam.ISAM2(self.smoother).update(factors, values, removed)
        except (RuntimeError, IndexError) as error:
            raise UnsolvableGraphError(
                f"expected an update that iSAM2 can take, got: {str(error).strip()}; nothing was changed"
            ) from error
        return tuple(self.smoother.update(factors, values, removed).getNewFactorsIndices())

    def _replace(self, leaving: Sequence[int], entering: Sequence[int]) -> None:
        for number in leaving:
            self._check_in(number)
        for number in entering:
            self._check_out(number)
        removed = [slot for number in leaving for slot in self._offers[number].slots]
        self._check_held(removed)
        added = [self._offers[number].closure for number in entering]
        slots = self._step(joined(*added), gtsam.Values(), removed)
        for number in leaving:
            self._offers[number].slots = ()
        for number, closure in zip(entering, added, strict=True):
            self._offers[number].slots, slots = slots[: closure.size()], slots[closure.size() :]

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

    def _offer(self, number: int) -> _Offer:
        if not 0 <= number < len(self._offers):
            raise InvalidClosureError(f"expected the number of one of {len(self._offers)} closures, got {number}")
        return self._offers[number]

    def _check_held(self, removed: Sequence[int]) -> None:
        """Refuse to remove the last factors of a variable, which iSAM2 would silently drop with them."""
        graph = self.smoother.getFactorsUnsafe()
        held = {key for factor in factors_of(without(graph, removed)) for key in keys_of(factor)}
        free = next((key for slot in removed for key in keys_of(graph.at(slot)) if key not in held), None)
        if free is not None:
            raise InvalidClosureError(
                f"expected a closure that the map holds without, got one on which "
                f"{gtsam.DefaultKeyFormatter(free)} hangs alone"
            )

    def _revisits(self) -> list[list[int]]:
        """Numbers of the closures of every revisit of which at least one is in."""
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
