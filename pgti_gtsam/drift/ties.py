"""Constraints between keyframes with their tolerances: odometry, closures and shared landmarks, in units of ρ."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import Keyframes
from pgti_gtsam.drift.units import Units, translation_of, variances_of
from pgti_gtsam.drift.upright import Upright
from pgti_gtsam.errors import NoRadiusError
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph

DRIFT = 0.03
"""Standard deviation of the odometry after one ρ travelled or one radian turned: 3 % of ρ, and 0.03 rad (1.7°). With
ρ = 4 m that is 12 cm and 1.7° for four metres of road, with ρ = 0.75 m it is 2 cm and 1.7° for a step indoors: worse
than what visual or wheel odometry is trusted with."""

STRETCH = 0.1
"""The same along the motion, on top: a step may be too long or too short. A scale that walks, as a single camera's
does, or wheels that slip err farther in this direction than in any other. On camera drives over a campus (seeds 1000
to 1003 of `scenarios.worlds`) true closures were lost without: 95 of 106 and 26 of 37 passed on two, all do with it."""

SHORTEST = 0.05
"""Least length of a step, in ρ: a standing robot drifts a little too."""

OFFSET, OFFSET_RAD = 0.125, 0.075
"""Standard deviation of what a closure measures, in ρ and in rad."""

FAR = 100.0
"""Standard deviation along a direction that a closure leaves open, in parts of the map's extent."""

HOLDING = int(EdgeSource.BETWEEN | EdgeSource.COVISIBILITY)
SKIP, ODOMETRY, COVISIBILITY = int(EdgeSource.SKIP), int(EdgeSource.ODOMETRY), int(EdgeSource.COVISIBILITY)
"""As plain numbers: flags of an enumeration cost a tenth of a large map's reading."""

Array = NDArray[np.float64]


class Offered(NamedTuple):
    """The relative pose that a closure measures, or that landmarks seen again imply.

    Attributes
    ----------
    first, second : int
        Keyframes, first < second.
    measured : gtsam.Pose2 or gtsam.Pose3
        Pose of the second seen from the first.
    unobservable : (d, k) float or None
        Directions in which the closure says nothing, orthonormal, in the tangent space of the second keyframe in ρ and
        rad; None where the closure fixes the whole pose.
    """

    first: int
    second: int
    measured: Any
    unobservable: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ties:
    """Constraints between keyframes, with their tolerances.

    Attributes
    ----------
    pairs : (m, 2) int
        Keyframes i and j of each tie, i < j.
    measured : tuple of m gtsam.Pose2 or gtsam.Pose3
        Pose of j seen from i.
    variances : (m, d) float
        In the tangent space of j, in GTSAM's order.
    slots : (m,) int
        Slot of the loop closure; −1 for odometry and shared landmarks.
    drifts : (m,) float
        Variance of the heading that a step of odometry gathers, rad²; zero for other ties.
    """

    pairs: NDArray[np.int64]
    measured: tuple[Any, ...]
    variances: Array
    slots: NDArray[np.int64]
    drifts: Array

    @property
    def closures(self) -> NDArray[np.int64]:
        """Whether each tie is a loop closure."""
        return np.flatnonzero(self.slots >= 0)

    def only(self, chosen: NDArray[np.bool_]) -> Ties:
        """Some of the ties."""
        own = np.flatnonzero(chosen)
        return Ties(
            pairs=self.pairs[own],
            measured=tuple(self.measured[k] for k in own.tolist()),
            variances=self.variances[own],
            slots=self.slots[own],
            drifts=self.drifts[own],
        )

    def joined(self, more: Ties) -> Ties:
        """These ties and more behind them."""
        return Ties(
            pairs=np.concatenate([self.pairs, more.pairs]),
            measured=self.measured + more.measured,
            variances=np.concatenate([self.variances, more.variances]),
            slots=np.concatenate([self.slots, more.slots]),
            drifts=np.concatenate([self.drifts, more.drifts]),
        )

    def levelled(self, body: Upright, unit: float) -> Ties:
        """The same ties between poses turned so that the z axis is the body's vertical, in space only.

        Parameters
        ----------
        body : Upright
        unit : float
            ρ, m.
        """
        turn = gtsam.Pose3(body.levelling, np.zeros(3))
        measured = tuple(turn.inverse().compose(z).compose(turn) for z in self.measured)
        variances, steps = self.variances.copy(), np.flatnonzero(self.drifts > 0)
        for k in steps.tolist():
            variances[k] = step_variances(measured[k], unit)
        variances[steps, :2] *= body.tilt**2
        return replace(self, measured=measured, variances=variances)


