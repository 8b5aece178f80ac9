"""Support graphs of section 5.1: minimum spheres that meet, and their merger with the pose graph.

Not every pair of spheres that meet without an edge is a defect. Where two passes of a way are tied here and there,
the keyframes overlap at many other pairs, and each such pair is the third side of a triangle of touching spheres.
`explained_overlaps` separates these pairs, *fusion*, from pairs to which no chain of triangles leads, *collisions*:
the line that section 6.3.2 of the paper draws by hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import KDTree

from pgti_gtsam.pair_codes import Codes, Pairs, codes_of, pairs_of
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph

MAX_PATHS = 10_000_000
"""Paths of two edges that one sparse product walks: some hundred megabytes."""


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
        E_m \\ E_p: the edges of the space that the pose graph lacks.
    explained_edges : (e, 2) int
        E_e: E_p and the fusion edges.
    fusion_edges, collision_edges : (f, 2), (c, 2) int
        The inserted edges in two sets: those that `explained_overlaps` explains, and the others.

    All have i < j and are sorted and unique.
    """

    free_space_edges: NDArray[np.int64]
    merged_edges: NDArray[np.int64]
    inserted_edges: NDArray[np.int64]
    explained_edges: NDArray[np.int64]
    fusion_edges: NDArray[np.int64]
    collision_edges: NDArray[np.int64]


def support_graph(pose_graph: PoseGraph) -> SupportGraph:
    """Free-space graph, merged graph and explained graph of a pose graph (section 5.1)."""
    n, edges = len(pose_graph), pose_graph.edges
    free = overlapping_spheres(pose_graph.positions, pose_graph.radii)
    p_codes, f_codes = codes_of(edges, n), codes_of(free, n)
    inserted = np.setdiff1d(f_codes, p_codes, assume_unique=True)
    odometry = edges[pose_graph.edge_sources & EdgeSource.ODOMETRY > 0]
    explained = explained_overlaps(n, edges, _frozen(inserted, n), odometry)
    return SupportGraph(
        free_space_edges=free,
        merged_edges=_frozen(np.union1d(p_codes, f_codes), n),
        inserted_edges=_frozen(inserted, n),
        explained_edges=_frozen(np.union1d(p_codes, inserted[explained]), n),
        fusion_edges=_frozen(inserted[explained], n),
        collision_edges=_frozen(inserted[~explained], n),
    )


def explained_overlaps(
    n: int,
    edges: NDArray[np.int64],
    overlaps: NDArray[np.int64],
    odometry: NDArray[np.int64],
    new: NDArray[np.int64] | None = None,
) -> NDArray[np.bool_]:
    """The overlaps that follow from the edges; all others are collisions.

    A *triangle* explains the overlap (i, j): some k is a neighbour of both. A *rung* explains it: odometry leads from i
    to k and from j to l, and k and l are neighbours. Explained overlaps join the edges, and so on until nothing
    changes: the least fixpoint, independent of the order of the keyframes and of the steps.

    The law: an edge that a triangle explains adds no cycle to the first homology of the clique complex, since the
    triangle fills the only cycle that the edge closes. An edge that a rung explains adds none once the square i k l j,
    between two odometry steps beside each other, counts as a cell. So the explained graph has the loops of the pose
    graph and no others. The rule takes the motive of section 5.1, the Rips complex of the space, at its word.

    Every edge is met once, when new: a round walks the paths of two edges that hold a new edge.

    Parameters
    ----------
    n : int
        Number of keyframes.
    edges, overlaps : (m, 2), (k, 2) int
        Pairs of different keyframes; no pair in both.
    odometry : (l, 2) int
        The steps of a track among the edges.
    new : (p, 2) int, optional
        Edges that have just joined a graph from which nothing more followed, in `edges` too; by default all edges.

    Returns
    -------
    (k,) bool
    """
    places = np.arange(1, len(overlaps) + 1, dtype=float)  # beginning at one, for zeros of a sparse matrix vanish
    unexplained, known, rails = _symmetric(n, overlaps, places), _symmetric(n, edges), _symmetric(n, odometry)
    frontier = known if new is None else _symmetric(n, new)
    explained = np.zeros(len(overlaps), dtype=bool)
    while frontier.nnz and unexplained.nnz:
        hit = np.zeros(len(overlaps), dtype=bool)
        for step, last in ((frontier, known), (rails @ frontier, rails)):
            for rows, paths in _walks(step, last, np.diff(unexplained.indptr) > 0):
                met = unexplained[rows].multiply(paths.astype(bool)).tocsr()
                hit[met.data.astype(np.int64) - 1] = True
        explained |= hit
        frontier = _symmetric(n, overlaps[hit])
        known = known + frontier
        unexplained.data[explained[unexplained.data.astype(np.int64) - 1]] = 0
        unexplained.eliminate_zeros()
    return explained


def _walks(
    step: sparse.csr_array, last: sparse.csr_array, wanted: NDArray[np.bool_]
) -> Iterator[tuple[NDArray[np.int64], sparse.csr_array]]:
    """step · last for the rows that are wanted, some rows at a time."""
    rows = np.flatnonzero(wanted & (np.diff(step.indptr) > 0))
    paths = np.cumsum(step[rows] @ np.diff(last.indptr).astype(float))
    parts: Any = np.searchsorted(paths, np.arange(MAX_PATHS, paths[-1], MAX_PATHS)) if len(rows) else []
    for part in np.split(rows, parts):
        yield part, step[part] @ last


def _symmetric(n: int, pairs: NDArray[np.int64], data: NDArray[np.float64] | None = None) -> sparse.csr_array:
    """Symmetric matrix with a number, or 1, for each pair."""
    values = np.ones(len(pairs)) if data is None else data
    i, j = pairs.T
    both = np.concatenate([i, j]), np.concatenate([j, i])
    return sparse.coo_array((np.concatenate([values, values]), both), shape=(n, n)).tocsr()


def overlapping_spheres(positions: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.int64]:
    """Pairs of spheres that meet: ‖p_i − p_j‖ ≤ r_i + r_j. Touching counts, as two closed balls do.

    Spheres are grouped by the power of two of the radius, so that a large sphere does not make
    every search large: O((n + pairs) log n) for each pair of groups.

    Parameters
    ----------
    positions : (n, 3) float, m
    radii : (n,) float, m
        A sphere of radius zero is its centre, and meets the spheres around the centre.

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
            met = np.stack([i[meet], j[meet]], axis=1)
            found.append(codes_of(met[met[:, 0] != met[:, 1]], len(radii)))
    return _frozen(np.unique(np.concatenate(found)), len(radii))


def _frozen(codes: Codes, n: int) -> Pairs:
    """Pairs of some codes, read-only."""
    pairs = pairs_of(codes, n)
    pairs.flags.writeable = False
    return pairs
