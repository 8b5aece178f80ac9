"""Section 7, places without texture: two corridors side by side, and where the radii come from.

A robot drives down a corridor, turns, and comes back through the next, behind a wall. Landmarks lie on the walls.
Where texture is poor the nearest landmark is far away, and the sphere reaches through the wall. Three sources of radii:

- landmarks, as in the paper: the nearest landmark in view of the keyframe or of a tied keyframe;
- the same, capped by visibility: lines of sight bound the space that was seen to be free, so that no sphere reaches
  beyond the polygon of the landmarks in view of the keyframe, in the order of bearings;
- a dense map: the nearest point of the walls.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

import pgti_gtsam as pgti
from scenarios.paper.ways import way

LENGTH_M, WIDTH_M, WALL_M, RANGE_M = 60.0, 2.4, 0.3, 12.0
"""Corridors and the wall between them; how far landmarks are seen."""

DENSITIES = (5.0, 1.0, 0.3, 0.1, 0.03)
"""Landmarks a metre of wall."""

DENSE = 40.0
"""Points a metre of wall of a dense map: the nearest is the wall."""

N_KEYFRAMES, NEIGHBOURS, SEEDS = 240, 8, (0, 1, 2)

STEP_SIGMAS = np.array([0.01, 0.01, 0.002])
"""Of odometry, x, y (m) and heading (rad), a step of half a metre."""

COUNTED = ("radius_m", "n_inserted", "n_collisions", "score", "collision_score")
SOURCES = ("landmarks", "landmarks, capped", "dense map")

Array = NDArray[np.float64]


def run() -> list[dict[str, Any]]:
    """Median radius, inserted edges, collisions, Λ and verdicts by texture and source of the radii; mean over seeds."""
    positions = _drive()
    found = []
    for density in DENSITIES:
        for source in SOURCES:
            rows = [_row(positions, density, source, seed) for seed in SEEDS]
            verdicts = Counter(str(row.pop("verdict")) for row in rows)
            means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
            found.append({"density": density, "radii": source, "verdicts": dict(verdicts)} | means)
    return found


def markdown(found: list[dict[str, Any]]) -> list[str]:
    """A row a texture and source of radii."""
    lines = [
        "| landmarks a metre | radii from | median radius m | inserted | collisions | Λ | Λ of collisions | verdicts |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in found:
        cells = [f"{row['density']:g}", row["radii"], f"{row['radius_m']:.2f}"]
        cells += [f"{row['n_inserted']:.0f}", f"{row['n_collisions']:.0f}"]
        cells += [f"{row['score']:.3f}", f"{row['collision_score']:.3f}"]
        cells += [", ".join(f"{count} {verdict}" for verdict, count in row["verdicts"].items())]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _row(positions: Array, density: float, source: str, seed: int) -> dict[str, Any]:
    """The diagnosis of a draw of landmarks."""
    random = np.random.default_rng(seed)
    marks = _walls(random, DENSE if source == "dense map" else density)
    radii = _radii(positions, marks, source)
    if not radii.any():
        return dict.fromkeys(COUNTED, 0.0) | {"verdict": "nothing known to be free"}
    diagnosis = pgti.diagnose(*_odometry(positions), radii=dict(enumerate(radii.tolist())))
    integrity = diagnosis.integrity
    return {
        "radius_m": float(np.median(radii)),
        "n_inserted": len(integrity.inserted_edges),
        "n_collisions": len(integrity.collision_edges),
        "score": integrity.score,
        "collision_score": integrity.collisions.score,
        "verdict": diagnosis.verdict,
    }


def _odometry(positions: Array) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The drive as a graph that is right and ties each keyframe to the next."""
    steps = np.diff(positions, axis=0, append=positions[-1:] * 2 - positions[-2:-1])
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, (place, step) in enumerate(zip(positions, steps, strict=True)):
        values.insert(key, gtsam.Pose2(*place, np.arctan2(step[1], step[0])))
    noise = gtsam.noiseModel.Diagonal.Sigmas(STEP_SIGMAS)
    for key in range(len(positions) - 1):
        measured = values.atPose2(key).between(values.atPose2(key + 1))
        graph.add(gtsam.BetweenFactorPose2(key, key + 1, measured, noise))
    return graph, values


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


def _radii(positions: Array, marks: Array, source: str) -> Array:
    """Radius of every keyframe, (n,); none seen guarantees nothing: radius 0."""
    gaps = np.linalg.norm(positions[:, None] - marks[None], axis=2)
    seen = ~_crosses_wall(positions[:, None], marks[None]) & (gaps <= RANGE_M)
    shared = np.array([seen[max(i - NEIGHBOURS, 0) : i + NEIGHBOURS + 1].any(axis=0) for i in range(len(seen))])
    known = seen if source == "dense map" else shared
    nearest = np.where(known, gaps, np.inf).min(axis=1, initial=np.inf)
    radii = np.where(np.isfinite(nearest), nearest, 0.0)
    if source == "landmarks, capped":
        radii = np.minimum(radii, [_seen_free(eye, marks[own]) for eye, own in zip(positions, seen, strict=True)])
    return radii


def _seen_free(eye: Array, marks: Array) -> float:
    """From an eye to the polygon of the landmarks in view, m; zero where half of the horizon is empty."""
    rays = marks - eye
    bearings = np.arctan2(rays[:, 1], rays[:, 0])
    rays, bearings = rays[np.argsort(bearings)], np.sort(bearings)
    turns = np.diff(bearings, append=bearings[:1] + 2 * np.pi)
    if len(rays) < 3 or turns.max() >= np.pi:
        return 0.0
    sides = np.roll(rays, -1, axis=0) - rays
    lengths = np.maximum((sides**2).sum(axis=1), 1e-12)
    along = np.clip(-(rays * sides).sum(axis=1) / lengths, 0, 1)
    return float(np.linalg.norm(rays + along[:, None] * sides, axis=1).min())


def _crosses_wall(eyes: Array, marks: Array) -> NDArray[np.bool_]:
    """Whether the line of sight passes the middle of the wall before the wall's end."""
    y = WIDTH_M / 2 + WALL_M / 2
    rise = marks[..., 1] - eyes[..., 1]
    share = np.divide(y - eyes[..., 1], rise, out=np.full(rise.shape, np.inf), where=rise != 0)
    x = eyes[..., 0] + np.where(np.isfinite(share), share, 0.0) * (marks[..., 0] - eyes[..., 0])
    crosses: NDArray[np.bool_] = (share > 0) & (share < 1) & (x < LENGTH_M)
    return crosses
