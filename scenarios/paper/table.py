"""Table 4: drawn layouts of every row beside the paper's, the share of the same kind, and two readings of the text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

import pgti_gtsam as pgti
from pgti_gtsam.integrity import relative_distortion, time_grid
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from scenarios.paper.growth import detours
from scenarios.paper.rows import BETAS, Row, rows
from scenarios.paper.ways import Pairs

HARMLESS, BALANCED, SEVERE = 0.2, 1.2, 1.0
"""Λ below which the paper's rows are harmless, the ratio of Λ_loc and Λ_glob up to which they count as equal, and Λ
above which the paper's large errors lie."""

SEEDS = range(20)
"""Of the layouts of each row; the first is drawn in the figure."""


STEADY = ("score", "stable_score", "detour", "apart")
"""Of `steady_markdown`."""


def run(data: Path | None, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Score the layouts of every row; rows ready for JSON, each with its first map for the figure.

    Parameters
    ----------
    data : Path, optional
        Folder of all data.
    tell : callable
        Called with a line of progress.
    """
    found = []
    for row in rows(data):
        maps = [row.pose_graph(seed) for seed in SEEDS]
        layouts = [{"seed": seed, **scored(graph)} for seed, graph in zip(SEEDS, maps, strict=True)]
        found.append(
            {
                "name": row.name,
                "what": row.what,
                "paper": paper(row),
                "layouts": layouts,
                "map": drawn(maps[0]),
            }
        )
        tell(line(found[-1]))
    return found


def paper(row: Row) -> dict[str, Any]:
    """The paper's figures of a row."""
    return {
        "sizes": [row.n_keyframes, row.n_edges, row.n_edges + row.n_inserted],
        "score": row.score,
        "splits": row.splits,
        "kind": kind(row.score, row.splits),
    }


def scored(graph: pgti.PoseGraph) -> dict[str, Any]:
    """The scores of a layout."""
    integrity = pgti.assess(graph)
    splits = [(split.local, split.global_) for split in map(integrity.split, BETAS)]
    return {
        "sizes": [len(graph), len(graph.edges), len(integrity.merged_edges)],
        "radius_m": float(graph.radii[0]),
        "score": integrity.score,
        "splits": splits,
        "kind": kind(integrity.score, splits),
        "stable_score": integrity.stable_score,
        "n_collisions": len(integrity.collision_edges),
        "collision_score": integrity.collisions.score,
        "apart": apart(integrity.inserted_edges, len(graph)),
        "detour": 1 - 1 / float(detours(len(graph), graph.edges, integrity.inserted_edges).max()),
        "readings": readings(graph, integrity),
    }


def drawn(graph: pgti.PoseGraph) -> dict[str, Any]:
    """Positions, ζ and inserted edges for Fig. 6; times and both signatures of the worst keyframe for Fig. 3."""
    integrity = pgti.assess(graph)
    return {
        "times": integrity.times.tolist(),
        "before": integrity.signatures_pose_graph[integrity.worst].tolist(),
        "after": integrity.signatures_merged_graph[integrity.worst].tolist(),
        "positions": np.round(graph.positions[:, :2], 2).tolist(),
        "scores": np.round(integrity.keyframe_scores, 4).tolist(),
        "inserted": integrity.inserted_edges.tolist(),
    }


def apart(inserted: Pairs, n: int) -> float:
    """Median share of the way between the ends of the inserted edges: of a lap, the lap's share.

    Parameters
    ----------
    inserted : (k, 2) int
    n : int
        Keyframes.
    """
    return float(np.median(np.ptp(inserted, axis=1)) / n)


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
    for name, times in (("merged", shared), ("own", own)):
        pair = before.signatures(times), after.signatures(shared)
        for norm in (1, 2):
            found[f"{name}, p = {norm}"] = float(relative_distortion(*pair, norm).max())
    return found


def line(row: dict[str, Any]) -> str:
    """A row in words."""
    of_kind, severe = _counts(row)
    of = len(row["layouts"])
    return (
        f"{row['name']:14s} Λ {_spread(_scores(row))} (paper {row['paper']['score']:.3f}), "
        f"{of_kind} of {of} {row['paper']['kind']}, {severe} above {SEVERE:g}"
    )


def markdown(found: Sequence[dict[str, Any]]) -> list[str]:
    """Two lines a row: the medians and quartiles of ours, and the paper's."""
    heads = ["row", "", "V", "E_p", "E_m", *(f"β {beta:.0%}" for beta in BETAS), "Λ", "kind", f"Λ > {SEVERE:g}"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for row in found:
        paper, of = row["paper"], len(row["layouts"])
        of_kind, severe = _counts(row)
        sizes = np.median([each["sizes"] for each in row["layouts"]], axis=0).astype(int)
        splits = np.median([each["splits"] for each in row["layouts"]], axis=0)
        counts = [f"{of_kind} of {of}", f"{severe} of {of}"]
        lines.append(_cells(row["name"], row["what"], sizes, splits, _spread(_scores(row)), *counts))
        lines.append(_cells("", "paper", paper["sizes"], paper["splits"], f"{paper['score']:.3f}", paper["kind"], ""))
    return lines


def readings_markdown(found: Sequence[dict[str, Any]]) -> list[str]:
    """The median Λ of every row by how the text is read."""
    names = list(found[0]["layouts"][0]["readings"])
    lines = ["| row | " + " | ".join(names) + " | paper |", "|---|" + "---|" * (len(names) + 1)]
    for row in found:
        middle = [np.median([each["readings"][name] for each in row["layouts"]]) for name in names]
        lines.append(f"| {row['name']} | " + " | ".join(f"{x:.3f}" for x in (*middle, row["paper"]["score"])) + " |")
    return lines


def steady_markdown(found: Sequence[dict[str, Any]]) -> list[str]:
    """Median and quartiles of the scores that do not fade as maps grow, and how Λ follows the size of the defect."""
    lines = [
        "| row | Λ | stable score | detour | rank correlation of Λ with the way between |",
        "|---|---|---|---|---|",
    ]
    for row in found:
        curves = {name: [each[name] for each in row["layouts"]] for name in STEADY}
        cells = [_spread(curves[name]) for name in STEADY[:3]]
        differ = np.ptp(curves["apart"]) > 0
        cells.append(f"{spearmanr(curves['apart'], curves['score']).statistic:.2f}" if differ else "–")
        lines.append(f"| {row['name']} | " + " | ".join(cells) + " |")
    return lines


def _scores(row: dict[str, Any]) -> list[float]:
    return [each["score"] for each in row["layouts"]]


def _counts(row: dict[str, Any]) -> tuple[int, int]:
    """Layouts of the paper's kind, and layouts with a large Λ."""
    of_kind = sum(each["kind"] == row["paper"]["kind"] for each in row["layouts"])
    return of_kind, sum(score > SEVERE for score in _scores(row))


def _spread(scores: Sequence[float]) -> str:
    """Median, quartiles in brackets."""
    low, middle, high = np.quantile(scores, [0.25, 0.5, 0.75])
    return f"{middle:.3f} [{low:.3f}, {high:.3f}]"


def _cells(name: str, what: str, sizes: Sequence[int], splits: Sequence[Sequence[float]], *last: str) -> str:
    parts = [f"{near:.3f}, {far:.2f}" for near, far in splits]
    return "| " + " | ".join([name, what, *map(str, sizes), *parts, *last]) + " |"
