"""The memory of a gated smoother: updates, and the closures that were offered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import gtsam

from pgti_gtsam.factor_graphs import factors_of
from pgti_gtsam.gate.decision import ClosureDecision


@dataclass(slots=True, kw_only=True, eq=False)
class GatedUpdate:
    """The result of an update. Not frozen: a frozen record costs an update without closures 0.4 µs more.

    Attributes
    ----------
    decisions : tuple of ClosureDecision
        A decision per closure, in the order given.
    closures : tuple of int
        Number of each closure, for `retract`: closures are counted from 0 in the order offered.
    slots : tuple of tuples of int
        Slots of the factors of each closure in the smoother; none for a closure outside.
    factor_slots : tuple of int
        Slots of the other factors, empty slots left out.
    changed : dict of int to ClosureDecision
        New verdicts on earlier closures that were undecided: by number, accepted or rejected by now.
    result : gtsam.ISAM2Result or gtsam.FixedLagSmootherResult
        The result of the smoother itself; a `GatedUpdate` has all its methods (`getNewFactorsIndices`, …).
    """

    decisions: tuple[ClosureDecision, ...] = ()
    closures: tuple[int, ...] = ()
    slots: tuple[tuple[int, ...], ...] = ()
    factor_slots: tuple[int, ...]
    changed: Mapping[int, ClosureDecision] = field(default_factory=dict)
    result: Any

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.result, name)

    @property
    def accepted(self) -> tuple[int, ...]:
        """Numbers of the closures that passed."""
        return tuple(n for n, decision in zip(self.closures, self.decisions, strict=True) if decision.accepted)

    @property
    def rejected(self) -> tuple[int, ...]:
        """Numbers of the closures that were kept out."""
        return tuple(n for n, decision in zip(self.closures, self.decisions, strict=True) if not decision.accepted)


class Step(NamedTuple):
    """The result of a step of a smoother.

    Attributes
    ----------
    result : gtsam.ISAM2Result or gtsam.FixedLagSmootherResult
    slots : list of tuple of int
        Slots in the map of each graph's factors.
    is_appended : bool
        Whether the map grew by the factors and changed in nothing else.
    """

    result: Any
    slots: Sequence[tuple[int, ...]]
    is_appended: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Review:
    """The verdicts on the closures offered so far by all later evidence.

    Attributes
    ----------
    decisions : dict of int to ClosureDecision
        By number, of every closure judged again.
    leaving : tuple of int
        Numbers of admitted closures that would now be rejected.
    entering : tuple of int
        Numbers of closures kept out that would now be accepted.
    """

    decisions: Mapping[int, ClosureDecision]
    leaving: tuple[int, ...]
    entering: tuple[int, ...]


@dataclass(slots=True)
class Offer:
    """A closure that was offered, and its slots if admitted."""

    closure: gtsam.NonlinearFactorGraph
    slots: tuple[int, ...] = ()

    def standing(self, graph: gtsam.NonlinearFactorGraph) -> list[int]:
        """Slots of a smoother's graph that hold the closure's own factors still.

        The factors themselves are compared, not their measurements: two robust noise models are never equal to GTSAM.
        """
        pairs = zip(self.slots, factors_of(self.closure), strict=False)
        return [slot for slot, factor in pairs if slot < graph.size() and graph.at(slot) is factor]


def made_anew(
    smoother: gtsam.ISAM2, size: int, came: gtsam.NonlinearFactorGraph, new: set[int], gone: Mapping[int, Any]
) -> gtsam.ISAM2:
    """A smoother of the factors and values that another smoother had before a step, in the same slots.

    Parameters
    ----------
    smoother : gtsam.ISAM2
        As the step left the smoother.
    size : int
        Number of slots before the step.
    came : gtsam.NonlinearFactorGraph
        New factors of the step: these may stand in slots that were empty before.
    new : set of int
        Keys of the step's new values.
    gone : mapping from int to factor
        Factors that the step took out, by slot.
    """
    values = gtsam.Values(smoother.getLinearizationPoint())
    for key in new & set(values.keys()):
        values.erase(key)
    graph, added = smoother.getFactorsUnsafe(), factors_of(came)
    slots = [None if any(factor is each for each in added) else factor for factor in map(graph.at, range(size))]
    for slot, factor in gone.items():
        slots[slot] = factor
    return smoother_of(slots, values, smoother.params())


def smoother_of(slots: Sequence[Any], values: gtsam.Values, parameters: gtsam.ISAM2Params) -> gtsam.ISAM2:
    """A smoother of given factors, each in its slot or None for an empty slot, linearised at given values.

    Closures that passed in turn may together be singular to rounding: the smoother factorises by QR then.

    Parameters
    ----------
    slots : sequence of object
        A factor or None for each slot.
    values : gtsam.Values
        Point of linearisation.
    parameters : gtsam.ISAM2Params
    """
    any_factor = next((factor for factor in slots if factor is not None), None)
    if any_factor is None:
        return gtsam.ISAM2(parameters)

    # something else stands in empty slots until these are emptied
    factors = gtsam.NonlinearFactorGraph()
    for factor in slots:
        factors.push_back(any_factor if factor is None else factor)
    found = gtsam.ISAM2(parameters)
    try:
        found.update(factors, values)
    except RuntimeError:
        asked = parameters.getFactorization()
        parameters.setFactorization("QR")
        found = gtsam.ISAM2(parameters)
        parameters.setFactorization(asked)
        found.update(factors, values)
    if empty := [slot for slot, factor in enumerate(slots) if factor is None]:
        found.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), removeFactorIndices=empty)
    return found
