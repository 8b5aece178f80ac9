"""GTSAM graphs as containers of factors: joined, thinned out, and checked where a closure comes in."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.errors import InvalidClosureError

BETWEEN = (gtsam.BetweenFactorPose2, gtsam.BetweenFactorPose3)


def joined(*graphs: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """New graph of the same factors, slot behind slot.

    The factors are shared, not cloned: those of smart landmarks cannot be, and none is changed here.
    """
    together = gtsam.NonlinearFactorGraph()
    for graph in graphs:
        together.push_back(graph)
    return together


def factors_of(graph: gtsam.NonlinearFactorGraph) -> list[Any]:
    """Factors of a graph, empty slots left out."""
    return [factor for factor in map(graph.at, range(graph.size())) if factor is not None]


def without(graph: gtsam.NonlinearFactorGraph, slots: Iterable[int]) -> gtsam.NonlinearFactorGraph:
    """The same factors in the same slots; the given slots are empty."""
    fewer = gtsam.NonlinearFactorGraph(graph)
    for slot in slots:
        fewer.remove(slot)
    return fewer


def checked_closure(closure: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """The closure, if it can be tried.

    Raises
    ------
    InvalidClosureError
        It holds no factor, or one that refers to a key without a value, measures something that is not
        finite, or has no finite error.
    """
    factors = factors_of(closure)
    if not factors:
        raise InvalidClosureError("expected a closure of at least one factor, got none; leave it out")
    for factor in factors:
        missing = [key for key in keys_of(factor) if not values.exists(key)]
        if missing:
            raise InvalidClosureError(
                f"expected a closure between keys of the map, got {_named(factor)}, of which "
                f"{gtsam.DefaultKeyFormatter(missing[0])} has no value; add the keyframe first"
            )
        if not np.isfinite(factor.error(values)):
            raise InvalidClosureError(
                f"expected a closure with finite measurements, got {_named(factor)} with error {factor.error(values)}"
            )
    return closure


def keys_of(factor: Any) -> list[int]:
    """Keys of a factor."""
    return list(factor.keys())


def _named(factor: Any) -> str:
    keys = ", ".join(gtsam.DefaultKeyFormatter(key) for key in keys_of(factor))
    return f"{type(factor).__name__} of {keys}"
