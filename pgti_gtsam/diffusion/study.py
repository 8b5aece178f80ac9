"""The full heat study of a graph: block Laplacian, flow, optimisers, spreading, proxy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.checks import pairs, real, whole
from pgti_gtsam.diffusion.block_laplacian import (
    NormalEquations,
    normal_equations,
    row_defects,
    weight_asymmetry,
)
from pgti_gtsam.diffusion.flow import HeatFlow, extreme_eigenvalues, heat_flow
from pgti_gtsam.diffusion.grounding import Ground, components, grounded, grounded_graph, grounds
from pgti_gtsam.diffusion.jacobians import Equation11, equation_11
from pgti_gtsam.diffusion.linearisation import Linearisation, in_space, linearise, robust_weights
from pgti_gtsam.diffusion.optimisers import OPTIMISERS, gtsam_steps, matched_time, steady_state_error, updates
from pgti_gtsam.diffusion.proxy import Proxy, block_edges, compare
from pgti_gtsam.diffusion.spread import TRANSLATION, Spread, spread
from pgti_gtsam.errors import InvalidOptionError, UnsolvableGraphError
from pgti_gtsam.spectral.laplacian import laplacian

N_TIMES = 61
N_STEPS = 6
"""Iterations of each optimiser: Gauss-Newton has settled by then on every graph tried but one that it cannot
solve."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OptimiserRun:
    """An optimiser of GTSAM, and the flow nearest to its first step.

    Attributes
    ----------
    method : str
    energies : (k,) float
        The graph's error from the start on; empty where the optimiser found the graph singular.
    time, miss : float
        The time at which the linear flow is nearest to the first step, and the distance then, relative to the
        step; NaN likewise.
    """

    method: str
    energies: FloatArray
    time: float
    miss: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Study:
    """The result of `study`.

    Attributes
    ----------
    body : Linearisation
        In GTSAM's frame, without grounds.
    positions : (n, 3) float, m
    edges : (m, 2) int
        Keyframes that exchange heat.
    parts : int
        Connected parts.
    grounds : tuple of Ground
        Added grounds, one for each part that nothing fixed.
    robust : dict of int to float
        Weights of robust losses by slot.
    defects_body, defects_spatial : (n,) float
        `row_defects`, grounds not counted.
    asymmetry_body, asymmetry_spatial : float
        `weight_asymmetry`.
    equation_11 : Equation11
    flow : HeatFlow
        Of the grounded graph, body frame, from the values.
    times, energies : (n_times,) float
    movements : (n_times, n) float, m
        How far the flow has shifted every keyframe.
    slowest, fastest : float
        λ_min and λ_max.
    steady_state_error : float
        Against GTSAM's Gauss-Newton step.
    optimisers : tuple of OptimiserRun
    spread_body, spread_spatial, spread_scalar : Spread
        Of a shift of the middle keyframe.
    proxy_body, proxy_spatial : Proxy
    """

    body: Linearisation
    positions: FloatArray
    edges: NDArray[np.int64]
    parts: int
    grounds: tuple[Ground, ...]
    robust: dict[int, float]
    defects_body: FloatArray
    defects_spatial: FloatArray
    asymmetry_body: float
    asymmetry_spatial: float
    equation_11: Equation11
    flow: HeatFlow
    times: FloatArray
    energies: FloatArray
    movements: FloatArray
    slowest: float
    fastest: float
    steady_state_error: float
    optimisers: tuple[OptimiserRun, ...]
    spread_body: Spread
    spread_spatial: Spread
    spread_scalar: Spread
    proxy_body: Proxy
    proxy_spatial: Proxy

    @property
    def laplacian_defect_body(self) -> float:
        """Largest of `defects_body`."""
        return float(self.defects_body.max())

    @property
    def laplacian_defect_spatial(self) -> float:
        """Largest of `defects_spatial`; above rounding only where a factor ties its pose to the world."""
        return float(self.defects_spatial.max())


