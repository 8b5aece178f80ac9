"""The optimum of a factor graph, and whether an estimate is at the optimum, as scores of a map assume."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.sparse import coo_array, csgraph

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.factor_graphs import factors_of, joined, keys_of

_LOG = logging.getLogger(__name__)

MAX_ITERATIONS = 100
"""Levenberg-Marquardt steps of a map, which may start far from its optimum."""

FAR = 0.25
"""Step, in ρ, beyond which an estimate is no optimum: overlaps of spheres change with it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence:
    """How far a step of Levenberg-Marquardt leads from an estimate.

    Attributes
    ----------
    error, error_after : float
        ½ Σ ‖e‖² in the caller's noise models, at the estimate and after the step.
    step_m : float
        Largest distance that the step moves a keyframe by.
    keyframe : int
        Index of the keyframe that moves farthest.
    """

    error: float
    error_after: float
    step_m: float
    keyframe: int

    def is_optimum(self, unit_m: float) -> bool:
        """Whether no keyframe moves by more than `FAR` free radii of so many metres."""
        return self.step_m <= FAR * unit_m


def convergence(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Convergence:
    """Try a step. Graph and values stay untouched; parts without a prior are held where they are.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        An estimate of all variables.

    Raises
    ------
    UnsolvableGraphError
        The graph is singular at the estimate.
    """
    stepped = optimised(graph, values, max_iterations=1)
    steps = np.linalg.norm(read_keyframes(stepped).positions - read_keyframes(values).positions, axis=1)
    farthest = int(np.argmax(steps))
    return Convergence(
        error=float(graph.error(values)),
        error_after=float(graph.error(stepped)),
        step_m=float(steps[farthest]),
        keyframe=farthest,
    )


def optimised(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    *,
    priors: gtsam.NonlinearFactorGraph | None = None,
    max_iterations: int = MAX_ITERATIONS,
    tolerance: float = 1e-5,
) -> gtsam.Values:
    """Optimum of a graph from given values, which stay untouched.

    Parameters
    ----------
    graph, values
    priors : gtsam.NonlinearFactorGraph, optional
        Priors that fix the map in space, where known: those of `gauge_priors`.
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
    anchored = joined(graph, gauge_priors(graph, values) if priors is None else priors)
    try:
        found = gtsam.LevenbergMarquardtOptimizer(anchored, values, parameters).optimize()
    except RuntimeError as error:
        raise UnsolvableGraphError(f"expected a factor graph with an optimum, got: {str(error).strip()}") from error
    if not np.isfinite(graph.error(found)):
        raise UnsolvableGraphError(f"expected a finite error at the optimum, got {graph.error(found)}")
    _LOG.debug("%d variables optimised: error %.4g, now %.4g", values.size(), graph.error(values), graph.error(found))
    return found


def gauge_priors(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """A prior at its present value for the first pose of every component that no unary factor holds.

    Without a prior the optimum is free to move as a whole. The prior pulls at nothing: its residual stays zero.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        An estimate of all variables.
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
