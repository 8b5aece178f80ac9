"""fr079 and mit-cscail with loops thinned to a tenth or removed, and some of the rest made false: mended by scans.

Odometry is chained, so that its drift is back. Published poses are no ground truth, but what the published loops and
their makers' optimiser made of the log: a tie counts as false where the tie differs by more than half a metre. How
well scans fit each other, whoever tied them, is told by the number of cells of 10 cm that all readings fall into: the
sharper a map, the fewer.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.datasets import Dataset
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import between_factor
from pgti_gtsam.mending import Attempt, Mended
from scenarios.measures import trajectory_errors

LOGS = ("fr079", "mit-cscail")
KINDS = ("intact", "a tenth", "a tenth, some false", "odometry")

FALSE_M = 0.5
"""How far a tie may lie from the published poses."""

FALSE_LOOP_M = 5.0
"""Least distance by which a loop that is made false misses the published poses."""

CELL_M = 0.1


def row(path: Path, kind: str, seed: int) -> dict[str, Any]:
    """Mend a damaged log.

    Parameters
    ----------
    path : Path
    kind : str
        Kind of damage.
    seed : int
    """
    # damage and mend
    dataset = datasets.read(path)
    graph, false = damaged(dataset, kind, np.random.default_rng(seed))
    started = time.process_time()
    mended = pgti.mend(graph, chained(dataset), pgti.scans_of(dataset.scans), radii=dataset.radii)
    seconds = time.process_time() - started

    # against the published graph
    full = optimised(dataset.graph, dataset.values)
    missed = np.array([_missed(dataset, attempt) for attempt in mended.of("confirmed")])
    whole = pgti.diagnose(dataset.graph, full, radii=dataset.radii)
    maps = {
        "before": mended.before_values,
        "after": mended.values,
        "exact": _exact(dataset, mended),
        "full": full,
        "published": dataset.values,
    }
    return {
        "log": path.stem,
        "kind": kind,
        "seed": seed,
        "n_loops": graph.size() - (dataset.graph.size() - len(dataset.closures or ())),
        "n_false": len(false),
        "false_out": len(false & set(mended.out)),
        "true_out": len(set(mended.out) - false),
        "verdict_before": mended.before.verdict,
        "verdict": mended.after.verdict,
        "collisions": {
            "before": len(mended.before.integrity.collision_edges),
            "after": len(mended.after.integrity.collision_edges),
            "full": len(whole.integrity.collision_edges),
        },
        "ate_m": {
            name: trajectory_errors(planar_poses(dataset.values), planar_poses(maps[name]))["ate_m"] for name in maps
        },
        "cells": {name: cells(dataset, values) for name, values in maps.items()},
        "confirmed": len(missed),
        "refused": len(mended.of("refused")),
        "undecided": len(mended.of("undecided")),
        "false_in": int((missed > FALSE_M).sum()),
        "missed_median_m": float(np.median(missed)) if len(missed) else None,
        "missed_worst_m": float(missed.max()) if len(missed) else None,
        "rounds": mended.n_rounds,
        "seconds": seconds,
    }


def damaged(dataset: Dataset, kind: str, random: np.random.Generator) -> tuple[gtsam.NonlinearFactorGraph, set[int]]:
    """The graph of a kind, and the slots of its false loops: each false loop measures another loop's pose.

    Parameters
    ----------
    dataset : Dataset
    kind : str
        Kind of damage.
    random : np.random.Generator
    """
    # loops to keep, and loops to make false
    loops = np.array(dataset.closures)
    n_kept = {"intact": len(loops), "odometry": 0}.get(kind, len(loops) // 10)
    kept = random.choice(loops, n_kept, replace=False).tolist()
    n_false = max(1, len(kept) // 10) if kind == "a tenth, some false" else 0

    # odometry and true loops
    graph, false = gtsam.NonlinearFactorGraph(), set()
    for slot in range(dataset.graph.size()):
        if slot not in dataset.closures:
            graph.push_back(dataset.graph.at(slot))
    for slot in kept[n_false:]:
        graph.push_back(dataset.graph.at(slot))

    # false loops, whose claim lies apart from the truth
    for slot in kept[:n_false]:
        factor = dataset.graph.at(slot)
        first, other = factor.keys()[0], dataset.graph.at(int(random.choice(loops)))
        claimed = dataset.values.atPose2(first).compose(other.measured())
        poses = {key: dataset.values.atPose2(key) for key in range(dataset.values.size())}
        second = int(
            random.choice([key for key, pose in poses.items() if claimed.range(pose.translation()) > FALSE_LOOP_M])
        )
        false.add(graph.size())
        graph.add(gtsam.BetweenFactorPose2(first, second, other.measured(), factor.noiseModel()))
    return graph, false


def chained(dataset: Dataset) -> gtsam.Values:
    """Poses that the odometry alone leads to."""
    odometry, values = {}, gtsam.Values()
    for slot in range(dataset.graph.size()):
        if slot not in dataset.closures:
            factor = dataset.graph.at(slot)
            first, second = factor.keys()
            odometry[first, second] = factor.measured()
            odometry[second, first] = factor.measured().inverse()
    pose = gtsam.Pose2()
    for key in range(dataset.values.size()):
        pose = pose if key == 0 else pose.compose(odometry[key - 1, key])
        values.insert(key, pose)
    return values


def published(dataset: Dataset, factor: Any) -> gtsam.Pose2:
    """What a between factor would measure if the published poses were true.

    Parameters
    ----------
    dataset : Dataset
    factor : gtsam.BetweenFactorPose2
    """
    i, j = factor.keys()
    return dataset.values.atPose2(i).between(dataset.values.atPose2(j))


def _missed(dataset: Dataset, attempt: Attempt) -> float:
    """How far a tie lies from the published poses, m."""
    return float(np.linalg.norm(published(dataset, attempt.factor).between(attempt.pose).translation()))


def _exact(dataset: Dataset, mended: Mended) -> gtsam.Values:
    """The mended map with the published poses in place of what the new ties measure: only their choice errs."""
    graph, new = gtsam.NonlinearFactorGraph(mended.graph), {attempt.keys for attempt in mended.of("confirmed")}
    for slot in range(graph.size()):
        factor = graph.at(slot)
        if factor is not None and tuple(factor.keys()) in new:
            graph.replace(slot, between_factor(*factor.keys(), published(dataset, factor), factor.noiseModel()))
    return optimised(graph, mended.values)


def planar_poses(values: gtsam.Values) -> list[gtsam.Pose2]:
    """Poses in the order of their keys.

    Parameters
    ----------
    values : gtsam.Values
    """
    return [values.atPose2(key) for key in sorted(values.keys())]


def cells(dataset: Dataset, values: gtsam.Values) -> int:
    """Cells that the readings of all scans fall into.

    Parameters
    ----------
    dataset : Dataset
    values : gtsam.Values
    """
    found = []
    for key, points in dataset.scans.items():
        matrix = values.atPose2(key).matrix()
        found.append(np.floor((points @ matrix[:2, :2].T + matrix[:2, 2]) / CELL_M).astype(np.int64))
    return len(np.unique(np.concatenate(found), axis=0))
