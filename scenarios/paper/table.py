"""Table 4 beside the paper's, the agreement in kind, and the effect of two readings of the text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam.integrity import relative_distortion, time_grid
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from scenarios.paper.rows import BETAS, Row, aliased, rows
from scenarios.paper.ways import covisible, kitti_00, pose_graph, radius_inserting, scale_drift, way

HARMLESS, BALANCED = 0.2, 1.2
"""Λ below which the paper's rows are harmless, and the ratio of Λ_loc and Λ_glob up to which they count as equal."""

N_FALSE_LOOPS = 40
"""Drawn false loops beside which rows (f) and (g) stand."""


def run(data: Path | None, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Score every counterpart; rows ready for JSON, each with its map for the figure.

    Parameters
    ----------
    data : Path, optional
        Folder of all data.
    tell : callable
        Called with a line of progress.
    """
    found = []
    for row in rows(data):
        graph = row.pose_graph()
        found.append(scored(row, graph))
        tell(line(found[-1]))
    return found


def scored(row: Row, graph: pgti.PoseGraph) -> dict[str, Any]:
    """The scores of a counterpart, beside the paper's.

    Parameters
    ----------
    row : Row
    graph : pgti.PoseGraph
    """
    integrity = pgti.assess(graph)
    splits = [(split.local, split.global_) for split in map(integrity.split, BETAS)]
    return {
        "name": row.name,
        "what": row.what,
        "paper": {
            "sizes": [row.n_keyframes, row.n_edges, row.n_edges + row.n_inserted],
            "score": row.score,
            "splits": row.splits,
        },
        "sizes": [len(graph), len(graph.edges), len(integrity.merged_edges)],
        "radius_m": float(graph.radii[0]),
        "score": integrity.score,
        "splits": splits,
        "kind": kind(integrity.score, splits),
        "paper_kind": kind(row.score, row.splits),
        "stable_score": integrity.stable_score,
        "n_collisions": len(integrity.collision_edges),
        "collision_score": integrity.collisions.score,
        "readings": readings(graph, integrity),
        "map": {
            "positions": np.round(graph.positions[:, :2], 2).tolist(),
            "scores": np.round(integrity.keyframe_scores, 4).tolist(),
            "inserted": integrity.inserted_edges.tolist(),
        },
    }  # fmt: skip


def kind(score: float, splits: Sequence[tuple[float, float]]) -> str:
    """Harmless, or else the part that dominates at every β.

    Parameters
    ----------
    score : float
        Λ.
    splits : sequence of tuple
        Λ_loc and Λ_glob for each β.
    """
    if score < HARMLESS:
        return "harmless"
    ratios = np.array([far / near for near, far in splits])
    if ((ratios < BALANCED) & (ratios > 1 / BALANCED)).all():
        return "balanced"
    return "global" if (ratios > 1).all() else "local" if (ratios < 1).all() else "mixed"


def readings(graph: pgti.PoseGraph, integrity: pgti.Integrity) -> dict[str, float]:
    """Λ by p = 1 and 2, on the merged graph's times and on each graph's own.

    Parameters
    ----------
    graph : pgti.PoseGraph
    integrity : pgti.Integrity
    """
    before, after = heat_kernels(len(graph), graph.edges, integrity.merged_edges)
    shared, own = time_grid(after, 100), time_grid(before, 100)
    found = {}
    for name, times in (("shared", shared), ("own", own)):
        pair = before.signatures(times), after.signatures(shared)
        for norm in (1, 2):
            found[f"{name}, p = {norm}"] = float(relative_distortion(*pair, norm).max())
    return found


def false_loops(seed: int) -> dict[str, Any]:
    """Λ and Λ_glob of drawn false loops in the corridors of rows (f) and (g), sized as row (g)."""
    row = next(each for each in rows(None) if each.name.startswith("(g)"))
    random, scores, far = np.random.default_rng(seed), [], []
    while len(scores) < N_FALSE_LOOPS:
        first, second = np.sort(random.uniform(0.05, 0.95, 2))
        if second - first < 0.25:
            continue
        positions, edges = aliased(first, second)(row.n_keyframes, row.n_edges)
        integrity = pgti.assess(pose_graph(positions, edges, radius_inserting(positions, edges, row.n_inserted)))
        scores.append(integrity.score)
        far.append(integrity.split().global_ > integrity.split().local)
    low, middle, high = np.quantile(scores, [0.25, 0.5, 0.75])
    return {"seed": seed, "n": len(scores), "quartiles": [low, middle, high], "largest": max(scores),
            "above_1": int((np.array(scores) > 1).sum()), "global_dominates": int(sum(far))}  # fmt: skip


def drifts(data: Path) -> list[dict[str, float]]:
    """Λ of the true way of KITTI 00, sized as row (a), by how much its scale drifts a kilometre."""
    row, found = rows(None)[0], []
    edges = covisible(row.n_keyframes, row.n_edges)
    for per_km in (0.02, 0.05, 0.1, 0.15, 0.2, 0.3):
        positions = scale_drift(kitti_00(data, 5, row.n_keyframes), per_km)
        graph = pose_graph(positions, edges, radius_inserting(positions, edges, row.n_inserted))
        found.append({"per_km": per_km, "score": pgti.assess(graph).score})
    return found


def side_loops() -> list[dict[str, float]]:
    """The side loop of row (d) at other places of a way as long: the largest ratio of the parts over all β."""
    row = next(each for each in rows(None) if each.name.startswith("(d)"))
    edges, found = covisible(row.n_keyframes, row.n_edges), []
    for behind_m in (8, 20, 40, 80, 120):
        corners = [(-230.0 + behind_m, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0), (0.0, -float(behind_m))]
        positions = way(corners, row.n_keyframes)
        integrity = pgti.assess(pose_graph(positions, edges, radius_inserting(positions, edges, row.n_inserted)))
        parts = [(split.local, split.global_) for split in map(integrity.split, BETAS)]
        found.append({"behind_m": behind_m, "ratio": max(max(pair) / min(pair) for pair in parts)})
    return found


def line(row: dict[str, Any]) -> str:
    """A row in words."""
    paper = f"paper {row['paper']['score']:.3f}, {row['paper_kind']}"
    return f"{row['name']:14s} Λ {row['score']:.3f}, {row['kind']} ({paper})"


def markdown(found: Sequence[dict[str, Any]]) -> list[str]:
    """Two lines a row: ours, and the paper's."""
    lines = [
        "| row | | V | E_p | E_m | " + " | ".join(f"β {beta:.0%}" for beta in BETAS) + " | Λ | kind |",
        "|---|---|---|---|---|" + "---|" * len(BETAS) + "---|---|",
    ]
    for row in found:
        lines.append(_cells(row["name"], row["what"], row["sizes"], row["splits"], row["score"], row["kind"]))
        paper = row["paper"]
        lines.append(_cells("", "paper", paper["sizes"], paper["splits"], paper["score"], row["paper_kind"]))
    return lines


def readings_markdown(found: Sequence[dict[str, Any]]) -> list[str]:
    """Λ of every row by how the text is read."""
    names = list(found[0]["readings"])
    lines = [
        "| row | " + " | ".join(f"{name.replace('shared', 'merged')}" for name in names) + " |",
        "|---|" + "---|" * len(names),
    ]
    lines += [
        f"| {row['name']} | " + " | ".join(f"{row['readings'][name]:.3f}" for name in names) + " |" for row in found
    ]
    return lines


def _cells(
    name: str, what: str, sizes: Sequence[int], splits: Sequence[Sequence[float]], score: float, kind: str
) -> str:
    parts = [f"{near:.3f}, {far:.2f}" for near, far in splits]
    return "| " + " | ".join([name, what, *map(str, sizes), *parts, f"{score:.3f}", kind]) + " |"
