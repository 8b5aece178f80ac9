"""Scan graphs with false closures between places at least 5 m apart: fr079 and mit-cscail through the gate.

Radii are what the scanner saw. Odometry is chained, so that its drift is back; the loops of the published map stand
for true ones, and every false one says that two places coincide which the published map has apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.errors import InvalidOptionError

LOGS = ("fr079", "mit-cscail")
APART_M = 5.0
"""Least distance in the published map between the ends of a false closure."""

N_FALSE = 80


def run(data: Path, seeds: Sequence[int], tell: Callable[[str], None]) -> dict[str, dict[str, Any]]:
    """Gate both graphs with fresh false closures for every seed; counts and rates by log."""
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
    """Add false closures to one log, and gate all of its closures in time order."""
    dataset = datasets.read(path)
    graph = gtsam.NonlinearFactorGraph(dataset.graph)
    published = dataset.truth if dataset.truth is not None else dataset.values
    false = false_pairs(published, np.random.default_rng(seed))
    noise = graph.at(dataset.closures[0]).noiseModel()
    for first, second, measured in false:
        graph.add(gtsam.BetweenFactorPose2(first, second, measured, noise))
    started = time.process_time()
    result = pgti.gate_graph(graph, dataset.values, radii=dataset.radii)
    accepted = set(result.accepted)
    return {
        "seed": seed,
        "true": len(dataset.closures),
        "true_accepted": len(accepted & set(dataset.closures)),
        "false": len(false),
        "false_accepted": len(accepted - set(dataset.closures)),
        "seconds": time.process_time() - started,
    }


def false_pairs(published: gtsam.Values, random: np.random.Generator) -> list[tuple[int, int, gtsam.Pose2]]:
    """Pairs of distant keyframes, earlier first, with the relative pose of two that see the same place from nearby."""
    keys = sorted(published.keys())
    pairs: list[tuple[int, int, gtsam.Pose2]] = []
    while len(pairs) < N_FALSE:
        first, second = sorted(random.choice(keys, 2, replace=False).tolist())
        between = published.atPose2(first).between(published.atPose2(second))
        if np.hypot(between.x(), between.y()) >= APART_M:
            x, y, theta = random.normal(0.0, [0.3, 0.3, 0.2])
            pairs.append((first, second, gtsam.Pose2(x, y, theta)))
    return pairs


def _path(data: Path, name: str) -> Path:
    for folder in (data, data / "scan_pose_graphs"):
        if (folder / f"{name}.log").is_file():
            return folder / f"{name}.log"
    raise InvalidOptionError(
        f"expected {name}.log in {data} or its scan_pose_graphs, got none; --data names the folder"
    )
