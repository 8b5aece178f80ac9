"""The map as an elastic body in units of free space: how far must it bend for a closure to hold?

Covariances are often wrong, by a factor or in kind, and χ² with them. The yardstick does without: it
gives every edge of the pose graph the tolerance that a poor odometer of any make would still keep, in
units of the free radius ρ, and asks what part of it a closure uses up. Lengths are divided by ρ, so one
number serves rooms and streets, and no noise model of the caller's enters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import read_keyframes, typed_value
from pgti_gtsam.factor_graphs import BETWEEN, factors_of, joined, keys_of
from pgti_gtsam.gate.evidence import free_space_unit
from pgti_gtsam.gate.trial import anchors, optimised, still_held
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.track import step_edges

DRIFT = 0.03
"""Tolerance of the odometry, as a standard deviation: a random walk of 3 % of ρ, and of 0.03 rad (1.7°), for every
ρ travelled or radian turned. With ρ = 4 m that is 12 cm and 1.7° for four metres of road, with ρ = 0.75 m it is
2 cm and 1.7° for a step indoors: worse than what visual or wheel odometry is trusted with."""

OFFSET = 0.25
"""Tolerance of a closure, in ρ and in rad: its relative pose may be off by a quarter of the free radius. Half of
what the gate grants as strain, since a residual shows only in part where the odometry gives way too."""

AGREEMENT = 0.5
"""How far apart two closures may put a place and still say the same, in ρ: twice the tolerance of one."""

SHORTEST = 0.05
"""Least length of a step, in ρ: a standing robot drifts a little too, and its tolerance must not be zero."""

MAX_ITERATIONS = 8
"""Steps of the elastic optimum. One that bends within tolerance has settled by then."""

PRECISION = 0.01
"""Relative change of the elastic energy at which to stop: half a percent of the bending."""


EASY, HOPELESS = 0.5, 10.0
"""Bending below and above which the first, linear step tells enough. On the closures of KITTI 00, 06 and 07, one by one
and in groups, the nonlinear optimum was within a quarter of it below, and never came under 5.7 above 12."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Yardstick:
    """A map at rest: every edge measures what the estimate has, so that nothing is bent yet.

    Attributes
    ----------
    unit_m : float
        ρ.
    edges : gtsam.NonlinearFactorGraph
        Between factors with the tolerances as noise models.
    poses : gtsam.Values
        Keyframes only, each as a Pose2 or Pose3.
    """

    unit_m: float
    edges: gtsam.NonlinearFactorGraph
    poses: gtsam.Values

    @cached_property
    def held(self) -> gtsam.NonlinearFactorGraph:
        """A prior for every component of the map."""
        return anchors(self.edges, self.poses)

    @cached_property
    def at_rest(self) -> gtsam.GaussianFactorGraph:
        """The edges, linear where they rest."""
        return self.edges.linearize(self.poses)

    def bending(self, closure: gtsam.NonlinearFactorGraph) -> float:
        """Bending in units of the tolerance: √(E / d), with E the elastic energy and d the dimension of a pose.

        E = min Σ ‖Log(z_ij⁻¹ T_i⁻¹ T_j)‖² over the map's edges and the closure's between factors, of the linear
        model where that is small or out of all proportion. The factors of one closure say one thing, so d counts
        once. A closure without a between factor pulls at nothing here: see `bent`.
        """
        pulls = gtsam.NonlinearFactorGraph()
        for factor in factors_of(closure):
            if isinstance(factor, BETWEEN):
                pulls.push_back(self._pull(factor))
        if not pulls.size():
            return 0.0
        graph = joined(self.edges, pulls)
        held = still_held(self.held, graph, self.poses)
        linear = self._linear_bending(joined(pulls, held))
        if linear is not None and not EASY < linear < HOPELESS:
            return linear
        bent = optimised(graph, self.poses, held=held, max_iterations=MAX_ITERATIONS, tolerance=PRECISION)
        return self._root_energy(2 * graph.error(bent))

    def bent(self, after: gtsam.Values) -> float:
        """Bending that the caller's optimum shows: √(E / d) of the map's edges alone."""
        return self._root_energy(2 * self.edges.error(poses_of(after)))

    def _linear_bending(self, pulls: gtsam.NonlinearFactorGraph) -> float | None:
        """Bending by one linear step from rest; None where a chain is so long that its elimination loses all digits."""
        linear = gtsam.GaussianFactorGraph()
        linear.push_back(self.at_rest)
        linear.push_back(pulls.linearize(self.poses))
        try:
            return self._root_energy(2 * linear.error(linear.optimize()))
        except RuntimeError:  # GTSAM's IndeterminantLinearSystemException; Levenberg-Marquardt damps it away
            return None

    def votes(self, closures: Sequence[gtsam.NonlinearFactorGraph]) -> NDArray[np.int64]:
        """How many of some closures each agrees with, itself included, (k,).

        A closure from a to b moves the map at b by T_a z T_b⁻¹. Two agree when these motions put the ends b of
        both to the same places, give or take `AGREEMENT`. One without a between factor has no vote.
        """
        factors = [next((f for f in factors_of(closure) if isinstance(f, BETWEEN)), None) for closure in closures]
        voters = [k for k, factor in enumerate(factors) if factor is not None]
        ends = [self._ends(factors[k]) for k in voters]
        centres = np.array([end.translation() for _, end in ends])
        motions = [predicted * end.inverse() for predicted, end in ends]
        count = np.zeros(len(closures), dtype=np.int64)
        if voters:
            moved = np.array([[motion.transformFrom(centre) for centre in centres] for motion in motions])
            own = np.array([predicted.translation() for predicted, _ in ends])  # motion k at end k
            miss = np.linalg.norm(moved - own[None, :], axis=2)
            count[voters] = (np.maximum(miss, miss.T) <= AGREEMENT * self.unit_m).sum(axis=1)
        return count

    def _ends(self, factor: Any) -> tuple[Any, Any]:
        """Where a between factor predicts its second pose, and where the map has it."""
        first, second = (pose_at(self.poses, key) for key in keys_of(factor))
        return first * factor.measured(), second

    def _root_energy(self, energy: float) -> float:
        dimension = next(iter(self.poses.dims().values()))
        return float(np.sqrt(energy / dimension))

    def _pull(self, factor: Any) -> Any:
        return _between(keys_of(factor), factor.measured(), OFFSET, self.unit_m)


