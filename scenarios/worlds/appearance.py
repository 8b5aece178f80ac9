"""Loop closures as a detector would propose them: by the shape of the surroundings, without positions.

Every keyframe's ranges are compared with all earlier ranges, over every turn where the sensor sees all around
(the idea of Scan Context: Kim and Kim, IROS 2018); the most alike are aligned by point-to-plane ICP. Pairs that align
well is proposed, with the relative pose that ICP found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from scenarios.worlds.alignment import Cloud, icp
from scenarios.worlds.sensors import Sensor
from scenarios.worlds.solid import Array, Hits, Solid

RECENT_M = 25.0
"""Way driven within which nobody looks for a closure."""

EVERY = 2
"""Every second keyframe asks."""

N_BEST = 3
"""Most alike earlier keyframes that are tried, each the best of its neighbourhood."""

NEIGHBOURHOOD = 5
"""Keyframes on either side of a better one that are not tried."""

ALIKE = 0.2
"""Largest root mean square difference of two views' log ranges."""

ALIGNED = 0.9
"""Least share of points that find a counterpart."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposals:
    """What a detector found among n keyframes.

    Attributes
    ----------
    pairs : (k, 2) int
        Earlier and later keyframe, by the later one.
    measured : list of k gtsam.Pose3
        Relative poses that alignment found.
    unlike : (n, n) float
        Difference of two views, [later, earlier]; infinite where nobody asked.
    """

    pairs: Array
    measured: list[gtsam.Pose3]
    unlike: Array


def proposals(solid: Solid, sensor: Sensor, poses: Sequence[gtsam.Pose3], random: np.random.Generator) -> Proposals:
    """The proposals of a detector on a drive.

    Parameters
    ----------
    solid : Solid
    sensor : Sensor
    poses : sequence of gtsam.Pose3
    random : np.random.Generator
    """
    scans = [_noisy(sensor.scan(solid, pose), sensor, random) for pose in poses]
    step = float(np.median([a.range(b) for a, b in pairwise(poses)]))
    before = np.arange(len(poses))
    return matched(scans, sensor, step, before <= before[:, None] - RECENT_M / step)


def matched(
    scans: Sequence[Hits],
    sensor: Sensor,
    reach_m: float,
    asked: NDArray[np.bool_],
    *,
    alike: float = ALIKE,
    aligned: float = ALIGNED,
) -> Proposals:
    """Scans that look alike and align.

    Parameters
    ----------
    scans : sequence of Hits
        A cloud for each keyframe, in the body's frame.
    sensor : Sensor
    reach_m : float
        Largest distance between points that belong together, to begin with.
    asked : (n, n) bool
        The earlier keyframes allowed for a later keyframe, [later, earlier].
    alike : float
        Largest root mean square difference of two views' log ranges.
    aligned : float
        Least share of points that find a counterpart within a third of `reach_m`.
    """
    unlike, turns = _compared(np.stack([_view(scan, sensor) for scan in scans]), sensor)
    unlike = np.where(asked, unlike, np.inf)
    clouds = [_cloud(scan, sensor) for scan in scans]
    pairs, measured = [], []
    for j in range(0, len(scans), EVERY):
        for i in _best(unlike[j], alike):
            first = gtsam.Pose3(gtsam.Rot3.Yaw(turns[j, i]), np.zeros(3))
            rough = icp(clouds[i], clouds[j], first, reach_m)
            found = icp(clouds[i], clouds[j], rough.pose, reach_m / 3)
            if found.fitness >= aligned:
                pairs.append((i, j))
                measured.append(_rounded(found.pose))
    return Proposals(pairs=np.array(pairs, dtype=int).reshape(-1, 2), measured=measured, unlike=unlike)


def _noisy(scan: Hits, sensor: Sensor, random: np.random.Generator) -> Hits:
    distances = scan.distances + random.normal(0.0, sensor.noise_m, scan.distances.shape)
    with np.errstate(invalid="ignore"):
        points = scan.points * (distances / scan.distances)[:, None]
    return Hits(points=points, normals=scan.normals, distances=distances)


def _view(scan: Hits, sensor: Sensor) -> Array:
    return np.log1p(np.minimum(scan.distances, sensor.reach_m)).reshape(sensor.grid)


def _compared(views: Array, sensor: Sensor) -> tuple[Array, Array]:
    """Root mean square difference of every two views at the best turn, and that turn in rad, [later, earlier]."""
    n, n_azimuths = len(views), views.shape[1]
    flat = views.reshape(n, -1)
    power = (flat**2).mean(axis=1)
    if not sensor.all_around:
        square = power[:, None] + power - 2 * flat @ flat.T / flat.shape[1]
        return np.sqrt(np.maximum(square, 0)), np.zeros((n, n))
    waves = np.fft.rfft(views, axis=1)
    square, turns = np.empty((n, n)), np.empty((n, n))
    for j in range(n):
        products = np.fft.irfft((waves * waves[j].conj()).sum(axis=2), n=n_azimuths, axis=1) / flat.shape[1]
        best = products.argmax(axis=1)
        square[j] = power[j] + power - 2 * products[np.arange(n), best]
        turns[j] = 2 * np.pi * best / n_azimuths
    return np.sqrt(np.maximum(square, 0)), turns


def _best(unlike: Array, alike: float) -> list[int]:
    """The most alike keyframes, none in the neighbourhood of a better match."""
    found: list[int] = []
    for i in np.argsort(unlike, kind="stable"):
        if unlike[i] > alike or len(found) == N_BEST:
            break
        if all(abs(i - other) > NEIGHBOURHOOD for other in found):
            found.append(int(i))
    return found


def _cloud(scan: Hits, sensor: Sensor) -> Cloud:
    """Points with normals; a scanner of a single plane knows of the floor."""
    seen = np.isfinite(scan.distances)
    points, normals = scan.points[seen], scan.normals[seen]
    if sensor.planar:
        x, y = np.meshgrid(np.linspace(-3, 3, 7), np.linspace(-3, 3, 7))
        floor = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.5)])
        points = np.concatenate([points, floor])
        normals = np.concatenate([normals, np.broadcast_to([0.0, 0.0, 1.0], floor.shape)])
    return Cloud.of(points, normals)


def _rounded(pose: gtsam.Pose3) -> gtsam.Pose3:
    """To a micrometre: how many digits of a sum are the same hangs on the processor."""
    return gtsam.Pose3(
        gtsam.Rot3.Expmap(np.round(gtsam.Rot3.Logmap(pose.rotation()), 6)), np.round(pose.translation(), 6)
    )
