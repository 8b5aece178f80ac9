"""Section 7, places without texture: two corridors side by side, and where the radii come from.

A robot drives down a corridor, turns, and comes back through the next, behind a wall. Landmarks lie on the walls; the
radius of a keyframe is the distance to the nearest landmark in view, as in the paper. Where texture is poor
the nearest landmark is far away, and the sphere reaches through the wall.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import pgti_gtsam as pgti
from scenarios.paper.ways import covisible, pose_graph, way

LENGTH_M, WIDTH_M, WALL_M, RANGE_M = 60.0, 2.4, 0.3, 12.0
"""Corridors and the wall between them; how far landmarks are seen."""

DENSITIES = (5.0, 1.0, 0.3, 0.1, 0.03)
"""Landmarks a metre of wall."""

DENSE = 40.0
"""Points a metre of wall of a dense map: the nearest is the wall."""

N_KEYFRAMES, NEIGHBOURS, SEEDS = 240, 8, (0, 1, 2)

Array = NDArray[np.float64]


def run() -> list[dict[str, Any]]:
    """Median radius, collisions, Λ and Λ of collisions by texture and by where radii come from; mean over seeds."""
    positions = _drive()
    found = []
    for density in DENSITIES:
        for source in ("landmarks", "dense map"):
            rows = [_row(positions, density, source, seed) for seed in SEEDS]
            found.append(
                {"density": density, "radii": source}
                | {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
            )
    return found


def markdown(found: list[dict[str, Any]]) -> list[str]:
    """A row a texture and source of radii."""
    lines = [
        "| landmarks a metre | radii from | median radius m | inserted | collisions | Λ | Λ of collisions |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in found:
        cells = [f"{row['density']:g}", row["radii"], f"{row['radius_m']:.2f}"]
        cells += [f"{row['n_inserted']:.0f}", f"{row['n_collisions']:.0f}"]
        cells += [f"{row['score']:.3f}", f"{row['collision_score']:.3f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _row(positions: Array, density: float, source: str, seed: int) -> dict[str, float]:
    random = np.random.default_rng(seed)
    marks = _walls(random, DENSE if source == "dense map" else density)
    radii = _nearest_seen(positions, marks)
    n = len(positions)
    graph = pose_graph(positions, covisible(n, n * NEIGHBOURS), radii)
    integrity = pgti.assess(graph)
    return {
        "radius_m": float(np.median(radii)),
        "n_inserted": len(integrity.inserted_edges),
        "n_collisions": len(integrity.collision_edges),
        "score": integrity.score,
        "collision_score": integrity.collisions.score,
    }


def _drive() -> Array:
    """Down the middle of one corridor and back through the other, around the wall's far end."""
    pitch = WIDTH_M + WALL_M
    return way([(0, 0), (LENGTH_M + 2, 0), (LENGTH_M + 2, pitch), (0, pitch)], N_KEYFRAMES, rounding=2)


def _walls(random: np.random.Generator, density: float) -> Array:
    """Landmarks on the outer walls, on both faces of the wall between the corridors, and on the end: (k, 2) m."""
    low, middle, high = -WIDTH_M / 2, WIDTH_M / 2, WIDTH_M / 2 + WALL_M
    found = []
    for y in (low, middle, high, high + WIDTH_M):
        x = random.uniform(0, LENGTH_M if y in (middle, high) else LENGTH_M + 4, random.poisson(density * LENGTH_M))
        found.append(np.stack([x, np.full(len(x), y)], axis=1))
    y = random.uniform(low, high + WIDTH_M, random.poisson(density * (high + WIDTH_M - low)))
    return np.concatenate([*found, np.stack([np.full(len(y), LENGTH_M + 4), y], axis=1)])


def _nearest_seen(positions: Array, marks: Array) -> Array:
    """Distance to the nearest mark in range that no wall hides; none seen guarantees nothing: radius 0."""
    gaps = np.linalg.norm(positions[:, None] - marks[None], axis=2)
    hidden = _crosses_wall(positions[:, None], marks[None])
    gaps[hidden | (gaps > RANGE_M)] = np.inf
    nearest = gaps.min(axis=1, initial=np.inf)
    return np.where(np.isfinite(nearest), nearest, 0.0)


def _crosses_wall(eyes: Array, marks: Array) -> NDArray[np.bool_]:
    """Whether the line of sight passes the middle of the wall before the wall's end."""
    y = WIDTH_M / 2 + WALL_M / 2
    rise = marks[..., 1] - eyes[..., 1]
    share = np.divide(y - eyes[..., 1], rise, out=np.full(rise.shape, np.inf), where=rise != 0)
    x = eyes[..., 0] + np.where(np.isfinite(share), share, 0.0) * (marks[..., 0] - eyes[..., 0])
    crosses: NDArray[np.bool_] = (share > 0) & (share < 1) & (x < LENGTH_M)
    return crosses
