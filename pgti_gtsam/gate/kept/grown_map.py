"""A reference map and the keyframes since: keyframes that odometry ties to its ends, and closures that passed.

A decision does without a new optimum, and costs a way up the elimination tree, not the map. Relative poses are linear
in the errors of the reference map and of the steps since; closures since then are conditioned on: see `known_closures`.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.families import Family, family_of, holds_position
from pgti_gtsam.adapter.values import pose_keys
from pgti_gtsam.drift.left_out import LEAST_REST
from pgti_gtsam.drift.ties import Offered, Ties, closures_of, errors_of, step_variances
from pgti_gtsam.drift.units import Units
from pgti_gtsam.factor_graphs import BETWEEN, factors_of, keys_of, measured_from
from pgti_gtsam.gate.candidates import agreement
from pgti_gtsam.gate.kept.kept_optimum import KeptOptimum
from pgti_gtsam.gate.kept.known_closures import Ends, KnownClosures, Prediction
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.spectral.block_inverse import products, solve

MOST_CLOSURES = 256
"""Closures since the reference map beyond which it is made anew: conditioning on so many takes 20 milliseconds."""

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


class Reached(NamedTuple):
    """A keyframe at the end of a track: its pose, and root and gathered errors as in `Tail`."""

    pose: Any
    root: int
    gathered: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GrownMap:
    """A map as closures find the map in a running pipeline.

    Attributes
    ----------
    optimum : KeptOptimum
        Of the reference map.
    way_m : (n,) float or None
        Way along the track to every keyframe of the reference map; None where these are not one track up to the last.
    tail : Tail
    places : ChainMap from key to int
        Keyframes of the tail, then those of the reference map, which all maps grown from the latter share.
    ends : dict from robot to key
        Latest keyframe of each robot; the robot is the first byte of the keys.
    known : KnownClosures
        Closures that passed since.
    """

    optimum: KeptOptimum
    way_m: Array | None
    tail: Tail
    places: ChainMap[int, int]
    ends: Mapping[int, int]
    known: KnownClosures

    @classmethod
    def of(cls, reference: ReferenceMap) -> GrownMap:
        """A reference map, and nothing since."""
        units, keys, track = reference.settled.model.units, reference.pose_graph.keys.tolist(), reference.track
        d, optimum = len(units.spread), KeptOptimum.of(reference.settled)
        return cls(
            optimum=optimum,
            way_m=track.way_m if track.order[-1] == len(keys) - 1 else None,
            tail=Tail(poses=(), roots=np.empty(0, dtype=np.int64), gathered=np.empty((0, d, d))),
            places=ChainMap({}, {key: place for place, key in enumerate(keys)}),
            ends={robot_of(key): key for key in keys},
            known=KnownClosures.none(optimum.factor, units),
        )

    @property
    def closures(self) -> Ties:
        """Closures that passed since."""
        return self.known.ties

    @property
    def units(self) -> Units:
        """ρ, the vertical and the spread of the reference map."""
        return self.optimum.units

    @property
    def way(self) -> Array | None:
        """Way along the track to every keyframe, (n + t,), in ρ; None where these are not the track of one robot."""
        if len(self.ends) > 1 or self.way_m is None:
            return None
        places = np.array([pose.translation() for pose in (self.pose(len(self.way_m) - 1), *self.tail.poses)])
        since = np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))
        return np.append(self.way_m, self.way_m[-1] + since) / self.units.unit_m

    @property
    def is_worn(self) -> bool:
        """Whether so much came since that the reference map is better made anew."""
        return len(self.closures.pairs) > MOST_CLOSURES or len(self.tail.poses) > len(self.optimum)

    def grown(self, news: Iterable[tuple[gtsam.NonlinearFactorGraph, gtsam.Values]]) -> GrownMap | None:
        """The map with more keyframes.

        None where appending does not suffice: each new keyframe must be tied by one between factor, which measures a
        pose of the map's type from the latest keyframe of its robot, and nothing else may come that a map is read from:
        no landmark and no position in the world.

        Parameters
        ----------
        news : iterable of (gtsam.NonlinearFactorGraph, gtsam.Values)
            Factors and values of each step of the smoother.
        """
        steps: list[tuple[int, int, Any]] = []
        for factors, values in news:
            own = _steps(factors, values)
            if own is None:
                return None
            steps += own
        return self._appended(steps)

    def _appended(self, steps: Sequence[tuple[int, int, Any]]) -> GrownMap | None:
        """The map with keyframes that steps tie, each to the latest of its robot; None where a step does not."""
        n, turn, tail = len(self.optimum), self.units.levelling, self.tail
        ends, reached, found = dict(self.ends), dict[int, Reached](), list[Reached]()
        for key, before, measured in steps:
            robot = robot_of(key)
            if ends.get(robot) != before or isinstance(measured, gtsam.Pose2) is not self.units.is_planar:
                return None
            last = reached[robot] if robot in reached else self._reached(self.places[before])

            # what it hangs on, and what the steps since gather
            step = turn.inverse().compose(measured).compose(turn)
            pose = last.pose.compose(step)
            carry = self.pose(last.root).between(pose).AdjointMap()
            gathered = carry @ np.diag(self._variances(step)) @ carry.T + last.gathered
            reached[robot], ends[robot] = Reached(pose, last.root, gathered), key
            found.append(reached[robot])
        if not found:
            return self
        poses, roots, own = zip(*found, strict=True)
        places = {key: place for place, (key, _, _) in enumerate(steps, start=n + len(tail.poses))}
        return replace(
            self,
            tail=Tail(
                poses=tail.poses + poses,
                roots=np.append(tail.roots, roots),
                gathered=np.concatenate([tail.gathered, own]),
            ),
            places=ChainMap({**self.places.maps[0], **places}, *self.places.maps[1:]),
            ends=ends,
        )

    def _reached(self, place: int) -> Reached:
        """A keyframe with what it hangs on."""
        n = len(self.optimum)
        if place < n:
            return Reached(self.optimum.pose(place), place, np.zeros_like(self.units.spread))
        return Reached(self.tail.poses[place - n], int(self.tail.roots[place - n]), self.tail.gathered[place - n])

    def offered(self, closure: gtsam.NonlinearFactorGraph) -> Ties | None:
        """A closure as a tie; None for no tie, or several."""
        factors = factors_of(closure)
        if len(factors) != 1 or not isinstance(factors[0], BETWEEN):
            return None
        first, second = sorted(keys_of(factors[0]))
        if first == second or not {first, second} <= self.places.keys():
            return None
        tie = Offered(self.places[first], self.places[second], measured_from(factors[0], first))
        return closures_of([tie], self.units)

    def predicted(self, offered: Ties) -> Prediction:
        """The prediction of some ties by the map and all closures since."""
        own = self._ends(offered.pairs)
        halves, across, covariance = self.known.halves.extended(own.roots, own.carry)
        across += self._shared(self.known.ends, own)
        covariance += self._shared(own, own)
        lost = self._lost(own)
        covariance[lost], covariance[:, lost], across[:, lost] = np.nan, np.nan, np.nan
        return self.known.prediction(offered, self._missed(offered), own, halves, across, covariance)

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
        own, later = self.optimum.closures_between(offered.pairs), np.ones(len(self.closures.pairs), dtype=bool)
        earlier = np.zeros(len(own.pairs), dtype=bool)
        for k in np.flatnonzero(held).tolist():
            since, before = (_same(ties, offered, k) for ties in (self.closures, own))
            since, before = since[later[since]], before[~earlier[before]]
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
        if self.units.bends(moved):
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
        way = self.way
        if way is None:
            return len(missed) == 1
        measured = [
            self.pose(i).compose(z) for i, z in zip(offered.pairs[:, 0].tolist(), offered.measured, strict=True)
        ]
        ends = [pose.compose(pose.Expmap(error)) for pose, error in zip(measured, missed, strict=True)]
        motions = [pose.compose(end.inverse()) for pose, end in zip(measured, ends, strict=True)]
        places = [end.translation() for end in ends]
        return bool(agreement(motions, places, way[offered.pairs[:, 1]], self.units.unit_m).all())

    def tied(self, new: Prediction) -> GrownMap | None:
        """The map with more ties that hold; None where the ties bend the map beyond a linear step."""
        tolerance, missed = np.diag(new.offered.variances.ravel()), new.missed.ravel()
        moved = tolerance @ np.linalg.solve(new.spread + tolerance, missed) - missed
        if not np.isfinite(moved).all():
            return None
        known = self.known.with_predicted(new)
        if self.units.moves_little(moved.reshape(new.missed.shape)):
            return replace(self, known=known)

        # the step that all of them take the reference map by
        pull = np.zeros((len(self.optimum), new.missed.shape[1]))
        np.add.at(pull, known.ends.roots, -np.einsum("keab,ka->keb", known.ends.carry, known.pulls()))
        return None if self.units.bends(solve(self.optimum.factor, pull)) else replace(self, known=known)

    def tied_by(self, closure: gtsam.NonlinearFactorGraph) -> GrownMap | None:
        """The map with a closure that passed; None where that takes more than a linear step."""
        tie = self.offered(closure)
        return None if tie is None else self.tied(self.predicted(tie))

    def _missed(self, ties: Ties) -> Array:
        """e of each tie at the keyframes of the reference map's optimum and the steps since, (k d,)."""
        places, local = np.unique(ties.pairs, return_inverse=True)
        poses = [self.pose(place) for place in places.tolist()]
        return errors_of(poses, local.reshape(-1, 2), ties.measured).ravel()

    def pose(self, place: int) -> Any:
        """The keyframe at a place, where the optimum of the reference map and the steps since put the keyframe."""
        n = len(self.optimum)
        return self.optimum.pose(place) if place < n else self.tail.poses[place - n]

    def _variances(self, step: Any) -> Array:
        variances = step_variances(step, self.units.unit_m)
        if not self.units.is_planar:
            variances[:2] *= self.units.tilt**2
        return variances

    def _covariance(self, pairs: NDArray[np.int64]) -> Array:
        """Joint covariance of the pose of j seen from i for all pairs, (k d, k d); NaN where no tie leads between."""
        ends = self._ends(pairs)
        whole, lost = products(self.optimum.factor, ends.roots, ends.carry) + self._shared(ends, ends), self._lost(ends)
        whole[lost], whole[:, lost] = np.nan, np.nan
        return whole

    def _shared(self, one: Ends, other: Ends) -> Array:
        """What the steps of the tails add to a covariance, (k d, l d): two ends on a tail share those up to the earlier
        of both."""
        n, d = len(self.optimum), len(self.units.spread)
        added = np.zeros((len(one.pairs), len(other.pairs), d, d))
        (a, i), (b, j) = (np.nonzero(ends.pairs >= n) for ends in (one, other))
        first, second = one.pairs[a, i] - n, other.pairs[b, j] - n
        on_one = one.roots[a, i][:, None] == other.roots[b, j]
        gathered = self.tail.gathered[np.minimum(first[:, None], second)] * on_one[:, :, None, None]
        parts = np.einsum("aux,abxy,bvy->abuv", one.carry[a, i], gathered, other.carry[b, j], optimize=True)
        np.add.at(added, (a[:, None], b), parts)
        return added.transpose(0, 2, 1, 3).reshape(len(one.pairs) * d, len(other.pairs) * d)

    def _lost(self, ends: Ends) -> NDArray[np.bool_]:
        """Rows of relative poses between parts that nothing joins, (k d,)."""
        return np.repeat(np.diff(self.optimum.component[ends.roots], axis=1)[:, 0] != 0, len(self.units.spread))

    def _ends(self, pairs: NDArray[np.int64]) -> Ends:
        """The ends of pairs, with the Jacobian of the pose of j seen from i."""
        roots = np.append(np.arange(len(self.optimum)), self.tail.roots)[pairs]
        found = [
            [
                sign * self.pose(j).between(self.pose(root)).AdjointMap()
                for sign, root in zip((-1.0, 1.0), own, strict=True)
            ]
            for j, own in zip(pairs[:, 1].tolist(), roots.tolist(), strict=True)
        ]
        d = len(self.units.spread)
        return Ends(pairs, roots, np.array(found).reshape(-1, 2, d, d))


