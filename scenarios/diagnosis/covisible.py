"""Maps of odometry and landmarks: landmarks seen again under their old identity tie passes, and give the radii."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from scenarios.diagnosis import damage, sparse
from scenarios.diagnosis.courses import Course, course, second_passes
from scenarios.diagnosis.damage import Case, Intact
from scenarios.diagnosis.stretches import Pairs
from scenarios.worlds import MATCH, landmarks
from scenarios.worlds.layouts import LAYOUTS, Layout
from scenarios.worlds.sensors import Sensor
from scenarios.worlds.solid import Array

SEEN = 30
"""Landmarks a keyframe: twice as many as two keyframes share that the adapter takes for tied."""

AT_ONCE = 4000
"""Points that are looked for together, a matter of time alone."""

DAMAGES = (damage.NOTHING, damage.DROPPED, damage.FALSE, damage.MANY_FALSE, damage.ODOMETRY)
"""Of `damage.DAMAGES`, those that such maps are given."""

Sightings = list[tuple[int, Array]]


def case(world: str, seed: int, kind: str, sensor: Sensor | None = None) -> Case:
    """A course through a world with damage, seen by the layout's sensor or another.

    Drive, landmarks, their strength and the damage are the same for all sensors.

    Parameters
    ----------
    world : str
    seed : int
    kind : str
        One of `DAMAGES`.
    sensor : Sensor, optional
        The layout's own when left out.
    """
    of_sightings, random = np.random.default_rng(
        [seed, sorted(LAYOUTS).index(world), damage.DAMAGES.index(kind)]
    ).spawn(2)
    driven = course(world, seed)
    if sensor is not None:
        driven = replace(driven, layout=replace(driven.layout, sensor=sensor))
    seen = _sightings(driven, of_sightings)
    if kind == damage.DROPPED:
        passes = second_passes(driven)
        seen = _forgotten(seen, *_ends(passes[random.integers(len(passes))])) if passes else seen
    if kind == damage.ODOMETRY:
        seen = _followed(seen)
    found = _intact(driven, seen)
    return damage.damaged(found, kind, random, range(len(driven.truth)), float(np.median(driven.radii)))


def _intact(driven: Course, seen: list[Sightings]) -> Intact:
    """The map of the sightings; landmarks are placed at the truth, or from odometry alone."""
    sensor = driven.layout.sensor
    graph, near = landmarks.landmark_graph(seen, driven.truth, sensor)
    _, chained = landmarks.landmark_graph(seen, driven.chained(), sensor)
    graph.push_back(sparse.odometry(driven))
    return Intact(
        base=graph,
        revisits=(),
        near=near,
        chained=chained,
        radii=None,
        places=np.array([pose.translation() for pose in driven.truth]),
        noise=sparse.told(MATCH, driven),
        match=sparse.identity(driven),
        solid=driven.layout.solid,
    )


def _sightings(driven: Course, random: np.random.Generator) -> list[Sightings]:
    """For each keyframe, points in view, the strongest points, and their positions; a point keeps its identity."""
    layout, sensor = driven.layout, driven.layout.sensor
    points = landmarks.places(layout.solid, sensor, driven.truth[0].z(), layout.landmarks_per_m2, random)
    points = points[random.permutation(len(points))]  # the strongest first
    seen = []
    for pose in driven.truth:
        view = _strongest(layout, pose, points, random)
        local = (points[view] - pose.translation()) @ pose.rotation().matrix()
        away = np.linalg.norm(local, axis=1, keepdims=True)
        local = local * (1 + random.normal(0.0, sensor.noise_m, away.shape) / away)
        seen.append(list(zip(view.tolist(), local, strict=True)))
    return seen


def _strongest(layout: Layout, pose: gtsam.Pose3, points: Array, random: np.random.Generator) -> NDArray[np.int64]:
    """The first points in view that are not missed; more are looked at only until enough are found."""
    found = np.zeros(0, dtype=np.int64)
    for start in range(0, len(points), AT_ONCE):
        view = start + layout.sensor.sees(layout.solid, pose, points[start : start + AT_ONCE])
        found = np.concatenate([found, view[random.random(len(view)) >= layout.sensor.drop_out]])
        if len(found) >= SEEN:
            break
    return found[:SEEN]


def _forgotten(seen: list[Sightings], first: int, last: int) -> list[Sightings]:
    """A later stretch without recognition of earlier landmarks, and never recognised later."""
    new = 1 + max((point for points in seen for point, _ in points), default=0)
    return [
        [(point + new if first <= k <= last else point, at) for point, at in points] for k, points in enumerate(seen)
    ]


def _followed(seen: list[Sightings]) -> list[Sightings]:
    """Identities that last as long as a point is followed."""
    last: dict[int, int] = {}
    name: dict[int, int] = {}
    found, n_names = [], 0
    for k, points in enumerate(seen):
        for point, _ in points:
            if k - last.get(point, -landmarks.LOST_AFTER - 1) > landmarks.LOST_AFTER:
                name[point], n_names = n_names, n_names + 1
            last[point] = k
        found.append([(name[point], at) for point, at in points])
    return found


def _ends(pairs: Pairs) -> tuple[int, int]:
    """First and last keyframe of the later pass."""
    return int(pairs[:, 1].min()), int(pairs[:, 1].max())
