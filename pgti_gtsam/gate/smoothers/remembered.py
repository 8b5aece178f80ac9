"""The whole map of a fixed-lag smoother, which itself holds a window of the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import Any

import gtsam

from pgti_gtsam.checks import in_a_line
from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.factor_graphs import factors_of, keys_of, slots_of, without
from pgti_gtsam.gate.smoothers.saved import State, graph_from, placed, placed_in, values_from


@dataclass(slots=True, eq=False)
class Remembered:
    """All factors given to a fixed-lag smoother, and the last estimate of each variable that left the window.

    The methods bear the names of `gtsam.ISAM2`.

    Parameters
    ----------
    smoother : gtsam.IncrementalFixedLagSmoother or gtsam.BatchFixedLagSmoother
    """

    smoother: Any
    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph, init=False)
    behind: gtsam.Values = field(default_factory=gtsam.Values, init=False)
    beyond: set[int] = field(default_factory=set, init=False)  # slots of factors that the smoother never had
    times: dict[int, float] = field(default_factory=dict, init=False)  # of the variables in the window
    _newest: float = field(default=-float("inf"), init=False)
    _queue: list[tuple[float, int]] = field(default_factory=list, init=False)  # times, and those from before too

    def __post_init__(self) -> None:
        self.graph.push_back(self.smoother.getFactors())
        self.follow(self.smoother)

    def follow(self, smoother: Any) -> None:
        """Go on with another smoother of the same window."""
        self.smoother, self.times = smoother, dict(smoother.timestamps())
        self._newest = max(self.times.values(), default=-float("inf"))
        self._queue = [(time, key) for key, time in self.times.items()]
        heapify(self._queue)

    def state(self) -> State:
        """The smoother and what is remembered beyond the graph; raises as `saved.archive_of` does."""
        (own,), apart = placed([self.smoother.getFactors()], self.graph)  # marginalisation makes factors of its own
        return {
            "kind": type(self.smoother).__name__,
            "lag": self.smoother.smootherLag(),
            "factors": own,
            "factors_apart": apart,
            "values": self.smoother.getLinearizationPoint().serialize(),
            "times": [[key, time] for key, time in self.times.items()],
            "behind": self.behind.serialize(),
            "beyond": sorted(self.beyond),
        }

    @classmethod
    def resumed(cls, state: State, graph: gtsam.NonlinearFactorGraph, parameters: Any | None) -> Remembered:
        """What `state` tells, with a smoother made anew.

        Parameters
        ----------
        state : dict
        graph : gtsam.NonlinearFactorGraph
            Of the whole map.
        parameters : gtsam.ISAM2Params or gtsam.LevenbergMarquardtParams, optional
            Of the smoother.

        Raises
        ------
        UnsolvableGraphError
            With these parameters the smoother has no optimum of its window.
        """
        smoother = getattr(gtsam, state["kind"])(state["lag"], *([] if parameters is None else [parameters]))
        factors = placed_in(state["factors"], graph, graph_from(state["factors_apart"]))
        try:
            smoother.update(factors, values_from(state["values"]), dict(state["times"]))
        except RuntimeError as error:
            raise UnsolvableGraphError(
                f"expected a window that the smoother can take, got: {in_a_line(error)}; give the parameters of the "
                "first start"
            ) from error
        found = cls(smoother)
        found.graph, found.behind, found.beyond = graph, values_from(state["behind"]), set(state["beyond"])
        return found

    def valueExists(self, key: int) -> bool:
        """Whether the map has a variable, in the window or behind it."""
        return self.has_in_window(key) or bool(self.behind.exists(key))

    def has_in_window(self, key: int) -> bool:
        """Whether the smoother still has a variable."""
        return bool(self.smoother.getLinearizationPoint().exists(key))

    def getFactorsUnsafe(self) -> gtsam.NonlinearFactorGraph:
        """All factors that were given and not taken out."""
        return self.graph

    def calculateEstimate(self) -> gtsam.Values:
        """The estimate of all variables; behind the window the last estimate."""
        values = gtsam.Values(self.behind)
        values.insert(self.smoother.calculateEstimate())
        return values

    def leaving(self, values: gtsam.Values, timestamps: Mapping[int, float]) -> gtsam.Values:
        """The variables that leave the window in the next step, with their estimates before the step.

        Parameters
        ----------
        values : gtsam.Values
            First values of new variables.
        timestamps : mapping from key to float
            Of new and of earlier variables.
        """
        # the times by then
        self.times |= timestamps
        for key, time in timestamps.items():
            heappush(self._queue, (time, key))
            self._newest = max(self._newest, time)

        # what is older than the lag; a variable that was seen again has an old time in the queue too
        due: set[int] = set()
        while self._queue and self._queue[0][0] < self._newest - self.smoother.smootherLag():
            time, key = heappop(self._queue)
            if self.times.get(key) == time:
                due.add(key)
                del self.times[key]
        left = values.extract([key for key in due if values.exists(key)])
        left.insert(self.smoother.calculateEstimate([key for key in due if not values.exists(key)]))
        return left

    def took(
        self, graphs: Sequence[gtsam.NonlinearFactorGraph], left: gtsam.Values, new: gtsam.Values
    ) -> list[tuple[int, ...]]:
        """Note the factors that a step brought, and the variables that left the window.

        Parameters
        ----------
        graphs : sequence of gtsam.NonlinearFactorGraph
        left : gtsam.Values
            As `leaving` found them.
        new : gtsam.Values
            First values of new variables.

        Returns
        -------
        list of tuple of int
            Slots of each graph's factors.
        """
        slots = []
        for graph in graphs:
            own = range(self.graph.size(), self.graph.size() + graph.size())
            slots.append(tuple(own))
            if self.keys_behind(graph, new):
                self.beyond.update(own)
            self.graph.push_back(graph)
        self.behind.insert(left)
        return slots

    def forgot(self, factors: Sequence[Any]) -> None:
        """Note that some factors were taken out."""
        self.graph = without(self.graph, [slot for slot, own in slots_of(self.graph) if any(own is f for f in factors)])

    def keys_behind(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> list[int]:
        """Variables of some factors that neither the window nor new values have.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
        values : gtsam.Values
            First values of new variables.
        """
        keys = {key for factor in factors_of(graph) for key in keys_of(factor)}
        return sorted(key for key in keys if not values.exists(key) and not self.has_in_window(key))
