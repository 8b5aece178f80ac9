"""How far two keyframes may lie apart, given every tie of a map: the odometry's errors in units of free space.

Covariances are often wrong, by a factor or in kind. The model does without the caller's. It grants every step of the
track what a poor odometer of any make still keeps, a white error that grows with the way in units of the free radius
ρ, and every closure a part of ρ. With T the keyframes' poses, a tie (i, j) that measures z has the error
e = Log(z⁻¹ T_i⁻¹ T_j), which the perturbations T Exp(δ) change by δ_j − A δ_i, A = Ad(T_j⁻¹ T_i). The information
matrix Σ Jᵀ R⁻¹ J of all ties is a graph Laplacian with matrix weights, and the covariance of the relative pose of two
keyframes is the effective resistance between them.

From one factorisation follows what every tie would have been predicted to measure without it: with the residual r at
the optimum, its tolerance R, the covariance C of the relative pose and S = R − C, the tie misses that prediction by
e = R S⁻¹ r, whose own covariance, without the tie's tolerance, is R S⁻¹ R − R (leave-one-out residuals of linear least
squares: Cook and Weisberg, Residuals and Influence in Regression, 1982, chapter 2).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import Keyframes, read_keyframes, typed_value
from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.gate.evidence import free_space_unit
from pgti_gtsam.gate.ties import Ties, ties_of, variances_of
from pgti_gtsam.gate.trial import optimised
from pgti_gtsam.places import places_on
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.block_inverse import BlockFactor, factorise, inverse_blocks, solve
from pgti_gtsam.spectral.elimination_tree import EliminationTree, analyse
from pgti_gtsam.spectral.laplacian import connected_components
from pgti_gtsam.track import track_of

ANCHOR = 1e-4
"""Standard deviation in ρ and rad of the pose that each part of the map is held at. No relative pose depends on it; a
loose anchor would let the whole map swing, and what is asked for would drown in that."""

HELD = 0.5
"""Standard deviation of a position that a factor of one variable holds, in ρ: a satellite receiver, say."""

MAX_ITERATIONS = 10
"""Levenberg-Marquardt steps to the model's optimum. Where closures are false there is no good one, nor need."""

