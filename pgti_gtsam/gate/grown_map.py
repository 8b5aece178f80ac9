"""A reference map and the keyframes since: keyframes that odometry ties to its ends, and closures that passed.

A decision does without a new optimum, and the cost does not grow with the map. Relative poses are linear in the errors
of the reference map and of the steps since. With P the covariance of the poses that closures c since then and a
candidate g measure, R the tolerances and e the residuals of the closures, the candidate differs by e_g − P_gc (R +
P_cc)⁻¹ e_c, with covariance P_gg − P_gc (R + P_cc)⁻¹ P_cg (Gaussian conditioning).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.factor_graphs import BETWEEN, factors_of, keys_of, measured_from
from pgti_gtsam.gate.candidates import agreement
from pgti_gtsam.gate.left_out import LEAST_REST
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.ties import Ties, closures_of, errors_of, step_variances
from pgti_gtsam.spectral.block_inverse import products, solve

MOST_CLOSURES = 64
"""Closures since the reference map beyond which it is made anew: conditioning on so many takes some milliseconds."""

ROUNDING = 1e-9
"""Difference, m and rad, below which two measurements are the same."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tail:
    """Keyframes since the reference map, each tied to the keyframe before by a step of odometry.

    Attributes
    ----------
    poses : tuple of t gtsam.Pose2 or gtsam.Pose3
        Chained from the reference map, in the same axes.
    roots : (t,) int
        Keyframe of the reference map that each hangs on.
    gathered : (t, d, d) float
        Covariance of the errors of the steps since the root, in the root's tangent space.
    """

    poses: tuple[Any, ...]
    roots: NDArray[np.int64]
    gathered: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GrownMap:
    """A map as closures find the map in a running pipeline.

    Attributes
    ----------
    reference : ReferenceMap
        Source of the free radius, the vertical and the spread.
    tail : Tail
    places : dict from key to int
        All keyframes: the reference map's, then the tail's.
    ends : dict from robot to key
        Latest keyframe of each robot; the robot is the first byte of the keys.
    closures : Ties
        That passed since.
    """

    reference: ReferenceMap
    tail: Tail
    places: Mapping[int, int]
    ends: Mapping[int, int]
    closures: Ties

    @classmethod
    def of(cls, reference: ReferenceMap) -> GrownMap:
        """A reference map, without its contacts and its factors for scores, and nothing since."""
        reference = replace(reference)
        model, keys = reference.settled.model, reference.pose_graph.keys.tolist()
        d = len(model.units.spread)
        return cls(
            reference=reference,
            tail=Tail(poses=(), roots=np.empty(0, dtype=np.int64), gathered=np.empty((0, d, d))),
            places=dict(reference.keyframes.index),
            ends={_robot(key): key for key in keys},
            closures=closures_of([], model.units),
        )

    @property
    def is_planar(self) -> bool:
        """Whether the poses are Pose2."""
        return self.reference.settled.model.units.is_planar

    @property
    def way(self) -> Array | None:
        """Way along the track to every keyframe, (n + t,), in ρ; None where these are not the track of one robot."""
        track, n = self.reference.track, len(self.reference.pose_graph)
        if len(self.ends) > 1 or track.order[-1] != n - 1:
            return None
        places = np.array([pose.translation() for pose in (self.pose(n - 1), *self.tail.poses)])
        since = np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))
        return np.append(track.way_m, track.way_m[-1] + since) / self.reference.settled.model.units.unit_m

    @property
    def is_worn(self) -> bool:
        """Whether so much came since that the reference map is better made anew."""
        n = len(self.reference.pose_graph)
        return len(self.closures.pairs) > MOST_CLOSURES or len(self.tail.poses) > n

    def grown(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> GrownMap | None:
        """The map with more keyframes.

        None where appending does not suffice: each new keyframe must be tied by one between factor, which measures a
        pose of the map's type from the latest keyframe of its robot.

        Parameters
        ----------
        factors, values
            Of the step.
        """
        # the step to each new keyframe
        model, new = self.reference.settled.model, set(values.keys())
        steps: dict[int, tuple[int, Any]] = {}
        for factor in factors_of(factors):
            before, key = min(keys_of(factor)), max(keys_of(factor))
            if not isinstance(factor, BETWEEN) or key not in new or key in steps:
                return None
            steps[key] = before, measured_from(factor, before)
        if set(steps) != new:
            return None

        # where it leads, and what it gathers
        n, turn = len(self.reference.pose_graph), model.units.levelling
        places, ends, poses = dict(self.places), dict(self.ends), list(self.tail.poses)
        roots, gathered = self.tail.roots.tolist(), list(self.tail.gathered)
        for key in sorted(steps):
            before, measured = steps[key]
            if ends.get(_robot(key)) != before or isinstance(measured, gtsam.Pose2) is not model.units.is_planar:
                return None
            step, place = turn.inverse().compose(measured).compose(turn), places[before]
            start = self.pose(place) if place < n else poses[place - n]
            root, so_far = (place, 0.0) if place < n else (roots[place - n], gathered[place - n])
            end = start.compose(step)
            carry = self.pose(root).between(end).AdjointMap()
            gathered.append(so_far + carry @ np.diag(self._variances(step)) @ carry.T)
            roots.append(root)
            poses.append(end)
            ends[_robot(key)], places[key] = key, n + len(poses) - 1
        tail = Tail(poses=tuple(poses), roots=np.array(roots, dtype=np.int64), gathered=np.array(gathered))
        return replace(self, tail=tail, places=places, ends=ends) if new else self

    def offered(self, closure: gtsam.NonlinearFactorGraph) -> Ties | None:
        """A closure as a tie; None for no tie, or several."""
        factors = factors_of(closure)
        if len(factors) != 1 or not isinstance(factors[0], BETWEEN):
            return None
        first, second = sorted(keys_of(factors[0]))
        if first == second or not {first, second} <= set(self.places):
            return None
        model = self.reference.settled.model
        tie = self.places[first], self.places[second], measured_from(factors[0], first)
        return closures_of([tie], model.units)

    def predicted(self, offered: Ties) -> tuple[Array, Array]:
        """Differences of some ties from the map's prediction, (g, d), and their joint covariance, (g d, g d)."""
        ties, d = self.closures.joined(offered), offered.variances.shape[1]
        k, missed, spread = d * len(self.closures.pairs), self._missed(ties), self._covariance(ties.pairs)
        known = spread[:k, :k] + np.diag(self.closures.variances.ravel())
        gain = np.linalg.solve(known, spread[:k, k:]).T
        return (missed[k:] - gain @ missed[:k]).reshape(-1, d), spread[k:, k:] - gain @ spread[:k, k:]

    def predicted_without(self, offered: Ties, held: Sequence[bool]) -> tuple[Array, Array] | None:
        """As `predicted`, by the map without those of the ties that hold.

        To leave out a tie of the reference map is to condition on a tie of the negative covariance −R. None where a
        linear step does not suffice, or where nothing else relates the keyframes.

        Parameters
        ----------
        offered : Ties
        held : sequence of g bool
            Which of the ties hold in the map.
        """
        # the ties that hold, in the reference map or since
        own, later = self.reference.settled.model.ties, np.ones(len(self.closures.pairs), dtype=bool)
        earlier = np.zeros(len(own.pairs), dtype=bool)
        for k in np.flatnonzero(held).tolist():
            since, before = (_same(ties, offered, k) for ties in (self.closures, own))
            since, before = since[later[since]], before[~earlier[before] & (own.slots[before] >= 0)]
            if len(since):
                later[since[0]] = False
            elif len(before):
                earlier[before[0]] = True
            else:
                return None

        # the prediction of the others
        known = self.closures.only(later).joined(own.only(earlier))
        signs = np.repeat([1.0, -1.0], [later.sum(), earlier.sum()])[:, None]
        ties, d = known.joined(offered), offered.variances.shape[1]
        k, missed, spread = d * len(known.pairs), self._missed(ties), self._covariance(ties.pairs)
        if not (np.isfinite(spread).all() and self._hold_without(known, signs[:, 0] < 0, spread[:k, :k])):
            return None
        gain = np.linalg.solve(spread[:k, :k] + np.diag((signs * known.variances).ravel()), spread[:k, k:]).T
        moved = (gain @ missed[:k]).reshape(-1, d)
        if self.reference.settled.model.units.bends(moved):
            return None
        return missed[k:].reshape(-1, d) - moved, spread[k:, k:] - gain @ spread[:k, k:]

    def _hold_without(self, ties: Ties, left_out: NDArray[np.bool_], spread: Array) -> bool:
        """Whether the map holds together without some ties: whether R − C is well above rounding."""
        rows = np.repeat(left_out, ties.variances.shape[1])
        roots = np.sqrt(ties.variances.ravel()[rows])
        rest = np.eye(len(roots)) - spread[np.ix_(rows, rows)] / (roots[:, None] * roots)
        return bool(np.linalg.eigvalsh(rest).min(initial=1.0) > LEAST_REST)

    def agree(self, offered: Ties, missed: Array) -> bool:
        """Whether all ties of a revisit agree, where the map without them differs from the ties so much.

        Parameters
        ----------
        offered : Ties
        missed : (g, d) float
            As from `predicted_without`.
        """
        way, model = self.way, self.reference.settled.model
        if way is None:
            return len(missed) == 1
        measured = [
            self.pose(i).compose(z) for i, z in zip(offered.pairs[:, 0].tolist(), offered.measured, strict=True)
        ]
        ends = [pose.compose(pose.Expmap(error)) for pose, error in zip(measured, missed, strict=True)]
        motions = [pose.compose(end.inverse()) for pose, end in zip(measured, ends, strict=True)]
        places = [end.translation() for end in ends]
        return bool(agreement(motions, places, way[offered.pairs[:, 1]], model.units.unit_m).all())

    def tied(self, offered: Ties, missed: Array, spread: Array) -> GrownMap | None:
        """The map with more ties that hold; None where the ties bend the map beyond a linear step.

        Parameters
        ----------
        offered : Ties
        missed, spread
            As from `predicted`.
        """
        ties, settled = self.closures.joined(offered), self.reference.settled
        tolerance = np.diag(offered.variances.ravel())
        moved = tolerance @ np.linalg.solve(spread + tolerance, missed.ravel()) - missed.ravel()
        if not np.isfinite(moved).all():
            return None
        if settled.model.units.moves_little(moved.reshape(missed.shape)):
            return replace(self, closures=ties)

        # the step that all of them take the reference map by
        known = self._covariance(ties.pairs) + np.diag(ties.variances.ravel())
        pulls = np.linalg.solve(known, self._missed(ties)).reshape(ties.variances.shape)
        roots, carry = self._carried(ties.pairs)
        pull = np.zeros_like(settled.steps)
        np.add.at(pull, roots, -np.einsum("keab,ka->keb", carry, pulls))
        return None if settled.model.units.bends(solve(settled.factor, pull)) else replace(self, closures=ties)

    def tied_by(self, closure: gtsam.NonlinearFactorGraph) -> GrownMap | None:
        """The map with a closure that passed; None where that takes more than a linear step."""
        tie = self.offered(closure)
        return None if tie is None else self.tied(tie, *self.predicted(tie))

    def _missed(self, ties: Ties) -> Array:
        """e of each tie at the keyframes of the reference map's optimum and the steps since, (k d,)."""
        places, local = np.unique(ties.pairs, return_inverse=True)
        poses = [self.pose(place) for place in places.tolist()]
        return errors_of(poses, local.reshape(-1, 2), ties.measured).ravel()

    def pose(self, place: int) -> Any:
        """The keyframe at a place, where the optimum of the reference map and the steps since put the keyframe."""
        settled, n = self.reference.settled, len(self.reference.pose_graph)
        return settled.poses[place].retract(settled.steps[place]) if place < n else self.tail.poses[place - n]

    def _variances(self, step: Any) -> Array:
        model = self.reference.settled.model
        variances = step_variances(step, model.units.unit_m)
        if not model.units.is_planar:
            variances[:2] *= model.units.tilt**2
        return variances

    def _covariance(self, pairs: NDArray[np.int64]) -> Array:
        """Joint covariance of the pose of j seen from i for all pairs, (k d, k d); NaN where no tie leads between."""
        settled, n, (roots, carry) = self.reference.settled, len(self.reference.pose_graph), self._carried(pairs)
        whole, d = products(settled.factor, roots, carry), carry.shape[-1]

        # what the steps of the tails add: two ends on one tail share those up to the earlier of both
        ends = np.flatnonzero(pairs.ravel() >= n)
        root, place = roots.ravel()[ends], pairs.ravel()[ends] - n
        shared = self.tail.gathered[np.minimum(place[:, None], place)] * (root[:, None] == root)[:, :, None, None]
        carried = carry.reshape(-1, d, d)[ends]
        added = np.einsum("aux,abxy,bvy->aubv", carried, shared, carried, optimize=True)
        rows = (d * (ends // 2)[:, None] + np.arange(d)).ravel()
        np.add.at(whole, (rows[:, None], rows), added.reshape(len(rows), len(rows)))

        # parts that nothing joins
        lost = np.repeat(np.diff(settled.component[roots], axis=1)[:, 0] != 0, d)
        whole[lost], whole[:, lost] = np.nan, np.nan
        return whole

    def _carried(self, pairs: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
        """Keyframes of the reference map that the ends of pairs hang on, (k, 2), and the Jacobian, (k, 2, d, d)."""
        n = len(self.reference.pose_graph)
        roots = np.append(np.arange(n), self.tail.roots)[pairs]
        found = [
            [
                sign * self.pose(j).between(self.pose(root)).AdjointMap()
                for sign, root in zip((-1.0, 1.0), own, strict=True)
            ]
            for j, own in zip(pairs[:, 1].tolist(), roots.tolist(), strict=True)
        ]
        d = len(self.reference.settled.model.units.spread)
        return roots, np.array(found).reshape(-1, 2, d, d)


def _same(ties: Ties, offered: Ties, k: int) -> NDArray[np.int64]:
    """Which of some ties measure the same between the same keyframes as an offered tie."""
    rows = np.flatnonzero((ties.pairs == offered.pairs[k]).all(axis=1))
    return rows[[ties.measured[row].equals(offered.measured[k], ROUNDING) for row in rows.tolist()]]


def _robot(key: int) -> int:
    return key >> 56
