"""The gate and the methods beside the gate: each takes a problem and says which closures are true.

All get the same graph, estimates, noise models and known inliers (prior and odometry), and run with the parameters that
their authors or GTSAM give as default. References: PCM: Mangelson et al., ICRA 2018; GNC: Yang et al., RA-L 2020; DCS:
Agarwal et al., ICRA 2013; largest edge error against 3 sigma: RTAB-Map, Labbé and Michaud, JFR 2019; IPC: Olivastri and
Pretto, ICRA 2024; ROVER: Yu et al., arXiv 2508.13488.
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

VETO = 0.9
"""Of the χ² test by which every edge of IPC has a veto: 6.251 with three degrees of freedom, as its authors have it."""

VOTER = 10.0
"""Factor of the odometry's information in the subgraphs of IPC, of its authors too: candidates have to yield."""

DEFORMED_M = 1.0
"""Most by which a candidate may deform the trajectory in ROVER, which names no number: of seven limits from 0.2 to 4 m
the best, with 1.5 m, on eight drives through the worlds (seeds 1000 and 1001)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """The answer of a method to a problem.

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
    """Run a method of `METHODS`.

    Parameters
    ----------
    problem : Problem
    method : str
        Name in `METHODS`.
    """
    started = time.process_time()
    accepted, confidence, values = METHODS[method](problem)
    seconds = time.process_time() - started
    return Outcome(accepted=accepted, confidence=confidence, values=values, seconds=seconds)


def joined(problem: Problem, accepted: NDArray[np.bool_]) -> gtsam.NonlinearFactorGraph:
    """The map with some of its closures.

    Parameters
    ----------
    problem : Problem
    accepted : (n_closures,) bool
    """
    graph = gtsam.NonlinearFactorGraph(problem.graph)
    for closure, keep in zip(problem.closures, accepted, strict=True):
        if keep:
            graph.push_back(closure)
    return graph


def optimised(problem: Problem, accepted: NDArray[np.bool_]) -> gtsam.Values:
    """The optimum of that map, from odometry.

    Parameters
    ----------
    problem : Problem
    accepted : (n_closures,) bool
    """
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
    """In time order: the closure's error against the error's covariance given all before, by iSAM2."""
    # the smoother without closures
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")  # Cholesky loses a chain as stiff as that of MIT.g2o
    parameters.relinearizeSkip = 1
    parameters.setRelinearizeThreshold(0.01)
    isam = gtsam.ISAM2(parameters)
    isam.update(problem.graph, problem.values)
    accepted, squares = np.zeros(len(problem.closures), dtype=bool), np.zeros(len(problem.closures))
    values = isam.calculateBestEstimate()
    for k, closure in enumerate(problem.closures):
        # error and covariance of the closure
        factor = closure.at(0)
        i, j = factor.keys()
        spread = isam.jointMarginalCovariance([i, j])
        joint = np.block([[spread.at(a, b) for b in (i, j)] for a in (i, j)])
        jacobian, right = factor.linearize(values).jacobian()
        right, n = np.asarray(right), factor.dim()
        jacobian = jacobian.reshape(n, 2 * n)
        squares[k] = right @ np.linalg.solve(np.eye(n) + jacobian @ joint @ jacobian.T, right)

        # the test
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


def _vetoed(problem: Problem) -> Answer:
    """IPC: in time order, rejected when any edge of the candidate's subgraph, optimised alone, fails its χ² test.

    The subgraph is the odometry from the first to the last keyframe of all accepted closures whose spans overlap the
    candidate's, directly or through others, with the closures of these spans.
    """
    accepted, worst = np.zeros(len(problem.closures), dtype=bool), np.zeros(len(problem.closures))
    voters = [_firmer(problem.graph.at(slot)) for slot in range(1, problem.graph.size())]
    values, spans = problem.values, list[tuple[int, int, list[int]]]()
    for k, closure in enumerate(problem.closures):
        # the candidate and all that its loop overlaps
        first, last = sorted(closure.at(0).keys())
        touched = [span for span in spans if span[0] < last and first < span[1]]
        first, last = min([first, *(span[0] for span in touched)]), max([last, *(span[1] for span in touched)])
        members = [*(member for span in touched for member in span[2]), k]
        edges = [*voters[first:last], *(problem.closures[member].at(0) for member in members)]
        after = _optimum_between(problem, first, last, edges, values)

        # every edge has a veto
        worst[k] = max(2 * edge.error(after) for edge in edges)
        if worst[k] <= stats.chi2.ppf(VETO, edges[0].dim()):
            accepted[k] = True
            spans = [span for span in spans if span not in touched] + [(first, last, members)]
            values = _carried(problem, values, after, last)
    return accepted, -worst, optimised(problem, accepted)


