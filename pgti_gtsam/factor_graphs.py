"""GTSAM graphs as containers of factors: joined, thinned out, and checked where a closure comes in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import gtsam
import numpy as np

from pgti_gtsam.errors import InvalidClosureError, InvalidGraphError

Closure: TypeAlias = gtsam.NonlinearFactor | Sequence[gtsam.NonlinearFactor] | gtsam.NonlinearFactorGraph
"""Factors that stand or fall together, as a caller may give them."""

BETWEEN = (gtsam.BetweenFactorPose2, gtsam.BetweenFactorPose3)


def joined(*graphs: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """New graph of the same factors, slot behind slot.

    The factors are shared, not cloned: smart factors cannot be cloned, and no factor is changed here.
    """
    together = gtsam.NonlinearFactorGraph()
    for graph in graphs:
        together.push_back(graph)
    return together


def graph_of(factors: Iterable[Any]) -> gtsam.NonlinearFactorGraph:
    """New graph of the same factors, without empty slots."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        if factor is not None:
            graph.push_back(factor)
    return graph


def slots_of(graph: gtsam.NonlinearFactorGraph) -> list[tuple[int, Any]]:
    """Slots and factors of a graph, empty slots left out."""
    return [(slot, factor) for slot in range(graph.size()) if (factor := graph.at(slot)) is not None]


def factors_of(graph: gtsam.NonlinearFactorGraph) -> list[Any]:
    """Factors of a graph, empty slots left out."""
    return [factor for _, factor in slots_of(graph)]


def without(graph: gtsam.NonlinearFactorGraph, slots: Iterable[int]) -> gtsam.NonlinearFactorGraph:
    """The same factors in the same slots; the given slots are empty.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    slots : iterable of int
        Slots to empty.
    """
    fewer = gtsam.NonlinearFactorGraph(graph)
    for slot in slots:
        fewer.remove(slot)
    return fewer


def keys_of(factor: Any) -> list[int]:
    """Keys of a factor."""
    return list(factor.keys())


def between_factor(first: int, second: int, measured: gtsam.Pose2 | gtsam.Pose3, model: Any) -> Any:
    """The between factor of a relative pose of either type.

    Parameters
    ----------
    first, second : int
        Keys.
    measured : gtsam.Pose2 or gtsam.Pose3
        The second pose seen from the first.
    model : gtsam.noiseModel.Base
    """
    make: Any = gtsam.BetweenFactorPose2 if isinstance(measured, gtsam.Pose2) else gtsam.BetweenFactorPose3
    return make(first, second, measured, model)


def measured_from(factor: Any, first: int) -> Any | None:
    """Relative pose that a factor of two keys measures from its key `first` to the other key.

    Parameters
    ----------
    factor : gtsam.NonlinearFactor
        A factor of two keys.
    first : int
        The key from which the pose is seen.

    Returns
    -------
    gtsam.Pose2, gtsam.Pose3 or None
        None where the factor measures no pose of these two types.
    """
    if not isinstance(factor, BETWEEN):
        return None
    measured = factor.measured()
    return measured if keys_of(factor)[0] == first else measured.inverse()


def closure_graph(closure: Closure) -> gtsam.NonlinearFactorGraph:
    """A closure in any of its forms as a new graph, without empty slots.

    Parameters
    ----------
    closure : gtsam.NonlinearFactor, sequence of gtsam.NonlinearFactor, or gtsam.NonlinearFactorGraph

    Raises
    ------
    InvalidClosureError
        Another type, or no factor at all.
    """
    if closure is None:
        raise InvalidClosureError("expected a closure, got None, which is an empty slot of a graph; leave it out")
    if isinstance(closure, gtsam.NonlinearFactorGraph):
        factors = factors_of(closure)
    elif isinstance(closure, Sequence) and not isinstance(closure, str):
        factors = [factor for factor in closure if factor is not None]
    else:
        factors = [closure]
    for factor in factors:
        if not isinstance(factor, gtsam.NonlinearFactor):
            raise InvalidClosureError(
                "expected a closure as a factor, a list of factors or a gtsam.NonlinearFactorGraph, "
                f"got {_article(factor)}" + _hint(factor)
            )
    if not factors:
        raise InvalidClosureError("expected a closure of at least one factor, got none; leave it out")
    return graph_of(factors)


