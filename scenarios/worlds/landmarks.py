"""Landmarks that a sensor tracks, as GTSAM factors: identities last as long as a track does.

A place seen again later is a new landmark: only a loop closure says that two landmarks are the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from scenarios.worlds.sensors import Sensor
from scenarios.worlds.solid import Array, Solid

LOST_AFTER = 3
"""Keyframes unseen after which a landmark is no longer followed."""

CALIBRATION = gtsam.Cal3_S2Stereo(400.0, 400.0, 0.0, 320.0, 240.0, 0.3)
"""Of a stereo camera: focal lengths, skew and principal point in pixels, base line in m."""

BODY_P_CAMERA = gtsam.Pose3(gtsam.Rot3(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], dtype=float)), np.zeros(3))
"""A camera looks along z, with x to the right; the body along x."""

PIXEL_SIGMA = 0.5


def places(solid: Solid, sensor: Sensor, height_m: float, per_m2: float, random: np.random.Generator) -> Array:
    """Distinct points on surfaces, (n, 3) m; a planar scanner's points lie at the scanner's height, on walls.

    Parameters
    ----------
    solid : Solid
    sensor : Sensor
    height_m : float
        Of a planar scanner.
    per_m2 : float
        Points a square metre.
    random : np.random.Generator
    """
    points, normals = solid.draw(random, per_m2)
    if not sensor.planar:
        return points
    points = points[np.abs(normals[:, 2]) < 0.5]
    return np.column_stack([points[:, :2], np.full(len(points), height_m)])


def sightings(
    solid: Solid, sensor: Sensor, poses: Sequence[gtsam.Pose3], points: Array, random: np.random.Generator
) -> list[list[tuple[int, Array]]]:
    """For each keyframe, tracks in view with positions: (3,) m in the keyframe's own frame, with the sensor's noise.

    Parameters
    ----------
    solid : Solid
    sensor : Sensor
    poses : sequence of gtsam.Pose3
    points : (n, 3) float
    random : np.random.Generator
    """
    strength = random.permutation(len(points))
    last = np.full(len(points), -LOST_AFTER - 1)
    track, n_tracks, seen = np.full(len(points), -1), 0, []
    for k, pose in enumerate(poses):
        view = sensor.sees(solid, pose, points)
        view = view[random.random(len(view)) >= sensor.drop_out]
        view = view[np.argsort(strength[view])][: sensor.n_landmarks]
        new = view[k - last[view] > LOST_AFTER]
        track[new] = n_tracks + np.arange(len(new))
        n_tracks += len(new)
        last[view] = k
        local = (points[view] - pose.translation()) @ pose.rotation().matrix()
        away = np.linalg.norm(local, axis=1, keepdims=True)
        local = local * (1 + random.normal(0.0, sensor.noise_m, away.shape) / away)
        seen.append(list(zip(track[view].tolist(), local, strict=True)))
    return seen


def landmark_graph(
    seen: Sequence[Sequence[tuple[int, Array]]], estimates: Sequence[gtsam.Pose3], sensor: Sensor
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Sightings as factors of the sensor's kind, landmarks placed by their first sighting from the estimates.

    Parameters
    ----------
    seen : sequence of sequence of tuple
        Tracks and positions for each keyframe.
    estimates : sequence of gtsam.Pose3
    sensor : Sensor
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pixels = gtsam.noiseModel.Isotropic.Sigma(3, PIXEL_SIGMA)
    ranges = gtsam.noiseModel.Isotropic.Sigma(2 if sensor.planar else 3, sensor.noise_m)
    for i, (pose, tracks) in enumerate(zip(estimates, seen, strict=True)):
        values.insert(i, gtsam.Pose2(*pose.translation()[:2], pose.rotation().yaw()) if sensor.planar else pose)

        # a sighting, and at the first the landmark's value
        for track, local in tracks:
            key = gtsam.symbol("l", track)
            if not values.exists(key):
                place = pose.transformFrom(local)
                values.insert(key, place[:2] if sensor.planar else place)
            if sensor.planar:
                away = float(np.hypot(*local[:2]))
                graph.add(
                    gtsam.BearingRangeFactor2D(
                        i, key, gtsam.Rot2.fromAngle(np.arctan2(local[1], local[0])), away, ranges
                    )
                )
            elif sensor.name == "camera":
                depth = local[0]
                u, v = 320.0 - 400.0 * local[1] / depth, 240.0 - 400.0 * local[2] / depth
                stereo = gtsam.StereoPoint2(u, u - 400.0 * 0.3 / depth, v)
                graph.add(gtsam.GenericStereoFactor3D(stereo, pixels, i, key, CALIBRATION, BODY_P_CAMERA))
            else:
                away = float(np.linalg.norm(local))
                graph.add(gtsam.BearingRangeFactor3D(i, key, gtsam.Unit3(local), away, ranges))
    return graph, values
