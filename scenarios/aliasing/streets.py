"""A town whose crossings all look alike: closures proposed by an appearance that sees local geometry only.

Streets form a square grid. A vehicle drives random routes over it: places are passed again and crossed. What a place
looks like is where it lies within its cell of the grid and which way the vehicle faces: every cell looks the same. A
proposal carries the relative pose that matching the two views would give; whether it is true is seen from the poses.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from scenarios.problem import Problem

BLOCK_M, STEP_M, RADIUS_M = 40.0, 4.0, 4.0
NEAR_M, NEAR_RAD = 1.0, 0.2
"""How alike two views must be to be matched: within their cells, and in heading."""

RECENT = 15
"""Keyframes within which nobody looks for a closure."""

ODOMETRY = np.array([0.06, 0.04, 0.006])
MATCH = np.array([0.10, 0.10, 0.01])
"""Standard deviations of a step and of a match: forward and sideways in m, heading in rad."""

FACTORS = {"a tenth": 0.1, "a third": 1 / 3, "right": 1.0, "three times": 3.0, "ten times": 10.0}
"""Sigmas that methods are told, in units of the true ones; "identity" tells them 1 m and 1 rad."""

TOLD = (*FACTORS, "identity")


def problem(seed: int, told: str = "right", *, n_streets: int = 24, share: float = 1.0) -> Problem:
    """One drive with its proposals.

    Parameters
    ----------
    seed : int
    told : str
        Of `TOLD`.
    n_streets : int
        Blocks driven.
    share : float
        False proposals per true one, as far as there are so many look-alikes.
    """
    random = np.random.default_rng(seed)
    truth = route(random, n_streets)
    bias = random.normal(0.0, 0.0015)
    graph, values, drifted, estimate = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.Values(), truth[0]
    steps, matches = (_noise(sigmas, told) for sigmas in (ODOMETRY, MATCH))
    graph.add(gtsam.PriorFactorPose2(0, truth[0], gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    for i, pose in enumerate(truth):
        if i:
            error = random.normal(0.0, ODOMETRY) + np.array([0.0, 0.0, bias])
            measured = truth[i - 1].between(pose).compose(gtsam.Pose2.Expmap(error))
            estimate = estimate.compose(measured)
            graph.add(gtsam.BetweenFactorPose2(i - 1, i, measured, steps))
        values.insert(i, pose)
        drifted.insert(i, estimate)
    pairs, true = proposals(truth, random, share)
    closures = tuple(_closure(i, j, _seen(truth[i], truth[j], random), matches) for i, j in pairs)
    return Problem(
        name=f"streets-{seed}-{told}",
        graph=graph,
        values=drifted,
        closures=closures,
        true=true,
        overlapping=np.array([kind or overlaps(truth, i, j) for (i, j), kind in zip(pairs, true, strict=True)]),
        radii=RADIUS_M,
        truth=values,
    )


def route(random: np.random.Generator, n_streets: int) -> list[gtsam.Pose2]:
    """Poses a step apart along random streets of a 4 by 4 grid, never back the way it came."""
    corner, heading = np.array([1, 1]), 0
    poses = []
    for _ in range(n_streets):
        choices = [turn for turn in (-1, 0, 1) if _inside(corner, (heading + turn) % 4)]
        heading = (heading + int(random.choice(choices))) % 4
        towards = _ways()[heading]
        for k in range(int(BLOCK_M / STEP_M)):
            place = corner * BLOCK_M + towards * k * STEP_M
            poses.append(gtsam.Pose2(*place, heading * np.pi / 2))
        corner = corner + towards
    return poses


def _ways() -> NDArray[np.int64]:
    return np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


def _inside(corner: NDArray[np.int64], heading: int) -> bool:
    after = corner + _ways()[heading]
    return bool((after >= 0).all() and (after < 4).all())


def _noise(sigmas: NDArray[np.float64], told: str) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.ones(3) if told == "identity" else sigmas * FACTORS[told])


def _seen(first: gtsam.Pose2, second: gtsam.Pose2, random: np.random.Generator) -> gtsam.Pose2:
    """What matching two views gives: their relative pose as if both stood in the same cell."""
    shift = np.round((second.translation() - first.translation()) / BLOCK_M) * BLOCK_M
    moved = gtsam.Pose2(second.rotation(), second.translation() - shift)
    return first.between(moved).compose(gtsam.Pose2.Expmap(random.normal(0.0, MATCH)))


def _closure(i: int, j: int, measured: gtsam.Pose2, noise: gtsam.noiseModel.Base) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.BetweenFactorPose2(i, j, measured, noise))
    return graph


def proposals(
    truth: list[gtsam.Pose2], random: np.random.Generator, share: float
) -> tuple[list[tuple[int, int]], NDArray[np.bool_]]:
    """Pairs that look alike, by the later one, and which are true by geometry; false ones thinned to their share."""
    poses = np.array([[pose.x(), pose.y(), pose.theta()] for pose in truth])
    i, j = np.triu_indices(len(poses), RECENT)
    offset = poses[j] - poses[i]
    within = offset[:, :2] - np.round(offset[:, :2] / BLOCK_M) * BLOCK_M
    turned = np.abs((offset[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    alike = (np.hypot(*within.T) < NEAR_M) & (turned < NEAR_RAD)
    i, j = i[alike], j[alike]
    true = np.hypot(*(poses[j, :2] - poses[i, :2]).T) < NEAR_M
    n_false = min(int((~true).sum()), round(share * true.sum()))
    kept = np.concatenate([np.flatnonzero(true), random.choice(np.flatnonzero(~true), n_false, replace=False)])
    kept = kept[np.lexsort((i[kept], j[kept]))]
    return [(int(a), int(b)) for a, b in zip(i[kept], j[kept], strict=True)], true[kept]


def overlaps(truth: list[gtsam.Pose2], i: int, j: int) -> bool:
    """Whether bringing the stretch before j to i lays spheres on others more than five keyframes from the ends."""
    places = np.array([pose.translation() for pose in truth])
    stretch = np.arange(max(j - 3 * RECENT, i + RECENT), j - 5)
    others = np.setdiff1d(np.arange(min(len(places), j - 3 * RECENT) if j > 3 * RECENT else 0), np.arange(i - 5, i + 6))
    if not len(stretch) or not len(others):
        return False
    carried = truth[i].compose(truth[j].inverse())
    moved = np.array([carried.transformFrom(places[k]) for k in stretch])
    return bool((np.linalg.norm(moved[:, None] - places[others][None], axis=2) < 2 * RADIUS_M).any())