def ties_of(
    graph: gtsam.NonlinearFactorGraph, pose_graph: PoseGraph, keyframes: Keyframes, poses: Sequence[Any], unit: float
) -> Ties:
    """Odometry, closures and shared landmarks, of the edges in order.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    pose_graph : PoseGraph
    keyframes : Keyframes
    poses : sequence of gtsam.Pose2 or gtsam.Pose3
        Those of the keyframes, all of one type.
    unit : float
        ρ, m.
    """
    keys = pose_graph.keys.tolist()
    planar = isinstance(poses[0], gtsam.Pose2)
    rows: list[tuple[tuple[int, int], Any, Array, int, float]] = []
    held = np.flatnonzero(pose_graph.edge_sources & HOLDING)
    own_slots = [pose_graph.edge_slots[k] for k in held.tolist()]
    known = zip(pose_graph.edges[held].tolist(), pose_graph.edge_sources[held].tolist(), own_slots, strict=True)
    tolerance = variances_of(OFFSET * unit, OFFSET_RAD, is_planar=planar)
    extent = max(float(np.ptp(pose_graph.positions, axis=0).max()), unit)
    far = variances_of(FAR * extent, FAR, is_planar=planar)
    for (i, j), source, slots in known:
        is_skip = bool(source & SKIP)
        measured = [(keyframes.measured(graph.at(slot), keys[i]), -1 if is_skip else slot) for slot in slots]
        found = [(_alike(z, planar), slot) for z, slot in measured if z is not None]

        # a step of the track drifts with its length
        if source & ODOMETRY:
            step = found[0][0] if found else poses[i].between(poses[j])
            rows.append(((i, j), step, step_variances(step, unit), -1, _drift(step, unit) ** 2))
            continue

        # a closure, or what both keyframes see, holds as well as a match; a range, say, fixes no pose
        for z, slot in found or [(poses[i].between(poses[j]), -1)]:
            is_fixed = found or source & COVISIBILITY or _fix_pose([graph.at(slot) for slot in slots], len(tolerance))
            rows.append(((i, j), z, tolerance if is_fixed else far, slot, 0.0))
    return Ties(
        pairs=np.array([row[0] for row in rows], dtype=np.int64).reshape(-1, 2),
        measured=tuple(row[1] for row in rows),
        variances=np.array([row[2] for row in rows]).reshape(-1, 3 if planar else 6),
        slots=np.array([row[3] for row in rows], dtype=np.int64),
        drifts=np.array([row[4] for row in rows]),
    )


def _fix_pose(factors: Sequence[Any], d: int) -> bool:
    """Whether factors between two keyframes say as many numbers as a relative pose has; two of a class say the same."""
    numbers: dict[type, int] = {type(factor): factor.dim() for factor in factors}
    return sum(numbers.values()) >= d


def step_variances(step: Any, unit: float) -> Array:
    """Variances of a step of odometry, in the tangent space of the end, (d,): errors grow with the step's length.

    Parameters
    ----------
    step : gtsam.Pose2 or gtsam.Pose3
        Measured, lengths in ρ.
    unit : float
        ρ, m.
    """
    drift, planar = _drift(step, unit), isinstance(step, gtsam.Pose2)
    variances = variances_of(drift * unit, drift, is_planar=planar)
    variances[translation_of(planar)] += np.square(STRETCH / DRIFT * drift * unit * _direction(step))
    return variances


def _drift(step: Any, unit: float) -> float:
    """Standard deviation of the heading that a step gathers, rad."""
    return DRIFT * float(np.sqrt(max(_length(step) / unit, _angle(step), SHORTEST)))


def free_space_unit(pose_graph: PoseGraph) -> float:
    """ρ: the median of the positive radii, m.

    Raises
    ------
    NoRadiusError
        No radius is positive.
    """
    positive = pose_graph.radii[pose_graph.radii > 0]
    if not len(positive):
        raise NoRadiusError("expected at least one positive radius, got none: nothing says how large free space is")
    return float(np.median(positive))


