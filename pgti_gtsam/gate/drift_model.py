"""How far two keyframes may lie apart, given every tie of a map: the odometry's errors in units of free space.

Covariances are often wrong, by a factor or in kind. The model does without the caller's. It grants every step of the
track what a poor odometer of any make still keeps, a white error that grows with the way in units of the free radius
ρ, and every closure a part of ρ. With T the keyframes' poses, a tie (i, j) that measures z has the error
e = Log(z⁻¹ T_i⁻¹ T_j), which the perturbations T Exp(δ) change by δ_j − A δ_i, A = Ad(T_j⁻¹ T_i). The information
matrix Σ Jᵀ R⁻¹ J of all ties is a graph Laplacian with matrix weights, and the covariance of the relative pose of two
keyframes is the effective resistance between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import between_factor, factors_of, keys_of
from pgti_gtsam.gate.ties import Ties, adjoints, alike, closures_of, errors_of, free_space_unit, ties_of, variances_of
from pgti_gtsam.gate.upright import chained, upright
from pgti_gtsam.places import places_on
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.block_inverse import (
    TOGETHER,
    BlockFactor,
    factorise,
    own_products,
    products,
    solve,
)
from pgti_gtsam.spectral.elimination_tree import EliminationTree, analyse
from pgti_gtsam.spectral.laplacian import connected_components
from pgti_gtsam.track import track_of

ANCHOR = 1e-4
"""Standard deviation in ρ and rad of the pose that each part of the map is held at. No relative pose depends on it; a
loose anchor would let the whole map swing, and what is asked for would drown in that."""

HELD = 0.5
"""Standard deviation of a position that a factor of one variable holds, in ρ: a satellite receiver, say."""

MAX_ITERATIONS = 40
"""Levenberg-Marquardt steps to the model's optimum. Where closures are false there is no good one, nor need."""

CURVED = 0.25
"""How far, in ρ, a correction may bend the map beyond what linear predictions hold for, before a new optimum."""

