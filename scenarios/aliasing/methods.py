"""The gate and the methods it is compared with: each takes a problem and says which closures it believes.

All get the same graph, estimates, noise models and known inliers (prior and odometry), and run with the parameters that
their authors or GTSAM give as default. References: PCM: Mangelson et al., ICRA 2018; GNC: Yang et al., RA-L 2020; DCS:
Agarwal et al., ICRA 2013; largest edge error against 3 sigma: RTAB-Map, Labbé and Michaud, JFR 2019.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gtsam
import networkx as nx
import numpy as np
from numpy.typing import NDArray
from scipy import stats

import pgti_gtsam as pgti
from scenarios.problem import Problem, between

CONFIDENCE = 0.99
"""Of every χ² test."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """What a method made of a problem.

    Attributes
    ----------
    accepted : (n_closures,) bool
    confidence : (n_closures,) float
        The more, the more the method believes in a closure; only the order means anything.
    values : gtsam.Values
        In the end.
    seconds : float
        Processor time.
    """

    accepted: NDArray[np.bool_]
    confidence: NDArray[np.float64]
    values: gtsam.Values
    seconds: float


Answer = tuple[NDArray[np.bool_], NDArray[np.float64], gtsam.Values]


def solve(problem: Problem, method: str) -> Outcome:
    """Run a method of `METHODS`."""
    started = time.process_time()
    accepted, confidence, values = METHODS[method](problem)
    seconds = time.process_time() - started
    return Outcome(accepted=accepted, confidence=confidence, values=values, seconds=seconds)


def joined(problem: Problem, accepted: NDArray[np.bool_]) -> gtsam.NonlinearFactorGraph:
    """The map with some of its closures."""
    graph = gtsam.NonlinearFactorGraph(problem.graph)
    for closure, keep in zip(problem.closures, accepted, strict=True):
        if keep:
            graph.push_back(closure)
    return graph


def optimised(problem: Problem, accepted: NDArray[np.bool_]) -> gtsam.Values:
    """Its optimum, from odometry."""
    return gtsam.LevenbergMarquardtOptimizer(joined(problem, accepted), problem.values).optimize()


def _no_gate(problem: Problem) -> Answer:
    accepted = np.ones(len(problem.closures), dtype=bool)
    return accepted, np.zeros(len(accepted)), optimised(problem, accepted)


def _gate(problem: Problem, rule: str) -> Answer:
    graph = joined(problem, np.ones(len(problem.closures), dtype=bool))
    gate = pgti.LoopClosureGate(options=pgti.GateOptions(rule=rule))
    slots = range(problem.graph.size(), problem.graph.size() + len(problem.closures))
    result = pgti.gate_graph(graph, problem.values, radii=problem.radii, closures=slots, gate=gate)
    decisions = [result.decisions[slot] for slot in slots]
    accepted = np.array([decision.accepted for decision in decisions])
    if rule == "log_odds":
        return accepted, np.nan_to_num([decision.log_odds for decision in decisions]), result.values
    return accepted, -np.array([decision.terms[rule].value for decision in decisions]), result.values


def _chi_squared(problem: Problem) -> Answer:
    """In time order: the closure's error against its covariance given all before, by iSAM2."""
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")  # Cholesky loses a chain as stiff as that of MIT.g2o
    parameters.relinearizeSkip = 1
    parameters.setRelinearizeThreshold(0.01)
    isam = gtsam.ISAM2(parameters)
    isam.update(problem.graph, problem.values)
    accepted, squares = np.zeros(len(problem.closures), dtype=bool), np.zeros(len(problem.closures))
    values = isam.calculateBestEstimate()
    for k, closure in enumerate(problem.closures):
        factor = closure.at(0)
        i, j = factor.keys()
        spread = isam.jointMarginalCovariance([i, j])
        joint = np.block([[spread.at(a, b) for b in (i, j)] for a in (i, j)])
        jacobian, right = factor.linearize(values).jacobian()
        right, n = np.asarray(right), factor.dim()
        jacobian = jacobian.reshape(n, 2 * n)
        squares[k] = right @ np.linalg.solve(np.eye(n) + jacobian @ joint @ jacobian.T, right)
        if squares[k] <= stats.chi2.ppf(CONFIDENCE, n):
            accepted[k] = True
            isam.update(closure, gtsam.Values())
            values = isam.calculateBestEstimate()
    return accepted, -squares, optimised(problem, accepted)


