"""Section 7: the scores of a defect while the map grows, away from the defect and at the defect's own end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam.integrity import STABLE_TIMES, stable_scores
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from scenarios.paper.rows import believed
from scenarios.paper.ways import Pairs, Positions, pose_graph, way

SMALL, NEIGHBOURS, RADIUS_M = 120, 4, 1.2
"""Keyframes of the small map, a metre apart, each tied to the next four."""

GROWTHS = (1, 2, 4, 8, 16, 32, 64)

OTHER_TIES, OTHER_GROWTH = (2, 8), 8
"""Ties of an added keyframe, where they are not as many as the small map's, and the map's size then, in small ones."""

VIRTUAL = 190
"""Keyframes of the virtual way at both ends: three times √(2t) at the longest of the stable score's times."""

SCORES = {
    "score": "Λ",
    "stable_score": "stable",
    "collision_score": "Λ of collisions",
    "stable_collision_score": "stable, of collisions",
    "open_stable_score": "stable, open ends",
}


def crossing() -> Positions:
    """The way back crosses the way out."""
    return way([(0, 0), (50, 0), (50, 20), (40, 20), (40, -20)], SMALL)


def second_pass() -> Positions:
    """The way back runs beside the way out."""
    return way([(0, 0), (50, 0), (50, 20), (30, 20), (30, 1.5), (6, 1.5), (6, 9)], SMALL)


def side_loop() -> Positions:
    """A loop of 30 m that ends at its start."""
    return way([(0, 0), (60, 0), (60, 8), (53, 8), (53, -35)], SMALL)


def end_on_way() -> Positions:
    """The way ends across its own middle."""
    return way([(0, 0), (50, 0), (50, 30), (30, 30), (30, -4)], SMALL)


def aliasing() -> Positions:
    """A false closure between two corridors, believed."""
    return believed(way([(0, 0), (40, 0), (40, 15), (0, 15), (0, 40)], SMALL), [(30, 70), (32, 72)])


def gap() -> Positions:
    """A straight way whose ties break off, see `_edges`."""
    return way([(0, 0), (120, 0)], SMALL)


DEFECTS: dict[str, Callable[[], Positions]] = {
    "crossing": crossing,
    "second pass": second_pass,
    "side loop": side_loop,
    "end on the way": end_on_way,
    "false closure": aliasing,
    "thin tracking": gap,
}