DRAWN = 1000
"""Pairs of keyframes that the spread of a map is drawn from."""

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class DriftModel:
    """A map's keyframes and what holds them together.

    Attributes
    ----------
    unit_m : float
        ρ.
    poses : tuple of n gtsam.Pose2 or gtsam.Pose3
        The estimate.
    ties : Ties
    held : (n,) bool
        Keyframes whose position a factor of one variable holds.
    along : (n,) float
        Coordinate of every keyframe along its track, as `places_on` has it.
    levelling : gtsam.Pose2 or gtsam.Pose3
        Turn Q that took the caller's poses T to the model's, T Q, whose z axis is the body's vertical.
    """

    unit_m: float
    poses: tuple[Any, ...]
    ties: Ties
    held: NDArray[np.bool_]
    along: Array
    levelling: Any

    def extended(self, offered: Sequence[tuple[int, int, Any]]) -> DriftModel:
        """The same map with more ties that measure poses, as closures numbered from 0: i < j, and j seen from i."""
        more = closures_of(offered, self.unit_m, self.levelling, is_planar=self.is_planar)
        mine = self.ties
        ties = Ties(
            pairs=np.concatenate([mine.pairs, more.pairs]),
            measured=mine.measured + more.measured,
            variances=np.concatenate([mine.variances, more.variances]),
            slots=np.concatenate([mine.slots, more.slots]),
            drifts=np.concatenate([mine.drifts, more.drifts]),
        )
        return replace(self, ties=ties)

    @property
    def is_planar(self) -> bool:
        """Whether the poses are Pose2."""
        return isinstance(self.poses[0], gtsam.Pose2)

    @property
    def translation(self) -> slice:
        """Where the translation stands in a tangent vector."""
        return slice(0, 2) if self.is_planar else slice(3, 6)

    def variances(self, length: float, angle: float) -> Array:
        """Squares of a length in ρ and of an angle in rad, in GTSAM's order, (d,)."""
        return variances_of(length * self.unit_m, angle, is_planar=self.is_planar)

    def bends(self, moved: Array) -> bool:
        """Whether corrections, (k, d), turn the map so far that linear predictions fail: extent θ² / 2."""
        turned = np.delete(moved, np.arange(moved.shape[1])[self.translation], axis=1)
        extent = float(np.sqrt(np.diag(self.spread)[self.translation].max()))
        return bool(extent * np.square(turned).max() / 2 > CURVED * self.unit_m)

    @cached_property
    def spread(self) -> Array:
        """Covariance of the relative pose of keyframes drawn at random, axis by axis, (d, d)."""
        first, second = np.random.default_rng(0).integers(len(self.poses), size=(2, DRAWN))
        pairs = zip(first.tolist(), second.tolist(), strict=True)
        apart = np.array([_parted(self.poses[i].between(self.poses[j])) for i, j in pairs])
        return np.diag(np.square(apart).mean(axis=0))

    def settled(
        self,
        active: NDArray[np.bool_] | None = None,
        start: Settled | None = None,
    ) -> Settled:
        """The optimum of the ties.

        Parameters
        ----------
        active : (m,) bool, optional
            Ties that hold, all without; the others pull at nothing.
        start : Settled, optional
            Where to begin; the estimate without.

        Raises
        ------
        UnsolvableGraphError
            The ties are so stiff or so many that their information matrix is singular to rounding.
        """
        # which parts hang together, and in which order their keyframes are eliminated
        ties, n = self.ties, len(self.poses)
        active = np.ones(len(ties.pairs), dtype=bool) if active is None else active
        _, component = connected_components(n, ties.pairs[active])
        tree = analyse(n, np.unique(np.sort(ties.pairs[active], axis=1), axis=0))

        # the optimum, and the information there
        anchors = self._anchors(component)
        poses = self._optimum(active, component, self.poses if start is None else start.poses)
        try:
            factor, pull = self._linearised(tree, anchors, active, poses)
        except np.linalg.LinAlgError as error:
            raise UnsolvableGraphError(
                "expected odometry and closures that fix every keyframe, got a singular information matrix; "
                "look for closures with measurements far beyond the map"
            ) from error
        steps = solve(factor, pull)
        return Settled(
            model=self,
            active=active,
            poses=tuple(poses),
            component=self._placed(component),
            steps=steps,
            residuals=_residuals(ties, poses, steps),
            factor=factor,
        )

    def _optimum(self, active: NDArray[np.bool_], component: NDArray[np.int32], start: Sequence[Any]) -> list[Any]:
        """Poses by Levenberg-Marquardt: damped, for false closures tear at the map."""
        prior = gtsam.PriorFactorPose2 if self.is_planar else gtsam.PriorFactorPose3
        model = gtsam.noiseModel.Diagonal.Variances
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k in np.flatnonzero(active).tolist():
            i, j = self.ties.pairs[k].tolist()
            graph.push_back(between_factor(i, j, self.ties.measured[k], model(self.ties.variances[k])))
        for i in self._fixed(component).tolist():
            graph.push_back(prior(i, start[i], model(self.variances(ANCHOR, ANCHOR))))
        for i, pose in enumerate(start):
            values.insert(i, pose)
        found = optimised(
            graph, values, held=gtsam.NonlinearFactorGraph(), max_iterations=MAX_ITERATIONS, tolerance=1e-3
        )
        at = found.atPose2 if self.is_planar else found.atPose3
        return [at(i) for i in range(len(start))]

    def _anchors(self, component: NDArray[np.int32]) -> Array:
        """Diagonal blocks of what holds keyframes in the world: one of every part, and `held` ones."""
        information = np.zeros((len(self.poses), len(self.spread), len(self.spread)))
        information[self.held] = np.diag(1 / self.variances(HELD, np.inf))
        information[self._fixed(component)] += np.diag(1 / self.variances(ANCHOR, ANCHOR))
        return information

    def _placed(self, component: NDArray[np.int32]) -> NDArray[np.int32]:
        """Parts between which something predicts relative poses: those that are held in the world are one."""
        held = np.isin(component, component[self.held])
        return np.where(held, -1, component).astype(np.int32)

    def _fixed(self, component: NDArray[np.int32]) -> NDArray[np.int64]:
        """The keyframe that each part is fixed at: the first one that is held in the world, else the first of all."""
        order = np.argsort(~self.held, kind="stable")
        return np.asarray(order[np.unique(component[order], return_index=True)[1]])

    def _linearised(
        self, tree: EliminationTree, anchors: Array, active: NDArray[np.bool_], poses: Sequence[Any]
    ) -> tuple[BlockFactor, Array]:
        """Σ Jᵀ R⁻¹ J, J = (−A, I), and −Σ Jᵀ R⁻¹ e, (n, d), of the active ties."""
        ties = self.ties.only(active)
        pairs, carry, weights = ties.pairs, adjoints(poses, ties.pairs), 1 / ties.variances
        weighted, errors = weights[:, :, None] * carry, weights * errors_of(poses, ties.pairs, ties.measured)
        diagonal, pull = anchors.copy(), np.zeros(anchors.shape[:2])
        np.add.at(diagonal, pairs[:, 0], carry.swapaxes(1, 2) @ weighted)
        np.add.at(diagonal, pairs[:, 1], weights[:, :, None] * np.eye(weights.shape[1]))
        np.add.at(pull, pairs[:, 0], (carry.swapaxes(1, 2) @ errors[:, :, None])[:, :, 0])
        np.add.at(pull, pairs[:, 1], -errors)
        return factorise(tree, diagonal, pairs, -weighted.swapaxes(1, 2)), pull


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settled:
    """A drift model at its optimum.

    Attributes
    ----------
    model : DriftModel
    active : (m,) bool
        Ties that hold.
    poses : tuple of n gtsam.Pose2 or gtsam.Pose3
    component : (n,) int
        Connected part of every keyframe.
    steps : (n, d) float
        δ, a last, linear step of every keyframe.
    residuals : (m, d) float
        Error of every tie after it.
    factor : BlockFactor
        Of the information matrix.
    """

    model: DriftModel
    active: NDArray[np.bool_]
    poses: tuple[Any, ...]
    component: NDArray[np.int32]
    steps: Array
    residuals: Array
    factor: BlockFactor

    def covariances(self, pairs: NDArray[np.int64]) -> Array:
        """Covariance of the pose of j seen from i, in the tangent space of j: (k, d, d), NaN where no tie leads."""
        i, j = pairs.T
        found = own_products(self.factor, pairs, self._jacobians(pairs))
        return np.where((self.component[i] == self.component[j])[:, None, None], found, np.nan)

    def extended(self, offered: Sequence[tuple[int, int, Any]]) -> Settled:
        """The same optimum of a model with more ties, which do not hold yet: see `DriftModel.extended`."""
        model, n = self.model.extended(offered), len(self.active)
        added = model.ties.only(np.arange(n + len(offered)) >= n)
        return replace(
            self,
            model=model,
            active=np.concatenate([self.active, np.zeros(len(offered), dtype=bool)]),
            residuals=np.concatenate([self.residuals, _residuals(added, self.poses, self.steps)]),
        )

    def toggled(self, ties: NDArray[np.int64]) -> Settled:
        """The optimum where some ties that do not hold did, or where some that hold did not.

        To first order, δ = −H⁻¹ Jᵀ (±R + J H⁻¹ Jᵀ)⁻¹ e, as far as that is good enough; else the optimum itself.
        """
        active = self.active.copy()
        active[ties] = ~active[ties]
        pairs, d = self.model.ties.pairs[ties], len(self.model.spread)
        spread, residuals = self.joint_covariances([pairs])[0], self.residuals[ties]

        # what they pull with, and by how much that moves their keyframes against each other
        signs = np.where(self.active[ties], -1.0, 1.0)[:, None]
        tolerance = np.diag((signs * self.model.ties.variances[ties]).ravel())
        pulls = np.linalg.lstsq(tolerance + np.nan_to_num(spread), residuals.ravel())[0]
        moved = (tolerance @ pulls).reshape(-1, d) - residuals
        if np.isnan(spread).any() or self.model.bends(moved):
            return self.model.settled(active, self)

        # the step of all keyframes
        pull = np.zeros((len(self.poses), d))
        np.add.at(pull, pairs, -np.einsum("keab,ka->keb", self._jacobians(pairs), pulls.reshape(-1, d)))
        steps = self.steps + solve(self.factor, pull)
        poses = tuple(pose.retract(step) for pose, step in zip(self.poses, steps, strict=True))
        return replace(self, active=active, poses=poses)

    def joint_covariances(self, groups: Sequence[NDArray[np.int64]]) -> list[Array]:
        """Covariance of all relative poses of each group of pairs together, (g d, g d).

        NaN in the rows and columns of pairs that no tie leads between.
        """
        found, d = [], len(self.model.spread)
        for together in _batches([len(group) for group in groups], TOGETHER):
            pairs = np.concatenate([groups[k] for k in together])
            whole = products(self.factor, pairs, self._jacobians(pairs))
            lost = np.repeat(self.component[pairs[:, 0]] != self.component[pairs[:, 1]], d)
            whole[lost], whole[:, lost] = np.nan, np.nan
            ends = d * np.cumsum([0, *(len(groups[k]) for k in together)])
            found += [whole[a:b, a:b] for a, b in pairwise(ends.tolist())]
        return found

    def _jacobians(self, pairs: NDArray[np.int64]) -> Array:
        """(−A, I) of every pair, (k, 2, d, d)."""
        carry = adjoints(self.poses, pairs)
        return np.stack([-carry, np.broadcast_to(np.eye(carry.shape[1]), carry.shape)], axis=1)

    def allowances_m(self, covariances: Array) -> Array:
        """Standard deviation, m, of relative positions along their least certain axis, (k,); infinite where unknown.

        Parameters
        ----------
        covariances : (k, d, d) float
            As `covariances` gives them.
        """
        own = self.model.translation
        blocks = covariances[:, own, own]
        unknown: Any = np.isnan(blocks).any(axis=(1, 2))
        squares = np.linalg.eigvalsh(np.where(unknown[:, None, None], 0.0, blocks))[:, -1]
        return np.where(unknown, np.inf, np.sqrt(np.maximum(squares, 0.0)))


