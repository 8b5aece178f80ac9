"""A map without closures, as it was when any of its keyframes was the last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import typed_value
from pgti_gtsam.factor_graphs import factors_of, graph_of, keys_of
from pgti_gtsam.gate.survey import Radii
from pgti_gtsam.gate.yardstick import pose_at, poses_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Past:
    """A map without closures, as it was when any of its keyframes was the last.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
    factors : list
        Those of the graph, empty slots left out.
    since : (f,) int
        Place of the last keyframe of every factor.
    tied : (n,) int
        Place of the keyframe with which the map up to each keyframe holds all of its keyframes: one that only later
        ones tie, as the first of a session, comes with those.
    values : gtsam.Values
        Optimum of all factors.
    first_seen : dict of int to int
        Place of the keyframe with which every variable came.
    keys : (n,) uint64
        Keyframes in their order.
    radii
        As in `from_gtsam`.
    """

    graph: gtsam.NonlinearFactorGraph
    factors: list[Any]
    since: NDArray[np.int64]
    tied: NDArray[np.int64]
    values: gtsam.Values
    first_seen: dict[int, int]
    keys: NDArray[np.uint64]
    radii: Radii | None

    @classmethod
    def of(
        cls,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        keys: NDArray[np.uint64],
        radii: Radii | None,
    ) -> Past:
        """Date every factor by its last keyframe, every other variable by its first factor."""
        place = {int(key): k for k, key in enumerate(keys)}
        factors = factors_of(graph)
        since = [max((place[key] for key in keys_of(factor) if key in place), default=0) for factor in factors]
        first_seen, tied = dict(place), np.full(len(keys), len(keys) - 1)
        for factor, time in zip(factors, since, strict=True):
            for key in keys_of(factor):
                if key in place:
                    tied[place[key]] = min(time, tied[place[key]])
                first_seen[key] = place.get(key, min(time, first_seen.get(key, time)))
        return cls(
            graph=graph,
            factors=factors,
            since=np.array(since),
            tied=np.maximum.accumulate(tied),
            values=values,
            first_seen=first_seen,
            keys=keys,
            radii=radii,
        )

    def until(self, last: int, known: gtsam.Values) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, Radii | None]:
        """Factors, values and radii of the map up to a keyframe, or the first one after it with which all are tied.

        Poses and points that are not known yet follow the last known keyframe: they are moved with it, rigidly.
        """
        while self.tied[last] > last:
            last = int(self.tied[last])
        graph = graph_of(self.factors[k] for k in np.flatnonzero(self.since <= last).tolist())
        values, motion = gtsam.Values(self.values), self._motion(known)
        for key, time in self.first_seen.items():
            if time > last or known.exists(key):
                values.erase(key)
            elif motion is not None:
                _move(values, key, motion)
        values.insert(known)
        radii = self.radii
        if isinstance(radii, Mapping):
            radii = {key: radius for key, radius in radii.items() if self.first_seen.get(int(key), 0) <= last}
        return graph, values, radii

    def _motion(self, known: gtsam.Values) -> Any:
        """Motion of the last known keyframe since it was placed without closures; None without one."""
        there = next((int(key) for key in self.keys[::-1] if known.exists(int(key))), None)
        if there is None:
            return None
        return pose_at(poses_of(known), there) * pose_at(poses_of(self.values), there).inverse()


def _move(values: gtsam.Values, key: int, motion: Any) -> None:
    """Move a pose or point of the motion's space in place; values of other types stay."""
    planar = isinstance(motion, gtsam.Pose2)
    pose = typed_value(values, "Pose2" if planar else "Pose3", key)
    point = None if pose else typed_value(values, "Point2" if planar else "Point3", key)
    if pose is not None:
        values.update(key, motion * pose)
    elif point is not None:
        values.erase(key)
        (values.insert if planar else values.insertPoint3)(key, motion.transformFrom(point))