def closure_graphs(closures: Sequence[Closure]) -> list[gtsam.NonlinearFactorGraph]:
    """Several closures, each as `closure_graph` has it.

    Raises
    ------
    InvalidClosureError
        As of `closure_graph`, and a single closure where a list belongs.
    """
    if isinstance(closures, gtsam.NonlinearFactorGraph | gtsam.NonlinearFactor | str) or not hasattr(
        closures, "__iter__"
    ):
        raise InvalidClosureError(f"expected a list of closures, got {_article(closures)}; put it into a list")
    return [closure_graph(closure) for closure in closures]


def checked_closure(closure: Closure, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """The closure as a graph, if it can be tried on the map.

    Parameters
    ----------
    closure
        As in `closure_graph`.
    values : gtsam.Values
        The map's.

    Raises
    ------
    InvalidClosureError
        As of `closure_graph`; a key without a value; a value of another type than the factor asks for; a
        measurement that is not finite.
    """
    checked = closure_graph(closure)
    for factor in factors_of(checked):
        missing = [key for key in keys_of(factor) if not values.exists(key)]
        if missing:
            raise InvalidClosureError(
                f"expected a closure between keys of the map, got {_named(factor)}, of which "
                f"{gtsam.DefaultKeyFormatter(missing[0])} has no value; add the keyframe first"
            )
        error = _error(factor, values)
        if not np.isfinite(error):
            raise InvalidClosureError(
                f"expected a closure with finite measurements, got {_named(factor)} with error {error}"
            )
    return checked


def check_map(graph: Any, values: Any) -> None:
    """Refuse anything but a factor graph with values.

    Parameters
    ----------
    graph : object
    values : object

    Raises
    ------
    InvalidGraphError
    """
    if not isinstance(graph, gtsam.NonlinearFactorGraph):
        raise InvalidGraphError(f"expected a gtsam.NonlinearFactorGraph as the graph, got {_article(graph)}")
    if not isinstance(values, gtsam.Values):
        raise InvalidGraphError(f"expected gtsam.Values as the values, got {_article(values)}")


def _error(factor: Any, values: gtsam.Values) -> float:
    """Error of a factor at given values, which must be of the types that the factor asks for."""
    try:
        return float(factor.error(values))
    except (RuntimeError, ValueError) as error:
        found = ", ".join(f"{gtsam.DefaultKeyFormatter(key)} a {_type_at(values, key)}" for key in keys_of(factor))
        raise InvalidClosureError(
            f"expected a closure of factors that fit the map's values, got {_named(factor)}; of the values, {found}"
        ) from error


def _type_at(values: gtsam.Values, key: int) -> str:
    for name in ("Pose2", "Pose3"):
        try:
            getattr(values, f"at{name}")(key)
        except RuntimeError:  # GTSAM has no other way to ask for a value's type
            continue
        return name
    return f"value of dimension {values.dims()[key]}"


def _named(factor: Any) -> str:
    keys = ", ".join(gtsam.DefaultKeyFormatter(key) for key in keys_of(factor))
    return f"{type(factor).__name__} of {keys}"


def _article(found: Any) -> str:
    return f"{found!r}" if isinstance(found, int | float | str) else f"an object of type {type(found).__name__}"


def _hint(found: Any) -> str:
    nested = isinstance(found, gtsam.NonlinearFactorGraph | Sequence) and not isinstance(found, str)
    return " in a list; several closures are for evaluate_many, evaluate_group or gate_graph" if nested else ""
