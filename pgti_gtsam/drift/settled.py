"""A drift model at its optimum: poses of the keyframes, residuals of the ties, and predictions.

The information matrix is factorised once, and every covariance is asked of the factors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.drift.model import DriftModel
from pgti_gtsam.drift.ties import Offered, Ties, adjoints, errors_of
from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import between_factor
from pgti_gtsam.spectral.block_inverse import TOGETHER, BlockFactor, factorise, own_products, products, solve
from pgti_gtsam.spectral.elimination_tree import EliminationTree, analyse
from pgti_gtsam.spectral.laplacian import connected_components

ANCHOR = 1e-4
"""Standard deviation in ρ and rad of the pose that each part of the map is held at. No relative pose depends on it; a
loose anchor would let the whole map swing, and what is asked for would drown in that."""

HELD = 0.5
"""Standard deviation of a position that a factor of one variable holds, in ρ: a satellite receiver, say. The estimate's
position is held, for the estimate has weighed the factor already."""

MAX_ITERATIONS = 40
"""Levenberg-Marquardt steps to the model's optimum. Where closures are false there is no good one, nor need."""

Array = NDArray[np.float64]


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
        Error of every tie at the optimum.
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

    def extended(self, offered: Sequence[Offered]) -> Settled:
        """The same optimum of a model with more ties, which do not hold yet: see `DriftModel.extended`."""
        model, n = self.model.extended(offered), len(self.active)
        added = model.ties.only(np.arange(n + len(offered)) >= n)
        return replace(
            self,
            model=model,
            active=np.concatenate([self.active, np.zeros(len(offered), dtype=bool)]),
            residuals=np.concatenate([self.residuals, _residuals(added, self.poses, self.steps)]),
        )

    def toggled(self, ties: NDArray[np.int64]) -> tuple[tuple[Any, ...], NDArray[np.bool_]]:
        """Poses, and ties that hold, where some ties that do not hold did, or where some that hold did not.

        To first order, δ = −H⁻¹ Jᵀ (±R + J H⁻¹ Jᵀ)⁻¹ e, as far as that suffices; else the optimum itself.
        """
        active = self.active.copy()
        active[ties] = ~active[ties]
        pairs, d = self.model.ties.pairs[ties], len(self.model.units.spread)
        spread, residuals = self.joint_covariances([pairs])[0], self.residuals[ties]

        # what they pull with, and the step of all keyframes
        signs = np.where(self.active[ties], -1.0, 1.0)[:, None]
        tolerance = np.diag((signs * self.model.ties.variances[ties]).ravel())
        pulls = np.linalg.lstsq(tolerance + np.nan_to_num(spread), residuals.ravel())[0]
        pull = np.zeros((len(self.poses), d))
        np.add.at(pull, pairs, -np.einsum("keab,ka->keb", self._jacobians(pairs), pulls.reshape(-1, d)))
        steps = solve(self.factor, pull)
        if np.isnan(spread).any() or self.model.units.bends(steps):
            return settle(self.model, active, self).poses, active
        return tuple(pose.retract(step) for pose, step in zip(self.poses, self.steps + steps, strict=True)), active

    def joint_covariances(self, groups: Sequence[NDArray[np.int64]]) -> list[Array]:
        """Covariance of all relative poses of each group of pairs together, (g d, g d).

        NaN in the rows and columns of pairs that no tie leads between.
        """
        found, d = [], len(self.model.units.spread)
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


def _residuals(ties: Ties, poses: Sequence[Any], steps: Array) -> Array:
    """Error of every tie after a linear step: e + δ_j − A δ_i."""
    i, j = ties.pairs.T
    carried = adjoints(poses, ties.pairs) @ steps[i][:, :, None]
    return np.asarray(errors_of(poses, ties.pairs, ties.measured) + steps[j] - carried[:, :, 0])


def _batches(sizes: Sequence[int], most: int) -> Iterator[list[int]]:
    """Groups of neighbours, up to a limit of the sum; an item above the limit stays alone."""
    batch: list[int] = []
    for k, size in enumerate(sizes):
        if batch and sum(sizes[b] for b in batch) + size > most:
            yield batch
            batch = []
        batch.append(k)
    if batch:
        yield batch