def _largest_edge_error(problem: Problem) -> Answer:
    """In time order: rejected when after optimisation any edge misses by more than three sigma."""
    accepted, worst = np.zeros(len(problem.closures), dtype=bool), np.zeros(len(problem.closures))
    graph, values = gtsam.NonlinearFactorGraph(problem.graph), problem.values
    for k, closure in enumerate(problem.closures):
        attempt = gtsam.NonlinearFactorGraph(graph)
        attempt.push_back(closure)
        after = gtsam.LevenbergMarquardtOptimizer(attempt, values).optimize()
        worst[k] = max(np.abs(attempt.at(s).whitenedError(after)).max() for s in range(1, attempt.size()))
        if worst[k] <= 3:
            accepted[k] = True
            graph, values = attempt, after
    return accepted, -worst, values


def _pairwise_consistent(problem: Problem) -> Answer:
    """PCM: the largest set of closures of which any two agree with odometry."""
    pairs = _consistent(problem)
    clique, _ = nx.max_weight_clique(nx.from_numpy_array(pairs), weight=None)
    accepted = np.zeros(len(problem.closures), dtype=bool)
    accepted[clique] = True
    return accepted, pairs[:, clique].mean(axis=1), optimised(problem, accepted)


def _consistent(problem: Problem) -> NDArray[np.bool_]:
    poses = problem.poses(problem.values)
    steps = [problem.graph.at(s) for s in range(1, problem.graph.size())]
    sums = [np.zeros_like(poses[0].AdjointMap())]
    for pose, step in zip(poses[1:], steps, strict=True):
        adjoint = pose.AdjointMap()
        sums.append(sums[-1] + adjoint @ _covariance(step) @ adjoint.T)
    closures = [closure.at(0) for closure in problem.closures]
    n, limit = len(closures), stats.chi2.ppf(CONFIDENCE, len(sums[0]))
    agree = np.zeros((n, n), dtype=bool)
    for a in range(n):
        (i, j), first = closures[a].keys(), closures[a].measured()
        for b in range(a + 1, n):
            (k, m), second = closures[b].keys(), closures[b].measured()
            loop = poses[i].between(poses[k]).compose(second).compose(poses[m].between(poses[j]))
            error = first.logmap(loop)
            to_j, to_end = poses[j].inverse().AdjointMap(), poses[m].between(poses[j]).inverse().AdjointMap()
            start = loop.inverse().compose(poses[i].inverse()).AdjointMap()
            spread = _covariance(closures[a]) + to_end @ _covariance(closures[b]) @ to_end.T
            spread = spread + start @ _between(sums, i, k) @ start.T + to_j @ _between(sums, m, j) @ to_j.T
            agree[a, b] = agree[b, a] = error @ np.linalg.solve(spread, error) <= limit
    return agree


def _between(sums: list[NDArray[np.float64]], a: int, b: int) -> NDArray[np.float64]:
    return sums[max(a, b)] - sums[min(a, b)]


def _covariance(factor: Any) -> NDArray[np.float64]:
    return np.asarray(factor.noiseModel().covariance())


def _gnc(problem: Problem, loss: Any) -> Answer:
    graph = joined(problem, np.ones(len(problem.closures), dtype=bool))
    parameters = gtsam.GncLMParams()
    parameters.setLossType(loss)
    parameters.setKnownInliers(list(range(problem.graph.size())))
    optimiser = gtsam.GncLMOptimizer(graph, problem.values, parameters)
    values = optimiser.optimize()
    weights = np.asarray(optimiser.getWeights())[problem.graph.size() :]
    return weights > 0.5, weights, values


def _kernel(problem: Problem, estimator: Any) -> Answer:
    graph = gtsam.NonlinearFactorGraph(problem.graph)
    for closure in problem.closures:
        factor = closure.at(0)
        robust = gtsam.noiseModel.Robust.Create(estimator, factor.noiseModel())
        graph.add(between(*factor.keys(), factor.measured(), robust))
    values = gtsam.LevenbergMarquardtOptimizer(graph, problem.values).optimize()
    norms = np.array([np.sqrt(2 * closure.error(values)) for closure in problem.closures])
    return np.array([estimator.weight(norm) > 0.5 for norm in norms]), -norms, values


_LOSSES = gtsam.noiseModel.mEstimator
METHODS: dict[str, Callable[[Problem], Answer]] = {
    "gate": partial(_gate, rule="log_odds"),
    "Λ_glob rule": partial(_gate, rule="global_rise"),
    "no gate": _no_gate,
    "χ²": _chi_squared,
    "3 σ": _largest_edge_error,
    "PCM": _pairwise_consistent,
    "GNC-TLS": partial(_gnc, loss=gtsam.GncLossType.TLS),
    "GNC-GM": partial(_gnc, loss=gtsam.GncLossType.GM),
    "DCS": partial(_kernel, estimator=_LOSSES.DCS.Create(1.0)),
    "Cauchy": partial(_kernel, estimator=_LOSSES.Cauchy.Create(1.0)),
    "Geman-McClure": partial(_kernel, estimator=_LOSSES.GemanMcClure.Create(1.0)),
}
