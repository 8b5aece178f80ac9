"""Poses placed by chaining factors between poses.

The file tells odometry from loop closures, or else `track.roles`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.adapter.values import insert_point
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.factor_graphs import BETWEEN
from pgti_gtsam.track import Tie, closure_edges, roles, track_of

Pose: TypeAlias = Any  # a gtsam.Pose2 or gtsam.Pose3: typing knows no pair of them that multiply
LETTER = 56  # bits of a symbol's index; its letter stands above them


class Between(NamedTuple):
    """Slot, keys and a BetweenFactorPose2 or BetweenFactorPose3 from the first key to the second."""

    slot: int
    first: int
    second: int
    factor: Any

    @property
    def ends(self) -> tuple[int, int]:
        """The smaller and the larger key."""
        return min(self.first, self.second), max(self.first, self.second)

    def step_from(self, key: int) -> Pose:
        """The other pose seen from ``key``, either key of the edge."""
        measured = self.factor.measured()
        return measured if key == self.first else measured.inverse()


def poses_of(values: gtsam.Values) -> dict[int, Pose]:
    """All poses of ``values``, by ascending key."""
    planar, spatial = gtsam.utilities.allPose2s(values), gtsam.utilities.allPose3s(values)
    poses: dict[int, Pose] = {key: planar.atPose2(key) for key in planar.keys()}  # noqa: SIM118  no mapping
    poses |= {key: spatial.atPose3(key) for key in spatial.keys()}  # noqa: SIM118
    return dict(sorted(poses.items()))


class Tracked(NamedTuple):
    """Keys of the poses chain by chain, and slots of the loop closures.

    Closures that no file names are in the order of their later poses.
    """

    chains: list[list[int]]
    closures: tuple[int, ...]


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


def tracked(dataset: Dataset) -> Tracked:
    """The chains of a dataset and its loop closures: those that the file names, or else those of `track.roles`.

    Raises
    ------
    PgtiError
        As of `from_gtsam`.
    """
    keys = list(poses_of(dataset.values))
    betweens = {between.slot: between for between in between_factors(dataset.graph)}
    if not betweens:
        return Tracked([keys], ())
    sources = {"between", "covisibility"}
    pose_graph = from_gtsam(dataset.graph, dataset.values, radii=1.0, edges=sources, closures=dataset.closures)
    chain = track_of(pose_graph).chain
    chains = [np.flatnonzero(chain == number).tolist() for number in range(int(chain.max()) + 1)]
    rows = np.flatnonzero(closure_edges(pose_graph)).tolist()
    found = [slot for row in rows for slot in pose_graph.edge_slots[row] if slot in betweens]
    found.sort(key=lambda slot: (betweens[slot].ends[1], slot))
    closures = tuple(found) if dataset.closures is None else dataset.closures
    return Tracked([[keys[k] for k in rows] for rows in chains], closures)


def closure_slots(dataset: Dataset) -> tuple[int, ...]:
    """Slots of the loop closures, as in `Tracked`; raises what `tracked` raises."""
    return tracked(dataset).closures if dataset.closures is None else dataset.closures


def place_by_factors(keys: Sequence[int], betweens: Sequence[Between], origin: Pose) -> tuple[dict[int, Pose], int]:
    """Place poses by chaining factors from the first key, along steps of the track as far as these lead.

    A breadth-first search in which a step costs nothing and another factor 1. Poses that no chain of
    factors reaches are left out. (SciPy's csgraph takes an edge of length zero for no edge.)

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
    others_used : int
        Factors that are no steps and replaced missing steps.
    """
    place = {key: k for k, key in enumerate(keys)}
    ties = [Tie(place[i], place[j], between.step_from(i)) for between in betweens for i, j in [between.ends]]
    stepping = roles(np.array(keys, dtype=np.uint64), ties).is_step.tolist()
    leaving: dict[int, list[tuple[Between, bool]]] = {}
    for between, is_step in zip(betweens, stepping, strict=True):
        for key in between.ends:
            leaving.setdefault(key, []).append((between, is_step))

    # along steps first, across another factor where nothing else leads
    poses: dict[int, Pose] = {}
    others_used = 0
    queue: deque[tuple[int, Pose, bool]] = deque([(keys[0], origin, True)])
    while queue:
        key, pose, by_step = queue.popleft()
        if key in poses:
            continue
        poses[key] = pose
        others_used += not by_step
        for between, is_step in leaving.get(key, ()):
            other = between.second if key == between.first else between.first
            if other not in poses:
                add = queue.appendleft if is_step else queue.append
                add((other, pose * between.step_from(key), is_step))
    return poses, others_used


def chain_odometry(dataset: Dataset) -> gtsam.Values:
    """First values from odometry alone: with the drift that closures had taken out.

    The first pose keeps its value, every later pose is chained to the latest earlier pose that odometry ties. Where
    odometry is missing, the next stretch starts at its stored pose. A landmark moves rigidly with the earliest pose
    with a sighting; all other variables keep their values.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    gtsam.Values
        A value for every variable of ``dataset.values``, which stays untouched.
    """
    stored, closures = poses_of(dataset.values), set(closure_slots(dataset))
    leading = _leading([between for between in between_factors(dataset.graph) if between.slot not in closures])
    chained: dict[int, Pose] = {}
    for key in stored:
        link = leading.get(key)
        chained[key] = stored[key] if link is None else chained[link.ends[0]] * link.step_from(link.ends[0])
    values = gtsam.Values(dataset.values)
    for key, pose in chained.items():
        values.update(key, pose)
    for point, key in earliest_observers(dataset.graph, stored).items():
        position = point_of(values, point, stored[key])
        if position is not None:
            values.erase(point)
            insert_point(values, point, chained[key].transformFrom(stored[key].transformTo(position)))
    return values


def _leading(odometry: Sequence[Between]) -> dict[int, Between]:
    """The odometry that leads to each key from the latest earlier key."""
    leading: dict[int, Between] = {}
    for between in odometry:
        before, key = between.ends
        if key not in leading or before > leading[key].ends[0]:
            leading[key] = between
    return leading


def earliest_observers(graph: gtsam.NonlinearFactorGraph, poses: Mapping[int, Pose]) -> dict[int, int]:
    """The earliest pose that shares a factor of two variables with each variable that is no pose.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    poses : mapping
        Poses by key.
    """
    earliest: dict[int, int] = {}
    for slot in range(graph.size()):
        factor = graph.at(slot)
        keys = [] if factor is None or isinstance(factor, BETWEEN) else factor.keys()
        if len(keys) == 2 and (keys[0] in poses) != (keys[1] in poses):
            pose, other = keys if keys[0] in poses else reversed(keys)
            earliest[other] = min(pose, earliest.get(other, pose))
    return earliest


def point_of(values: gtsam.Values, key: int, pose: Pose) -> NDArray[np.float64] | None:
    """The value of a key as a point of the space of ``pose``, or None where the value is no point.

    Parameters
    ----------
    values : gtsam.Values
    key : int
    pose : Pose
        Any pose of the map, for the dimension.
    """
    try:
        point = values.atPoint2(key) if isinstance(pose, gtsam.Pose2) else values.atPoint3(key)
    except RuntimeError:  # GTSAM has no other way to ask for a value's type
        return None
    return np.asarray(point, dtype=float)
