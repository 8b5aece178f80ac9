"""Section 8: the best new tie by low-rank updates, against trying every tie by a fresh assessment."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam.support_graph import support_graph
from scenarios.paper.ways import Positions, covisible, pose_graph

AGREED = 1e-6
"""Difference in Λ up to which two ties count as equally good."""

FIRST_SEED, RADIUS_M = 100, 1.0


def winding(seed: int, n: int) -> Positions:
    """A drive that winds about its start and crosses its own way, a metre a step: (n, 2) m.

    Parameters
    ----------
    seed : int
    n : int
        Keyframes.
    """
    random = np.random.default_rng(seed)
    position, heading, positions = np.zeros(2), 0.0, []
    for _ in range(n):
        positions.append(position.copy())
        home = np.arctan2(-position[1], -position[0])
        heading += random.normal(0, 0.15) + 0.15 * np.sin(home - heading) * np.hypot(*position) / 20
        position += np.cos(heading), np.sin(heading)
    return np.array(positions)


def run(n_maps: int, n: int, path: Path, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Both ways on drawn maps: the tie that each finds, and the processor time of each.

    Parameters
    ----------
    n_maps : int
    n : int
        Keyframes of each.
    path : Path
        JSON lines; known lines are kept.
    tell : callable
        Called with a line of progress.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    found = [json.loads(line) for line in lines]
    seed = found[-1]["seed"] + 1 if found else FIRST_SEED
    while len(found) < n_maps:
        graph = pose_graph(winding(seed, n), covisible(n, 4 * n), RADIUS_M)
        if len(support_graph(graph).inserted_edges):
            found.append({"seed": seed, **_compared(graph)})
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(found[-1]) + "\n")
            row = found[-1]
            tell(f"{row['seed']} {row['n_ties']} ties, {row['seconds']:.3f} s against {row['brute_seconds']:.1f} s")
        seed += 1
    return found[:n_maps]


def summary(found: list[dict[str, Any]]) -> str:
    """How often both agree, and how much faster updates are."""
    ratios = np.array([row["brute_seconds"] / row["seconds"] for row in found])
    same = sum(row["same"] for row in found)
    return (
        f"`best_revisits` finds the best tie in {same} of {len(found)} maps of {found[0]['n_keyframes']} keyframes, "
        f"{np.median(ratios):.0f} times faster than trying all (least {ratios.min():.0f}; "
        f"{np.median([row['n_ties'] for row in found]):.0f} candidates a map, median)"
    )


def _compared(graph: pgti.PoseGraph) -> dict[str, Any]:
    """A map by both ways."""
    started = time.process_time()
    best = pgti.best_revisits(graph, 1)[0]
    seconds = time.process_time() - started
    started = time.process_time()
    ties = support_graph(graph).inserted_edges
    scores = [pgti.assess(_with(graph, tie)).score for tie in ties]
    brute_seconds = time.process_time() - started
    return {
        "n_keyframes": len(graph),
        "n_ties": len(ties),
        "keyframes": list(best.keyframes),
        "score_before": best.score_before,
        "score": best.score,
        "brute_score": min(scores),
        "same": bool(abs(best.score - min(scores)) <= AGREED),
        "seconds": seconds,
        "brute_seconds": brute_seconds,
    }


def _with(graph: pgti.PoseGraph, tie: Any) -> pgti.PoseGraph:
    edges = np.concatenate([graph.edges, tie[None]])
    return pgti.PoseGraph(keys=graph.keys, positions=graph.positions, edges=edges, radii=graph.radii)
