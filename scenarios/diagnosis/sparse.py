"""Maps of odometry and closures with given radii: the output of most SLAM systems."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np

from scenarios.diagnosis import damage
from scenarios.diagnosis.courses import Course, course, match, out_and_back, second_passes
from scenarios.diagnosis.damage import Case, Intact
from scenarios.problem import between
from scenarios.worlds import MATCH
from scenarios.worlds.layouts import LAYOUTS
from scenarios.worlds.solid import Array

POORER = 3.0
"""Factor of the odometry's errors in the damage of that name."""

SURE = 1e-4
"""Least sigma of a step, rad and m."""


def case(world: str, seed: int, kind: str) -> Case:
    """A course through a world with damage.

    Parameters
    ----------
    world : str
    seed : int
    kind : str
        One of `DAMAGES`.
    """
    random = np.random.default_rng([seed, sorted(LAYOUTS).index(world), damage.DAMAGES.index(kind)])
    if kind == damage.BACK:
        driven = out_and_back(world, seed)
    else:
        driven = course(world, seed, POORER if kind == damage.DRIFT else 1.0)
    found = intact(driven, random, with_ties=kind != damage.BACK)
    return damage.damaged(found, kind, random, range(len(driven.truth)), float(np.median(driven.radii)))


def intact(driven: Course, random: np.random.Generator, *, with_ties: bool = True) -> Intact:
    """The map of a course with all that a detector would tie.

    Parameters
    ----------
    driven : Course
    random : np.random.Generator
    with_ties : bool
    """
    passes = second_passes(driven) if with_ties else []
    noise = told(MATCH, driven)
    revisits = tuple(
        tuple(between(i, j, flat(match(driven, i, j, random), driven), noise) for i, j in pairs.tolist())
        for pairs in passes
    )
    return Intact(
        base=odometry(driven),
        revisits=revisits,
        near=values(driven.truth, driven),
        chained=values(driven.chained(), driven),
        radii=dict(enumerate(driven.radii.tolist())),
        places=np.array([pose.translation() for pose in driven.truth]),
        noise=noise,
        match=identity(driven),
        solid=driven.layout.solid if with_ties else None,  # a drive out and back is in no world
    )


def odometry(driven: Course) -> gtsam.NonlinearFactorGraph:
    """The steps of a course as factors, in order."""
    graph, noise = gtsam.NonlinearFactorGraph(), told(driven.sigmas, driven)
    for i, step in enumerate(driven.steps):
        graph.add(between(i, i + 1, flat(step, driven), noise))
    return graph


def identity(driven: Course) -> Callable[[np.random.Generator], gtsam.Pose2 | gtsam.Pose3]:
    """A matcher that takes two places for the same place."""

    def measured(random: np.random.Generator) -> gtsam.Pose2 | gtsam.Pose3:
        return flat(gtsam.Pose3.Expmap(random.normal(0.0, MATCH)), driven)

    return measured


def told(sigmas: Array, driven: Course) -> gtsam.noiseModel.Base:
    """The noise model of sigmas in GTSAM's order in space.

    Parameters
    ----------
    sigmas : (6,) float
        In GTSAM's order in space.
    driven : Course
    """
    own = sigmas[[3, 4, 2]] if driven.is_planar else sigmas
    return gtsam.noiseModel.Diagonal.Sigmas(np.maximum(own, SURE))


def flat(pose: gtsam.Pose3, driven: Course) -> gtsam.Pose2 | gtsam.Pose3:
    """The pose on the course's map, planar or spatial.

    Parameters
    ----------
    pose : gtsam.Pose3
    driven : Course
    """
    return gtsam.Pose2(pose.x(), pose.y(), pose.rotation().yaw()) if driven.is_planar else pose


def values(poses: list[gtsam.Pose3], driven: Course) -> gtsam.Values:
    """Poses under the keys 0, 1, …

    Parameters
    ----------
    poses : list of gtsam.Pose3
    driven : Course
    """
    found = gtsam.Values()
    for key, pose in enumerate(poses):
        found.insert(key, flat(pose, driven))
    return found
