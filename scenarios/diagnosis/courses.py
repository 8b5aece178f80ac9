"""Drives through ray-cast worlds with the free space around them, their drift and their second passes."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from itertools import accumulate, pairwise

import gtsam
import numpy as np

from scenarios.diagnosis.stretches import Pairs, grouped
from scenarios.worlds import MATCH, drift, driving
from scenarios.worlds.appearance import EVERY, RECENT_M
from scenarios.worlds.layouts import LAYOUTS, Layout
from scenarios.worlds.solid import Array

TIED_WITHIN = 0.7
"""Distance of two keyframes, in the sum of their radii, within which one is matched with the other."""

NOTHING_NEAR_M = 5.0
"""Radius where no ray meets anything."""

SHORTEST, LONGEST = 10, 1000
"""Keyframes of a drive out and back."""

MOST_DRIFT = 2.0
"""Largest distance between end and start of a drive out and back, in radii."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """A drive, its free space and its odometry.

    Attributes
    ----------
    layout : Layout
    truth : list of gtsam.Pose3
    radii : (n,) float
        Length of the shortest ray of every keyframe's scan, m.
    steps : list of gtsam.Pose3
        Measured from each keyframe to the next.
    sigmas : (6,) float
        Of a step, in GTSAM's order.
    """

    layout: Layout
    truth: list[gtsam.Pose3]
    radii: Array
    steps: list[gtsam.Pose3]
    sigmas: Array

    @property
    def is_planar(self) -> bool:
        """Whether its map is one of `Pose2`."""
        return self.layout.sensor.planar

    def chained(self) -> list[gtsam.Pose3]:
        """Poses that the steps lead to."""
        return list(accumulate(self.steps, gtsam.Pose3.compose, initial=self.truth[0]))


def course(world: str, seed: int, drift_scale: float = 1.0) -> Course:
    """A drive through a world of `LAYOUTS`, with errors of odometry this many times the simulator's.

    Parameters
    ----------
    world : str
        A world of `LAYOUTS`.
    seed : int
    drift_scale : float
        Factor on the simulator's errors of odometry.
    """
    layout, truth, radii = _driven(world, seed)
    return _with_odometry(layout, truth, radii, seed, drift_scale)


def out_and_back(world: str, seed: int) -> Course:
    """A drive along a way, straight or curved, and back: length and drift are drawn.

    Step and radii are the world's.

    Parameters
    ----------
    world : str
    seed : int
    """
    layout, _, around = _driven(world, seed)
    random = np.random.default_rng([seed, sorted(LAYOUTS).index(world)])
    n = round(np.exp(random.uniform(np.log(SHORTEST), np.log(LONGEST))) / 2)
    turn = random.choice([0.0, random.uniform(-1.5, 1.5) * np.pi])

    # there: an arc, as long as it is; back: half a step beside those keyframes, looking the other way
    at = layout.step_m * np.arange(n)
    back = at[::-1] - layout.step_m / 2
    truth = [_on_arc(s, turn / at[-1], 0.0) for s in at] + [_on_arc(s, turn / at[-1], np.pi) for s in back]
    there = np.resize(around, n)
    radii = np.concatenate([there, there[::-1]])

    # its errors are scaled until the end lies as far off as was drawn
    wanted, scale = random.uniform(0.0, MOST_DRIFT) * float(np.median(radii)), 1.0
    for _ in range(4):
        found = _with_odometry(layout, truth, radii, seed, scale)
        scale *= wanted / max(found.chained()[-1].range(truth[-1]), 1e-9)
    return _with_odometry(layout, truth, radii, seed, scale)


def second_passes(course: Course) -> list[Pairs]:
    """Pairs of keyframes that a detector matches, (k, 2) int each, grouped by revisit.

    Every second keyframe of a later pass with the nearest of the earlier; of a pass that comes no nearer, or only
    between two such keyframes, the nearest pair.
    """
    places = np.array([pose.translation() for pose in course.truth])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    gaps = np.linalg.norm(places[:, None] - places, axis=2) / (course.radii[:, None] + course.radii)
    touching = np.argwhere((gaps <= 1.0) & (way - way[:, None] >= RECENT_M))
    return [_matched(pairs, gaps) for pairs in grouped(touching)]


def match(course: Course, i: int, j: int, random: np.random.Generator) -> gtsam.Pose3:
    """Pose of j seen from i as a matcher measures the pose.

    Parameters
    ----------
    course : Course
    i, j : int
    random : np.random.Generator
    """
    free = np.array([0, 0, 1, 1, 1, 0]) if course.is_planar else 1
    return course.truth[i].between(course.truth[j]).compose(gtsam.Pose3.Expmap(random.normal(0.0, MATCH) * free))


def _matched(pairs: Pairs, gaps: Array) -> Pairs:
    """The nearest earlier keyframe for every second later keyframe."""
    distance = gaps[pairs[:, 0], pairs[:, 1]]
    by_distance = pairs[np.argsort(distance, kind="stable")]
    _, first = np.unique(by_distance[:, 1], return_index=True)
    nearest = by_distance[first]
    kept = nearest[(nearest[:, 1] % EVERY == 0) & (gaps[nearest[:, 0], nearest[:, 1]] <= TIED_WITHIN)]
    return kept if len(kept) else by_distance[:1]


@functools.lru_cache(maxsize=4)
def _driven(world: str, seed: int) -> tuple[Layout, list[gtsam.Pose3], Array]:
    layout = LAYOUTS[world]()
    truth = driving.drive(layout.ways, np.random.default_rng(seed), layout.length_m, layout.step_m)
    shortest = np.array([layout.sensor.scan(layout.solid, pose).distances.min() for pose in truth])
    return layout, truth, np.where(np.isfinite(shortest), shortest, NOTHING_NEAR_M)


def _with_odometry(layout: Layout, truth: list[gtsam.Pose3], radii: Array, seed: int, scale: float) -> Course:
    sensor = layout.sensor
    random = np.random.default_rng(seed + 77)
    found = drift.odometry(truth, random, planar=sensor.planar, scaled=sensor.name == "camera")
    steps = [
        _scaled(one.between(other), step, scale)
        for (one, other), step in zip(pairwise(truth), found.steps, strict=True)
    ]
    return Course(layout=layout, truth=truth, radii=radii, steps=steps, sigmas=found.sigmas * scale)


def _scaled(true: gtsam.Pose3, measured: gtsam.Pose3, scale: float) -> gtsam.Pose3:
    """A measured step whose error is so many times as large."""
    return true.compose(gtsam.Pose3.Expmap(scale * gtsam.Pose3.Logmap(true.between(measured))))


def _on_arc(way: float, curvature: float, turned: float) -> gtsam.Pose3:
    """The end of an arc after so much way, and the body's attitude there."""
    heading = way * curvature
    if abs(curvature) < 1e-9:
        place = np.array([way, 0.0, 0.0])
    else:
        place = np.array([np.sin(heading), 1 - np.cos(heading), 0.0]) / curvature
    return gtsam.Pose3(gtsam.Rot3.Yaw(heading + turned), place)
