"""The rows of the paper's Table 4, and the rule by which counterparts of each are drawn.

The paper's maps are not published. A counterpart has as many keyframes, edges and inserted edges as the paper's row,
and the same kind of defect; place and size of the defect the rule draws from the layout's seed. The radius is the
smallest that inserts as many edges as the row has.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pgti_gtsam as pgti
from scenarios.paper.layouts import (
    Rule,
    aliased,
    beside,
    crossing,
    fused_but,
    quick_turn,
    second_lap,
    true_way,
)
from scenarios.paper.ways import pose_graph, radius_inserting

BETAS = (0.3, 0.4, 0.5, 0.6, 0.7)

Split = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A row of Table 4.

    Attributes
    ----------
    name, what : str
        Letter and dataset of the paper's row, and a description of the counterparts.
    n_keyframes, n_edges, n_inserted : int
        |V|, |E_p| and |E_m| − |E_p| of the paper's row.
    score : float
        The paper's Λ.
    splits : tuple of (Λ_loc, Λ_glob)
        The paper's, for the five `BETAS`.
    rule : callable
        Draws a counterpart's positions and edges.
    """

    name: str
    what: str
    n_keyframes: int
    n_edges: int
    n_inserted: int
    score: float
    splits: tuple[Split, ...]
    rule: Rule

    def pose_graph(self, seed: int) -> pgti.PoseGraph:
        """One counterpart's map."""
        positions, edges = self.rule(np.random.default_rng(seed), self.n_keyframes, self.n_edges)
        return pose_graph(positions, edges, radius_inserting(positions, edges, self.n_inserted))


def rows(data: Path | None) -> list[Row]:
    """All ten rows; with the data also row (a) on the true way of KITTI 00, with our drift."""
    # the paper's figures
    found = [
        _row("(a) KITTI-00", "a lap whose way back runs beside the way out", (877, 15228, 22),
             1.3702, ((0.0146, 1.7554), (0.0149, 2.0740), (0.0522, 2.7790), (0.1634, 4.7935), (0.3988, 11.7651)),
             beside),
        _row("(b) KITTI-08", "a lap that crosses its own way out", (1019, 18388, 36),
             1.7096, ((0.0176, 2.2215), (0.0317, 2.6169), (0.0465, 3.5049), (0.1974, 5.9635), (0.5599, 8.8850)),
             crossing(0.3, 0.8)),
        _row("(c) Campus-8", "a lap and part of a second one, untied", (266, 6015, 1339),
             4.7524, ((1.2473, 9.0408), (1.7285, 10.7859), (2.2552, 11.9005), (2.7747, 12.5754), (3.2776, 13.0900)),
             second_lap),
        _row("(d) Campus-9", "a side loop of a tenth to four tenths of the way, untied", (277, 6239, 160),
             0.3890, ((0.4201, 0.3700), (0.3982, 0.3818), (0.3859, 0.3923), (0.3828, 0.3984), (0.3842, 0.4003)),
             crossing(0.1, 0.4)),
        _row("(e) Campus-10", "a lap and part of a second one, untied", (415, 9596, 796),
             2.4414, ((0.5832, 3.8679), (0.7446, 4.9282), (0.9764, 6.2534), (1.2768, 7.2474), (1.6033, 7.6630)),
             second_lap),
        _row("(f) Campus-3", "four alike corridors, two places taken for one", (739, 17446, 553),
             1.2050, ((0.1074, 1.5604), (0.1767, 1.9200), (0.2770, 2.5624), (0.3989, 3.8761), (0.5525, 7.3810)),
             aliased),
        _row("(g) Campus-4", "four alike corridors, two places taken for one", (489, 11036, 170),
             1.0533, ((0.0729, 1.5737), (0.1737, 2.3355), (0.3712, 3.9282), (0.6123, 4.9457), (0.7857, 4.8397)),
             aliased),
        _row("(h) KITTI-13", "a closed lap, 14 pairs of its two passes untied", (1090, 16183, 14),
             0.0672, ((0.1507, 0.0032), (0.1289, 0.0032), (0.1104, 0.0026), (0.0976, 0.0017), (0.0894, 0.0008)),
             fused_but(14)),
        _row("(i) KITTI-18", "a closed lap, 11 pairs of its two passes untied", (551, 6420, 11),
             0.1708, ((0.2185, 0.0691), (0.1964, 0.0787), (0.1829, 0.0993), (0.1754, 0.1273), (0.1717, 0.1578)),
             fused_but(11)),
        _row("(j) Campus-7", "a quick turn that loses ties of tracking", (450, 8973, 3),
             0.0365, ((0.0473, 0.0047), (0.0418, 0.0055), (0.0385, 0.0083), (0.0369, 0.0155), (0.0365, 0.0173)),
             quick_turn),
    ]  # fmt: skip

    # the true way of KITTI 00
    if data is not None:
        first = found[0]
        real = _row(first.name, "the true way of KITTI 00, its scale drifting",
                    (first.n_keyframes, first.n_edges, first.n_inserted), first.score, first.splits,
                    true_way(data))  # fmt: skip
        found.insert(1, real)
    return found


def _row(name: str, what: str, sizes: tuple[int, int, int], score: float, splits: tuple[Split, ...], rule: Rule) -> Row:
    n, m, k = sizes
    return Row(name=name, what=what, n_keyframes=n, n_edges=m, n_inserted=k, score=score, splits=splits, rule=rule)
