"""The relative pose of two keyframes by their common view: generalised ICP of small_gicp from several starts.

Generalised ICP: Segal, Haehnel and Thrun, RSS 2009; small_gicp: Koide, JOSS 2024 (doi:10.21105/joss.06948). Lengths
are in ρ, the map's free radius: a room's scans and a street's clouds are matched alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pgti_gtsam.errors import MissingDependencyError
from pgti_gtsam.mend.common_view import CommonView, common_view, drawn
from pgti_gtsam.mend.starts import starts
from pgti_gtsam.mend.submap import Submap, moved

RESOLUTION = 1 / 10
"""Edge of the voxels that points are thinned out to, ρ."""

LAYERS = (-1, 0, 1)
"""Heights at which a scan of one plane is repeated, in three voxels each: walls stand upright."""

NEIGHBOURS = 20
"""Points that a surface is estimated from."""

DISTANCES = (4 / 3, 0.4)
"""How far apart points of one surface may lie, ρ: at first, and then."""

MAX_ITERATIONS = 30

MATCHED = 0.2
"""How far apart, in ρ, points of one surface lie at most where submaps fit."""

TRIED = 4
"""Starts from which points are aligned: those whose points lie nearest to others."""

ASKED = 150
"""Points by which starts are compared."""

SAME, SAME_RAD = 0.3, float(np.radians(5))
"""How far apart, in ρ and rad, two fits are one."""

SURFACE = 2e-3
"""Variance across a surface that small_gicp grants a pair of points, m²."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """How two submaps fit together.

    Attributes
    ----------
    pose : gtsam.Pose2 or gtsam.Pose3
        Of the second keyframe seen from the first.
    stiffness : (d, d) float
        Mean square by which a motion of the second submap moves a point across the surface of its match, in
        ρ², in the tangent space of the second keyframe in GTSAM's order, with lengths in ρ. Along an axis of the
        translation: the share of surfaces that face the axis.
    matched : float
        Share of the second submap's points that found a counterpart.
    residual_m : float
        Root mean square distance of the matches across their surfaces.
    view : CommonView
        The common view of the two keyframes at that pose.
    rival : CommonView or None
        The same of the best fit elsewhere.
    """

    pose: Any
    stiffness: Array
    matched: float
    residual_m: float
    view: CommonView
    rival: CommonView | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cloud:
    """A submap in the form of small_gicp."""

    submap: Submap
    points: Any
    tree: Any
    unit_m: float

    @classmethod
    def of(cls, submap: Submap, unit_m: float) -> Cloud:
        """Thin out the points of a submap and estimate their surfaces.

        Parameters
        ----------
        submap : Submap
        unit_m : float
            The free radius ρ, m.
        """
        voxel = RESOLUTION * unit_m
        points = submap.points
        if points.shape[1] == 2:
            points = np.concatenate([np.pad(points, ((0, 0), (0, 1)), constant_values=3 * voxel * k) for k in LAYERS])
        cloud, tree = load_small_gicp().preprocess_points(points, voxel, NEIGHBOURS, 1)
        return cls(submap=submap, points=cloud, tree=tree, unit_m=unit_m)


def align(first: Cloud, second: Cloud, predicted: Any, covariance: Array) -> Alignment | None:
    """Fit the second submap to the first.

    Parameters
    ----------
    first, second : Cloud
    predicted : gtsam.Pose2 or gtsam.Pose3
        Pose of the second keyframe seen from the first.
    covariance : (d, d) float
        Of the prediction, in the tangent space of the second keyframe: where to start from.

    Returns
    -------
    Alignment or None
        The fit whose views agree best; None where no start leads to a fit.
    """
    if min(len(each) for end in (first, second) for each in (end.submap.view, end.submap.points)) < NEIGHBOURS:
        return None
    chosen = _best(first, second, starts(predicted, covariance, first.unit_m))
    fits = [fit for start in chosen if (fit := _fitted(first, second, start)) is not None]
    if not fits:
        return None
    fits.sort(key=lambda fit: -fit.view.seen)
    others = [fit for fit in fits[1:] if not _is_same(fit.pose, fits[0].pose, first.unit_m)]
    return replace(fits[0], rival=others[0].view if others else None)


def _best(first: Cloud, second: Cloud, tried: Sequence[Any]) -> list[Any]:
    """The predicted pose, and the poses at which the points of the two submaps lie nearest, each by itself."""
    if len(tried) == 1:
        return list(tried)
    reach = DISTANCES[0] * first.unit_m
    tree, some = KDTree(first.submap.points), drawn(second.submap.points, ASKED)
    apart = np.array([np.minimum(tree.query(moved(some, pose))[0], reach).mean() for pose in tried])
    return [tried[0], *(tried[k] for k in np.argsort(apart, kind="stable")[:TRIED].tolist() if k)]


def _fitted(first: Cloud, second: Cloud, start: Any) -> Alignment | None:
    """The fit that a start leads to, by points that lie far apart at first."""
    found, matrix = None, (gtsam.Pose3(start) if isinstance(start, gtsam.Pose2) else start).matrix()
    for distance in DISTANCES:
        found = load_small_gicp().align(
            first.points,
            second.points,
            first.tree,
            matrix,
            "GICP",
            distance * first.unit_m,
            1,
            MAX_ITERATIONS,
        )
        matrix = found.T_target_source
    if found is None or not found.num_inliers or not np.isfinite(matrix).all():
        return None

    # in the map's own kind of pose
    space, own = gtsam.Pose3(matrix), list(range(6))
    pose: Any = space
    if isinstance(start, gtsam.Pose2):
        pose, own = gtsam.Pose2(space.x(), space.y(), space.rotation().yaw()), [3, 4, 2]
    scale = np.array([1 / first.unit_m] * 3 + [1.0] * 3)
    stiffness = np.asarray(found.H) * np.outer(scale, scale) * SURFACE / found.num_inliers

    # what the two say of each other there
    ends = first.submap, second.submap
    theirs = moved(ends[1].points, pose), moved(ends[0].points, pose.inverse())
    return Alignment(
        pose=pose,
        stiffness=stiffness[np.ix_(own, own)],
        matched=found.num_inliers / second.points.size(),
        residual_m=float(np.sqrt(found.error * 2 * SURFACE / found.num_inliers)),
        view=common_view((ends[0].view, ends[1].view), theirs, MATCHED * first.unit_m),
    )


def _is_same(one: Any, other: Any, unit_m: float) -> bool:
    off = one.between(other)
    turn = off.rotation()
    angle = abs(turn.theta()) if isinstance(off, gtsam.Pose2) else np.linalg.norm(gtsam.Rot3.Logmap(turn))
    return bool(np.linalg.norm(off.translation()) <= SAME * unit_m and angle <= SAME_RAD)


def load_small_gicp() -> Any:
    """Import small_gicp.

    Raises
    ------
    MissingDependencyError
    """
    try:
        import small_gicp
    except ImportError as error:
        raise MissingDependencyError(
            f"small_gicp cannot be loaded ({error}): install it with  pip install 'pgti-gtsam[match]', or match "
            "elsewhere with --proposals and --loops"
        ) from error
    return small_gicp