LEAST_REST = 1e-6
"""Least eigenvalue of S in units of R: the rounding of the covariances. What the others predict is uncertain by 1000
tolerances there, and how uncertain exactly does not matter."""

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
    """

    unit_m: float
    poses: tuple[Any, ...]
    ties: Ties
    held: NDArray[np.bool_]
    along: Array

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

    @cached_property
    def spread(self) -> Array:
        """Covariance of the relative pose of keyframes drawn at random, were all headings alike, (d, d)."""
        places = np.array([pose.translation() for pose in self.poses])
        extent = float(np.sqrt(2 * places.var(axis=0).mean()))
        return np.diag(variances_of(extent, np.pi / np.sqrt(3), is_planar=self.is_planar))

    def settled(
        self,
        active: NDArray[np.bool_] | None = None,
        asked: NDArray[np.int64] | None = None,
        start: Settled | None = None,
    ) -> Settled:
        """The optimum of the ties.

        Parameters
        ----------
        active : (m,) bool, optional
            Ties that hold, all without; the others pull at nothing.
        asked : (k, 2) int, optional
            Pairs of keyframes, beside those of ties, whose relative pose will be asked for.
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
        together = np.concatenate([ties.pairs, np.empty((0, 2), dtype=np.int64) if asked is None else asked])
        _, component = connected_components(n, ties.pairs[active])
        tree = analyse(n, np.unique(np.sort(together[together[:, 0] != together[:, 1]], axis=1), axis=0))

        # the optimum, and the information there
        weights = np.where(active[:, None], 1 / ties.variances, 0.0)
        anchors = self._anchors(component)
        poses = self._optimum(active, component, self.poses if start is None else start.poses)
        try:
            factor, pull = self._linearised(tree, anchors, weights, poses)
        except np.linalg.LinAlgError as error:
            raise UnsolvableGraphError(
                "expected odometry and closures that fix every keyframe, got a singular information matrix; "
                "look for closures with measurements far beyond the map"
            ) from error
        return Settled(
            model=self,
            active=active,
            poses=tuple(poses),
            component=component,
            residuals=self._residuals(poses, solve(factor, pull)),
            factor=factor,
        )

    def _optimum(self, active: NDArray[np.bool_], component: NDArray[np.int32], start: Sequence[Any]) -> list[Any]:
        """Poses by Levenberg-Marquardt: damped, for false closures tear at the map."""
        between = gtsam.BetweenFactorPose2 if self.is_planar else gtsam.BetweenFactorPose3
        prior = gtsam.PriorFactorPose2 if self.is_planar else gtsam.PriorFactorPose3
        model = gtsam.noiseModel.Diagonal.Variances
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k in np.flatnonzero(active).tolist():
            i, j = self.ties.pairs[k].tolist()
            graph.push_back(between(i, j, self.ties.measured[k], model(self.ties.variances[k])))
        for i in np.unique(component, return_index=True)[1].tolist():
            graph.push_back(prior(i, start[i], model(self.variances(ANCHOR, ANCHOR))))
        for i, pose in enumerate(start):
            values.insert(i, pose)
        found = optimised(
            graph, values, held=gtsam.NonlinearFactorGraph(), max_iterations=MAX_ITERATIONS, tolerance=1e-3
        )
        at = found.atPose2 if self.is_planar else found.atPose3
        return [at(i) for i in range(len(start))]

    def _residuals(self, poses: Sequence[Any], steps: Array) -> Array:
        """Error of every tie after a last, linear step: e + δ_j − A δ_i."""
        i, j = self.ties.pairs.T
        carried = _adjoints(poses, self.ties.pairs) @ steps[i][:, :, None]
        return np.asarray(_errors(poses, self.ties) + steps[j] - carried[:, :, 0])

    def _anchors(self, component: NDArray[np.int32]) -> Array:
        """Diagonal blocks of what holds keyframes in the world: the first one of every component, and `held` ones."""
        information = np.zeros((len(self.poses), len(self.spread), len(self.spread)))
        information[self.held] = np.diag(1 / self.variances(HELD, np.inf))
        information[np.unique(component, return_index=True)[1]] += np.diag(1 / self.variances(ANCHOR, ANCHOR))
        return information

    def _linearised(
        self, tree: EliminationTree, anchors: Array, weights: Array, poses: Sequence[Any]
    ) -> tuple[BlockFactor, Array]:
        """Σ Jᵀ R⁻¹ J, J = (−A, I), and −Σ Jᵀ R⁻¹ e, (n, d)."""
        pairs, carry = self.ties.pairs, _adjoints(poses, self.ties.pairs)
        weighted, errors = weights[:, :, None] * carry, weights * _errors(poses, self.ties)
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
    residuals : (m, d) float
        Error of every tie.
    factor : BlockFactor
        Of the information matrix.
    """

    model: DriftModel
    active: NDArray[np.bool_]
    poses: tuple[Any, ...]
    component: NDArray[np.int32]
    residuals: Array
    factor: BlockFactor

    def asked(self, pairs: NDArray[np.int64]) -> Settled:
        """The same optimum, of which more relative poses can be asked."""
        return self.model.settled(self.active, pairs, self)

    def covariances(self, pairs: NDArray[np.int64]) -> Array:
        """Covariance of the pose of j seen from i, in the tangent space of j: (k, d, d), NaN where no tie leads."""
        i, j = pairs.T
        ends = np.concatenate([np.stack(each, axis=1) for each in ((i, i), (j, j), (i, j))])
        own, other, cross = inverse_blocks(self.factor, ends).reshape(3, len(pairs), *self.model.spread.shape)
        carry = _adjoints(self.poses, pairs)
        mixed = carry @ cross
        found = carry @ own @ carry.swapaxes(1, 2) + other - mixed - mixed.swapaxes(1, 2)
        values, axes = np.linalg.eigh(found)
        found = axes * np.maximum(values, 0.0)[:, None, :] @ axes.swapaxes(1, 2)
        return np.where((self.component[i] == self.component[j])[:, None, None], found, np.nan)

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

    def _alone(self) -> NDArray[np.int64]:
        """Active closures without which the map would fall apart."""
        ties, n = self.model.ties, len(self.poses)
        held = self.active & (ties.slots < 0)
        parts, part = connected_components(n, ties.pairs[held])
        between = np.flatnonzero(self.active & (ties.slots >= 0) & (part[ties.pairs[:, 0]] != part[ties.pairs[:, 1]]))
        ends = part[ties.pairs[between]].astype(np.int64)
        n_parts = connected_components(parts, ends)[0]
        _, first, count = np.unique(np.sort(ends, axis=1), axis=0, return_index=True, return_counts=True)
        single = first[count == 1]
        needed = [k for k in single.tolist() if connected_components(parts, np.delete(ends, k, axis=0))[0] > n_parts]
        return between[needed]

    def left_out(self) -> tuple[Array, Array]:
        """By how much every tie misses what all the others predict, (m, d), and the covariance of that, (m, d, d).

        A tie that pulls at nothing misses by its residual. Where no other tie leads, the covariance is NaN.
        """
        ties = self.model.ties
        spread = self.covariances(ties.pairs)
        missed, others = _predicted(self.residuals, np.sqrt(ties.variances), np.nan_to_num(spread, nan=0.0))
        others[self._alone()] = np.nan
        return (
            np.where(self.active[:, None], missed, self.residuals),
            np.where(self.active[:, None, None], others, spread),
        )

    def left_out_together(self, groups: Sequence[NDArray[np.int64]]) -> list[tuple[Array, Array]]:
        """By how much the ties of each group miss what all others predict, (g, d), and its covariance, (g d, g d).

        Relative poses between all keyframes of a group must have been asked for.
        """
        ties = self.model.ties
        ends = [ties.pairs[group].reshape(-1) for group in groups]
        squares = [np.stack(np.meshgrid(own, own, indexing="ij"), -1).reshape(-1, 2) for own in ends]
        blocks = inverse_blocks(self.factor, np.concatenate([np.empty((0, 2), dtype=np.int64), *squares]))
        parts = np.split(blocks, np.cumsum([len(square) for square in squares])[:-1]) if groups else []
        found = []
        for group, part in zip(groups, parts, strict=True):
            missed, others = _predicted(
                self.residuals[group].reshape(1, -1),
                np.sqrt(ties.variances[group]).reshape(1, -1),
                self._relative(group, part)[None],
            )
            found.append((missed.reshape(len(group), -1), others[0]))
        return found

    def _relative(self, group: NDArray[np.int64], blocks: Array) -> Array:
        """Joint covariance of a group's relative poses, (g d, g d), from that of its ends."""
        g, d = len(group), blocks.shape[1]
        whole = blocks.reshape(2 * g, 2 * g, d, d).transpose(0, 2, 1, 3).reshape(2 * g * d, 2 * g * d)
        jacobian, own = np.zeros((g, d, g, 2, d)), np.arange(g)
        jacobian[own, :, own, 0] = -_adjoints(self.poses, self.model.ties.pairs[group])
        jacobian[own, :, own, 1] = np.eye(d)
        flat = jacobian.reshape(g * d, 2 * g * d)
        return np.asarray(flat @ whole @ flat.T)


