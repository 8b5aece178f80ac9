"""Worlds of walls and floors that look alike in many places, driven and sensed: from geometry to a problem.

1. A layout (`layouts`) is driven at random (`driving`) with odometry that drifts (`drift`).
2. The sensor tracks landmarks (`sensors`, `landmarks`): as GTSAM factors they give the radii, through the adapter.
3. Closures are proposed by the look of the surroundings (`appearance`), with the aligned pose.
4. Whether a proposal is true, and whether a false proposal makes free space overlap, follows from the true poses.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

import pgti_gtsam as pgti
from scenarios.problem import Problem, alone, between
from scenarios.worlds import appearance, drift, driving, landmarks
from scenarios.worlds.ambiguity import ambiguity as look_alikes
from scenarios.worlds.layouts import LAYOUTS, Layout
from scenarios.worlds.solid import Array

TRUE_M, TRUE_RAD = 0.5, 0.2
"""How far a measured relative pose may lie from the true one. Alignments err by a twentieth of it, or by metres."""

MATCH = np.array([0.005, 0.005, 0.01, 0.1, 0.1, 0.05])
"""Standard deviations of a match, on top of what alignment errs: roll, pitch, yaw in rad, x, y, z in m."""

FACTORS = {"a tenth": 0.1, "a third": 1 / 3, "right": 1.0, "three times": 3.0, "ten times": 10.0}
"""Sigmas that methods are told, in units of the true ones."""

ALIKE = (*FACTORS, "identity")
"""Odometry and closures alike; "identity" tells 1 rad and 1 m of both."""

APART = {"odometry a tenth": (0.1, 1.0), "closures a tenth": (1.0, 0.1)}
"""Factors of the sigmas of odometry and of closures."""

TOLD = (*ALIKE, *APART)

REACH = 30
"""Keyframes before a closure's later end that a false one carries along, when overlap is asked."""