def closures_of(offered: Sequence[Offered], units: Units) -> Ties:
    """Closures as ties, numbered in order; poses of the plane become poses in space where the map is spatial.

    Axes along which a closure leaves a direction open get the variance of that direction.

    Parameters
    ----------
    offered : sequence of Offered
    units : Units
    """
    poses, turn = [_alike(tie.measured, units.is_planar) for tie in offered], units.levelling
    pairs = np.array([tie[:2] for tie in offered], dtype=np.int64).reshape(-1, 2)
    found = level_closures(pairs, [turn.inverse().compose(z).compose(turn) for z in poses], units)
    for k, covariance in unobservable_of(offered, units).items():
        found.variances[k] += np.diag(covariance)
    return found


def unobservable_of(offered: Sequence[Offered], units: Units) -> dict[int, Array]:
    """Covariances, (d, d), along the directions that closures leave open, by place; wider than the map is.

    Parameters
    ----------
    offered : sequence of Offered
    units : Units
    """
    scale = np.sqrt(units.variances(1.0, 1.0))
    far = FAR * np.sqrt(np.diag(units.spread).max()) / scale.min()
    found = {}
    for k, tie in enumerate(offered):
        if tie.unobservable is not None:
            own = tie.unobservable if len(tie.unobservable) == len(scale) else _in_space(tie.unobservable)
            directions = units.levelling.inverse().AdjointMap() @ (far * scale[:, None] * own)
            found[k] = directions @ directions.T
    return found


def _in_space(directions: Array) -> Array:
    """Directions of the plane, x, y and heading, as directions in space, turns first."""
    found = np.zeros((6, directions.shape[1]))
    found[[3, 4, 2]] = directions
    return found


def level_closures(pairs: NDArray[np.int64], measured: Iterable[Any], units: Units) -> Ties:
    """Closures as ties, numbered in order, whose measured poses are the model's already.

    Parameters
    ----------
    pairs : (k, 2) int
    measured : iterable of k gtsam.Pose2 or gtsam.Pose3
    units : Units
    """
    return Ties(
        pairs=pairs,
        measured=tuple(measured),
        variances=np.tile(units.variances(OFFSET, OFFSET_RAD), (len(pairs), 1)),
        slots=np.arange(len(pairs)),
        drifts=np.zeros(len(pairs)),
    )


def _alike(pose: Any, is_planar: bool) -> Any:
    """A pose of the plane as a pose in space where the map is spatial."""
    return pose if is_planar or isinstance(pose, gtsam.Pose3) else gtsam.Pose3(pose)


def _direction(step: Any) -> Array:
    """Unit vector of a step's motion in the axes of its end; zero without motion."""
    moved = np.asarray(step.rotation().unrotate(step.translation()))
    return np.asarray(moved / max(float(np.linalg.norm(moved)), np.finfo(float).tiny))


def _length(step: Any) -> float:
    return float(np.linalg.norm(step.translation()))


def _angle(step: Any) -> float:
    """Angle that a relative pose turns by, rad."""
    return (
        abs(step.theta())
        if isinstance(step, gtsam.Pose2)
        else float(np.linalg.norm(gtsam.Rot3.Logmap(step.rotation())))
    )


def adjoints(poses: Sequence[Any], pairs: NDArray[np.int64]) -> Array:
    """A = Ad(T_j⁻¹ T_i) of every pair, (k, d, d).

    Parameters
    ----------
    poses : sequence of object
    pairs : (k, 2) int
    """
    d = 3 if isinstance(poses[0], gtsam.Pose2) else 6
    return np.array([poses[j].between(poses[i]).AdjointMap() for i, j in pairs.tolist()]).reshape(-1, d, d)


def errors_of(poses: Sequence[Any], pairs: NDArray[np.int64], measured: Sequence[Any]) -> Array:
    """e = Log(z⁻¹ T_i⁻¹ T_j) of some ties, (m, d).

    Parameters
    ----------
    poses : sequence of object
    pairs : (m, 2) int
    measured : sequence of object
    """
    d = 3 if isinstance(poses[0], gtsam.Pose2) else 6
    errors = [
        type(z).Logmap(z.between(poses[i].between(poses[j])))
        for (i, j), z in zip(pairs.tolist(), measured, strict=True)
    ]
    return np.array(errors).reshape(-1, d)


def alike(poses: Iterable[Any]) -> tuple[Any, ...]:
    """All poses of the plane, or all in space."""
    found = list(poses)
    if all(isinstance(pose, gtsam.Pose2) for pose in found):
        return tuple(found)
    return tuple(gtsam.Pose3(pose) if isinstance(pose, gtsam.Pose2) else pose for pose in found)