def yardstick(pose_graph: PoseGraph, values: gtsam.Values) -> Yardstick:
    """The yardstick of a map as it stands.

    Steps of the track are odometry; other pairs that a factor ties are closures already accepted, or hold as well.
    """
    unit, poses = free_space_unit(pose_graph), poses_of(values)
    keys = pose_graph.keys.tolist()
    placed = [pose_at(poses, key) for key in keys]
    edges = gtsam.NonlinearFactorGraph()
    known = zip(
        pose_graph.edges.tolist(), pose_graph.edge_sources.tolist(), step_edges(pose_graph).tolist(), strict=True
    )
    for (i, j), source, is_step in known:
        if is_step:
            step = placed[i].between(placed[j])
            edges.push_back(_between((keys[i], keys[j]), step, DRIFT * math.sqrt(_length(step, unit)), unit))
        elif source & EdgeSource.BETWEEN:
            edges.push_back(_between((keys[i], keys[j]), placed[i].between(placed[j]), OFFSET, unit))
    return Yardstick(unit_m=unit, edges=edges, poses=poses)


def poses_of(values: gtsam.Values) -> gtsam.Values:
    """Keyframes only, those of other types as the Pose2 or Pose3 they hold."""
    keyframes = read_keyframes(values)
    poses = gtsam.Values(gtsam.utilities.allPose3s(values))
    poses.insert(gtsam.utilities.allPose2s(values))
    for key, pose in keyframes.poses.items():
        poses.insert(key, pose)
    return poses


def pose_at(poses: gtsam.Values, key: int) -> Any:
    """The Pose2 or Pose3 of a key."""
    return typed_value(poses, "Pose2", key) or poses.atPose3(key)


def _length(step: Any, unit: float) -> float:
    """Length of a step in ρ or radians, whichever is more."""
    if isinstance(step, gtsam.Pose2):
        moved, turned = math.hypot(step.x(), step.y()), abs(step.theta())
    else:
        moved, turned = math.hypot(*step.translation()), math.hypot(*gtsam.Rot3.Logmap(step.rotation()))
    return max(moved / unit, turned, SHORTEST)


def _between(keys: Sequence[int], measured: Any, tolerance: float, unit: float) -> Any:
    """Between factor with a tolerance in ρ and rad."""
    first, second = keys
    length, angle = tolerance * unit, tolerance
    if isinstance(measured, gtsam.Pose2):
        model = gtsam.noiseModel.Diagonal.Sigmas([length, length, angle])
        return gtsam.BetweenFactorPose2(first, second, measured, model)
    model = gtsam.noiseModel.Diagonal.Sigmas([angle, angle, angle, length, length, length])
    return gtsam.BetweenFactorPose3(first, second, measured, model)
