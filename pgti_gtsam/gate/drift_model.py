"""How far two keyframes may lie apart, given every tie of a map: the odometry's errors in units of free space.

Covariances are often wrong, by a factor or in kind. The model does without the caller's. It grants every step of the
track what a poor odometer of any make still keeps, a white error that grows with the way in units of the free radius
ρ, and every closure a part of ρ. With T the keyframes' poses, a tie (i, j) that measures z has the error
e = Log(z⁻¹ T_i⁻¹ T_j), which the perturbations T Exp(δ) change by δ_j − A δ_i, A = Ad(T_j⁻¹ T_i). The information matrix
Σ Jᵀ R⁻¹ J of all ties is a graph Laplacian with matrix weights, and the covariance of the relative pose of two
keyframes is the effective resistance between them.

From one factorisation follows what every closure would have been predicted to measure without it: with the residual r
at the optimum, its tolerance R and the covariance C of the relative pose, S = R − C, the closure misses that prediction
by e = R S⁻¹ r, whose drift covariance is R S⁻¹ R − R (leave-one-out residuals of linear least squares; Cook and
Weisberg, Residuals and Influence in Regression, 1982, chapter 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import read_keyframes, typed_value
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.spectral.block_inverse import BlockFactor, factorise, inverse_blocks, solve
from pgti_gtsam.spectral.elimination_tree import analyse
from pgti_gtsam.spectral.laplacian import connected_components

DRIFT = 0.03
"""Standard deviation of the odometry after one ρ travelled or one radian turned: 3 % of ρ, and 0.03 rad (1.7°). With
ρ = 4 m that is 12 cm and 1.7° for four metres of road, with ρ = 0.75 m it is 2 cm and 1.7° for a step indoors: worse than
what visual or wheel odometry is trusted with."""

SHORTEST = 0.05
"""Least length of a step, in ρ: a standing robot drifts a little too."""

OFFSET, OFFSET_RAD = 0.125, 0.075
"""Standard deviation of what a closure measures, in ρ and in rad."""

NEAR, NEAR_RAD = 0.5, 0.25
"""The same of a near miss, in ρ and in rad: a detector that matches places and not poses. It misses by less than the
free space, so that it ties what belongs together."""

NEAR_SHARE = 0.1
"""Of true closures, those that are near misses."""

ITERATIONS = 3
"""Gauss-Newton steps from the estimate to the model's optimum; each starts at the bottom of a valley already."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ties:
    """What holds keyframes together, and how well.

    Attributes
    ----------
    pairs : (m, 2) int
        Keyframes i and j of each tie.
    measured : tuple of m gtsam.Pose2 or gtsam.Pose3
        Pose of j seen from i.
    variances : (m, d) float
        In the tangent space of j, in GTSAM's order.
    slots : (m,) int
        Slot of the closure that the tie is; −1 for a tie that is not judged.
    """

    pairs: NDArray[np.int64]
    measured: tuple[Any, ...]
    variances: Array
    slots: NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
        Keyframes whose position a factor of one variable holds, to within `NEAR`.
    """

    unit_m: float
    poses: tuple[Any, ...]
    ties: Ties
    held: NDArray[np.bool_]

    @property
    def is_planar(self) -> bool:
        """Whether the poses are Pose2."""
        return isinstance(self.poses[0], gtsam.Pose2)

    def sigmas(self, length: float, angle: float) -> Array:
        """Standard deviations in GTSAM's order, (d,): of a length in ρ and an angle in rad."""
        shift = length * self.unit_m
        return np.array([shift, shift, angle] if self.is_planar else [angle] * 3 + [shift] * 3)

    def settled(self, active: NDArray[np.bool_], asked: NDArray[np.int64]) -> Settled:
        """The optimum of the active ties, with covariances that can be asked for.

        Parameters
        ----------
        active : (m,) bool
            Ties that hold; the others pull at nothing.
        asked : (k, 2) int
            Pairs of keyframes, beside those of ties, whose relative pose will be asked for.
        """
        pairs = self.ties.pairs
        n, together = len(self.poses), np.concatenate([pairs, asked])
        _, component = connected_components(n, pairs[active])
        tree = analyse(n, np.unique(np.sort(together[together[:, 0] != together[:, 1]], axis=1), axis=0))
        weights = np.where(active[:, None], 1 / self.ties.variances, 0.0)
        diagonal = self._held(component)
        poses = list(self.poses)
        for _ in range(ITERATIONS):
            errors = _errors(poses, pairs, self.ties.measured)
            carry = adjoints(poses, pairs)
            factor = self._factor(tree, diagonal, carry, weights)
            pull = np.zeros((n, diagonal.shape[1]))
            np.add.at(pull, pairs[:, 1], -weights * errors)
            np.add.at(pull, pairs[:, 0], np.einsum("kba,kb->ka", carry, weights * errors))
            steps = solve(factor, pull)
            poses = [pose.retract(step) for pose, step in zip(poses, steps, strict=True)]
        carry = adjoints(poses, pairs)
        return Settled(
            model=self,
            active=active,
            poses=tuple(poses),
            component=component,
            residuals=_errors(poses, pairs, self.ties.measured),
            factor=self._factor(tree, diagonal, carry, weights),
        )

    def _held(self, component: NDArray[np.int32]) -> Array:
        """Diagonal blocks of what holds the keyframes in the world: one in every component at least."""
        d = 3 if self.is_planar else 6
        information = np.zeros((len(self.poses), d, d))
        position = np.diag(1 / self.sigmas(NEAR, np.inf) ** 2)
        information[self.held] = position
        first = np.unique(component, return_index=True)[1]
        information[first] += np.diag(1 / self.sigmas(OFFSET, OFFSET_RAD) ** 2)
        return information

    def _factor(self, tree: Any, held: Array, carry: Array, weights: Array) -> BlockFactor:
        """Σ Jᵀ R⁻¹ J with J = (−A, I) for every tie."""
        pairs, diagonal = self.ties.pairs, held.copy()
        weighted = weights[:, :, None] * carry
        np.add.at(diagonal, pairs[:, 0], carry.swapaxes(1, 2) @ weighted)
        np.add.at(diagonal, pairs[:, 1], weights[:, :, None] * np.eye(weights.shape[1]))
        return factorise(tree, diagonal, pairs, -weighted.swapaxes(1, 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settled:
    """A drift model at its optimum."""

    model: DriftModel
    active: NDArray[np.bool_]
    poses: tuple[Any, ...]
    component: NDArray[np.int32]
    residuals: Array
    factor: BlockFactor

    def covariances(self, pairs: NDArray[np.int64]) -> Array:
        """Covariance of the pose of j seen from i, in the tangent space of j: (k, d, d), NaN where no tie leads."""
        i, j = pairs.T
        own, other, cross = (inverse_blocks(self.factor, ends) for ends in (np.c_[i, i], np.c_[j, j], pairs))
        carry = adjoints(self.poses, pairs)
        mixed = carry @ cross
        found = carry @ own @ carry.swapaxes(1, 2) + other - mixed - mixed.swapaxes(1, 2)
        return np.where((self.component[i] == self.component[j])[:, None, None], found, np.nan)

    def left_out(self) -> tuple[Array, Array]:
        """By how much every tie misses what all the others predict, (m, d), and that prediction's covariance.

        A tie that pulls at nothing misses by its residual. Where no other tie leads, the covariance is NaN.
        """
        ties = self.model.ties
        tolerance = ties.variances[:, None] * np.eye(ties.variances.shape[1])
        spread = self.covariances(ties.pairs)
        gain = tolerance @ np.linalg.inv(tolerance - spread)
        missed = np.where(self.active[:, None], np.einsum("kab,kb->ka", gain, self.residuals), self.residuals)
        return missed, np.where(self.active[:, None, None], gain @ tolerance - tolerance, spread)


def drift_model(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, pose_graph: PoseGraph) -> DriftModel:
    """The drift model of a map as it stands."""
    positive = pose_graph.radii[pose_graph.radii > 0]
    unit = float(np.median(positive)) if len(positive) else 1.0
    keyframes = read_keyframes(values)
    poses = [pose_of(keyframes, int(key)) for key in pose_graph.keys]
    planar = isinstance(poses[0], gtsam.Pose2)
    kind = gtsam.BetweenFactorPose2 if planar else gtsam.BetweenFactorPose3
    pairs, measured, variances, slots = [], [], [], []

    def add(i, j, z, length, angle, slot):
        shift = length * unit
        pairs.append((i, j)); measured.append(z); slots.append(slot)
        s = np.array([shift, shift, angle] if planar else [angle] * 3 + [shift] * 3)
        variances.append(s**2)

    for (i, j), source, own in zip(pose_graph.edges.tolist(), pose_graph.edge_sources.tolist(), pose_graph.edge_slots, strict=True):
        step = bool(source & EdgeSource.ODOMETRY)
        if not source & ~EdgeSource.TRACK:
            continue
        usable = [slot for slot in own if isinstance(graph.at(slot), kind)]
        found = []
        for slot in usable:
            f = graph.at(slot)
            z = f.measured()
            z = z if values_index(keyframes, f.keys()[0]) == i else z.inverse()
            found.append((z, slot))
        if not found:
            found = [(poses[i].between(poses[j]), -1)]
        if step:
            z = found[0][0]
            moved, turned = lengths_of(z)
            s = DRIFT * np.sqrt(max(moved / unit, turned, SHORTEST))
            add(i, j, z, s, s, -1)
        else:
            for z, slot in found:
                add(i, j, z, OFFSET, OFFSET_RAD, slot)
    held = np.zeros(len(poses), bool)
    return DriftModel(
        unit_m=unit, poses=tuple(poses),
        ties=Ties(pairs=np.array(pairs, np.int64).reshape(-1, 2), measured=tuple(measured), variances=np.array(variances).reshape(-1, 3 if planar else 6), slots=np.array(slots, np.int64)),
        held=held,
    )


def values_index(keyframes, key):
    return keyframes.index[key]


def pose_of(keyframes, key):
    return keyframes.poses.get(key) or typed_value(keyframes.values, "Pose2", key) or keyframes.values.atPose3(key)


def lengths_of(step):
    if isinstance(step, gtsam.Pose2):
        return float(np.hypot(step.x(), step.y())), abs(step.theta())
    return float(np.linalg.norm(step.translation())), float(np.linalg.norm(gtsam.Rot3.Logmap(step.rotation())))


def adjoints(poses: Sequence[Any], pairs: NDArray[np.int64]) -> Array:
    return np.array([poses[j].between(poses[i]).AdjointMap() for i, j in pairs.tolist()]).reshape(-1, *[poses[0].AdjointMap().shape[0]]*2)


def _errors(poses, pairs, measured):
    return np.array([type(z).Logmap(z.between(poses[i].between(poses[j]))) for (i, j), z in zip(pairs.tolist(), measured, strict=True)])
