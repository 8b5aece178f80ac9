"""Submaps: the points of a few neighbouring keyframes in the frame of the middle keyframe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.mending.clouds import Clouds, Points
from pgti_gtsam.track import Track

REACH = 2.0
"""Way along the track, in ρ, from the middle of a submap to either end. Odometry drifts little over so short a way:
by the drift model 4 % of ρ, less than a tenth of the distance that points are matched over."""

MOST = 6
"""Keyframes at most on either side of the middle."""

ENOUGH = 5_000
"""Points from which a keyframe needs no neighbours: submaps are for thin scans."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Submap:
    """Points about a keyframe, in the keyframe's frame.

    Attributes
    ----------
    view : (n, 2) or (n, 3) float, m
        Points that the keyframe itself sees.
    points : (m, 2) or (m, 3) float, m
        Points of the keyframe and its neighbours.
    """

    view: Points
    points: Points


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Submaps:
    """Submaps of a map's keyframes.

    Attributes
    ----------
    clouds : Clouds
    keys : sequence of int
        Of all n keyframes.
    poses : sequence of gtsam.Pose2 or gtsam.Pose3
        Of all keyframes.
    track : Track
    unit_m : float
        ρ.
    """

    clouds: Clouds
    keys: Sequence[int]
    poses: Sequence[Any]
    track: Track
    unit_m: float

    def at(self, index: int) -> Submap:
        """The submap about a keyframe that has points."""
        view, middle = self.clouds.points(self.keys[index]), self.poses[index]
        if len(view) >= ENOUGH:
            return Submap(view=view, points=view)
        near = [k for k in self._neighbours(index) if self.keys[k] in self.clouds]
        parts = [moved(self.clouds.points(self.keys[k]), middle.between(self.poses[k])) for k in near]
        return Submap(view=view, points=np.concatenate([view, *parts]))

    def _neighbours(self, index: int) -> list[int]:
        """Keyframes on the same chain within reach, at most so many on either side."""
        order, way, chain = self.track.order, self.track.way_m, self.track.chain
        middle, found = int(np.flatnonzero(order == index)[0]), []
        for side in (order[middle + 1 :], order[:middle][::-1]):
            for k in side[:MOST].tolist():
                if chain[k] != chain[index] or abs(way[k] - way[index]) > REACH * self.unit_m:
                    break
                found.append(k)
        return found


def moved(points: Points, pose: Any) -> Points:
    """Points in the frame of `pose`, moved to the frame around it: in the plane for planar points, else in space.

    Parameters
    ----------
    points : (n, 2) or (n, 3) float
    pose : gtsam.Pose2 or gtsam.Pose3
    """
    if points.shape[1] == 2:
        planar = pose if isinstance(pose, gtsam.Pose2) else gtsam.Pose2(pose.x(), pose.y(), pose.rotation().yaw())
        matrix = planar.matrix()
    else:
        matrix = (gtsam.Pose3(pose) if isinstance(pose, gtsam.Pose2) else pose).matrix()
    d = points.shape[1]
    return np.asarray(points @ matrix[:d, :d].T + matrix[:d, d])
