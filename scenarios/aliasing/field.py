"""The field's protocol: false closures between random keyframes of standard graphs, mixed into their true ones.

A false closure joins two keyframes that the clean optimum has more than 10 m apart, with the relative pose of a true
one. Truth is the optimum of the published graph. Free radii, which these files do not hold, are assumed: twice the
median step. Whether a false closure brings free space into contact is not told: all count as if it did.
"""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam import datasets
from pgti_gtsam.errors import InvalidOptionError
from scenarios.problem import Problem

APART_M = 10.0
RADIUS_STEPS = 2.0


def problem(path: Path, seed: int, share: float) -> Problem:
    """A planar graph with outliers, in time order.

    Parameters
    ----------
    path : Path
        g2o file of Pose2 keyframes.
    seed : int
    share : float
        False closures per true one.
    """
    if not path.is_file():
        raise InvalidOptionError(
            f"expected a standard graph, got no file {path}; --data names the folder of the graphs"
        )
    dataset = datasets.read(path)
    random = np.random.default_rng(seed)
    prior = gtsam.PriorFactorPose2(0, dataset.values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
    whole, odometry = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
    whole.add(prior)
    odometry.add(prior)
    closures = set(dataset.closures)
    for slot in range(dataset.graph.size()):
        whole.push_back(dataset.graph.at(slot))
        if slot not in closures:
            odometry.push_back(dataset.graph.at(slot))
    truth = gtsam.LevenbergMarquardtOptimizer(whole, dataset.values).optimize()
    places = gtsam.utilities.extractPose2(truth)[:, :2]
    inliers = [dataset.graph.at(slot) for slot in dataset.closures]
    outliers = [_outlier(places, inliers, random) for _ in range(max(1, round(share * len(inliers))))]
    factors = [*inliers, *outliers]
    order = sorted(range(len(factors)), key=lambda k: (max(factors[k].keys()), min(factors[k].keys()), k))
    return Problem(
        name=f"{path.stem}-{seed}-{share}",
        graph=odometry,
        values=datasets.chain_odometry(dataset),
        closures=tuple(_alone(factors[k]) for k in order),
        true=np.array([k < len(inliers) for k in order]),
        overlapping=np.ones(len(order), dtype=bool),
        radii=RADIUS_STEPS * float(np.median(np.linalg.norm(np.diff(places, axis=0), axis=1))),
        truth=truth,
    )


def _outlier(
    places: NDArray[np.float64], inliers: list[gtsam.BetweenFactorPose2], random: np.random.Generator
) -> gtsam.BetweenFactorPose2:
    """Two random keyframes far apart, with the relative pose and the noise model of a true closure drawn at random."""
    while True:
        i, j = sorted(random.choice(len(places), 2, replace=False).tolist())
        if np.linalg.norm(places[i] - places[j]) > APART_M:
            like = inliers[int(random.integers(len(inliers)))]
            return gtsam.BetweenFactorPose2(i, j, like.measured(), like.noiseModel())


def _alone(factor: gtsam.BetweenFactorPose2) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    return graph
