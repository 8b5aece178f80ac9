"""The raw log `aces`: odometry, mended by scans, against 88 hand-checked relative poses of scans far apart in time.

The error is Kümmerle's: how far relations of the map lie from the hand-checked ones (Autonomous Robots 27, 2009,
doi:10.1007/s10514-009-9155-6). Beside the mended map stands graduated non-convexity (GTSAM's GNC, truncated least
squares) with what brute force finds: every pair of scans that the odometry has within 5 m of each other, aligned by
the same generalised ICP, scan to scan, and kept where three points in five find a counterpart.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from scipy.spatial import KDTree

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.datasets import Dataset
from pgti_gtsam.mending import Attempt
from pgti_gtsam.mending.alignment import Cloud, align
from pgti_gtsam.mending.submap import Submap

REACH_M, LATER, EVERY = 5.0, 40, 3
"""Distance within which pairs are tried, keyframes between them, and of how many later ones each is tried."""

REGION = np.array([0.3, 0.3, 0.08])
"""Standard deviations of its predictions, in ρ and rad: one start each."""

MATCHED = 0.6
"""Share of points with a counterpart from which brute force keeps a fit."""

FALSE_M = 1.0
"""How far a tie may lie from the optimum with the hand-checked relations, which is no better between them."""

SIGMAS = np.array([0.05, 0.05, 0.02])
"""Of its fits: what the reader grants the hand-checked relations."""


def row(path: Path) -> dict[str, Any]:
    """Errors of the odometry, of the mended map and of GNC's."""
    # odometry alone, mended
    whole = datasets.read(path)
    relations = [whole.graph.at(slot) for slot in whole.closures or ()]
    dataset = replace(whole, graph=odometry_of(whole), closures=())
    started = time.process_time()
    mended = pgti.mend(dataset.graph, dataset.values, pgti.scans_of(dataset.scans), radii=dataset.radii)
    seconds = time.process_time() - started

    # GNC over all fits
    started = time.process_time()
    fits = _brute_force(dataset)
    robust = _gnc(dataset, fits)
    best = optimum_of(whole)
    intact = pgti.mend(whole.graph, best, pgti.scans_of(whole.scans), radii=whole.radii, closures=whole.closures)
    return {
        "n_keyframes": dataset.values.size(),
        "n_relations": len(relations),
        "verdict_before": mended.before.verdict,
        "verdict": mended.after.verdict,
        "collisions": len(mended.after.integrity.collision_edges),
        "confirmed": len(mended.of("confirmed")),
        "false_in": sum(_missed(best, attempt) > FALSE_M for attempt in mended.of("confirmed")),
        "n_brute_force": len(fits),
        "verdict_intact": intact.before.verdict,
        "confirmed_intact": len(intact.of("confirmed")),
        "seconds": seconds,
        "seconds_gnc": time.process_time() - started,
        "errors": {
            "odometry": _errors(relations, dataset.values),
            "mended": _errors(relations, mended.values),
            "GNC with brute-force ICP": _errors(relations, robust),
            "optimum with the relations themselves": _errors(relations, best),
            "the same, mended": _errors(relations, intact.values),
        },
    }


def odometry_of(dataset: Dataset) -> gtsam.NonlinearFactorGraph:
    """The factors of a log without loops."""
    graph = gtsam.NonlinearFactorGraph()
    for slot in range(dataset.graph.size()):
        if slot not in (dataset.closures or ()):
            graph.push_back(dataset.graph.at(slot))
    return graph


def _missed(values: gtsam.Values, attempt: Attempt) -> float:
    """Distance between a tie and the map's pose, m."""
    i, j = attempt.keys
    return float(np.linalg.norm(values.atPose2(i).between(values.atPose2(j)).between(attempt.pose).translation()))


def _errors(relations: list[gtsam.BetweenFactorPose2], values: gtsam.Values) -> dict[str, float]:
    """Mean distance, m, and angle, degrees, with the medians and the worst distance."""
    off = []
    for factor in relations:
        i, j = factor.keys()
        off.append(factor.measured().between(values.atPose2(i).between(values.atPose2(j))))
    shifts, turns = np.array([np.linalg.norm(each.translation()) for each in off]), [abs(each.theta()) for each in off]
    return {
        "mean_m": float(shifts.mean()),
        "median_m": float(np.median(shifts)),
        "worst_m": float(shifts.max()),
        "mean_deg": float(np.degrees(np.mean(turns))),
    }


def _brute_force(dataset: Dataset) -> list[gtsam.BetweenFactorPose2]:
    """Every fit of two single scans that most points agree to."""
    keys = [key for key in sorted(dataset.scans) if len(dataset.scans[key]) > 30]
    poses = [dataset.values.atPose2(key) for key in keys]
    unit = float(np.median(list((dataset.radii or {}).values())))
    clouds = [Cloud.of(Submap(view=dataset.scans[key], points=dataset.scans[key]), unit) for key in keys]
    near = KDTree([pose.translation() for pose in poses]).query_pairs(REACH_M, output_type="ndarray")
    model, found = gtsam.noiseModel.Diagonal.Sigmas(SIGMAS), []
    for i, j in near[(np.diff(near, axis=1)[:, 0] > LATER) & (near[:, 1] % EVERY == 0)].tolist():
        fit = align(clouds[i], clouds[j], poses[i].between(poses[j]), np.diag((REGION * [unit, unit, 1]) ** 2))
        if fit is not None and fit.matched >= MATCHED:
            found.append(gtsam.BetweenFactorPose2(keys[i], keys[j], fit.pose, model))
    return found


def _gnc(dataset: Dataset, fits: list[gtsam.BetweenFactorPose2]) -> gtsam.Values:
    """Truncated least squares, the odometry known to be true."""
    graph = gtsam.NonlinearFactorGraph(dataset.graph)
    graph.add(gtsam.PriorFactorPose2(0, dataset.values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    n_known = graph.size()
    for fit in fits:
        graph.push_back(fit)
    parameters = gtsam.GncLMParams()
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setKnownInliers(list(range(n_known)))
    return gtsam.GncLMOptimizer(graph, dataset.values, parameters).optimize()


def optimum_of(dataset: Dataset) -> gtsam.Values:
    """The optimum of all factors of a log in the plane, the first keyframe held."""
    graph = gtsam.NonlinearFactorGraph(dataset.graph)
    graph.add(gtsam.PriorFactorPose2(0, dataset.values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    return gtsam.LevenbergMarquardtOptimizer(graph, dataset.values).optimize()
