"""Replay at size: the time of 1000 keyframes with 15 000 edges, and the difference from `assess`."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam.replaying import METRICS, Replay, replay_graph
from scenarios.paper.curves import LIKE_KITTI_05
from scenarios.paper.ways import covisible, pose_graph, way

N_KEYFRAMES, N_EDGES, RADIUS_M = 1000, 15_000, 1.4
N_COMPARED, SEED = 20, 0
"""Random keyframes at which the replay is compared with a fresh assessment."""


def run(n_keyframes: int = N_KEYFRAMES, n_edges: int = N_EDGES) -> dict[str, Any]:
    """Seconds of a replay at every keyframe, and the largest difference from `assess` in any metric.

    The difference is relative where a metric is above 1, as the optimality criteria are, and absolute below.

    Parameters
    ----------
    n_keyframes, n_edges : int
    """
    graph = pose_graph(way(LIKE_KITTI_05, n_keyframes), covisible(n_keyframes, n_edges), RADIUS_M)
    wall, processor = time.perf_counter(), time.process_time()
    grown = replay_graph(graph)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    compared = np.random.default_rng(SEED).choice(len(graph), min(N_COMPARED, len(graph)), replace=False)
    return {
        "n_keyframes": len(graph),
        "n_edges": len(graph.edges),
        "n_with_inserted": int((grown.curve("n_inserted") > 0).sum()),
        "seconds": wall,
        "processor_seconds": processor,
        "load": os.getloadavg()[0],
        "n_compared": len(compared),
        "difference": max(difference(grown, int(k)) for k in compared),
    }


def difference(grown: Replay, moment: int) -> float:
    """Largest difference of a moment's metrics from `assess` of the first keyframes.

    Parameters
    ----------
    grown : Replay
    moment : int
    """
    fresh = pgti.assess(first(grown.pose_graph, moment + 1))
    split, change = fresh.split(), fresh.optimality.change
    expected = {"local": split.local, "global_": split.global_}
    expected |= {name: getattr(change, name) for name in ("d", "t", "e", "e_tilde")}
    expected |= {name: getattr(fresh, name) for name in ("score", "mean_score", "stable_score")}
    found = {name: getattr(grown.moments[moment], name) for name in METRICS}
    return max(abs(found[name] - expected[name]) / max(abs(expected[name]), 1.0) for name in METRICS)


def first(graph: pgti.PoseGraph, size: int) -> pgti.PoseGraph:
    """The graph of the first keyframes.

    Parameters
    ----------
    graph : pgti.PoseGraph
    size : int
    """
    kept = (graph.edges < size).all(axis=1)
    return pgti.PoseGraph(
        keys=graph.keys[:size],
        positions=graph.positions[:size],
        edges=graph.edges[kept],
        radii=graph.radii[:size],
        edge_sources=graph.edge_sources[kept],
    )


def markdown(found: dict[str, Any]) -> list[str]:
    """A sentence."""
    return [
        f"{found['n_keyframes']} keyframes with {found['n_edges']} edges, edges inserted in {found['n_with_inserted']} "
        f"of the moments: {found['seconds']:.0f} s, of the processor {found['processor_seconds']:.0f} s, at a load of "
        f"{found['load']:.1f}; the largest difference of any metric from `assess` at {found['n_compared']} random "
        f"keyframes is {found['difference']:.1e}"
    ]
