"""A city driven for months: a map of any size, with streets that are passed three times and more.

The robot drives districts of 5 × 5 blocks in a row, 4000 keyframes each, and prefers streets with fewest passes so
far. A pass is tied to the pass before at every seventh keyframe, which makes a tenth as many closures as
keyframes. In some districts nothing is tied, and some closures are false.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from scenarios.problem import between

STEP, RADIUS = 2.0, 3.0
"""Way between keyframes and free distance around them, m."""

BLOCK, SIDE, DISTRICT = 20, 6, 4000
"""Keyframes along a street, crossings along a side of a district, keyframes that are driven in a district."""

TIED = 7
"""Keyframes from one closure of a pass to the next."""

NOISE, MATCH = np.array([0.01, 0.01, 0.002]), np.array([0.05, 0.05, 0.01])
"""Standard deviations of a step and of a closure, m, m, rad."""

WAYS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])

Street = tuple[tuple[int, ...], tuple[int, ...]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class City:
    """A map at the truth, and the false closures."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    n_closures: int
    false: tuple[tuple[int, int], ...]


def city(n: int, *, untied: float = 0.0, false: int = 0, seed: int = 0) -> City:
    """A map of a city.

    Parameters
    ----------
    n : int
        Keyframes.
    untied : float
        Share of the districts without ties.
    false : int
        Number of false closures.
    seed : int
    """
    random = np.random.default_rng([seed, n])
    tour = _Tour(random=random, poses=np.empty((n, 3)), untied=untied)
    tour.drive()
    poses = [gtsam.Pose2(*row) for row in tour.poses.tolist()]
    values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    pairs = [(k, k + 1) for k in range(n - 1)], tour.closures
    for ends, sigmas in zip(pairs, (NOISE, MATCH), strict=True):
        noise, errors = gtsam.noiseModel.Diagonal.Sigmas(sigmas), sigmas * random.normal(size=(len(ends), 3))
        for (i, j), error in zip(ends, errors, strict=True):
            graph.push_back(between(i, j, poses[i].between(poses[j]).retract(error), noise))
    wrong = [(int(i), int(j)) for i, j in np.sort(random.integers(n, size=(false, 2)), axis=1)]
    for i, j in wrong:
        graph.push_back(between(i, j, gtsam.Pose2(), gtsam.noiseModel.Diagonal.Sigmas(MATCH)))
    return City(graph=graph, values=values, n_closures=len(tour.closures) + false, false=tuple(wrong))


@dataclass(slots=True, kw_only=True)
class _Tour:
    """The way so far."""

    random: np.random.Generator
    poses: NDArray[np.float64]
    untied: float
    closures: list[tuple[int, int]] = field(default_factory=list)
    passes: dict[Street, list[NDArray[np.int64]]] = field(default_factory=dict)

    def drive(self) -> None:
        """Street after street, district after district, up to the last keyframe."""
        n, at, way = len(self.poses), np.zeros(2, dtype=np.int64), 0
        wide = int(np.ceil(np.sqrt(n / DISTRICT)))
        for district, first in enumerate(range(0, n, DISTRICT)):
            row, column = divmod(district, wide)
            low = (SIDE - 1) * np.array([column if row % 2 == 0 else wide - 1 - column, row])
            is_tied = self.random.random() >= self.untied
            for k in range(first, min(first + DISTRICT, n), BLOCK):
                way = self._next_way(at, way, low)
                self._pass(at, way, np.arange(k, min(k + BLOCK, n)), is_tied=is_tied)
                at = at + WAYS[way]

    def _next_way(self, at: NDArray[np.int64], way: int, low: NDArray[np.int64]) -> int:
        """Straight on, left or right, within the district, by few passes; or towards the district."""
        on = [turn for turn in range(4) if turn != (way + 2) % 4]
        inside = [turn for turn in on if ((at + WAYS[turn] >= low) & (at + WAYS[turn] < low + SIDE)).all()]
        if not inside:
            middle = low + (SIDE - 1) / 2
            return min(on, key=lambda turn: float(np.abs(at + WAYS[turn] - middle).sum()))
        seldom = np.array([1 / (1 + len(self.passes.get(_street(at, turn), ()))) ** 2 for turn in inside])
        return int(self.random.choice(inside, p=seldom / seldom.sum()))

    def _pass(self, at: NDArray[np.int64], way: int, keyframes: NDArray[np.int64], *, is_tied: bool) -> None:
        """Drive along the right of a street, and tie the pass to the pass before."""
        yaw, m = way * np.pi / 2, len(keyframes)
        lane = 0.3 * np.array([np.sin(yaw), -np.cos(yaw)])
        centres = BLOCK * STEP * at + STEP * np.arange(m)[:, None] * WAYS[way] + lane
        self.poses[keyframes, :2] = centres + 0.05 * self.random.normal(size=(m, 2))
        self.poses[keyframes, 2] = yaw

        # keyframes by how far along the street they are, from its lower end
        along = np.full(BLOCK + 1, -1)
        along[np.arange(m) if way < 2 else BLOCK - np.arange(m)] = keyframes
        earlier = self.passes.setdefault(_street(at, way), [])
        if earlier and is_tied:
            places = np.arange(self.random.integers(TIED), BLOCK + 1, TIED)
            ends = zip(earlier[-1][places].tolist(), along[places].tolist(), strict=True)
            self.closures += [(i, j) for i, j in ends if i >= 0 and j > i + BLOCK]
        earlier.append(along)


def _street(at: NDArray[np.int64], way: int) -> Street:
    """The two crossings that a street leads between, in either direction."""
    ends = sorted([tuple(at.tolist()), tuple((at + WAYS[way]).tolist())])
    return ends[0], ends[1]
