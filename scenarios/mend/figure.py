"""A map of odometry alone before and after mending: all readings, the track, and the ties that came in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from matplotlib.figure import Figure

import pgti_gtsam as pgti
from pgti_gtsam import datasets, outputs
from pgti_gtsam.datasets import Dataset
from scenarios.mend.aces import odometry_of


def draw(log: Path, out: Path) -> None:
    """Mend the odometry of a raw log, and draw both maps.

    Parameters
    ----------
    log : Path
    out : Path
    """
    dataset = datasets.read(log)
    scans = pgti.scans_of(dataset.scans)
    mended = pgti.mend(odometry_of(dataset), dataset.values, scans, radii=dataset.radii)
    ties = mended.of("confirmed")
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    before, after = figure.subplots(1, 2)
    _map(before, dataset, mended.before_values, "odometry")
    _map(after, dataset, mended.values, f"mended: {len(ties)} ties that scans confirm")
    for attempt in ties:
        ends = np.array([mended.values.atPose2(key).translation() for key in attempt.keys])
        after.plot(*ends.T, color="#1b7a43", linewidth=1.0)
    with outputs.drawn(out) as part:
        figure.savefig(part, dpi=110)


def _map(axes: Any, dataset: Dataset, values: gtsam.Values, title: str) -> None:
    points = []
    for key, seen in dataset.scans.items():
        matrix = values.atPose2(key).matrix()
        near = seen[np.linalg.norm(seen, axis=1) < 15]
        points.append(near[::2] @ matrix[:2, :2].T + matrix[:2, 2])
    track = np.array([values.atPose2(key).translation() for key in sorted(values.keys())])
    axes.plot(*np.concatenate(points).T, ",", color="#16202e", alpha=0.5)
    axes.plot(*track.T, color="#d7263d", linewidth=0.6)
    axes.set(title=title, aspect="equal")
    axes.set_axis_off()