def _firmer(step: Any) -> Any:
    """A step of odometry with sigmas below the true errors."""
    noise = gtsam.noiseModel.Gaussian.Covariance(_covariance(step) / VOTER)
    return between(*step.keys(), step.measured(), noise)


def _optimum_between(problem: Problem, first: int, last: int, edges: list[Any], values: gtsam.Values) -> gtsam.Values:
    """Keyframes from the first to the last by some edges alone, with the first fixed at its place."""
    at = values.atPose2 if problem.planar else values.atPose3
    prior = gtsam.PriorFactorPose2 if problem.planar else gtsam.PriorFactorPose3
    graph, own = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(prior(first, at(first), gtsam.noiseModel.Isotropic.Sigma(edges[0].dim(), 1e-3)))
    for edge in edges:
        graph.push_back(edge)
    for key in range(first, last + 1):
        own.insert(key, at(key))
    return gtsam.LevenbergMarquardtOptimizer(graph, own).optimize()


def _carried(problem: Problem, values: gtsam.Values, after: gtsam.Values, last: int) -> gtsam.Values:
    """Estimates with a stretch at its optimum, and the keyframes after the stretch moved along with its end."""
    poses, moved = problem.poses(values), gtsam.Values(values)
    moved.update(after)
    end = (after.atPose2 if problem.planar else after.atPose3)(last)
    for key in range(last + 1, problem.n_keyframes):
        moved.update(key, end.compose(poses[last].between(poses[key])))
    return moved


def _deforming(problem: Problem) -> Answer:
    """ROVER: in time order, rejected when the trajectory with the candidate, aligned, is far from that without."""
    accepted, deformed = np.zeros(len(problem.closures), dtype=bool), np.zeros(len(problem.closures))
    graph, values = gtsam.NonlinearFactorGraph(problem.graph), problem.values
    for k, closure in enumerate(problem.closures):
        attempt = gtsam.NonlinearFactorGraph(graph)
        attempt.push_back(closure)
        after = gtsam.LevenbergMarquardtOptimizer(attempt, values).optimize()
        known = 1 + max(closure.at(0).keys())
        before, now = (_places(problem, each)[:known] for each in (values, after))
        deformed[k] = _apart_m(before, now)
        if deformed[k] <= DEFORMED_M:
            accepted[k] = True
            graph, values = attempt, after
    return accepted, -deformed, values


def _places(problem: Problem, values: gtsam.Values) -> NDArray[np.float64]:
    return np.array([pose.translation() for pose in problem.poses(values)])


def _apart_m(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Root mean square distance of places after rigid alignment, by singular values (Kabsch, Acta Cryst. A 1976)."""
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    left, along, right = np.linalg.svd(one.T @ other)
    along[-1] *= np.sign(np.linalg.det(left @ right))
    return float(np.sqrt(max(np.square(one).sum() + np.square(other).sum() - 2 * along.sum(), 0.0) / len(one)))


def _pairwise_consistent(problem: Problem) -> Answer:
    """PCM: the largest set of closures in which any two agree with odometry."""
    pairs = _consistent(problem)
    clique, _ = nx.max_weight_clique(nx.from_numpy_array(pairs), weight=None)
    accepted = np.zeros(len(problem.closures), dtype=bool)
    accepted[clique] = True
    return accepted, pairs[:, clique].mean(axis=1), optimised(problem, accepted)


def _consistent(problem: Problem) -> NDArray[np.bool_]:
    # covariance of the way from the first pose, in the axes of the map
    poses = problem.poses(problem.values)
    steps = [problem.graph.at(s) for s in range(1, problem.graph.size())]
    sums = [np.zeros_like(poses[0].AdjointMap())]
    for pose, step in zip(poses[1:], steps, strict=True):
        adjoint = pose.AdjointMap()
        sums.append(sums[-1] + adjoint @ _covariance(step) @ adjoint.T)

    # every pair of closures by the loop that the two make
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
    "IPC": _vetoed,
    "ROVER": _deforming,
    "PCM": _pairwise_consistent,
    "GNC-TLS": partial(_gnc, loss=gtsam.GncLossType.TLS),
    "GNC-GM": partial(_gnc, loss=gtsam.GncLossType.GM),
    "DCS": partial(_kernel, estimator=_LOSSES.DCS.Create(1.0)),
    "Cauchy": partial(_kernel, estimator=_LOSSES.Cauchy.Create(1.0)),
    "Geman-McClure": partial(_kernel, estimator=_LOSSES.GemanMcClure.Create(1.0)),
}
