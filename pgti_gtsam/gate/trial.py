"""A closure on trial: the map's factors with those of the closure, optimised on a copy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gtsam
import numpy as np
from scipy.sparse import coo_array, csgraph

from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.factor_graphs import BETWEEN, factors_of, joined, keys_of

MAX_ITERATIONS = 100
"""Levenberg-Marquardt steps of a map without a candidate, which may start far from its optimum."""

TRIAL_ITERATIONS = 12
"""Steps of a map with a candidate, from the optimum without it. A closure that is right settles in fewer than ten;
one that is wrong may go on tearing at the map for long, and is no less wrong where it is stopped."""


def optimised(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    *,
    held: gtsam.NonlinearFactorGraph | None = None,
    max_iterations: int = MAX_ITERATIONS,
    tolerance: float = 1e-5,
) -> gtsam.Values:
    """Optimum of a graph from given values, which stay untouched.

    Parameters
    ----------
    graph, values
    held : gtsam.NonlinearFactorGraph, optional
        Priors that hold it in place, where they are known: those of `anchors`.
    max_iterations : int
    tolerance : float
        Relative decrease of the error at which to stop; GTSAM's own default.

    Raises
    ------
    UnsolvableGraphError
        The graph is singular, or the error at the optimum is not finite.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(max_iterations)
    parameters.setRelativeErrorTol(tolerance)
    anchored = joined(graph, anchors(graph, values) if held is None else held)
    try:
        found = gtsam.LevenbergMarquardtOptimizer(anchored, values, parameters).optimize()
    except RuntimeError as error:
        raise UnsolvableGraphError(f"expected a factor graph with an optimum, got: {str(error).strip()}") from error
    if not np.isfinite(graph.error(found)):
        raise UnsolvableGraphError(f"expected a finite error at the optimum, got {graph.error(found)}")
    return found


def still_held(
    held: gtsam.NonlinearFactorGraph, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> gtsam.NonlinearFactorGraph:
    """Anchors of a graph that has grown by a closure, from those it had without: two may hold one component now."""
    return held if held.size() <= 1 else anchors(graph, values)


def anchors(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """A prior at its present value for the first pose of every component that no unary factor holds.

    Without one the optimum is free to move as a whole. The prior pulls at nothing: its residual stays zero.
    """
    factors = factors_of(graph)
    keys = sorted(values.keys())
    row = {key: i for i, key in enumerate(keys)}
    used = [[row[key] for key in keys_of(factor) if key in row] for factor in factors]
    links = np.array([(rows[0], other) for rows in used for other in rows[1:]], dtype=np.int64).reshape(-1, 2)
    shape = (len(keys), len(keys))
    _, component = csgraph.connected_components(coo_array((np.ones(len(links)), links.T), shape=shape))
    held = {component[rows[0]] for rows in used if len(rows) == 1}
    return _priors(keys, component.tolist(), held, values)


def _priors(
    keys: list[int], component: Iterable[int], held: set[int], values: gtsam.Values
) -> gtsam.NonlinearFactorGraph:
    planar, spatial = gtsam.utilities.allPose2s(values), gtsam.utilities.allPose3s(values)
    priors = gtsam.NonlinearFactorGraph()
    held = set(held)
    for key, part in zip(keys, component, strict=True):
        if part in held:
            continue
        if planar.exists(key):
            priors.push_back(gtsam.PriorFactorPose2(key, planar.atPose2(key), gtsam.noiseModel.Unit.Create(3)))
        elif spatial.exists(key):
            priors.push_back(gtsam.PriorFactorPose3(key, spatial.atPose3(key), gtsam.noiseModel.Unit.Create(6)))
        else:
            continue
        held.add(part)
    return priors


def translation_residual_m(factor: Any, values: gtsam.Values) -> float:
    """Distance between where a between factor measures its second pose and where the values have it."""
    at: Any = values.atPose2 if isinstance(factor, gtsam.BetweenFactorPose2) else values.atPose3
    first, second = keys_of(factor)
    found = at(first).between(at(second))
    return float(np.linalg.norm(found.translation() - factor.measured().translation()))


def largest_strain_m(factors: Iterable[Any], values: gtsam.Values) -> float:
    """Largest `translation_residual_m` of the between factors among these; zero without one."""
    return max((translation_residual_m(f, values) for f in factors if isinstance(f, BETWEEN)), default=0.0)
