"""The agreement of two views: points that both see, and points in free space of the other.

A beam tells more than its end: the whole way to the end is free. A point that lies in another sensor's free space
contradicts the relative pose, and a point behind a surface of the other says nothing. So the agreement of two
views is the share of points, of those that the other must see, that the other does see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pgti_gtsam.mending.clouds import Points

BEAMS = 3.0
"""Angle, in those between neighbouring beams of a view, within which a beam sees what a point would hide."""

BESIDE = {2: 3, 3: 9}
"""Beams that are asked about a point, by dimension: all of those about its direction must end behind it."""

TURNED = 0.02
"""Angle, rad, by which a fit and the drift within a submap turn points. Points may lie apart by so much of their
distance, or beams that graze a wall would seem to see through the wall."""

AGREES = 0.9
"""Agreement of two views from which the sensors confirm a fit."""

MOST = 2000
"""Points of each cloud that are asked, evenly drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonView:
    """Agreement of two views.

    Attributes
    ----------
    agreement : float
        Share of points seen by both, of points that both must see; 0 without such points.
    seen : float
        Points seen by both, in points of the smaller cloud.
    """

    agreement: float
    seen: float

    @property
    def weight(self) -> float:
        """Points seen by both less points seen through, which count so much that the sum is 0 at `AGREES`."""
        if not self.agreement:
            return -np.inf
        return self.seen * (1 - (1 / self.agreement - 1) / (1 / AGREES - 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """The free space that a sensor sees: beams from the sensor to the points.

    Attributes
    ----------
    ends : KDTree
        Of the points that beams end at, m.
    directions : KDTree
        Of the beams, on the unit sphere.
    depths_m : (n,) float
        Length of every beam; a last one, infinite, is of no beam.
    spacing : float
        Distance between neighbouring beams on the unit sphere.
    """

    ends: KDTree
    directions: KDTree
    depths_m: NDArray[np.float64]
    spacing: float

    @classmethod
    def of(cls, points: Points) -> View:
        """The view of a sensor that sees some points, (n, 2) or (n, 3), n > 1, m."""
        depths = np.linalg.norm(points, axis=1)
        points, depths = points[depths > 0], depths[depths > 0]
        beams = points / depths[:, None]
        directions = KDTree(beams)
        return cls(
            ends=KDTree(points),
            directions=directions,
            depths_m=np.append(depths, np.inf),
            spacing=float(np.median(np.asarray(directions.query(beams, k=2)[0])[:, 1])),
        )


def common_view(views: tuple[View, View], points: tuple[Points, Points], tolerance_m: float) -> CommonView:
    """Compare two views.

    Parameters
    ----------
    views : two View
    points : two (m, d) float, m
        Points of the second submap, seen from the first sensor, and the reverse.
    tolerance_m : float
        How far apart points of the same surface may lie near the sensor; `TURNED` of the distance is added.
    """
    found = [_seen(view, drawn(others, MOST), tolerance_m) for view, others in zip(views, points, strict=True)]
    both, through, asked = (np.array(each) for each in zip(*found, strict=True))
    return CommonView(
        agreement=float(both.sum() / max(both.sum() + through.sum(), 1)),
        seen=float((both / np.maximum(asked, 1)).min()),
    )


def _seen(view: View, points: Points, tolerance_m: float) -> tuple[int, int, int]:
    """How many points of another cloud a view sees, sees through, and is asked for."""
    distances = np.linalg.norm(points, axis=1)
    points, distances = points[distances > tolerance_m], distances[distances > tolerance_m]
    allowed = tolerance_m + TURNED * distances
    is_near = np.asarray(view.ends.query(points, distance_upper_bound=allowed.max(initial=0.0))[0]) <= allowed

    # the nearest depth of the beams about a point's direction
    towards, n_beside = points / distances[:, None], BESIDE[points.shape[1]]
    found = view.directions.query(towards, k=n_beside, distance_upper_bound=BEAMS * view.spacing)
    chords, beside = np.asarray(found[0]), np.asarray(found[1])
    nearest = view.depths_m[beside].min(axis=1)
    is_through = ~is_near & np.isfinite(chords[:, 0]) & (distances < nearest - allowed)
    return int(is_near.sum()), int(is_through.sum()), len(points)


def drawn(points: Points, most: int) -> Points:
    """At most so many points, evenly.

    Parameters
    ----------
    points : Points
    most : int
        Points to keep.
    """
    return np.asarray(points[np.unique(np.linspace(0, len(points) - 1, most).round().astype(int))])
