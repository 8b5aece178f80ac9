"""Alignment of two clouds by point-to-plane ICP (Chen and Medioni, Image and Vision Computing 1992).

Open3D has the same, but adds up in an order that its threads settle: where ICP converges slowly a last digit decides
whether a step more is taken, and where a bare plane leaves motions free the pivot's last digit decides whether the pose
flies away. Sums have one order here, and a free motion is not made, so that a seed names one world.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.spatial import cKDTree

from scenarios.worlds.solid import Array

MOST_STEPS = 30
"""Steps after which an alignment is taken as it is; Open3D's default."""

SETTLED = 1e-6
"""Change of fitness, and of the root mean square distance in m, below which a step is the last; Open3D's default."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cloud:
    """Points of surfaces, (n, 3) m, their unit normals, (n, 3), and the points' tree."""

    points: Array
    normals: Array
    tree: cKDTree

    @staticmethod
    def of(points: Array, normals: Array) -> Cloud:
        """Points with their tree.

        Parameters
        ----------
        points, normals : (n, 3) float
        """
        return Cloud(points=points, normals=normals, tree=cKDTree(points))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aligned:
    """Pose of the later cloud in the earlier frame, and the share of later points that find a counterpart."""

    pose: gtsam.Pose3
    fitness: float


def icp(earlier: Cloud, later: Cloud, first: gtsam.Pose3, reach_m: float) -> Aligned:
    """The pose that lays a later cloud upon an earlier cloud, sought from a first pose.

    Parameters
    ----------
    earlier, later : Cloud
    first : gtsam.Pose3
    reach_m : float
        Largest distance between points that belong together.
    """
    pose, before = first, (0.0, np.inf)
    for _ in range(MOST_STEPS + 1):
        # counterparts, and how well they fit
        places = later.points @ pose.rotation().matrix().T + pose.translation()
        distances, nearest = earlier.tree.query(places, distance_upper_bound=reach_m)
        met = np.isfinite(distances)
        fitness = float(met.sum() / max(len(met), 1))
        now = fitness, float(np.sqrt(np.square(distances[met]).mean())) if met.any() else 0.0
        if not met.any() or all(abs(a - b) < SETTLED for a, b in zip(before, now, strict=True)):
            break

        # least squares of the distances across the surfaces, the shortest step where they leave one free
        before, normals = now, earlier.normals[nearest[met]]
        off = np.einsum("ka,ka->k", places[met] - earlier.points[nearest[met]], normals)
        jacobian = np.hstack([np.cross(places[met], normals), normals])
        moments, pull = np.einsum("ka,kb->ab", jacobian, jacobian), np.einsum("ka,k->a", jacobian, off)
        x = np.linalg.lstsq(moments, -pull, rcond=None)[0]
        pose = gtsam.Pose3(gtsam.Rot3.Ypr(x[2], x[1], x[0]), x[3:]).compose(pose)
    return Aligned(pose=pose, fitness=fitness)
