"""Ray-cast worlds with a cloud a keyframe on disk, mended by the command line; and the ties of a naive matcher.

The naive matcher takes every two keyframes that look alike and that ICP aligns (`worlds.appearance`), as a pipeline
without a gate does. In storeys of one plan all floors look alike.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam import datasets
from pgti_gtsam.dense_map import load_open3d
from scenarios import worlds
from scenarios.measures import trajectory_errors
from scenarios.problem import between
from scenarios.worlds.sensors import Sensor
from scenarios.worlds.solid import Array, Solid

WORLDS = ("streets", "garage", "storeys")
FLOOR_M = 2.0
"""Height between keyframes from which they are on different floors."""

LIDAR = Sensor(
    name="3D lidar",
    half_width_rad=np.pi,
    elevations_rad=(-np.radians(25), np.radians(15)),
    grid=(180, 32),
    reach_m=40.0,
    n_landmarks=300,
)


def row(world: str, seed: int) -> dict[str, Any]:
    """Mend the odometry of a drive by its clouds.

    Parameters
    ----------
    world : str
    seed : int
    """
    driven = worlds.drive(world, seed)
    radius = float(np.median([radius for radius in driven.radii.values() if radius > 0]))
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        _write(driven, where)
        started = _processor_seconds()
        command = [
            sys.executable, "-c", "from pgti_gtsam.cli import main; main()", "mend", str(where / "map.g2o"),
            "--radius", f"{radius:.3f}", "--clouds", str(where / "clouds"), "--out", str(where / "mended.g2o"),
            "--json", str(where / "mended.json"),
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stderr)
        seconds = _processor_seconds() - started
        document = json.loads((where / "mended.json").read_text(encoding="utf-8"))
        mended = datasets.read(where / "mended.g2o")
    return {"world": world, "seed": seed, "radius_m": radius, "seconds": seconds, **_told(driven, document, mended)}


def _processor_seconds() -> float:
    """Of all processes that were run so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _told(driven: worlds.Drive, document: dict[str, Any], mended: datasets.Dataset) -> dict[str, Any]:
    """The mended map against the truth."""
    # ties by their distance from the truth
    truth, start = driven.truth, driven.truth[0]
    poses = [mended.values.atPose3(key) for key in range(len(truth))]
    ties = [mended.graph.at(slot) for slot in range(mended.graph.size())]
    ends = [(factor.keys(), factor.measured()) for factor in ties if abs(factor.keys()[0] - factor.keys()[1]) > 1]
    missed = [float(np.linalg.norm(truth[i].between(truth[j]).between(z).translation())) for (i, j), z in ends]

    # what a matcher without a gate ties
    heights = np.array([pose.z() for pose in truth])
    naive = driven.pairs[~driven.true]
    return {
        "n_keyframes": len(truth),
        "verdict_before": document["before"]["verdict"]["level"],
        "verdict": document["after"]["verdict"]["level"],
        "places_before": sum(document["before"]["places"].values()),
        "places": sum(document["after"]["places"].values()),
        "confirmed": len(missed),
        "false_in": int((np.array(missed) > worlds.TRUE_M).sum()),
        "wrong_floor": int(sum(abs(heights[i] - heights[j]) > FLOOR_M and off > worlds.TRUE_M
                           for ((i, j), _), off in zip(ends, missed, strict=True))),
        "missed_median_m": float(np.median(missed)) if missed else None,
        "naive": len(driven.pairs),
        "naive_false": len(naive),
        "naive_wrong_floor": int((np.abs(heights[naive[:, 0]] - heights[naive[:, 1]]) > FLOOR_M).sum()),
        "ate_before_m": trajectory_errors(truth, driven.odometry.chained(start))["ate_m"],
        "ate_m": trajectory_errors(truth, poses)["ate_m"],
    }  # fmt: skip


def _write(driven: worlds.Drive, folder: Path) -> None:
    """The odometry as g2o, and a PCD file for each keyframe."""
    open3d, random, sensor = load_open3d(), np.random.default_rng(driven.seed), LIDAR
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas(driven.odometry.sigmas)
    for i, step in enumerate(driven.odometry.steps):
        graph.add(between(i, i + 1, step, noise))
    for key, pose in enumerate(driven.odometry.chained(driven.truth[0])):
        values.insert(key, pose)
    datasets.write_g2o(graph, values, folder / "map.g2o")
    (folder / "clouds").mkdir()
    for key, pose in enumerate(driven.truth):
        points = seen_from(sensor, driven.layout.solid, pose, random)
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        open3d.io.write_point_cloud(str(folder / "clouds" / f"{key:06d}.pcd"), cloud)


def seen_from(sensor: Sensor, solid: Solid, pose: gtsam.Pose3, random: np.random.Generator) -> Array:
    """Points of a scan with the sensor's noise, (n, 3) m, seen from the pose.

    Parameters
    ----------
    sensor : Sensor
    solid : Solid
    pose : gtsam.Pose3
    random : numpy.random.Generator
    """
    seen = sensor.scan(solid, pose)
    hit = np.isfinite(seen.distances)
    ranges = seen.distances[hit] + random.normal(0.0, sensor.noise_m, int(hit.sum()))
    return np.asarray(seen.points[hit] * (ranges / seen.distances[hit])[:, None])
