"""Sightings of point landmarks given in Cartesian coordinates, as GTSAM's bearing-range factors.

GTSAM's wheel binds no factor between a pose and a Cartesian point. With the point written as a function
x(b, r) of bearing and range and K its Jacobian, the information in bearing and range is Kᵀ Λ K: nothing
is inverted, so unmeasured directions stay unmeasured.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.noise import information_models
from pgti_gtsam.datasets.text import Table, TextFile

Factory = Callable[[int, int, NDArray[np.float64], float, gtsam.noiseModel.Base], gtsam.NonlinearFactor]


class Sighting(NamedTuple):
    """Line, keys of pose and landmark, the point seen from the pose's body (2,) or (3,) in metres, the factor.

    A bearing or a range alone gives no point.
    """

    line: int
    pose: int
    landmark: int
    point: NDArray[np.float64] | None
    factor: gtsam.NonlinearFactor


def landmark_key(identifier: int) -> int:
    """Key of landmark ``identifier``: a symbol's own, else l or, below zero, m with the number.

    Poses have plain numbers or symbols of their own, so the two do not collide.
    """
    if identifier >= 1 << 56:
        return identifier
    return int(gtsam.symbol("m" if identifier < 0 else "l", abs(identifier)))


def landmark_identifier(key: int) -> int:
    """The identifier whose `landmark_key` is ``key``."""
    letter, index = chr(key >> 56), key & ((1 << 56) - 1)
    return {"l": index, "m": -index}.get(letter, key)


def planar_jacobian(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """∂(x, y)/∂(bearing, range) at points (n, 2) away from the origin, (n, 2, 2)."""
    ranges = np.linalg.norm(points, axis=1, keepdims=True)
    along = points / ranges
    across = np.stack([-points[:, 1], points[:, 0]], axis=1)
    return np.stack([across, along], axis=2)


def spatial_jacobian(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """∂(x, y, z)/∂(bearing, range) at points (n, 3) away from the origin, (n, 3, 3).

    Bearing is counted in the tangent basis of ``gtsam.Unit3`` at the point's direction, as GTSAM's reader does.
    """
    ranges = np.linalg.norm(points, axis=1)[:, None, None]
    bases = np.array([gtsam.Unit3(point).basis() for point in points]).reshape(-1, 3, 2)
    return np.concatenate([ranges * bases, points[:, :, None] / ranges], axis=2)


def cartesian(point: NDArray[np.float64], information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Λ with Kᵀ Λ K the information in bearing and range: the inverse of `sightings`; NaN at range zero.

    Parameters
    ----------
    point : (2,) float
    information : (2, 2) float
        Of x and y.
    """
    if not np.linalg.norm(point) > 0.0:
        return np.full_like(information, np.nan)
    jacobian = planar_jacobian if len(point) == 2 else spatial_jacobian
    inverse = np.linalg.inv(jacobian(point[None])[0])
    return np.asarray(inverse.T @ information @ inverse)


def planar_point(factor: Any) -> NDArray[np.float64]:
    """The point that a BearingRangeFactor2D measures, seen from its pose, (2,) m."""
    seen = factor.measured()
    return np.asarray(seen.range() * np.array([seen.bearing().c(), seen.bearing().s()]))


def spatial_point(factor: Any) -> NDArray[np.float64]:
    """The point that a BearingRangeFactor3D measures, seen from its pose, (3,) m."""
    seen = factor.measured()
    return np.asarray(seen.range() * np.asarray(seen.bearing().point3()))


def sightings(
    file: TextFile, table: Table, points: NDArray[np.float64], information: NDArray[np.float64]
) -> list[Sighting]:
    """Bearing-range factors of one kind of lines.

    Parameters
    ----------
    file, table : TextFile, Table
        The lines; ``table.ids`` starts with pose and landmark.
    points : (n, d) float
        Points that the pose sees, in the body frame, metres; d is 2 or 3.
    information : (n, d, d) float
        Of the points, in the same frame.

    Returns
    -------
    list of Sighting
        Sightings at range zero have no bearing and are left out with a note.
    """
    seen = np.linalg.norm(points, axis=1) > 0.0
    kept = table.where(seen)
    points, information = points[seen], information[seen]

    # from points to bearing and range
    is_planar = points.shape[1] == 2
    jacobians = planar_jacobian(points) if is_planar else spatial_jacobian(points)
    models = information_models(file, kept, jacobians.transpose(0, 2, 1) @ information @ jacobians)
    make: Factory = _planar_factor if is_planar else _spatial_factor
    ranges = np.linalg.norm(points, axis=1).tolist()
    found = []
    for line, ids, point, range_m, model in zip(
        kept.lines.tolist(), kept.ids.tolist(), points, ranges, models, strict=True
    ):
        pose, landmark = ids[0], landmark_key(ids[1])
        found.append(Sighting(line, pose, landmark, point, make(pose, landmark, point, range_m, model)))

    # what has no bearing
    lost = table.lines[~seen]
    if lost.size:
        file.notes.append(
            f"left out {lost.size} sightings at range zero, which have no bearing (first on line {lost[0]})"
        )
    return found


def _planar_factor(
    pose: int, landmark: int, point: NDArray[np.float64], range_m: float, model: gtsam.noiseModel.Base
) -> gtsam.NonlinearFactor:
    bearing = gtsam.Rot2.atan2(point[1], point[0])
    return gtsam.BearingRangeFactor2D(pose, landmark, bearing, range_m, model)


def _spatial_factor(
    pose: int, landmark: int, point: NDArray[np.float64], range_m: float, model: gtsam.noiseModel.Base
) -> gtsam.NonlinearFactor:
    return gtsam.BearingRangeFactor3D(pose, landmark, gtsam.Unit3(point), range_m, model)
