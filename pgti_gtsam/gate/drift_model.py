"""How far two keyframes may lie apart, given every tie of a map: the odometry's errors in units of free space.

Covariances are often wrong, by a factor or in kind. The model does without the caller's. Every step of the
track gets the error that a poor odometer of any make keeps, a white error that grows with the way in units of the free
radius ρ, and every closure a part of ρ. With T the keyframes' poses, a tie (i, j) that measures z has the error
e = Log(z⁻¹ T_i⁻¹ T_j), which the perturbations T Exp(δ) change by δ_j − A δ_i, A = Ad(T_j⁻¹ T_i). The information
matrix Σ Jᵀ R⁻¹ J of all ties is a graph Laplacian with matrix weights, and the covariance of the relative pose of two
keyframes is the effective resistance between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.factor_graphs import factors_of, keys_of
from pgti_gtsam.gate.ties import Ties, alike, closures_of, free_space_unit, ties_of, variances_of
from pgti_gtsam.gate.upright import chained, upright
from pgti_gtsam.places import places_on
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.track import track_of

CURVED = 0.25
"""How far, in ρ, a correction may bend the map beyond what linear predictions hold for, before a new optimum."""

DRAWN = 1000
"""Pairs of keyframes that the spread of a map is drawn from."""

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class DriftModel:
    """A map's keyframes and their ties.

    Attributes
    ----------
    unit_m : float
        ρ.
    poses : tuple of n gtsam.Pose2 or gtsam.Pose3
        The estimate.
    ties : Ties
    held : (n,) bool
        Keyframes whose position a factor of a single variable fixes.
    along : (n,) float
        Coordinate of every keyframe along the track, from `places_on`.
    levelling : gtsam.Pose2 or gtsam.Pose3
        Turn Q that took the caller's poses T to the model's, T Q, whose z axis is the body's vertical.
    tilt : float
        Drift of the odometry's tilt in parts of that of the heading: see `upright`.
    """

    unit_m: float
    poses: tuple[Any, ...]
    ties: Ties
    held: NDArray[np.bool_]
    along: Array
    levelling: Any
    tilt: float

    def extended(self, offered: Sequence[tuple[int, int, Any]]) -> DriftModel:
        """The same map with more ties that measure poses, as closures numbered from 0: i < j, and j seen from i."""
        more = closures_of(offered, self.unit_m, self.levelling, is_planar=self.is_planar)
        return replace(self, ties=self.ties.joined(more))

    @property
    def is_planar(self) -> bool:
        """Whether the poses are Pose2."""
        return isinstance(self.poses[0], gtsam.Pose2)

    @property
    def translation(self) -> slice:
        """Where the translation stands in a tangent vector."""
        return slice(0, 2) if self.is_planar else slice(3, 6)

    def variances(self, length: float, angle: float) -> Array:
        """Squares of a length in ρ and of an angle in rad, in GTSAM's order, (d,).

        Parameters
        ----------
        length : float
            In ρ.
        angle : float
            In rad.
        """
        return variances_of(length * self.unit_m, angle, is_planar=self.is_planar)

    def allowances_m(self, covariances: Array) -> Array:
        """Standard deviation, m, of relative positions along their least certain axis, (k,); infinite where unknown.

        Parameters
        ----------
        covariances : (k, d, d) float
            As from `Settled.covariances`.
        """
        own = self.translation
        blocks = covariances[:, own, own]
        unknown: Any = np.isnan(blocks).any(axis=(1, 2))
        squares = np.linalg.eigvalsh(np.where(unknown[:, None, None], 0.0, blocks))[:, -1]
        return np.where(unknown, np.inf, np.sqrt(np.maximum(squares, 0.0)))

    def moves_little(self, moved: Array) -> bool:
        """Whether corrections, (k, d), stay within linear steps, for keyframes and all that turns with them."""
        place = np.arange(moved.shape[1])[self.translation]
        turned, shifted = np.delete(moved, place, axis=1), moved[:, place]
        reach = np.linalg.norm(shifted, axis=1) + self.extent_m * np.linalg.norm(turned, axis=1)
        return bool(reach.max() <= CURVED * self.unit_m)

    def bends(self, moved: Array) -> bool:
        """Whether corrections, (k, d), turn the map so far that linear predictions fail: extent θ² / 2."""
        turned = np.delete(moved, np.arange(moved.shape[1])[self.translation], axis=1)
        return bool(self.extent_m * np.square(turned).max() / 2 > CURVED * self.unit_m)

    @property
    def extent_m(self) -> float:
        """How far keyframes lie apart along the map's longest axis."""
        return float(np.sqrt(np.diag(self.spread)[self.translation].max()))

    @cached_property
    def spread(self) -> Array:
        """Covariance of the relative pose of keyframes drawn at random, axis by axis, (d, d)."""
        first, second = np.random.default_rng(0).integers(len(self.poses), size=(2, DRAWN))
        pairs = zip(first.tolist(), second.tolist(), strict=True)
        apart = np.array([_parted(self.poses[i].between(self.poses[j])) for i, j in pairs])
        return np.diag(np.square(apart).mean(axis=0))


def drift_model(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, pose_graph: PoseGraph) -> DriftModel:
    """The drift model of a map at its present estimate.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Best an optimum of the graph: the model's own optimum is sought from there.
    pose_graph : PoseGraph
        The same map, from `from_gtsam`.

    Raises
    ------
    NoRadiusError
        No keyframe has a radius.
    """
    unit, keyframes = free_space_unit(pose_graph), read_keyframes(values)
    poses = alike([keyframes.pose(int(key)) for key in pose_graph.keys])
    ties = ties_of(graph, pose_graph, poses, unit)
    levelling: Any = gtsam.Pose2()
    tilt = 1.0

    # in space the z axis becomes the body's vertical
    if isinstance(poses[0], gtsam.Pose3):
        steps = ties.only(ties.drifts > 0)
        body = upright(*chained(len(poses), steps.pairs, steps.measured, steps.drifts))
        levelling = gtsam.Pose3(body.levelling, np.zeros(3))
        ties, tilt = ties.levelled(body, unit), body.tilt
    return DriftModel(
        unit_m=unit,
        poses=tuple(pose.compose(levelling) for pose in poses),
        ties=ties,
        held=_held(graph, keyframes.index),
        along=places_on(pose_graph, track_of(pose_graph)),
        levelling=levelling,
        tilt=tilt,
    )


def _parted(pose: Any) -> Array:
    """Translation and rotation vector of a relative pose, in GTSAM's order, (d,)."""
    if isinstance(pose, gtsam.Pose2):
        return np.array([pose.x(), pose.y(), pose.theta()])
    return np.concatenate([gtsam.Rot3.Logmap(pose.rotation()), pose.translation()])


def _held(graph: gtsam.NonlinearFactorGraph, index: dict[int, int]) -> NDArray[np.bool_]:
    """Keyframes with a factor of their own."""
    held = np.zeros(len(index), dtype=bool)
    for factor in factors_of(graph):
        keys = keys_of(factor)
        if len(keys) == 1 and keys[0] in index and isinstance(factor, _HOLDING):
            held[index[keys[0]]] = True
    return held


_HOLDING = (gtsam.PriorFactorPose2, gtsam.PriorFactorPose3, gtsam.GPSFactor)
