"""Closures as candidate ties: the relative pose that each measures or implies, and groups of ties that agree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import Keyframes, measures_pose, typed_value
from pgti_gtsam.drift.settled import Settled
from pgti_gtsam.drift.ties import Offered
from pgti_gtsam.drift.units import variances_of
from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import factors_of, graph_of, keys_of
from pgti_gtsam.gate.revisits import revisits

AGREEMENT, AGREEMENT_RAD = 0.5, 0.35
"""How far apart two closures of a revisit may put a place and still say the same, in ρ and in rad."""

STRETCHED = 0.1
"""Part by which that grows with each ρ of way between the two: the odometry drifts in between as well."""

STILL, MOST_STEPS = 1e-3, 50
"""Standard deviation, in ρ, of landmarks that a keyframe is placed by, and Levenberg-Marquardt steps for it."""

OPEN = 1e-6
"""Information along a direction, in parts of the largest, below which landmarks leave the direction open: one seen by
bearing and range leaves the way around it open, two points leave the turn about the line between them."""

AS_WELL, EXACT = 1.01, 1e-6
"""Factor and difference of ½ Σ ‖e‖² up to which a keyframe is placed as well by one pose as by another."""


def measured_ties(closure: gtsam.NonlinearFactorGraph, keyframes: Keyframes) -> list[Offered]:
    """The relative poses that the factors of a closure measure.

    Parameters
    ----------
    closure : gtsam.NonlinearFactorGraph
    keyframes : Keyframes
    """
    found = []
    for factor in factors_of(closure):
        if measures_pose(factor):
            first, second = sorted(keys_of(factor), key=lambda key: keyframes.index[key])
            found.append(Offered(keyframes.index[first], keyframes.index[second], keyframes.measured(factor, first)))
    return [tie for tie in found if tie.first != tie.second]


def implied_tie(
    closure: gtsam.NonlinearFactorGraph, graph: gtsam.NonlinearFactorGraph, keyframes: Keyframes, unit_m: float
) -> Offered | None:
    """The relative pose that landmarks seen again imply: of their keyframe, placed by the landmarks alone, from the
    first observer.

    The landmarks keep their place on the map, and the keyframe is placed by the closure's factors, from its own pose
    and from the pose of the keyframe that knows most of the landmarks; the better fit counts, and of two that are as
    good the first. None where no other keyframe does.

    Parameters
    ----------
    closure : gtsam.NonlinearFactorGraph
    graph : gtsam.NonlinearFactorGraph
    keyframes : Keyframes
    unit_m : float
        The free radius ρ, m.
    """
    seen = {key for factor in factors_of(closure) for key in keys_of(factor)}
    second = max((key for key in seen if key in keyframes.index), key=lambda key: keyframes.index[key], default=None)
    if second is None:
        return None

    # who knows the landmarks
    known: dict[int, int] = {}
    for factor in factors_of(graph):
        keys = keys_of(factor)
        if seen.intersection(keys) - {second}:
            for key in set(keys) & set(keyframes.index) - {second}:
                known[key] = known.get(key, 0) + 1
    if not known:
        return None
    first = min(known, key=lambda key: (-known[key], keyframes.index[key]))

    # where they put the keyframe, seen from there
    placed = _placed(closure, keyframes, second, [keyframes.pose(second), keyframes.pose(first)], unit_m)
    if placed is None:
        return None
    pose, unobservable = placed
    i, j, measured = keyframes.index[first], keyframes.index[second], keyframes.pose(first).between(pose)
    if i < j:
        return Offered(i, j, measured, unobservable)

    # the other way round
    if unobservable is not None:
        scale = _lengths(pose, unit_m)[:, None]
        unobservable = np.linalg.qr(measured.AdjointMap() @ (scale * unobservable) / scale)[0]
    return Offered(j, i, measured.inverse(), unobservable)


def _placed(
    closure: gtsam.NonlinearFactorGraph, keyframes: Keyframes, key: int, starts: Sequence[Any], unit_m: float
) -> tuple[Any, NDArray[np.float64] | None] | None:
    """Pose of a keyframe by factors to variables that stay fixed, and the directions that these leave open."""
    # the factors of the keyframe, every other variable fixed at its value
    factors = [factor for factor in factors_of(closure) if key in keys_of(factor)]
    graph, values = graph_of(factors), gtsam.Values()
    for other in sorted({k for factor in factors for k in keys_of(factor)} - {key}):
        for name, prior in _PRIORS.items():
            value = typed_value(keyframes.values, name, other)
            if value is not None:
                (values.insertPoint3 if name == "Point3" else values.insert)(other, value)
                graph.push_back(
                    prior(other, value, gtsam.noiseModel.Isotropic.Sigma(_DIMENSIONS[name], STILL * unit_m))
                )
                break
        else:
            return None

    # the best optimum of all starts
    found = []
    for start in starts:
        tried = gtsam.Values(values)
        tried.insert(key, start)
        try:
            best = optimised(graph, tried, max_iterations=MOST_STEPS)
        except UnsolvableGraphError:  # all landmarks lie behind the camera, say
            continue
        found.append((graph.error(best), best))
    if not found:
        return None
    least = min(error for error, _ in found)
    best = next(values for error, values in found if error <= AS_WELL * least + EXACT)
    pose = best.atPose2(key) if isinstance(starts[0], gtsam.Pose2) else best.atPose3(key)
    return pose, _open_directions(graph_of(factors), best, key, _lengths(pose, unit_m))


def _open_directions(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, key: int, lengths: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Orthonormal directions of a pose, in units of some lengths, about which no factor says anything, (d, k).

    All of them where a factor has no derivative, as a bearing to where the keyframe stands.
    """
    ordering = gtsam.Ordering()
    for each in [key, *sorted(set(graph.keyVector()) - {key})]:
        ordering.push_back(each)
    jacobian, _ = graph.linearize(values).jacobian(ordering)
    own = jacobian[:, : len(lengths)] * lengths
    if not np.isfinite(own).all():
        return np.eye(len(lengths))
    information, axes = np.linalg.eigh(own.T @ own)
    is_open = information <= OPEN * information[-1]
    return axes[:, is_open] if is_open.any() else None


