"""What a gated smoother estimates is the optimum of the factors that it holds, however closures came and went."""

import gtsam
import numpy as np
import pytest
from test_units import RADIUS, laps

import pgti_gtsam as pgti
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import factors_of, graph_of, keys_of

LIMIT = 1e-3
"""Largest distance of a pose, in its tangent space: m and rad."""


def sequence(seed):
    """Laps in pieces of random length: factors, values and the closures that are offered with them, true and false."""
    random = np.random.default_rng(seed)
    spatial = bool(seed % 2)
    graph, values = laps(spatial)
    at = values.atPose3 if spatial else values.atPose2
    prior = gtsam.PriorFactorPose3 if spatial else gtsam.PriorFactorPose2
    pieces = [prior(0, at(0), graph.at(0).noiseModel()), *factors_of(graph)]
    last = -1
    for until in [*np.sort(random.choice(np.arange(5, 59), 5, replace=False)).tolist(), 59]:
        own = [factor for factor in pieces if last < max(keys_of(factor)) <= until]
        new = gtsam.Values()
        for key in range(last + 1, until + 1):
            new.insert(key, at(key))
        steps = [factor for factor in own if max(keys_of(factor)) - min(keys_of(factor)) <= 1]
        yield graph_of(steps), new, [factor for factor in own if factor not in steps]
        last = until


def farthest(smoother, n):
    """Largest distance between the smoother's poses and the optimum of its factors."""
    held = graph_of(factors_of(smoother.smoother.getFactorsUnsafe()))
    estimate = smoother.estimate()
    best = optimised(held, estimate, max_iterations=100, tolerance=1e-10)
    apart = estimate.localCoordinates(best)
    return max(float(np.abs(apart.at(key)).max()) for key in range(n))


@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 109), marks=pytest.mark.slow)], ids=["8", "101"])
def test_estimates_are_those_of_batch_optimisation(seeds):
    """Six comparisons a sequence; iSAM2 linearises again what moved by more than 1e-5, at every step."""
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(1e-5)
    parameters.relinearizeSkip = 1
    parameters.setFactorization("QR")
    verdicts, misses = set(), []
    for seed in seeds:
        smoother, n = pgti.GatedISAM2(parameters, radii=RADIUS), 0
        for factors, values, closures in sequence(seed):
            update = smoother.update(factors, values, closures)
            verdicts |= {decision.verdict for decision in (*update.decisions, *update.changed.values())}
            for _ in range(10):
                smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values())
            n += values.size()
            misses.append(farthest(smoother, n))
    assert len(misses) == 6 * len(seeds)
    assert {"accepted", "rejected"} <= verdicts
    assert max(misses) < LIMIT, f"{sum(miss >= LIMIT for miss in misses)} of {len(misses)}, the worst by {max(misses)}"
