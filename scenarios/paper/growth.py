"""Section 7: the scores of a defect while the map grows, away from the defect and at the defect's own end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

import pgti_gtsam as pgti
from pgti_gtsam.integrity import N_TIMES, NORM, relative_distortion, time_grid
from pgti_gtsam.pair_codes import without
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from pgti_gtsam.spectral.laplacian import laplacian
from scenarios.paper.layouts import believed
from scenarios.paper.ways import Pairs, Positions, pose_graph, way

SMALL, NEIGHBOURS, RADIUS_M = 120, 4, 1.2
"""Keyframes of the small map, a metre apart, each tied to the next four."""

GROWTHS = (1, 2, 4, 8, 16, 32, 64)

OTHER_TIES, OTHER_GROWTH = (2, 8), 8
"""Ties of an added keyframe, where they are not as many as the small map's, and the map's size then, in small ones."""

HOPS = 10
"""Of a keyframe's neighbourhood in the merged graph: some eighty keyframes of the same pass, and as many across."""

SCORES = {
    "score": "Λ",
    "stable_score": "stable",
    "collision_score": "Λ of collisions",
    "stable_collision_score": "stable, of collisions",
    "near_score": "Λ of neighbourhoods",
    "detour": "detour",
    "log_detour": "its logarithm",
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
        Size of the grown map, in small maps.
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
    """The paper's score, the stable score, both of collisions; the paper's within neighbourhoods; and the detour."""
    integrity = pgti.assess(graph)
    detour = float(detours(len(graph), graph.edges, integrity.inserted_edges).max())
    return {
        "score": integrity.score,
        "stable_score": integrity.stable_score,
        "collision_score": integrity.collisions.score,
        "stable_collision_score": integrity.collisions.stable_score,
        "near_score": near_score(len(graph), graph.edges, integrity.merged_edges),
        "detour": 1 - 1 / detour,
        "log_detour": float(np.log(detour)),
    }


def near_score(n: int, edges: Pairs, merged: Pairs) -> float:
    """Largest ζ of a keyframe in the subgraph of all keyframes within `HOPS`, on the times of that subgraph.

    Only keyframes at inserted edges are tried.

    Parameters
    ----------
    n : int
    edges, merged : (m, 2) int
        E_p and E_m.
    """
    found, linked = 0.0, adjacency(n, merged)
    inserted = without(merged, edges, n)
    for vertex in np.unique(inserted).tolist():
        near = neighbourhood(linked, vertex, HOPS)
        before, after = (np.searchsorted(near, e[np.isin(e, near).all(axis=1)]) for e in (edges, merged))
        kernels = heat_kernels(len(near), before, after)
        times, own = time_grid(kernels[1], N_TIMES), np.searchsorted(near, [vertex])
        pair = (kernel.signatures(times)[own] for kernel in kernels)
        found = max(found, float(relative_distortion(*pair, NORM)[0]))
    return found


def neighbourhood(linked: sparse.csr_array, vertex: int, hops: int) -> NDArray[np.int64]:
    """Vertices few hops away, ascending.

    Parameters
    ----------
    linked : (n, n) sparse
        See `adjacency`.
    vertex, hops : int
    """
    reached = np.array([vertex])
    for _ in range(hops):
        reached = np.union1d(reached, linked[reached].indices)
    return reached


def adjacency(n: int, edges: Pairs) -> sparse.csr_array:
    """The adjacency matrix of a graph.

    Parameters
    ----------
    n : int
    edges : (m, 2) int
    """
    i, j = np.concatenate([edges, edges[:, ::-1]]).T
    return sparse.csr_array((np.ones(len(i)), (i, j)), shape=(n, n))


def detours(n: int, edges: Pairs, inserted: Pairs) -> NDArray[np.float64]:
    """How many times farther around than through: R_ij without and with the inserted edges, for each of these, (k,).

    R_ij is the resistance between two keyframes with every edge a resistor of an ohm, and the variance of the relative
    position with every tie of unit variance (Barooah and Hespanha, IEEE Control Systems Magazine 2007,
    doi:10.1109/MCS.2007.384125). A way that ends carries no current: R_ij stays, however the map grows at an end.

    Parameters
    ----------
    n : int
    edges : (m, 2) int
        Of a connected graph.
    inserted : (k, 2) int
    """
    ends = np.arange(len(inserted))
    unit = np.zeros((n, len(inserted)))
    unit[inserted[:, 0], ends], unit[inserted[:, 1], ends] = 1.0, -1.0
    before, after = (
        np.einsum("nk,nk->k", unit[1:], splu(laplacian(n, some)[1:, 1:].tocsc()).solve(unit[1:]))
        for some in (edges, np.concatenate([edges, inserted]))
    )
    return np.asarray(before / after)


def markdown(found: list[dict[str, Any]]) -> list[str]:
    """The share of each score when the map has grown to its largest."""
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
