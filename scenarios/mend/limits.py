"""How near other ties that are as good can come to the published poses of a scan graph.

Published poses are the optimum of the published loops, so that a map with any other ties lies apart from them, however
good the ties. Four maps tell how far:

1. halves of the published loops, drawn at random, against the published poses and against each other;
2. the loops' pairs with the published poses for measurements, so that only odometry and the choice of pairs err;
3. the loops' pairs as `mend` matches them, in the loops' own noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.datasets import Dataset
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import between_factor
from pgti_gtsam.mending import Wanted
from pgti_gtsam.mending.alignment import Cloud, align, is_thin
from pgti_gtsam.mending.submap import Submaps
from pgti_gtsam.mending.verdicts import sensors_say
from pgti_gtsam.track import track_of
from scenarios.measures import trajectory_errors
from scenarios.mend.logs import cells, chained, planar_poses, published

N_HALVES = 10
"""Times that the loops are halved."""

REGION, REGION_RAD = 0.3, 0.05
"""Standard deviations of predictions, in ρ and rad: one start each."""


def row(path: Path) -> dict[str, Any]:
    """Maps of a log by other ties.

    Parameters
    ----------
    path : Path
    """
    # the published loops, and halves of them
    dataset = datasets.read(path)
    loops = [dataset.graph.at(slot) for slot in dataset.closures or ()]
    random, halves = np.random.default_rng(0), []
    for _ in range(N_HALVES):
        order = random.permutation(len(loops)).tolist()
        parts = order[: len(loops) // 2], order[len(loops) // 2 :]
        halves.append([_tied(dataset, [loops[k] for k in part]) for part in parts])

    # the same pairs as published, and as matched
    exact = [between_factor(*f.keys(), published(dataset, f), f.noiseModel()) for f in loops]
    submaps = _submaps(dataset)
    matched = [each for factor in loops if (each := _matched(dataset, submaps, factor)) is not None]
    return {
        "n_loops": len(loops),
        "n_matched": len(matched),
        "full": _told(dataset, _tied(dataset, loops)),
        "halves": [_told(dataset, each) for both in halves for each in both],
        "halves_apart_m": [trajectory_errors(planar_poses(one), planar_poses(other))["ate_m"] for one, other in halves],
        "exact": _told(dataset, _tied(dataset, exact)),
        "matched": _told(dataset, _tied(dataset, matched)),
    }


def _tied(dataset: Dataset, ties: Sequence[Any]) -> gtsam.Values:
    """The optimum of odometry and ties."""
    graph = gtsam.NonlinearFactorGraph()
    for slot in range(dataset.graph.size()):
        if slot not in dataset.closures:
            graph.push_back(dataset.graph.at(slot))
    for tie in ties:
        graph.push_back(tie)
    return optimised(graph, dataset.values)


def _told(dataset: Dataset, values: gtsam.Values) -> dict[str, float]:
    """Distance of a map from the published poses, and its cells."""
    errors = trajectory_errors(planar_poses(dataset.values), planar_poses(values))
    return {"ate_m": errors["ate_m"], "cells": cells(dataset, values)}


def _submaps(dataset: Dataset) -> Submaps:
    """Submaps on odometry alone."""
    values = chained(dataset)
    pose_graph = pgti.from_gtsam(dataset.graph, values, radii=dataset.radii)
    return Submaps(
        clouds=pgti.scans_of(dataset.scans),
        keys=pose_graph.keys.tolist(),
        poses=planar_poses(values),
        track=track_of(pose_graph),
        unit_m=float(np.median(pose_graph.radii[pose_graph.radii > 0])),
    )


def _matched(dataset: Dataset, submaps: Submaps, loop: Any) -> Any | None:
    """A loop with what the match measures between its keyframes; None where the sensors do not confirm the match."""
    # align from where the published poses say
    unit, (i, j) = submaps.unit_m, loop.keys()
    covariance = np.diag(np.square([REGION * unit, REGION * unit, REGION_RAD]))
    wanted = Wanted(
        keyframes=(i, j),
        keys=(i, j),
        place="missed closure",
        pose=published(dataset, loop),
        covariance=covariance,
        allowance_m=REGION * unit,
    )
    ends = [submaps.at(k) for k in (i, j)]
    if any(map(is_thin, ends)):
        return None
    fit = align(*(Cloud.of(end, unit) for end in ends), wanted.pose, covariance)

    # keep what is confirmed
    if fit is None or sensors_say(wanted, fit, unit)[0] != "confirmed":
        return None
    return between_factor(i, j, fit.pose, loop.noiseModel())
