"""How far two keyframes may lie apart, given every tie of a map: the odometry's errors in units of free space.

Covariances are often wrong, by a factor or in kind. The model does without the caller's. Every step of the
track gets the error that a poor odometer of any make keeps, a white error that grows with the way in units of the free
radius ρ, and every closure a part of ρ. With T the keyframes' poses, a tie (i, j) that measures z has the error
e = Log(z⁻¹ T_i⁻¹ T_j), which the perturbations T Exp(δ) change by δ_j − A δ_i, A = Ad(T_j⁻¹ T_i). The information
matrix Σ Jᵀ R⁻¹ J of all ties is a graph Laplacian with matrix weights, and the covariance of the relative pose of two
keyframes is the effective resistance between them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.families import holds_position
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.drift.ties import Offered, Ties, alike, closures_of, free_space_unit, ties_of, unobservable_of
from pgti_gtsam.drift.units import Units
from pgti_gtsam.drift.upright import chained, upright
from pgti_gtsam.factor_graphs import factors_of, keys_of
from pgti_gtsam.places import places_on
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.track import track_of

DRAWN = 1000
"""Pairs of keyframes that the spread of a map is drawn from."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftModel:
    """A map's keyframes and their ties.

    Attributes
    ----------
    units : Units
    poses : tuple of n gtsam.Pose2 or gtsam.Pose3
        The estimate.
    ties : Ties
    held : (n,) bool
        Keyframes whose position in the world a factor fixes.
    along : (n,) float
        Coordinate of every keyframe along the track, from `places_on`.
    unobservable : mapping from int to (d, d) float
        Covariance along the directions that a tie leaves open, by tie, for those that leave some.
    """

    units: Units
    poses: tuple[Any, ...]
    ties: Ties
    held: NDArray[np.bool_]
    along: Array
    unobservable: Mapping[int, Array] = field(default_factory=dict)

    def extended(self, offered: Sequence[Offered]) -> DriftModel:
        """The same map with more ties, as closures numbered from 0."""
        n = len(self.ties.pairs)
        more = {n + k: covariance for k, covariance in unobservable_of(offered, self.units).items()}
        ties = self.ties.joined(closures_of(offered, self.units))
        return replace(self, ties=ties, unobservable={**self.unobservable, **more})

    def unobserved(self, ties: NDArray[np.int64]) -> Array:
        """Covariance along the directions that some ties leave open, (k, d, d).

        Parameters
        ----------
        ties : (k,) int
        """
        found = np.zeros((len(ties), *self.units.spread.shape))
        for k, tie in enumerate(ties.tolist() if self.unobservable else ()):
            found[k] = self.unobservable.get(tie, 0.0)
        return found


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
    ties = ties_of(graph, pose_graph, keyframes, poses, unit)
    levelling: Any = gtsam.Pose2()
    tilt = 1.0

    # in space the z axis becomes the body's vertical
    if isinstance(poses[0], gtsam.Pose3):
        steps = ties.only(ties.drifts > 0)
        body = upright(*chained(len(poses), steps.pairs, steps.measured, steps.drifts))
        levelling = gtsam.Pose3(body.levelling, np.zeros(3))
        ties, tilt = ties.levelled(body, unit), body.tilt
    poses = tuple(pose.compose(levelling) for pose in poses)
    return DriftModel(
        units=Units(unit_m=unit, levelling=levelling, tilt=tilt, spread=_spread(poses)),
        poses=poses,
        ties=ties,
        held=_held(graph, keyframes.index),
        along=places_on(pose_graph, track_of(pose_graph)),
    )


def _spread(poses: Sequence[Any]) -> Array:
    """Mean squares of the relative poses of keyframes drawn at random, on a diagonal, (d, d)."""
    first, second = np.random.default_rng(0).integers(len(poses), size=(2, DRAWN))
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    apart = np.array([_parted(poses[i].between(poses[j])) for i, j in pairs])
    return np.diag(np.square(apart).mean(axis=0))


def _parted(pose: Any) -> Array:
    """Translation and rotation vector of a relative pose, in GTSAM's order, (d,)."""
    if isinstance(pose, gtsam.Pose2):
        return np.array([pose.x(), pose.y(), pose.theta()])
    return np.concatenate([gtsam.Rot3.Logmap(pose.rotation()), pose.translation()])


def _held(graph: gtsam.NonlinearFactorGraph, index: dict[int, int]) -> NDArray[np.bool_]:
    """Keyframes whose position in the world a factor fixes."""
    held = np.zeros(len(index), dtype=bool)
    for factor in factors_of(graph):
        if holds_position(type(factor).__name__):
            held[[index[key] for key in keys_of(factor) if key in index]] = True
    return held
