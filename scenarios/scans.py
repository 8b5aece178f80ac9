"""Scan graphs with false closures between scans that truly look alike: fr079 and mit-cscail through the gate.

Radii are the scanner's own. Odometry is chained, so that its drift is back; the loops of the published map stand
for true loops. A false loop joins two scans that the same matching as in `worlds.appearance` finds alike and aligns,
though at least 5 m apart on the published map.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.errors import InvalidOptionError
from scenarios.worlds import appearance
from scenarios.worlds.sensors import Sensor
from scenarios.worlds.solid import Hits

LOGS = ("fr079", "mit-cscail")
APART_M = 5.0
"""Least distance in the published map between the ends of a false closure."""

N_FALSE = 80
"""At most so many a run, drawn from all that look alike."""

SCANNER = Sensor(
    name="2D lidar",
    half_width_rad=np.pi / 2,
    elevations_rad=(0.0, 0.0),
    grid=(180, 1),
    reach_m=30.0,
    n_landmarks=0,
)
"""Half a turn, half of its readings."""

ALIKE, ALIGNED = 0.45, 0.6
"""As in `appearance.matched`: people and open doors make real scans less alike than ray-cast ones."""

MATCH_M = 0.6
"""Largest distance between points of two scans that belong together, to begin with."""


def run(data: Path, seeds: Sequence[int], tell: Callable[[str], None]) -> dict[str, dict[str, Any]]:
    """Gate both graphs with fresh false closures for every seed; counts and rates by log.

    Parameters
    ----------
    data : Path
        Folder of the scan graphs.
    seeds : sequence of int
    tell : callable
        Called with a line of progress.
    """
    found = {}
    for name in LOGS:
        rows = [gated(_path(data, name), seed) for seed in seeds]
        for row in rows:
            tell(
                f"{name:12s} seed {row['seed']:4d}  true {row['true_accepted']:4d} of {row['true']:4d}  "
                f"false {row['false_accepted']:3d} of {row['false']:3d}  {row['seconds']:6.1f} s"
            )
        counts = {key: sum(row[key] for row in rows) for key in ("true", "true_accepted", "false", "false_accepted")}
        found[name] = {
            **counts,
            "true_accepted_rate": counts["true_accepted"] / counts["true"],
            "false_accepted_rate": counts["false_accepted"] / counts["false"],
            "rows": rows,
        }
    return found


def gated(path: Path, seed: int) -> dict[str, Any]:
    """Add false closures to a log, and gate all closures in time order.

    Parameters
    ----------
    path : Path
    seed : int
    """
    # false closures among the true
    dataset = datasets.read(path)
    graph = gtsam.NonlinearFactorGraph(dataset.graph)
    alike, random = look_alikes(path), np.random.default_rng(seed)
    false = [alike[k] for k in sorted(random.choice(len(alike), min(N_FALSE, len(alike)), replace=False))]
    true = datasets.closure_slots(dataset)
    noise = graph.at(true[0]).noiseModel()
    for first, second, measured in false:
        graph.add(gtsam.BetweenFactorPose2(first, second, measured, noise))

    # the gate's answer
    started = time.process_time()
    offered = [*true, *range(dataset.graph.size(), graph.size())]
    result = pgti.gate_graph(graph, dataset.values, radii=dataset.radii, closures=offered)
    accepted = set(result.accepted)
    return {
        "seed": seed,
        "true": len(true),
        "true_accepted": len(accepted & set(true)),
        "look_alikes": len(alike),
        "false": len(false),
        "false_accepted": len(accepted - set(true)),
        "seconds": time.process_time() - started,
    }


@functools.lru_cache(maxsize=2)
def look_alikes(path: Path) -> list[tuple[int, int, gtsam.Pose2]]:
    """All pairs of keyframes that scan matching takes for the same place, earlier first, with the matched pose."""
    published = datasets.read(path).values
    scans = [_hits(scan) for scan in _scans(path)]
    places = np.array([published.atPose2(key).translation() for key in range(len(scans))])
    apart = np.linalg.norm(places[:, None] - places, axis=2) >= APART_M
    found = appearance.matched(scans, SCANNER, MATCH_M, np.tril(apart, -1), alike=ALIKE, aligned=ALIGNED)
    return [
        (i, j, gtsam.Pose2(pose.x(), pose.y(), pose.rotation().yaw()))
        for (i, j), pose in zip(found.pairs.tolist(), found.measured, strict=True)
    ]


def _scans(path: Path) -> list[NDArray[np.float64]]:
    """Ranges in m of every vertex's scan, in the file's order; infinite where nothing was hit."""
    lines = (line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("ROBOTLASER1"))
    ranges = [np.array(words[9 : 9 + int(words[8])], dtype=float) for words in lines]
    return [np.where(row < SCANNER.reach_m, row, np.inf) for row in ranges]


def _hits(ranges: NDArray[np.float64]) -> Hits:
    """A scan's points, with normals across the line to the neighbours, facing the scanner."""
    bearings = np.linspace(-np.pi / 2, np.pi / 2, len(ranges))
    kept = np.linspace(0, len(ranges) - 1, SCANNER.grid[0]).round().astype(int)
    finite = np.where(np.isfinite(ranges), ranges, SCANNER.reach_m)
    points = np.column_stack([finite * np.cos(bearings), finite * np.sin(bearings), np.zeros(len(ranges))])
    along = np.gradient(points, axis=0)
    normals = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(ranges))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Hits(points=points[kept], normals=normals[kept], distances=ranges[kept])


def _path(data: Path, name: str) -> Path:
    for folder in (data, data / "scan_pose_graphs"):
        if (folder / f"{name}.log").is_file():
            return folder / f"{name}.log"
    raise InvalidOptionError(
        f"expected {name}.log in {data} or its scan_pose_graphs, got none; --data names the folder"
    )
