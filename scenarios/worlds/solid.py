"""Walls and floors as parallelograms: building, casting rays, drawing points."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.dense_map import load_open3d

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hits:
    """Where rays end: (n, 3) m, with the surfaces' (n, 3) unit normals, and (n,) distances, infinite for a miss."""

    points: Array
    normals: Array
    distances: Array


@dataclass(frozen=True, eq=False)
class Solid:
    """Surfaces of a world: (n, 3, 3), a corner of each parallelogram and its two sides, m."""

    faces: Array

    @functools.cached_property
    def _scene(self) -> Any:
        o3d = load_open3d()
        corner, u, v = self.faces.transpose(1, 0, 2)
        vertices = np.stack([corner, corner + u, corner + u + v, corner + v], axis=1).reshape(-1, 3)
        starts = 4 * np.arange(len(self.faces))[:, None]
        triangles = np.concatenate([starts + [0, 1, 2], starts + [0, 2, 3]])
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(triangles.astype(np.uint32)))
        return scene

    def cast(self, origins: Array, directions: Array) -> Hits:
        """Rays from (n, 3) m along (n, 3) unit vectors.

        Parameters
        ----------
        origins : (n, 3) float
            In m.
        directions : (n, 3) float
            Unit vectors.
        """
        o3d = load_open3d()
        rays = np.hstack([origins, directions]).astype(np.float32)
        found = self._scene.cast_rays(o3d.core.Tensor(rays))
        distances = found["t_hit"].numpy().astype(float)
        normals = found["primitive_normals"].numpy().astype(float)
        with np.errstate(invalid="ignore"):
            points = origins + distances[:, None] * directions
        return Hits(points=points, normals=normals, distances=distances)

    def parts(self, places: Array, others: Array) -> NDArray[np.bool_]:
        """Whether a surface lies between each pair of places: (n,) bool.

        Parameters
        ----------
        places, others : (n, 3) float
            In m.
        """
        away = np.linalg.norm(others - places, axis=1)
        directions = (others - places) / np.maximum(away, np.finfo(float).tiny)[:, None]
        return np.asarray(self.cast(places, directions).distances < away)

    def draw(self, random: np.random.Generator, per_m2: float) -> tuple[Array, Array]:
        """Points drawn evenly from all surfaces, (n, 3) m, and the (n, 3) unit normals there.

        Parameters
        ----------
        random : np.random.Generator
        per_m2 : float
            Points a square metre.
        """
        across = np.cross(self.faces[:, 1], self.faces[:, 2])
        areas = np.linalg.norm(across, axis=1)
        face = random.choice(len(areas), round(per_m2 * areas.sum()), p=areas / areas.sum())
        u, v = random.random((2, len(face), 1))
        points = self.faces[face, 0] + u * self.faces[face, 1] + v * self.faces[face, 2]
        return points, (across / areas[:, None])[face]


def box(low: Sequence[float], high: Sequence[float]) -> Array:
    """All six sides of a box with edges along the axes.

    Parameters
    ----------
    low, high : sequence of float
    """
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    x, y, z = np.diag(high - low)
    return np.array(
        [[low, x, y], [low, x, z], [low, y, z], [high, -x, -y], [high, -x, -z], [high, -y, -z]], dtype=float
    )


def plate(corner: Sequence[float], along: Sequence[float], across: Sequence[float]) -> Array:
    """A single parallelogram: a floor, a ramp, a thin wall.

    Parameters
    ----------
    corner : sequence of float
    along, across : sequence of float
    """
    return np.array([[corner, along, across]], dtype=float)
