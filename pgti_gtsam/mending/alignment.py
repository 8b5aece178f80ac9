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
from pgti_gtsam.mending.common_view import CommonView, View, common_view, drawn
from pgti_gtsam.mending.starts import EXTENT, starts
from pgti_gtsam.mending.submap import Submap, moved

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

MOST_SLID = 20
"""Steps of twice `SAME` that a fit slides by to either side."""

SAME, SAME_RAD = 0.3, float(np.radians(5))
"""How far apart, in ρ and rad, two fits are one."""

DEGENERATE = 0.004
"""Stiffness below which a motion is free: small_gicp's own regularisation leaves 0.001 along a blank wall."""

FIT = 0.015
"""Error of a fit across its surfaces, in ρ. It is one for all points, not one for each: what a moved chair or the drift
within a submap puts aside does not average. Of the confirmed fits half err by less than 0.009."""

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
        translation: the share of surfaces that face the axis. Zero along motions that the prediction knows better than
        the surfaces, along which the pose is the predicted one.
    matched : float
        Share of the second submap's points that found a counterpart.
    residual_m : float
        Root mean square distance of the matches across their surfaces.
    view : CommonView
        The common view of the two keyframes at that pose.
    rival : CommonView or None
        The same of the best fit elsewhere, or of this one where it slides along a wall.
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
    view: View
    points: Any
    tree: Any
    unit_m: float

    @classmethod
    def of(cls, submap: Submap, unit_m: float) -> Cloud:
        """Thin out the points of a submap that is not thin (`is_thin`), and estimate their surfaces.

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
        return cls(submap=submap, view=View.of(submap.view), points=cloud, tree=tree, unit_m=unit_m)


def is_thin(submap: Submap) -> bool:
    """Whether a submap has too few points to estimate a surface from."""
    return min(len(submap.view), len(submap.points)) < NEIGHBOURS


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
        The fit with most in common view; None where no start leads to a fit.
    """
    chosen = _best(first, second, starts(predicted, covariance, first.unit_m))
    fits = [fit for start in chosen if (fit := _fitted(first, second, start, predicted, covariance)) is not None]
    if not fits:
        return None
    fits.sort(key=lambda fit: (max(fit.view.weight, 0.0), fit.view.seen * fit.view.agreement), reverse=True)
    others = [fit.view for fit in fits[1:] if not _is_same(fit.pose, fits[0].pose, first.unit_m)]
    others += _slid(first, second, fits[0], predicted, covariance)
    return replace(fits[0], rival=max(others, key=lambda view: view.weight, default=None))


def _best(first: Cloud, second: Cloud, tried: Sequence[Any]) -> list[Any]:
    """The predicted pose, and the poses at which the points of the two submaps lie nearest, each by itself."""
    if len(tried) == 1:
        return list(tried)
    reach = DISTANCES[0] * first.unit_m
    tree, some = KDTree(first.submap.points), drawn(second.submap.points, ASKED)
    apart = np.array([np.minimum(tree.query(moved(some, pose))[0], reach).mean() for pose in tried])
    return [tried[0], *(tried[k] for k in np.argsort(apart, kind="stable")[:TRIED].tolist() if k)]


def _fitted(first: Cloud, second: Cloud, start: Any, predicted: Any, covariance: Array) -> Alignment | None:
    """The fit that a start leads to, by points that lie far apart at first; along free motions as predicted."""
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

    # in the map's own kind of pose, with lengths in ρ
    space, own = gtsam.Pose3(matrix), list(range(6))
    pose: Any = space
    if isinstance(start, gtsam.Pose2):
        pose, own = gtsam.Pose2(space.x(), space.y(), space.rotation().yaw()), [3, 4, 2]
    scale = np.array([1 / first.unit_m] * 3 + [1.0] * 3)
    stiffness = (np.asarray(found.H) * np.outer(scale, scale) * SURFACE / found.num_inliers)[np.ix_(own, own)]

    # along motions that no surface holds the prediction stays
    scale = lengths(len(covariance), first.unit_m)
    squares, axes = np.linalg.eigh(stiffness)
    known = np.einsum("ak,ab,bk->k", axes, covariance / np.outer(scale, scale), axes)
    is_free = (squares < DEGENERATE) | (squares * known < FIT**2)
    free = axes[:, is_free]
    pose = pose.retract(scale * (free @ (free.T @ (pose.localCoordinates(predicted) / scale))))
    return Alignment(
        pose=pose,
        stiffness=(axes * np.where(is_free, 0.0, squares)) @ axes.T,
        matched=found.num_inliers / second.points.size(),
        residual_m=float(np.sqrt(found.error * 2 * SURFACE / found.num_inliers)),
        view=_view(first, second, pose),
    )


def _slid(first: Cloud, second: Cloud, fit: Alignment, predicted: Any, covariance: Array) -> list[CommonView]:
    """Common views of a fit that slides along its softest motion, as far as the prediction allows.

    A corridor fits at every door: surfaces that face aside tell a place from the next no better than the prediction.
    """
    unit = lengths(len(covariance), first.unit_m)
    motion = np.linalg.eigh(fit.stiffness)[1][:, 0]
    reach = EXTENT * float(np.sqrt(motion @ (covariance / np.outer(unit, unit)) @ motion))
    start = float(motion @ (np.asarray(type(predicted).Logmap(predicted.between(fit.pose))) / unit))
    steps = 2 * SAME * np.arange(-MOST_SLID, MOST_SLID + 1)
    steps = steps[(np.abs(start + steps) <= reach) & (steps != 0)]
    return [_view(first, second, fit.pose.retract(step * motion * unit)) for step in steps]


def lengths(dimension: int, unit_m: float) -> Array:
    """ρ and radians in m and radians, in the order of GTSAM's tangent space, (d,).

    Parameters
    ----------
    dimension : int
        3 in the plane, 6 in space.
    unit_m : float
        The free radius ρ, m.
    """
    return np.array([unit_m, unit_m, 1.0] if dimension == 3 else [1.0] * 3 + [unit_m] * 3)


def _view(first: Cloud, second: Cloud, pose: Any) -> CommonView:
    """Common view of two keyframes, the second at a pose."""
    theirs = moved(second.submap.points, pose), moved(first.submap.points, pose.inverse())
    return common_view((first.view, second.view), theirs, MATCHED * first.unit_m)


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