def _residuals(ties: Ties, poses: Sequence[Any], steps: Array) -> Array:
    """Error of every tie after a linear step: e + δ_j − A δ_i."""
    i, j = ties.pairs.T
    carried = adjoints(poses, ties.pairs) @ steps[i][:, :, None]
    return np.asarray(errors_of(poses, ties.pairs, ties.measured) + steps[j] - carried[:, :, 0])


def _batches(sizes: Sequence[int], most: int) -> Iterator[list[int]]:
    """Neighbours together, up to so much in sum; what is larger by itself stays alone."""
    batch: list[int] = []
    for k, size in enumerate(sizes):
        if batch and sum(sizes[b] for b in batch) + size > most:
            yield batch
            batch = []
        batch.append(k)
    if batch:
        yield batch


def drift_model(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, pose_graph: PoseGraph) -> DriftModel:
    """The drift model of a map as it stands.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Best an optimum of the graph: the model's own is sought from there.
    pose_graph : PoseGraph
        The same map as `from_gtsam` reads it.

    Raises
    ------
    NoRadiusError
        No keyframe has a radius.
    """
    unit, keyframes = free_space_unit(pose_graph), read_keyframes(values)
    poses = alike([keyframes.pose(int(key)) for key in pose_graph.keys])
    ties = ties_of(graph, pose_graph, poses, unit)
    levelling: Any = gtsam.Pose2()

    # in space the z axis becomes the body's vertical
    if isinstance(poses[0], gtsam.Pose3):
        steps = ties.only(ties.drifts > 0)
        body = upright(*chained(len(poses), steps.pairs, steps.measured, steps.drifts))
        levelling = gtsam.Pose3(body.levelling, np.zeros(3))
        ties = ties.levelled(body)
    return DriftModel(
        unit_m=unit,
        poses=tuple(pose.compose(levelling) for pose in poses),
        ties=ties,
        held=_held(graph, keyframes.index),
        along=places_on(pose_graph, track_of(pose_graph)),
        levelling=levelling,
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
