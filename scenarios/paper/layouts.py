"""The rule by which a layout of each kind of defect is drawn: shares of the way, uniform within wide bounds.

Only ratios count, as the radius follows from the number of inserted edges. Steps are about a metre.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import gtsam
import numpy as np
from numpy.random import Generator

from scenarios.paper.ways import Pairs, Positions, covisible, kitti_00, scale_drift, way

Drawn = tuple[Positions, Pairs]
Rule = Callable[[Generator, int, int], Drawn]
"""From a generator and the numbers of keyframes and edges to positions and edges."""

FLATNESS = (0.3, 1.0)
"""Short side of a lap, in its long sides."""

BESIDE_M = (0.5, 3.0)
"""Between two passes that run side by side."""

FUSED_M = 6.0
"""Up to which the keyframes of two passes of a fused lap are tied."""

CORRIDORS = [(0.0, 0.0), (100.0, 0.0), (100.0, 60.0), (0.0, 60.0), (0.0, 120.0)]
CORRIDORS += [(100.0, 120.0), (100.0, 180.0), (0.0, 180.0)]
"""Four corridors that look alike, driven to and fro, m."""

ODOMETRY_SIGMAS, CLOSURE_SIGMAS = np.array([0.02, 0.02, 0.002]), np.array([0.05, 0.05, 0.01])
"""x, y (m) and heading (rad) of steps and of closures: what a false closure bends hangs on their ratio."""


def crossing(least: float, most: float) -> Rule:
    """A lap that crosses the way out. The lap is a drawn share of the way; the rest lies before and behind.

    Parameters
    ----------
    least, most : float
        Bounds of the share.
    """

    def rule(random: Generator, n: int, m: int) -> Drawn:
        lap, before = random.uniform(least, most) * n, random.uniform(0.1, 0.9)
        across, up = _sides(random, lap)
        before, behind = before * (n - lap), (1 - before) * (n - lap)
        return way([(-before, 0), (across, 0), (across, up), (0, up), (0, -behind)], n), covisible(n, m)

    return rule


def beside(random: Generator, n: int, m: int) -> Drawn:
    """A lap. The way back runs beside the way out, for a twentieth to a fifth of the way before the lap, and leaves.

    Parameters
    ----------
    random, n, m
        As of every `Rule`.
    """
    lap, before = random.uniform(0.3, 0.8) * n, random.uniform(0.1, 0.9)
    across, up = _sides(random, lap)
    before, behind = before * (n - lap), (1 - before) * (n - lap)
    along, apart = random.uniform(0.05, 0.2) * before, random.uniform(*BESIDE_M)
    corners = [(-before, 0), (across, 0), (across, up), (0, up), (0, apart), (-along, apart), (-along, apart + behind)]
    return way(corners, n), covisible(n, m)


def second_lap(random: Generator, n: int, m: int) -> Drawn:
    """A lap, and a tenth to nine tenths of a second lap beside the first; nothing ties the two.

    Parameters
    ----------
    random, n, m
        As of every `Rule`.
    """
    return _two_laps(random, n), covisible(n, m)


def aliased(random: Generator, n: int, m: int) -> Drawn:
    """Corridors that look alike; two places a quarter of the way or more apart are taken for the same.

    Parameters
    ----------
    random, n, m
        As of every `Rule`.
    """
    first, second = np.sort(random.uniform(0.05, 0.95, 2))
    while second - first < 0.25:
        first, second = np.sort(random.uniform(0.05, 0.95, 2))
    i, j = int(first * n), int(second * n)
    bent = believed(way(CORRIDORS, n), [(i - 4, j - 4), (i, j), (i + 4, j + 4)])
    near = np.arange(-8, 9)
    fused = np.array([(i + a, j + b) for a in near for b in near if abs(a - b) <= 8])
    return bent, np.concatenate([covisible(n, m - len(fused)), fused])


def fused_but(lost: int) -> Rule:
    """Two passes of a lap, tied wherever near; so many drawn keyframes lack the tie to the nearest of the other."""

    def rule(random: Generator, n: int, m: int) -> Drawn:
        positions = _two_laps(random, n)
        gaps = np.linalg.norm(positions[:, None] - positions[None], axis=2)
        near = np.triu(gaps < FUSED_M, n // 4)
        untied = random.choice(np.flatnonzero(near.any(axis=0)), lost, replace=False)
        near[np.where(near, gaps, np.inf)[:, untied].argmin(axis=0), untied] = False
        tied = np.argwhere(near)
        return positions, np.concatenate([covisible(n, m - len(tied)), tied])

    return rule


def quick_turn(random: Generator, n: int, m: int) -> Drawn:
    """A turn with few common views: across the turn the next twelve keyframes are tied, save the first two.

    Parameters
    ----------
    random, n, m
        As of every `Rule`.
    """
    at = int(random.uniform(0.1, 0.9) * n)
    positions = way([(0, 0), (at, 0), (at, n - at)], n)
    edges = covisible(n, m + 150)
    gaps = edges[:, 1] - edges[:, 0]
    across = (edges[:, 0] < at) & (edges[:, 1] >= at)
    edges = edges[~across | ((gaps > 2) & (gaps <= 12))]
    return positions, edges[np.argsort(edges[:, 1] - edges[:, 0], kind="stable")][:m]


def true_way(data: Path) -> Rule:
    """The true way of KITTI 00, every third to fifth pose a keyframe, with scale drift of 2 to 30 % a kilometre."""

    def rule(random: Generator, n: int, m: int) -> Drawn:
        true = kitti_00(data, int(random.integers(3, 6)), n)
        return scale_drift(true, random.uniform(0.02, 0.3)), covisible(n, m)

    return rule


def believed(true: Positions, closures: list[tuple[int, int]]) -> Positions:
    """The optimum of a way with right odometry, with closures that take two places for the same.

    Parameters
    ----------
    true : (n, 2) float
    closures : list of tuple
    """
    steps = np.diff(true, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    poses = [gtsam.Pose2(*place, turn) for place, turn in zip(true, [*headings, headings[-1]], strict=True)]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    graph.add(gtsam.PriorFactorPose2(0, poses[0], gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    steady, found = (gtsam.noiseModel.Diagonal.Sigmas(sigmas) for sigmas in (ODOMETRY_SIGMAS, CLOSURE_SIGMAS))
    for k, (one, other) in enumerate(pairwise(poses)):
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, one.between(other), steady))
    for i, j in closures:
        graph.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(), found))
    best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    bent: Positions = gtsam.utilities.extractPose2(best)[:, :2]
    return bent


def _sides(random: Generator, around: float) -> tuple[float, float]:
    """Width and height of a lap."""
    flat = random.uniform(*FLATNESS)
    return around / 2 / (1 + flat), around / 2 * flat / (1 + flat)


def _two_laps(random: Generator, n: int) -> Positions:
    """A lap, and a tenth to nine tenths of a second lap inside the first."""
    share = random.uniform(0.1, 0.9)
    (across, up), apart = _sides(random, n / (1 + share)), random.uniform(*BESIDE_M)
    inner = [(0.0, apart), (across - apart, apart), (across - apart, up - apart), (apart, up - apart), (apart, apart)]
    corners, left = [(0.0, 0.0), (across, 0.0), (across, up), (0.0, up), inner[0]], share * n / (1 + share)
    for start, end in pairwise(inner):
        length = abs(end[0] - start[0]) + abs(end[1] - start[1])
        part = min(1.0, left / length)
        corners.append((start[0] + part * (end[0] - start[0]), start[1] + part * (end[1] - start[1])))
        left -= part * length
        if left <= 0:
            break
    return way(corners, n)