@contextmanager
def solvable() -> Iterator[None]:
    """Linear algebra of a map whose lengths float64 can hold side by side.

    Raises
    ------
    UnsolvableGraphError
        A matrix is singular to rounding.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise UnsolvableGraphError(
            "expected odometry and closures that fix every keyframe, got a singular information matrix; "
            "look for positions or measurements far beyond the map, and for radii far below it"
        ) from error


def settle(model: DriftModel, active: NDArray[np.bool_] | None = None, start: Settled | None = None) -> Settled:
    """The optimum of a model's ties.

    Parameters
    ----------
    model : DriftModel
    active : (m,) bool, optional
        Ties that hold, by default all; the others pull at nothing.
    start : Settled, optional
        Where to begin; the estimate without.

    Raises
    ------
    UnsolvableGraphError
        The ties are so stiff or so many that their information matrix is singular to rounding.
    """
    # which parts hang together, and in which order their keyframes are eliminated
    ties, n = model.ties, len(model.poses)
    active = np.ones(len(ties.pairs), dtype=bool) if active is None else active
    _, component = connected_components(n, ties.pairs[active])
    tree = analyse(n, np.unique(np.sort(ties.pairs[active], axis=1), axis=0))

    # the optimum, and the information there
    gauge_priors = _anchors(model, component)
    poses = _optimum(model, active, component, model.poses if start is None else start.poses)
    with solvable():
        factor, pull = _linearised(model, tree, gauge_priors, active, poses)
    steps = solve(factor, pull)
    return Settled(
        model=model,
        active=active,
        poses=tuple(poses),
        component=_placed(model, component),
        steps=steps,
        residuals=_residuals(ties, poses, steps),
        factor=factor,
    )


def _optimum(
    model: DriftModel, active: NDArray[np.bool_], component: NDArray[np.int32], start: Sequence[Any]
) -> list[Any]:
    """Poses by Levenberg-Marquardt, whose damping knows no units: lengths are in ρ. False closures bend the map."""
    # ties and priors, all lengths in ρ
    inverse, unit = 1 / model.units.unit_m, np.ones(len(model.units.spread))
    unit[model.units.translation] = model.units.unit_m**2
    prior = gtsam.PriorFactorPose2 if model.units.is_planar else gtsam.PriorFactorPose3
    noise = gtsam.noiseModel.Diagonal.Variances
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in np.flatnonzero(active).tolist():
        i, j = model.ties.pairs[k].tolist()
        graph.push_back(
            between_factor(i, j, _scaled(model.ties.measured[k], inverse), noise(model.ties.variances[k] / unit))
        )
    for i in _fixed(model, component).tolist():
        graph.push_back(prior(i, _scaled(start[i], inverse), noise(model.units.variances(ANCHOR, ANCHOR) / unit)))
    position = gtsam.PoseTranslationPrior2D if model.units.is_planar else gtsam.PoseTranslationPrior3D
    for i in np.flatnonzero(model.held).tolist():
        near = gtsam.noiseModel.Isotropic.Sigma(2 if model.units.is_planar else 3, HELD)
        graph.push_back(position(i, _scaled(model.poses[i], inverse), near))

    # their optimum, in metres again
    for i, pose in enumerate(start):
        values.insert(i, _scaled(pose, inverse))
    found = optimised(graph, values, priors=gtsam.NonlinearFactorGraph(), max_iterations=MAX_ITERATIONS, tolerance=1e-3)
    at = found.atPose2 if model.units.is_planar else found.atPose3
    return [_scaled(at(i), model.units.unit_m) for i in range(len(start))]


def _scaled(pose: Any, scale: float) -> Any:
    """The same pose with lengths in another unit."""
    return type(pose)(pose.rotation(), scale * pose.translation())


def _anchors(model: DriftModel, component: NDArray[np.int32]) -> Array:
    """Diagonal blocks of the priors in the world: one of every part, and of `held` keyframes."""
    information = np.zeros((len(model.poses), len(model.units.spread), len(model.units.spread)))
    information[model.held] = np.diag(1 / model.units.variances(HELD, np.inf))
    information[_fixed(model, component)] += np.diag(1 / model.units.variances(ANCHOR, ANCHOR))
    return information


def _placed(model: DriftModel, component: NDArray[np.int32]) -> NDArray[np.int32]:
    """Parts between which relative poses are predicted: parts with a position in the world count as connected."""
    held = np.isin(component, component[model.held])
    return np.where(held, -1, component).astype(np.int32)


def _fixed(model: DriftModel, component: NDArray[np.int32]) -> NDArray[np.int64]:
    """The keyframe at which each part is fixed: the first with a position in the world, else the first of all."""
    order = np.argsort(~model.held, kind="stable")
    return np.asarray(order[np.unique(component[order], return_index=True)[1]])


def _linearised(
    model: DriftModel, tree: EliminationTree, gauge_priors: Array, active: NDArray[np.bool_], poses: Sequence[Any]
) -> tuple[BlockFactor, Array]:
    """Σ Jᵀ R⁻¹ J, J = (−A, I), and −Σ Jᵀ R⁻¹ e, (n, d), of the active ties and of the positions that are held."""
    # the ties
    ties = model.ties.only(active)
    pairs, carry, weights = ties.pairs, adjoints(poses, ties.pairs), 1 / ties.variances
    weighted, errors = weights[:, :, None] * carry, weights * errors_of(poses, ties.pairs, ties.measured)
    diagonal, pull = gauge_priors.copy(), np.zeros(gauge_priors.shape[:2])
    np.add.at(diagonal, pairs[:, 0], carry.swapaxes(1, 2) @ weighted)
    np.add.at(diagonal, pairs[:, 1], weights[:, :, None] * np.eye(weights.shape[1]))
    np.add.at(pull, pairs[:, 0], (carry.swapaxes(1, 2) @ errors[:, :, None])[:, :, 0])
    np.add.at(pull, pairs[:, 1], -errors)

    # held positions
    for i in np.flatnonzero(model.held).tolist():
        away = model.poses[i].translation() - poses[i].translation()
        pull[i, model.units.translation] += poses[i].rotation().unrotate(away) / (HELD * model.units.unit_m) ** 2
    return factorise(tree, diagonal, pairs, -weighted.swapaxes(1, 2)), pull