def _predicted(residuals: Array, roots: Array, spread: Array) -> tuple[Array, Array]:
    """R S⁻¹ r and R S⁻¹ R − R with S = R − C, of (k, d) residuals r, roots of R and (k, d, d) covariances C."""
    rest, axes = np.linalg.eigh(np.eye(roots.shape[1]) - spread / (roots[:, :, None] * roots[:, None, :]))
    gain = 1 / np.clip(rest, LEAST_REST, 1.0)  # S⁻¹ in units of R, along the axes
    along = axes.swapaxes(1, 2) @ (residuals / roots)[:, :, None]
    missed = roots * (axes @ (gain[:, :, None] * along))[:, :, 0]
    return missed, roots[:, :, None] * (axes * (gain - 1)[:, None, :] @ axes.swapaxes(1, 2)) * roots[:, None, :]


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
    poses = _alike([_pose(keyframes, int(key)) for key in pose_graph.keys])
    return DriftModel(
        unit_m=unit,
        poses=poses,
        ties=ties_of(graph, pose_graph, poses, unit),
        held=_held(graph, keyframes.index),
        along=places_on(pose_graph, track_of(pose_graph)),
    )


def _held(graph: gtsam.NonlinearFactorGraph, index: dict[int, int]) -> NDArray[np.bool_]:
    """Keyframes with a factor of their own."""
    held = np.zeros(len(index), dtype=bool)
    for slot in range(graph.size()):
        factor = graph.at(slot)
        keys = [] if factor is None else factor.keys()
        if len(keys) == 1 and keys[0] in index and isinstance(factor, _HOLDING):
            held[index[keys[0]]] = True
    return held


_HOLDING = (gtsam.PriorFactorPose2, gtsam.PriorFactorPose3, gtsam.GPSFactor)


def _pose(keyframes: Keyframes, key: int) -> Any:
    """The Pose2 or Pose3 of a keyframe."""
    return keyframes.poses.get(key) or typed_value(keyframes.values, "Pose2", key) or keyframes.values.atPose3(key)


def _alike(poses: Iterable[Any]) -> tuple[Any, ...]:
    """All poses of the plane, or all in space."""
    found = list(poses)
    if all(isinstance(pose, gtsam.Pose2) for pose in found):
        return tuple(found)
    return tuple(gtsam.Pose3(pose) if isinstance(pose, gtsam.Pose2) else pose for pose in found)


def _adjoints(poses: Sequence[Any], pairs: NDArray[np.int64]) -> Array:
    """A = Ad(T_j⁻¹ T_i) of every pair, (k, d, d)."""
    d = 3 if isinstance(poses[0], gtsam.Pose2) else 6
    return np.array([poses[j].between(poses[i]).AdjointMap() for i, j in pairs.tolist()]).reshape(-1, d, d)


def _errors(poses: Sequence[Any], ties: Ties) -> Array:
    """e = Log(z⁻¹ T_i⁻¹ T_j) of every tie, (m, d)."""
    errors = [
        type(z).Logmap(z.between(poses[i].between(poses[j])))
        for (i, j), z in zip(ties.pairs.tolist(), ties.measured, strict=True)
    ]
    return np.array(errors).reshape(ties.variances.shape)