def study(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, stage: Callable[[str], None] = lambda _: None
) -> Study:
    """Examine a factor graph of poses as a conductor of heat. Graph and values stay untouched.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        All variables but poses are marginalised.
    values : gtsam.Values
    stage : callable, optional
        Called with the name of each step.

    Raises
    ------
    PgtiError
        As of `linearise`.
    """
    stage("linearising")
    body = linearise(graph, values)
    free = normal_equations(body), normal_equations(in_space(body))
    added = grounds(body)
    equations = normal_equations(grounded(body, added))

    # where the flow ends, and how fast
    stage("steady state")
    flow = heat_flow(equations)
    slowest, fastest = extreme_eigenvalues(equations)
    if not 0 < slowest <= fastest < np.inf:
        raise UnsolvableGraphError(
            f"expected rates of the heat flow above 0, got {slowest:.3g} to {fastest:.3g}: "
            "the factors' information is so far apart that rounding hides the slowest"
        )
    times = time_grid(slowest, fastest)

    # the flow, and what is compared with it
    stage("heat flow")
    states = flow.at(times)
    stage("optimisers")
    runs = _optimisers(graph, values, body, added, flow, times, states)
    stage("spreading from one keyframe")
    spreads = _spreads(free, times)
    stage("the scalar Laplacian as a proxy")
    proxies = compare(free[0]), compare(free[1])

    # all of it
    shifted = states.reshape(len(times), -1, body.dimension)
    return Study(
        body=body,
        positions=_positions(body, values),
        edges=block_edges(free[0].hessian, body.dimension),
        parts=int(components(free[0].hessian, body.dimension).max()) + 1,
        grounds=tuple(added),
        robust=robust_weights(graph, values),
        defects_body=row_defects(free[0]),
        defects_spatial=row_defects(free[1]),
        asymmetry_body=weight_asymmetry(free[0]),
        asymmetry_spatial=weight_asymmetry(free[1]),
        equation_11=equation_11(graph, values),
        flow=flow,
        times=times,
        energies=flow.energies(states),
        movements=np.linalg.norm(shifted[:, :, TRANSLATION[body.dimension]], axis=2),
        slowest=slowest,
        fastest=fastest,
        steady_state_error=steady_state_error(body, graph, values, added, flow.steady),
        optimisers=runs,
        spread_body=spreads[0],
        spread_spatial=spreads[1],
        spread_scalar=spreads[2],
        proxy_body=proxies[0],
        proxy_spatial=proxies[1],
    )


def time_grid(slowest: float, fastest: float) -> FloatArray:
    """Times from 0.01/λ_max, when nothing has moved, to 30/λ_min, when e^(−30) is left to move.

    Parameters
    ----------
    slowest, fastest : float
        λ_min and λ_max.

    Raises
    ------
    InvalidOptionError
        Rates that are not positive and finite, or not in this order.
    """
    if not 0 < real(slowest, "the slowest rate") <= real(fastest, "the fastest rate") < np.inf:
        raise InvalidOptionError(f"expected rates above 0, the slowest first, got {slowest:.3g} and {fastest:.3g}")
    return np.geomspace(0.01 / fastest, 30 / slowest, N_TIMES)


def _optimisers(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    body: Linearisation,
    added: list[Ground],
    flow: HeatFlow,
    times: FloatArray,
    states: FloatArray,
) -> tuple[OptimiserRun, ...]:
    held = grounded_graph(graph, values, added)
    path = np.append(times, np.inf), np.concatenate([states, flow.steady[None]])
    runs = []
    for method in OPTIMISERS:
        try:
            steps = gtsam_steps(held, values, method, N_STEPS)
        except UnsolvableGraphError:
            runs.append(OptimiserRun(method=method, energies=np.zeros(0), time=np.nan, miss=np.nan))
            continue
        time, miss = matched_time(*path, updates(body, values, steps[1].values).ravel())
        energies = np.array([step.energy for step in steps])
        runs.append(OptimiserRun(method=method, energies=energies, time=time, miss=miss))
    return tuple(runs)


def _spreads(free: tuple[NormalEquations, NormalEquations], times: FloatArray) -> tuple[Spread, Spread, Spread]:
    """From the middle keyframe: in the body frame, in the spatial frame on a clock of its own, and by the
    scalar Laplacian."""
    n = free[0].n_vertices
    scalar = scalar_equations(n, block_edges(free[0].hessian, free[0].dimension))
    found = []
    for equations in (*free, scalar):
        smallest, largest = _positive_ends(equations)
        found.append(spread(equations, n // 2, np.geomspace(0.01 / largest, 30 / smallest, len(times))))
    return found[0], found[1], found[2]


def scalar_equations(n_vertices: int, edges: NDArray[np.int64]) -> NormalEquations:
    """The unweighted Laplacian that PGTI takes, as normal equations without residuals.

    Parameters
    ----------
    n_vertices : int
    edges : (m, 2) int

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        No vertices, or edges between others.
    """
    whole(n_vertices, "the number of vertices", least=1)
    return NormalEquations(
        hessian=sparse.csr_array(laplacian(n_vertices, pairs(edges, n_vertices, "vertices"))),
        gradient=np.zeros(n_vertices),
        constant=0.0,
        dimension=1,
        frame="spatial",
    )


def _positive_ends(equations: NormalEquations) -> tuple[float, float]:
    """λ_max, and λ_min above zero, found by holding the first pose of every part."""
    labels = components(equations.hessian, equations.dimension)
    diagonal = equations.hessian.diagonal().reshape(-1, equations.dimension)
    added = np.zeros_like(diagonal)
    first = np.unique(labels, return_index=True)[1]
    added[first] = np.where(diagonal[first] > 0, diagonal[first], 1.0)
    held = replace(equations, hessian=sparse.csr_array(equations.hessian + sparse.diags_array(added.ravel())))
    smallest, largest = extreme_eigenvalues(held)
    return (smallest if smallest > 0 else largest), largest


def _positions(body: Linearisation, values: gtsam.Values) -> FloatArray:
    keyframes = read_keyframes(values)
    return keyframes.positions[[keyframes.index[int(key)] for key in body.keys]]
