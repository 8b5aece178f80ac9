"""The agreement of two views: points that both see, and points in free space of the other.

A beam tells more than its end: the whole way to the end is free. A point that lies in another sensor's free space
contradicts the relative pose, and a point behind a surface of the other says nothing. So the agreement of two
views is the share of points, of those that the other must see, that the other does see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from pgti_gtsam.mend.clouds import Points

BEAMS = 3.0
"""Angle, in those between neighbouring beams of a view, within which a beam sees what a point would hide."""

BESIDE = {2: 3, 3: 9}
"""Beams that are asked about a point, by dimension: all of those about its direction must end behind it."""

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


def common_view(views: tuple[Points, Points], points: tuple[Points, Points], tolerance_m: float) -> CommonView:
    """Compare two views.

    Parameters
    ----------
    views : two (n, d) float, m
        Points seen from either sensor, in the sensor's own frame.
    points : two (m, d) float, m
        Points of the second submap, seen from the first sensor, and the reverse.
    tolerance_m : float
        How far apart points of the same surface may lie.
    """
    found = [_seen(view, drawn(others, MOST), tolerance_m) for view, others in zip(views, points, strict=True)]
    both, through, asked = (np.array(each) for each in zip(*found, strict=True))
    return CommonView(
        agreement=float(both.sum() / max(both.sum() + through.sum(), 1)),
        seen=float((both / np.maximum(asked, 1)).min()),
    )


def _seen(view: Points, points: Points, tolerance_m: float) -> tuple[int, int, int]:
    """How many points of another cloud a view sees, sees through, and is asked for."""
    depths, distances = np.linalg.norm(view, axis=1), np.linalg.norm(points, axis=1)
    view, depths = view[depths > 0], depths[depths > 0]
    points, distances = points[distances > tolerance_m], distances[distances > tolerance_m]
    beams, towards = view / depths[:, None], points / distances[:, None]
    away = np.asarray(KDTree(view).query(points, distance_upper_bound=tolerance_m)[0])
    is_near = away <= tolerance_m

    # the nearest depth of the beams about a point's direction
    tree = KDTree(beams)
    spacing = float(np.median(np.asarray(tree.query(beams, k=2)[0])[:, 1]))
    found = tree.query(towards, k=BESIDE[view.shape[1]], distance_upper_bound=BEAMS * spacing)
    chords, beside = np.asarray(found[0]), np.asarray(found[1])
    nearest = np.append(depths, np.inf)[beside].min(axis=1)
    is_through = ~is_near & np.isfinite(chords[:, 0]) & (distances < nearest - tolerance_m)
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
