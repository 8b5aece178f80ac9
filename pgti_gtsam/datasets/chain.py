"""Odometry, loop closures, and poses placed by chaining one factor after the other.

Odometry is what links two poses that follow each other in the order of their keys, in either direction:
keys may skip numbers and factors may point backwards. Poses whose symbols have different letters, as those of
two robots or sessions have, do not follow each other. Every other factor between poses is a closure.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.dataset import Dataset

Pose: TypeAlias = Any  # a gtsam.Pose2 or gtsam.Pose3: typing knows no pair of them that multiply
LETTER = 56  # bits of a symbol's index; its letter stands above them
BETWEEN = (gtsam.BetweenFactorPose2, gtsam.BetweenFactorPose3)


class Between(NamedTuple):
    """Slot, keys and a BetweenFactorPose2 or BetweenFactorPose3, which measures the second from the first."""

    slot: int
    first: int
    second: int
    factor: Any

    @property
    def ends(self) -> tuple[int, int]:
        """The smaller and the larger key."""
        return min(self.first, self.second), max(self.first, self.second)

    def step_from(self, key: int) -> Pose:
        """The other pose seen from ``key``, which is one of the two."""
        measured = self.factor.measured()
        return measured if key == self.first else measured.inverse()


def poses_of(values: gtsam.Values) -> dict[int, Pose]:
    """All poses of ``values``, by ascending key."""
    planar, spatial = gtsam.utilities.allPose2s(values), gtsam.utilities.allPose3s(values)
    poses: dict[int, Pose] = {key: planar.atPose2(key) for key in planar.keys()}  # noqa: SIM118  no mapping
    poses |= {key: spatial.atPose3(key) for key in spatial.keys()}  # noqa: SIM118
    return dict(sorted(poses.items()))


def insert_point(values: gtsam.Values, key: int, point: NDArray[np.float64]) -> None:
    """Add a point (2,) or (3,), in space as a Point3 proper.

    ``Values.insert`` takes any array for a vector of dynamic size, which ``Values.update`` then confuses with
    a point. Python has no way to add a Point2 proper; GTSAM's factors read the vector all the same.
    """
    insert = values.insertPoint3 if len(point) == 3 else values.insert
    insert(key, np.asarray(point, dtype=float))


def between_factors(graph: gtsam.NonlinearFactorGraph) -> list[Between]:
    """The factors between two different poses, by slot; empty slots are passed over."""
    found = []
    for slot in range(graph.size()):
        factor = graph.at(slot)
        if isinstance(factor, BETWEEN):
            first, second = factor.keys()
            if first != second:
                found.append(Between(slot, first, second, factor))
    return found


def odometry_factors(dataset: Dataset) -> list[Between]:
    """The factors between poses that are no closures of the dataset, by slot."""
    closures = set(dataset.closures)
    return [between for between in between_factors(dataset.graph) if between.slot not in closures]


def neighbouring(keys: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs of ascending keys that follow each other and whose symbols have one letter."""
    return [(before, key) for before, key in pairwise(keys) if before >> LETTER == key >> LETTER]


def odometry_links(keys: Sequence[int], betweens: Iterable[Between]) -> dict[tuple[int, int], Between]:
    """The first factor that links each pair of neighbours in ``keys``, which ascend."""
    neighbours = set(neighbouring(keys))
    links: dict[tuple[int, int], Between] = {}
    for between in betweens:
        if between.ends in neighbours:
            links.setdefault(between.ends, between)
    return links


def closure_slots(keys: Sequence[int], betweens: Iterable[Between]) -> tuple[int, ...]:
    """Slots of the factors that link no neighbours in ``keys``, by the later of their poses."""
    neighbours = set(neighbouring(keys))
    closures = [between for between in betweens if between.ends not in neighbours]
    return tuple(between.slot for between in sorted(closures, key=lambda closure: (closure.ends[1], closure.slot)))


def place_by_factors(keys: Sequence[int], betweens: Sequence[Between], origin: Pose) -> tuple[dict[int, Pose], int]:
    """Place poses by chaining factors from the first key, through as few closures as the graph allows.

    A breadth-first search in which odometry costs nothing and a closure one. Poses that no chain of
    factors reaches are left out.

    Parameters
    ----------
    keys : sequence of int
        Ascending keys, not empty.
    betweens : sequence of Between
        The factors.
    origin : Pose2 or Pose3
        Where the first key is put.

    Returns
    -------
    poses : dict of int to pose
    closures_used : int
        How many closures had to stand in for missing odometry.
    """
    neighbours = set(neighbouring(keys))
    leaving: dict[int, list[Between]] = {}
    for between in betweens:
        for key in between.ends:
            leaving.setdefault(key, []).append(between)

    # along odometry first, across a closure where nothing else leads
    poses: dict[int, Pose] = {}
    closures_used = 0
    queue: deque[tuple[int, Pose, bool]] = deque([(keys[0], origin, False)])
    while queue:
        key, pose, is_closure = queue.popleft()
        if key in poses:
            continue
        poses[key] = pose
        closures_used += is_closure
        for between in leaving.get(key, ()):
            other = between.second if key == between.first else between.first
            if other not in poses:
                is_closure = between.ends not in neighbours
                add = queue.append if is_closure else queue.appendleft
                add((other, pose * between.step_from(key), is_closure))
    return poses, closures_used


def chain_odometry(dataset: Dataset) -> gtsam.Values:
    """First values as an odometer alone gives them: the drift is back that closures had taken out.

    The first pose keeps its value, every later one is chained to the one before it. Where odometry is
    missing, the next stretch starts at its stored pose. A landmark moves rigidly with the earliest pose
    that sees it; all other variables keep their values.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    gtsam.Values
        A value for every variable of ``dataset.values``, which stays untouched.
    """
    stored = poses_of(dataset.values)
    keys = list(stored)
    links = odometry_links(keys, odometry_factors(dataset))
    chained = {key: stored[key] for key in keys[:1]}
    for before, key in pairwise(keys):
        link = links.get((before, key))
        chained[key] = stored[key] if link is None else chained[before] * link.step_from(before)
    values = gtsam.Values(dataset.values)
    for key, pose in chained.items():
        values.update(key, pose)
    for point, key in earliest_observers(dataset.graph, stored).items():
        position = point_of(values, point, stored[key])
        if position is not None:
            values.erase(point)
            insert_point(values, point, chained[key].transformFrom(stored[key].transformTo(position)))
    return values


def earliest_observers(graph: gtsam.NonlinearFactorGraph, poses: Mapping[int, Pose]) -> dict[int, int]:
    """The earliest pose that shares a factor of two variables with each variable that is no pose."""
    earliest: dict[int, int] = {}
    for slot in range(graph.size()):
        factor = graph.at(slot)
        keys = [] if factor is None or isinstance(factor, BETWEEN) else factor.keys()
        if len(keys) == 2 and (keys[0] in poses) != (keys[1] in poses):
            pose, other = keys if keys[0] in poses else reversed(keys)
            earliest[other] = min(pose, earliest.get(other, pose))
    return earliest


def point_of(values: gtsam.Values, key: int, pose: Pose) -> NDArray[np.float64] | None:
    """The value of a key as a point of the space that ``pose`` lives in, or None where it is none."""
    try:
        point = values.atPoint2(key) if isinstance(pose, gtsam.Pose2) else values.atPoint3(key)
    except RuntimeError:  # GTSAM has no other way to ask for a value's type
        return None
    return np.asarray(point, dtype=float)
