"""Maps without damage, and seven ways to damage a map."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import joined
from scenarios.problem import between
from scenarios.worlds.solid import Array, Solid

NOTHING, DROPPED, FALSE, MANY_FALSE = "nothing", "revisit dropped", "false closure", "false closures"
DRIFT, ODOMETRY, BACK = "drift", "odometry only", "out and back"
DAMAGES = (NOTHING, DROPPED, FALSE, MANY_FALSE, DRIFT, ODOMETRY, BACK)

SCALE = "scale drift"
"""A drive whose odometry errs in its scale alone, as a single camera's does: of one way, in `kitti`."""

APART = 10.0
"""Least distance of the ends of a false closure, in radii."""

MOST_FALSE = 5
"""Where there are several: from two to this."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Intact:
    """A map with all its ties.

    Attributes
    ----------
    base : gtsam.NonlinearFactorGraph
        Odometry, and all else but closures.
    revisits : tuple of tuples of factors
        True closures, the closures of a second pass together.
    near : gtsam.Values
        From where the optimum is found: the truth.
    chained : gtsam.Values
        Odometry alone.
    radii : float, mapping from key to float, or None
        None where landmark factors give the radii.
    places : (n, 3) float
        True positions in the order of the keys, m.
    noise : gtsam.noiseModel.Base
        Of a closure.
    match : callable
        A pose that the identity is measured as.
    solid : Solid or None
        The surfaces that may hide places from each other; None where not known.
    """

    base: gtsam.NonlinearFactorGraph
    revisits: tuple[tuple[Any, ...], ...]
    near: gtsam.Values
    chained: gtsam.Values
    radii: float | Mapping[int, float] | None
    places: Array
    noise: gtsam.noiseModel.Base
    match: Callable[[np.random.Generator], Any]
    solid: Solid | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A map to diagnose.

    Attributes
    ----------
    graph, values, radii
        The input of `diagnose`.
    places, solid
        As in `Intact`.
    false_slots : tuple of int
        Where the false closures are in the graph.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    radii: float | Mapping[int, float] | None
    places: Array
    false_slots: tuple[int, ...] = ()
    solid: Solid | None = None


def damaged(intact: Intact, damage: str, random: np.random.Generator, keys: Sequence[int], unit_m: float) -> Case:
    """The map after one of `DAMAGES`, at its optimum; `drift` and `out and back` are made with the map.

    Parameters
    ----------
    keys : sequence of int
        Of the keyframes, in the order of `places`.
    unit_m : float
        Median radius.
    """
    kept = _kept(intact, damage, random)
    graph = joined(intact.base, *(_graph(factors) for factors in kept))
    if damage in (ODOMETRY, BACK):
        return _case(intact, graph, intact.chained)
    good = optimised(graph, intact.near)
    wanted = {FALSE: 1, MANY_FALSE: int(random.integers(2, MOST_FALSE + 1))}.get(damage, 0)
    if not wanted:
        return _case(intact, graph, good)
    false = [_false_closure(intact, random, keys, unit_m) for _ in range(wanted)]
    torn = joined(graph, _graph(false))
    return _case(intact, torn, optimised(torn, good), tuple(range(graph.size(), torn.size())))


def _kept(intact: Intact, damage: str, random: np.random.Generator) -> list[tuple[Any, ...]]:
    """Revisits whose closures stay."""
    n = len(intact.revisits)
    left = np.ones(n, dtype=bool)
    if damage in (ODOMETRY, BACK):
        left[:] = False
    elif damage == DROPPED and n:
        left[random.integers(n)] = False
    elif damage == DRIFT and n:
        left[random.choice(n, n - max(n // 3, 1), replace=False)] = False
    return [factors for factors, stays in zip(intact.revisits, left, strict=True) if stays]


def _false_closure(intact: Intact, random: np.random.Generator, keys: Sequence[int], unit_m: float) -> Any:
    """A closure that takes two distant keyframes for the same place."""
    for _ in range(10_000):
        i, j = np.sort(random.choice(len(keys), 2, replace=False))
        if np.linalg.norm(intact.places[i] - intact.places[j]) >= APART * unit_m:
            return between(keys[i], keys[j], intact.match(random), intact.noise)
    raise ValueError(f"expected a map with keyframes {APART * unit_m:.0f} m apart, found none; take a longer drive")


def _case(intact: Intact, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, false: tuple[int, ...] = ()) -> Case:
    return Case(
        graph=graph, values=values, radii=intact.radii, places=intact.places, false_slots=false, solid=intact.solid
    )


def _graph(factors: Sequence[Any]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    return graph