def run(tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Scores of every defect, by the map's size and the end at which it grew."""
    found = []
    for name, drawn in DEFECTS.items():
        for growth in GROWTHS:
            for end in ("far", "near") if growth > 1 else ("none",):
                graph = grown(name, drawn(), growth, end)
                found.append({"defect": name, "growth": growth, "end": end, **scores(graph)})
        last = found[-2:]
        for ties in OTHER_TIES:
            graph = grown(name, drawn(), OTHER_GROWTH, "near", ties)
            found.append({"defect": name, "growth": OTHER_GROWTH, "end": f"near, {ties} ties", **scores(graph)})
        tell(
            f"{name:14s} "
            + ", ".join(f"{row['end']} Λ {row['score']:.3f} stable {row['stable_score']:.3f}" for row in last)
        )
    return found


def grown(name: str, positions: Positions, growth: int, end: str, ties: int = NEIGHBOURS) -> pgti.PoseGraph:
    """The small map with a straight way before its beginning, far from the defect, or behind its end.

    Parameters
    ----------
    name : str
        Kind of defect.
    positions : (n, 2) float
        Of the small map.
    growth : int
        Keyframes to add.
    end : str
        "far" or "near", where the map grows.
    ties : int
        Next keyframes to which each added keyframe is tied.

    """
    added = (growth - 1) * len(positions)
    steps = np.arange(1, added + 1)[:, None]
    before = positions[0] - steps[::-1] * _unit(positions[1] - positions[0]) if end == "far" else positions[:0]
    behind = positions[-1] + steps * _unit(positions[-1] - positions[-2]) if end == "near" else positions[:0]
    whole = np.concatenate([before, positions, behind])
    own = np.arange(len(before), len(before) + len(positions))
    inside, outside = _edges(name, len(whole), len(before), NEIGHBOURS), _edges(name, len(whole), len(before), ties)
    edges = [inside[np.isin(inside, own).all(axis=1)], outside[~np.isin(outside, own).all(axis=1)]]
    return pose_graph(whole, np.concatenate(edges), RADIUS_M)


def scores(graph: pgti.PoseGraph) -> dict[str, float]:
    """The paper's score, the stable score, both of collisions, and the stable score with open ends."""
    integrity = pgti.assess(graph)
    return {
        "score": integrity.score,
        "stable_score": integrity.stable_score,
        "collision_score": integrity.collisions.score,
        "stable_collision_score": integrity.collisions.stable_score,
        "open_stable_score": open_stable_score(graph, integrity.merged_edges),
    }


def open_stable_score(graph: pgti.PoseGraph, merged: Pairs) -> float:
    """The stable score of a map whose track goes on at both ends, tied as densely as its median keyframe is.

    At the end of a track heat is reflected, and all heat comes from one side; once the map grows there neither holds.
    With a virtual way at both ends, in both graphs, the ends are like the middle, whatever is added later.

    Parameters
    ----------
    graph : pgti.PoseGraph
    merged : (m, 2) int
    """
    n = len(graph)
    reach = max(1, round(float(np.median(np.bincount(graph.edges.ravel(), minlength=n))) / 2))
    whole = n + 2 * VIRTUAL
    i, j = np.triu_indices(reach + 1, 1)
    links = np.unique(np.concatenate([np.stack([i + k, j + k], axis=1) for k in range(whole - reach)]), axis=0)
    virtual = links[(links[:, 0] < VIRTUAL) | (links[:, 1] >= VIRTUAL + n)]
    before, after = heat_kernels(
        whole, *(np.concatenate([virtual, edges + VIRTUAL]) for edges in (graph.edges, merged))
    )
    return float(stable_scores(before, after, STABLE_TIMES)[VIRTUAL : VIRTUAL + n].max())


def markdown(found: list[dict[str, Any]]) -> list[str]:
    """The share of each score when the map has grown to its largest, and the smallest share on the way."""
    lines = ["| defect | grown | " + " | ".join(SCORES.values()) + " |", "|---|---|" + "---|" * len(SCORES)]
    others = {f"near, {ties} ties": f"at its end, tied to the next {ties}" for ties in OTHER_TIES}
    for defect in dict.fromkeys(row["defect"] for row in found):
        own = [row for row in found if row["defect"] == defect]
        first = next(row for row in own if row["end"] == "none")
        lines.append(f"| {defect} | small map | " + " | ".join(f"{first[name]:.3f}" for name in SCORES) + " |")
        for end, what in {"far": "away from it", "near": "at its end", **others}.items():
            last = max((row for row in own if row["end"] == end), key=lambda row: row["growth"])
            cells = [f"{last[name] / first[name]:.2f}" if first[name] else "–" for name in SCORES]
            lines.append(f"| | {last['growth']} times, {what} | " + " | ".join(cells) + " |")
    return lines


def _edges(name: str, n: int, before: int, ties: int) -> Pairs:
    i = np.repeat(np.arange(n), ties)
    pairs = np.stack([i, i + np.tile(np.arange(1, ties + 1), n)], axis=1)
    pairs = pairs[pairs[:, 1] < n]
    if name == "thin tracking":
        at = before + 3 * SMALL // 4
        crossing_it = (pairs[:, 0] < at) & (pairs[:, 1] >= at)
        pairs = pairs[~crossing_it | (pairs[:, 1] - pairs[:, 0] == 1)]
    return pairs


def _unit(vector: Positions) -> Positions:
    scaled: Positions = vector / np.linalg.norm(vector)
    return scaled