def _lengths(pose: Any, unit_m: float) -> NDArray[np.float64]:
    """ρ and rad, in GTSAM's order, (d,)."""
    return np.sqrt(variances_of(unit_m, 1.0, is_planar=isinstance(pose, gtsam.Pose2)))


_PRIORS: dict[str, Any] = {
    "Point2": gtsam.PriorFactorPoint2,
    "Point3": gtsam.PriorFactorPoint3,
    "Pose2": gtsam.PriorFactorPose2,
    "Pose3": gtsam.PriorFactorPose3,
}
_DIMENSIONS = {"Point2": 2, "Point3": 3, "Pose2": 3, "Pose3": 6}


def agreeing(settled: Settled, ties: NDArray[np.int64], way: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Groups of ties of a revisit that agree.

    A tie from i to j moves the map at j by T_i z T_j⁻¹. Two agree when these motions put the places of both to the
    same places; the largest party is taken first.

    Parameters
    ----------
    settled : Settled
    ties : (k,) int
    way : (n,) float
        Along the track, ρ.
    """
    pairs, found = settled.model.ties.pairs, []
    for revisit in revisits([(int(i), int(j)) for i, j in pairs[ties]], way):
        own = ties[revisit]
        agree, left = _agree(settled, own, way), np.arange(len(own))
        while len(left):
            best = left[np.argmax(agree[np.ix_(left, left)].sum(axis=1))]
            party = left[agree[best, left]]
            found.append(own[party])
            left = np.setdiff1d(left, party)
    return found


def _agree(settled: Settled, ties: NDArray[np.int64], way: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The pairs of ties that agree, (k, k)."""
    model, poses = settled.model, settled.poses
    pairs = model.ties.pairs[ties]
    motions = [
        poses[i].compose(model.ties.measured[k]).compose(poses[j].inverse())
        for k, (i, j) in zip(ties.tolist(), pairs.tolist(), strict=True)
    ]
    return agreement(
        motions, [poses[j].translation() for j in pairs[:, 1].tolist()], way[pairs[:, 1]], model.units.unit_m
    )


def agreement(
    motions: Sequence[Any], places: Sequence[NDArray[np.float64]], way: NDArray[np.float64], unit_m: float
) -> NDArray[np.bool_]:
    """The pairs of closures that agree, (k, k).

    Parameters
    ----------
    motions : sequence of k gtsam.Pose2 or gtsam.Pose3
        Motion of the map at the later keyframe by each closure.
    places : sequence of k (2,) or (3,) float, m
        Of the later keyframes.
    way : (k,) float
        Of the later keyframes along the track, ρ.
    unit_m : float
        ρ.
    """
    own = np.arange(len(motions))
    moved = np.array([[motion.transformFrom(place) for place in places] for motion in motions])
    apart = np.linalg.norm(moved - moved[own, own], axis=2) / unit_m
    allowed = AGREEMENT * (1 + STRETCHED * np.abs(way[:, None] - way))
    turned = np.array([[_angle(one.between(other)) for other in motions] for one in motions])
    return np.asarray((np.maximum(apart, apart.T) <= allowed) & (turned <= AGREEMENT_RAD))


def _angle(pose: Any) -> float:
    if isinstance(pose, gtsam.Pose2):
        return abs(float(pose.theta()))
    return float(np.linalg.norm(gtsam.Rot3.Logmap(pose.rotation())))