def _steps(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> list[tuple[int, int, Any]] | None:
    """Key, key before and measured pose of each new keyframe; None where more comes that a map is read from."""
    new = set(values.keys())
    steps: dict[int, tuple[int, Any]] = {}
    others = []
    for factor in factors_of(factors):
        if not isinstance(factor, BETWEEN):
            others.append(factor)
            continue
        before, key = min(keys_of(factor)), max(keys_of(factor))
        if key not in new or key in steps:
            return None
        steps[key] = before, measured_from(factor, before)

    # velocities, biases and attitudes are not read, nor is the motion beside a step
    poses = new if new == steps.keys() else pose_keys(values)
    if poses != steps.keys() or not all(_says_nothing(factor, steps) for factor in others):
        return None
    return [(key, *steps[key]) for key in sorted(steps)]


def _says_nothing(factor: Any, steps: Mapping[int, tuple[int, Any]]) -> bool:
    """Whether a map is read alike with and without a factor: see `adapter.families`."""
    name = type(factor).__name__
    if family_of(name) is Family.MOTION:
        keys = keys_of(factor)
        return any(key in keys and before in keys for key, (before, _) in steps.items())
    return family_of(name) is Family.IGNORED and not holds_position(name)


def _same(ties: Ties, offered: Ties, k: int) -> NDArray[np.int64]:
    """Which of some ties measure the same between the same keyframes as an offered tie."""
    rows = np.flatnonzero((ties.pairs == offered.pairs[k]).all(axis=1))
    return rows[[ties.measured[row].equals(offered.measured[k], ROUNDING) for row in rows.tolist()]]


def robot_of(key: int) -> int:
    """The robot of a keyframe: the first byte of the key."""
    return key >> 56
