"""Ways that a robot drives, how odometry bends ways, and connections of keyframes along them."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.support_graph import overlapping_spheres

Positions = NDArray[np.float64]
Pairs = NDArray[np.int64]


def way(corners: list[tuple[float, float]], n: int, rounding: int = 3) -> Positions:
    """Keyframes at equal distances along a polyline with rounded corners: (n, 2) m.

    Parameters
    ----------
    corners : list of tuple
        In m.
    n : int
        Keyframes.
    rounding : int
        Keyframes over which a corner is rounded.
    """
    places = np.array(corners, dtype=float)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    at = np.linspace(0, along[-1], n + 2 * rounding)
    sharp = np.stack([np.interp(at, along, column) for column in places.T], axis=1)
    window = np.ones(2 * rounding + 1) / (2 * rounding + 1)
    return np.stack([np.convolve(column, window, "valid") for column in sharp.T], axis=1)


def kitti_00(data: Path, every: int, n: int) -> Positions:
    """The true way of KITTI 00, thinned out: (n, 2) m.

    Parameters
    ----------
    data : Path
        Folder of all data.
    every : int
        Keep every so many-th pose.
    n : int
        Keyframes.
    """
    dataset = datasets.read(data / "kitti_robustslam" / "00" / "kitti_00_GT.g2o")
    poses: Positions = gtsam.utilities.extractPose2(dataset.values)
    return poses[::every, :2][:n]


def travelled_m(positions: Positions) -> NDArray[np.float64]:
    """Way up to each keyframe, (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])


def scale_drift(positions: Positions, per_km: float) -> Positions:
    """A way by monocular odometry: the scale falls by exp(−per_km) a kilometre.

    Parameters
    ----------
    positions : (n, 2) float
    per_km : float
    """
    scales = np.exp(-per_km * travelled_m(positions)[1:] / 1000)
    steps = np.diff(positions, axis=0) * scales[:, None]
    return np.concatenate([positions[:1], positions[0] + np.cumsum(steps, axis=0)])


def heading_drift(positions: Positions, rad_per_km: float) -> Positions:
    """A way by odometry with a heading bias.

    Parameters
    ----------
    positions : (n, 2) float
    rad_per_km : float
    """
    angles = rad_per_km * travelled_m(positions)[1:] / 1000
    steps = np.diff(positions, axis=0)
    turned = np.stack([np.cos(angles) * steps[:, 0] - np.sin(angles) * steps[:, 1],
                       np.sin(angles) * steps[:, 0] + np.cos(angles) * steps[:, 1]], axis=1)  # fmt: skip
    return np.concatenate([positions[:1], positions[0] + np.cumsum(turned, axis=0)])


def covisible(n: int, count: int) -> Pairs:
    """So many pairs of keyframes, the nearest along the track; of the last distance evenly spread pairs.

    Parameters
    ----------
    n : int
        Keyframes.
    count : int
        Pairs.
    """
    pairs: list[Pairs] = []
    for gap in range(1, n):
        i = np.arange(n - gap)
        missing = count - sum(map(len, pairs))
        if missing <= len(i):
            i = i[np.linspace(0, len(i) - 1, missing).round().astype(int)]
        pairs.append(np.stack([i, i + gap], axis=1))
        if missing <= len(i):
            break
    return np.concatenate(pairs)


def inserted_by(positions: Positions, edges: Pairs, radius: float) -> int:
    """Edges that spheres of equal radius would insert.

    Parameters
    ----------
    positions : (n, 2) float
    edges : (m, 2) int
    radius : float
    """
    n = len(positions)
    space = np.pad(positions, ((0, 0), (0, 1)))
    free = overlapping_spheres(space, np.full(n, radius))
    low, high = edges.min(axis=1), edges.max(axis=1)
    return len(np.setdiff1d(free[:, 0] * n + free[:, 1], low * n + high))


def radius_inserting(positions: Positions, edges: Pairs, count: int) -> float:
    """The smallest radius with which spheres insert at least so many edges, to a thousandth, m.

    Parameters
    ----------
    positions : (n, 2) float
    edges : (m, 2) int
    count : int
        Edges to insert.
    """
    low, high = 0.0, 1.0
    while inserted_by(positions, edges, high) < count:
        low, high = high, 2 * high
    while high - low > 1e-3 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if inserted_by(positions, edges, middle) >= count else (middle, high)
    return high


def pose_graph(positions: Positions, edges: Pairs, radius: float | NDArray[np.float64]) -> pgti.PoseGraph:
    """Keyframes numbered in order; steps from each to the next are odometry.

    Parameters
    ----------
    positions : (n, 2) float
    edges : (m, 2) int
    radius : float or (n,) float
    """
    steps = np.abs(edges[:, 0] - edges[:, 1]) == 1
    sources = np.where(steps, pgti.EdgeSource.BETWEEN | pgti.EdgeSource.ODOMETRY, pgti.EdgeSource.BETWEEN)
    return pgti.PoseGraph(
        keys=np.arange(len(positions)), positions=positions, edges=edges, radii=radius, edge_sources=sources
    )
