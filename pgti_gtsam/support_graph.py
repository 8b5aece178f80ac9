"""Support graphs of section 5.1: minimum spheres that meet, and their merger with the pose graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pgti_gtsam.pose_graph import PoseGraph


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SupportGraph:
    """Edges of the free-space graph and of the merged graph, on the pose graph's keyframes.

    Attributes
    ----------
    free_space_edges : (k, 2) int
        E_f: pairs of keyframes whose minimum spheres meet.
    merged_edges : (m, 2) int
        E_m = E_p ∪ E_f (Eq. 14).
    inserted_edges : (l, 2) int
        E_m \\ E_p: what the space has and the pose graph lacks.

    All have i < j and are sorted and unique.
    """

    free_space_edges: NDArray[np.int64]
    merged_edges: NDArray[np.int64]
    inserted_edges: NDArray[np.int64]


def support_graph(pose_graph: PoseGraph) -> SupportGraph:
    """Free-space graph and merged graph of a pose graph (section 5.1)."""
    free = overlapping_spheres(pose_graph.positions, pose_graph.radii)
    n = len(pose_graph)
    p_codes, f_codes = (edges[:, 0] * n + edges[:, 1] for edges in (pose_graph.edges, free))
    inserted = np.setdiff1d(f_codes, p_codes, assume_unique=True)
    merged = np.union1d(p_codes, f_codes)
    return SupportGraph(free_space_edges=free, merged_edges=_pairs(merged, n), inserted_edges=_pairs(inserted, n))


def overlapping_spheres(positions: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.int64]:
    """Pairs of spheres that meet: ‖p_i − p_j‖ ≤ r_i + r_j. Touching counts, as two closed balls do.

    Spheres are grouped by the power of two of their radius, so that one large sphere does not make
    every search large: O((n + pairs) log n) for each pair of groups.

    Parameters
    ----------
    positions : (n, 3) float, m
    radii : (n,) float, m
        A sphere of radius zero is its centre, and meets the spheres that contain it.

    Returns
    -------
    (k, 2) int
        i < j, sorted, unique.
    """
    classes = np.frexp(radii)[1].astype(np.int64)
    classes[radii == 0] = np.iinfo(np.int64).min
    groups = [np.flatnonzero(classes == c) for c in np.unique(classes)]
    trees = [KDTree(positions[members]) for members in groups]
    found = []
    for a, tree_a in enumerate(trees):
        for b in range(a + 1):
            reach = radii[groups[a]].max() + radii[groups[b]].max()
            near = tree_a.sparse_distance_matrix(trees[b], reach * (1 + 1e-12), output_type="ndarray")
            i, j = groups[a][near["i"]], groups[b][near["j"]]
            meet = near["v"] <= radii[i] + radii[j]
            found.append(_codes(i[meet], j[meet], len(radii)))
    return _pairs(np.unique(np.concatenate(found)), len(radii))


def _codes(i: NDArray[np.int64], j: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """One integer for each pair of different vertices, in the order of the sorted pairs."""
    distinct = i != j
    low, high = np.minimum(i, j)[distinct], np.maximum(i, j)[distinct]
    return np.asarray(low * n + high)


def _pairs(codes: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    pairs: NDArray[np.int64] = np.stack([codes // n, codes % n], axis=1)
    pairs.flags.writeable = False
    return pairs
