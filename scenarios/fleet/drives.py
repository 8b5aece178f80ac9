"""Drives around blocks, each block twice: maps with counted damage.

A map is a row of four to eight blocks. The robot goes twice around each, then straight on to the next, so that each
block is a revisit by itself, a loop of 100 to 200 m. Odometry errs by a third of what the package grants. A block is
*tied* where every third keyframe of its second lap is tied to the first lap.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import gtsam
import numpy as np

from pgti_gtsam.estimate import optimised
from scenarios.problem import between

STEP, RADIUS = 2.0, 3.0
"""Way between keyframes and free distance around them, m."""

NOISE = np.array([0.02, 0.02, 0.008])
"""Standard deviations of a step of odometry, m, m, rad: a third of the 0.05 m and 0.024 rad that are granted."""

MATCH = np.array([0.05, 0.05, 0.01])
"""The same of a closure."""

APART = 10.0
"""Least distance of the ends of a false closure, in radii."""

MOST_UNTIED, MOST_FALSE = 4, 5
WANDER = 0.1
"""Standard deviation by which the robot steps aside from one keyframe to the next, m."""


class Damage(NamedTuple):
    """Damage of a map: so many blocks without ties, so many false closures."""

    untied: int
    false: int

    @property
    def size(self) -> int:
        """A false closure is more than all blocks that may be untied."""
        return self.untied + (MOST_UNTIED + 1) * self.false


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """A map and the damage done."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    damage: Damage


def damage_of(seed: int) -> Damage:
    """A quarter of the maps is intact, a quarter has untied blocks, a quarter false closures, a quarter both."""
    random = np.random.default_rng([seed, 1])
    untied, false = int(random.integers(1, MOST_UNTIED + 1)), int(random.integers(1, MOST_FALSE + 1))
    return Damage(untied * (seed % 2), false * (seed // 2 % 2))


def drive(seed: int) -> Drive:
    """The map of a seed, at the optimum."""
    # the way, and which of its keyframes are two laps of which block
    random, damage = np.random.default_rng([seed, 0]), damage_of(seed)
    steps: list[gtsam.Pose2] = []
    laps = []
    for _ in range(int(random.integers(MOST_UNTIED, 9))):
        once = lap(*random.integers(11, 23, size=2).tolist())
        laps.append((len(steps), len(once)))
        steps += [*once, *once, *_straight(2 * len(once) // 3)]
    truth = [gtsam.Pose2()]
    for step in steps:
        truth.append(truth[-1].compose(step.retract(np.array([0, WANDER * random.normal(), 0]))))

    # odometry, and the ties of blocks that are tied
    graph = gtsam.NonlinearFactorGraph()
    for i, (here, there) in enumerate(pairwise(truth)):
        _tie(graph, i, i + 1, here.between(there), NOISE, random)
    untied = set(random.choice(len(laps), damage.untied, replace=False).tolist())
    for block, (first, length) in enumerate(laps):
        for i in range(first, first + length, 3) if block not in untied else ():
            _tie(graph, i, i + length, truth[i].between(truth[i + length]), MATCH, random)

    # the optimum, with closures between places that are far apart
    values = gtsam.Values()
    for key, pose in enumerate(truth):
        values.insert(key, pose)
    good, n = optimised(graph, values), graph.size()
    while graph.size() < n + damage.false:
        i, j = np.sort(random.choice(len(truth), 2, replace=False)).tolist()
        if np.linalg.norm(truth[i].translation() - truth[j].translation()) >= APART * RADIUS:
            _tie(graph, i, j, gtsam.Pose2(), MATCH, random)
    return Drive(graph=graph, values=optimised(graph, good) if damage.false else good, damage=damage)


def _straight(keyframes: int) -> list[gtsam.Pose2]:
    return [gtsam.Pose2(STEP, 0, 0)] * keyframes


def lap(width: int, height: int) -> list[gtsam.Pose2]:
    """Steps once around a block, left turns.

    Parameters
    ----------
    width, height : int
        Sides in keyframes.
    """
    corner = [gtsam.Pose2(STEP / 2, 0, np.pi / 4)] * 2
    return [step for side in (width, height, width, height) for step in (*_straight(side), *corner)]


def _tie(graph: Any, i: int, j: int, pose: gtsam.Pose2, sigmas: Any, random: np.random.Generator) -> None:
    measured = pose.retract(random.normal(size=3) * sigmas)
    graph.push_back(between(i, j, measured, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
