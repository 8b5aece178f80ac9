"""Section 8: several robots in a common map, and control points, which separate metric from topological errors."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

import pgti_gtsam as pgti
from scenarios.paper.ways import Positions, covisible, heading_drift, pose_graph, scale_drift, way

N, NEIGHBOURS, RADIUS_M = 200, 4, 1.5
"""Keyframes of each drive, about two metres apart, each tied to the next four."""

CONTROL_SIGMA_M, EVERY = 0.05, 40
"""How well control points are known, and keyframes from one to the next."""

STEP_SIGMAS = np.array([0.3, 0.3, 0.02])
"""Of steps of two metres, x, y (m) and heading (rad): as wide as the scale's drift is."""

LAP = [(0, 0), (120, 0), (120, 80), (0, 80), (0, 1), (60, 1)]
BESIDE = [(60, 2), (180, 2), (180, -70), (60, -70), (60, -10)]
OPEN = [(0, 0), (120, 0), (120, 80), (240, 80), (240, 160)]


def robots() -> list[dict[str, Any]]:
    """Two robots whose ways share a stretch: each alone, and merged with no tie, a single tie, and all ties between."""
    first, second = way(LAP[:-2] + [(0, 30)], N), way(BESIDE, N)
    own = covisible(N, NEIGHBOURS * N)
    drives = {"first robot": first, "second robot": second}
    found = [_scored(what, pose_graph(positions, own, RADIUS_M)) for what, positions in drives.items()]
    both, apart = np.concatenate([first, second]), np.concatenate([own, own + N])
    gaps = np.linalg.norm(first[:, None] - second[None], axis=2)
    near = np.argwhere(gaps < 2 * RADIUS_M) + [0, N]
    middle = near[[len(near) // 2]]
    for what, ties in (
        ("merged, no tie between them", near[:0]),
        ("merged, one tie", middle),
        ("merged, all ties", near),
    ):
        found.append(_scored(what, pose_graph(both, np.concatenate([apart, ties]), RADIUS_M)))
    return found


def control_points() -> list[dict[str, Any]]:
    """Maps by metric error and by Λ, as odometry alone has them and with control points held."""
    cases: dict[str, tuple[list[tuple[float, float]], float, float]] = {
        "open way, right": (OPEN, 0.0, 0.0),
        "open way, scale drifts": (OPEN, 0.5, 0.0),
        "second pass untied, right": (LAP, 0.0, 0.0),
        "second pass untied, heading drifts": (LAP, 0.0, 0.4),
        "second pass untied, scale drifts": (LAP, 0.5, 0.0),
    }
    found = []
    for name, (corners, scale, heading) in cases.items():
        true = way(corners, N)
        drifted = heading_drift(scale_drift(true, scale), heading)
        for what, positions in (("odometry", drifted), ("with control points", held(true, drifted))):
            error = np.sqrt(((true - positions) ** 2).sum(axis=1).mean())
            graph = pose_graph(positions, covisible(N, NEIGHBOURS * N), RADIUS_M)
            found.append({**_scored(name, graph), "map": what, "ate_m": float(error)})
    return found


def held(true: Positions, drifted: Positions) -> Positions:
    """The optimum of drifted odometry with the true position known at every so many-th keyframe and at the last.

    Parameters
    ----------
    true : (n, 2) float
    drifted : (n, 2) float
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses = [gtsam.Pose2(x, y, 0) for x, y in drifted]
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    steps = gtsam.noiseModel.Diagonal.Sigmas(STEP_SIGMAS)
    known = gtsam.noiseModel.Isotropic.Sigma(2, CONTROL_SIGMA_M)
    for key in range(len(poses) - 1):
        graph.add(gtsam.BetweenFactorPose2(key, key + 1, poses[key].between(poses[key + 1]), steps))
    for key in {*range(0, len(poses), EVERY), len(poses) - 1}:
        graph.add(gtsam.PoseTranslationPrior2D(key, gtsam.Pose2(*true[key], 0), known))
    best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    positions: Positions = gtsam.utilities.extractPose2(best)[:, :2]
    return positions


def robots_markdown(found: list[dict[str, Any]]) -> list[str]:
    """Each robot and their merged maps."""
    lines = ["| map | keyframes | inserted | collisions | Λ | Λ of collisions |", "|---|---|---|---|---|---|"]
    return lines + [f"| {row['what']} | {row['n_keyframes']} | " + _cells(row) for row in found]


def control_markdown(found: list[dict[str, Any]]) -> list[str]:
    """Metric beside topological error."""
    lines = ["| drive | map | error m | inserted | collisions | Λ | Λ of collisions |", "|---|---|---|---|---|---|---|"]
    return lines + [f"| {row['what']} | {row['map']} | {row['ate_m']:.2f} | " + _cells(row) for row in found]


def _cells(row: dict[str, Any]) -> str:
    return f"{row['n_inserted']} | {row['n_collisions']} | {row['score']:.3f} | {row['collision_score']:.3f} |"


def _scored(what: str, graph: pgti.PoseGraph) -> dict[str, Any]:
    integrity = pgti.assess(graph)
    return {
        "what": what,
        "n_keyframes": len(graph),
        "n_inserted": len(integrity.inserted_edges),
        "n_collisions": len(integrity.collision_edges),
        "score": integrity.score if np.isfinite(integrity.score) else "infinite",
        "collision_score": integrity.collisions.score,
    }