AROUND = 5
"""Keyframes next to a closure's ends of which overlap is a matter of course."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """A drive through a world, with all sensor data.

    Attributes
    ----------
    world : str
    seed : int
    layout : Layout
    truth : list of gtsam.Pose3
    odometry : Odometry
    radii : dict of int to float
        m, by keyframe, from landmark factors on the drifted poses.
    landmarks : list of (m, 3) float
        m, by keyframe, as the keyframe sees them in the odometry's scale.
    pairs : (k, 2) int
        Proposed closures, earlier keyframe first.
    measured : list of gtsam.Pose3
    true, overlapping : (k,) bool
        As in `Problem`.
    ambiguity : float
        Share of keyframes whose place has a look-alike elsewhere: see `ambiguity`.
    """

    world: str
    seed: int
    layout: Layout
    truth: list[gtsam.Pose3]
    odometry: drift.Odometry
    radii: dict[int, float]
    landmarks: list[Array]
    pairs: NDArray[np.int64]
    measured: list[gtsam.Pose3]
    true: NDArray[np.bool_]
    overlapping: NDArray[np.bool_]
    ambiguity: float


@functools.lru_cache(maxsize=2)
def drive(world: str, seed: int, length_m: float | None = None) -> Drive:
    """Drive through a world of `LAYOUTS`, for the layout's length where none is given.

    Parameters
    ----------
    world : str
        A world of `LAYOUTS`.
    seed : int
    length_m : float, optional
        The layout's own when left out.
    """
    # way, odometry and sightings
    layout, random = LAYOUTS[world](), np.random.default_rng(seed)
    truth = driving.drive(layout.ways, random, length_m or layout.length_m, layout.step_m)
    sensor, solid = layout.sensor, layout.solid
    odometry = drift.odometry(truth, random, planar=sensor.planar, scaled=sensor.name == "camera")
    points = landmarks.places(solid, sensor, truth[0].z(), layout.landmarks_per_m2, random)
    seen = landmarks.sightings(solid, sensor, truth, points, random)

    # proposals, and the truth on each
    found = appearance.proposals(solid, sensor, truth, random)
    measured = [pose.compose(_match_error(random, sensor.planar)) for pose in found.measured]
    radii = _radii(seen, odometry, layout)
    named = list(zip(found.pairs.tolist(), measured, strict=True))
    true = np.array([_agrees(truth[i].between(truth[j]), m) for (i, j), m in named], dtype=bool)
    overlapping = np.array([overlaps(truth, radii, *pair, m) for pair, m in named], dtype=bool)
    return Drive(
        world=world,
        seed=seed,
        layout=layout,
        truth=truth,
        odometry=odometry,
        radii=radii,
        landmarks=[scale * _places(tracks) for tracks, scale in zip(seen, odometry.scales, strict=True)],
        pairs=found.pairs,
        measured=measured,
        true=true,
        overlapping=true | overlapping,
        ambiguity=look_alikes(found.unlike, np.array([pose.translation() for pose in truth]), layout.step_m),
    )


def drifting(driven: Drive, errors: drift.Errors) -> Drive:
    """The same drive with other errors of odometry; radii keep their size in the odometry's own scale.

    Parameters
    ----------
    driven : Drive
    errors : drift.Errors
    """
    sensor, random = driven.layout.sensor, np.random.default_rng([driven.seed, 1])
    found = drift.odometry(driven.truth, random, planar=sensor.planar, scaled=sensor.name == "camera", errors=errors)
    radii = {key: radius * found.scales[key] / driven.odometry.scales[key] for key, radius in driven.radii.items()}
    return dataclasses.replace(driven, odometry=found, radii=radii)


def problem(
    world: str,
    seed: int,
    told: str = "right",
    *,
    share: float = 1.0,
    length_m: float | None = None,
    errors: drift.Errors = drift.USUAL,
) -> Problem:
    """The drive as a method's problem.

    Parameters
    ----------
    world : str
        Of `LAYOUTS`.
    seed : int
    told : str
        Of `TOLD`.
    share : float
        False proposals per true proposal, as far as proposals exist.
    length_m : float, optional
        Way driven; the layout's own without.
    errors : Errors
        Other errors than the usual are drawn anew, for the same drive.
    """
    # the drive, with the odometry asked for
    driven = drive(world, seed, length_m)
    if errors is not drift.USUAL:
        driven = drifting(driven, errors)
    planar, start = driven.layout.sensor.planar, driven.truth[0]
    steps, matches = (_noise(own, planar) for own in _told(driven.odometry.sigmas, told))

    # odometry as methods get it
    graph, dim = gtsam.NonlinearFactorGraph(), 3 if planar else 6
    prior = gtsam.PriorFactorPose2 if planar else gtsam.PriorFactorPose3
    graph.add(prior(0, _flat(start, planar), gtsam.noiseModel.Isotropic.Sigma(dim, 1e-3)))
    for i, step in enumerate(driven.odometry.steps):
        graph.add(between(i, i + 1, _flat(step, planar), steps))

    # candidates and truth
    kept = _thinned(driven, share)
    return Problem(
        name=f"{world}-{seed}-{told}-{share}",
        graph=graph,
        values=_values(driven.odometry.chained(start), planar),
        closures=tuple(
            alone(between(*driven.pairs[k].tolist(), _flat(driven.measured[k], planar), matches)) for k in kept
        ),
        true=driven.true[kept],
        overlapping=driven.overlapping[kept],
        radii=driven.radii,
        truth=_values(driven.truth, planar),
        ambiguity=driven.ambiguity,
    )


def overlaps(truth: list[gtsam.Pose3], radii: dict[int, float], i: int, j: int, measured: gtsam.Pose3) -> bool:
    """Whether a closure carries the stretch that ends at j onto other spheres.

    Spheres that touch in truth do not count, nor do those next to the closure's ends.

    Parameters
    ----------
    truth : list of gtsam.Pose3
    radii : mapping
    i, j : int
    measured : gtsam.Pose3
    """
    places = np.array([pose.translation() for pose in truth])
    size = np.array([radii[k] for k in range(len(truth))])
    stretch = np.arange(max(j - REACH, i + AROUND), j - AROUND + 1)
    others = np.setdiff1d(np.arange(stretch[0] if len(stretch) else 0), np.arange(i - AROUND, i + AROUND + 1))
    if not len(stretch) or not len(others):
        return False
    carried = truth[i].compose(measured).compose(truth[j].inverse())
    moved = places[stretch] @ carried.rotation().matrix().T + carried.translation()
    reach = size[stretch, None] + size[others]
    touching = np.linalg.norm(moved[:, None] - places[others], axis=2) < reach
    touched = np.linalg.norm(places[stretch, None] - places[others], axis=2) < reach
    return bool((touching & ~touched).any())


def _agrees(true: gtsam.Pose3, measured: gtsam.Pose3) -> bool:
    off = true.between(measured)
    turned = np.linalg.norm(gtsam.Rot3.Logmap(off.rotation()))
    return bool(np.linalg.norm(off.translation()) < TRUE_M and turned < TRUE_RAD)


def _places(tracks: list[tuple[int, Array]]) -> Array:
    return np.array([at for _, at in tracks]).reshape(-1, 3)


def _radii(seen: list[list[tuple[int, Array]]], odometry: drift.Odometry, layout: Layout) -> dict[int, float]:
    scaled = [
        [(track, scale * at) for track, at in tracks] for tracks, scale in zip(seen, odometry.scales, strict=True)
    ]
    graph, values = landmarks.landmark_graph(scaled, odometry.chained(gtsam.Pose3()), layout.sensor)
    for i, step in enumerate(odometry.steps):
        noise = gtsam.noiseModel.Unit.Create(3 if layout.sensor.planar else 6)
        graph.add(between(i, i + 1, _flat(step, layout.sensor.planar), noise))
    adapted = pgti.from_gtsam(graph, values)
    return dict(zip(adapted.keys.tolist(), adapted.radii.tolist(), strict=True))


def _match_error(random: np.random.Generator, planar: bool) -> gtsam.Pose3:
    return gtsam.Pose3.Expmap(random.normal(0.0, MATCH) * (np.array([0, 0, 1, 1, 1, 0]) if planar else 1))


def _thinned(driven: Drive, share: float) -> NDArray[np.int64]:
    """True proposals and some of the false ones, by the later keyframe."""
    random, false = np.random.default_rng(driven.seed), np.flatnonzero(~driven.true)
    n_false = min(len(false), round(share * int(driven.true.sum())))
    kept = np.concatenate([np.flatnonzero(driven.true), random.choice(false, n_false, replace=False)])
    return kept[np.lexsort((driven.pairs[kept, 0], driven.pairs[kept, 1]))]


def _told(steps: Array, told: str) -> tuple[Array, Array]:
    """Sigmas of odometry and of closures that methods are told."""
    if told == "identity":
        return np.ones_like(steps), np.ones_like(MATCH)
    odometry, closures = APART[told] if told in APART else (FACTORS[told],) * 2
    return steps * odometry, MATCH * closures


def _noise(sigmas: Array, planar: bool) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(sigmas[[3, 4, 2]] if planar else sigmas)


def _flat(pose: gtsam.Pose3, planar: bool) -> gtsam.Pose2 | gtsam.Pose3:
    return gtsam.Pose2(pose.x(), pose.y(), pose.rotation().yaw()) if planar else pose


def _values(poses: list[gtsam.Pose3], planar: bool) -> gtsam.Values:
    values = gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, _flat(pose, planar))
    return values
