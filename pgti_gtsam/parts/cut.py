"""A map cut into parts that overlap: every triangle and every rung lies whole in some part.

The *core* of a part are the keyframes of a box; boxes halve the map at the median of the longest side, again and again
(coordinate bisection, as in Berger and Bokhari, IEEE Transactions on Computers 1987, doi:10.1109/TC.1987.1676942). A
part is a core with all keyframes within two steps, each along an edge or to a sphere that may meet. So the part holds
every overlap of a core keyframe with the edges that may explain the overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.checks import whole
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.spectral.laplacian import adjacency

Indices = NDArray[np.int64]

CELLS = 2**20
"""Most cells along an axis: three numbers of twenty bits and their neighbours' are one number of 64."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """Some keyframes of a map, and all edges between them.

    Attributes
    ----------
    vertices : (m,) int
        The keyframes, ascending.
    is_core : (m,) bool
        Keyframes of the core.
    positions, radii : (m, 3), (m,) float, m
    edges : (k, 2) int
        Edges of G_p, as places in `vertices`.
    is_step : (k,) bool
        Steps of the track.
    """

    vertices: Indices
    is_core: NDArray[np.bool_]
    positions: NDArray[np.float64]
    radii: NDArray[np.float64]
    edges: Indices
    is_step: NDArray[np.bool_]


def cores(positions: NDArray[np.float64], n_parts: int) -> Indices:
    """Number of each keyframe's core, (n,): boxes of equally many keyframes.

    Parameters
    ----------
    positions : (n, 3) float, m
    n_parts : int

    Raises
    ------
    InvalidOptionError
        Fewer parts than one, or more than keyframes.
    """
    if whole(n_parts, "parts", least=1) > len(positions):
        raise InvalidOptionError(f"expected at most as many parts as keyframes, {len(positions)}, got {n_parts}")
    core = np.zeros(len(positions), dtype=np.int64)
    open_ = [(np.arange(len(positions)), 0, n_parts)]
    while open_:
        own, first, count = open_.pop()
        core[own] = first
        if count > 1:
            along = positions[own, np.argmax(np.ptp(positions[own], axis=0))]
            order, half = own[np.argsort(along, kind="stable")], count // 2
            at = len(own) * half // count
            open_ += [(order[:at], first, half), (order[at:], first + half, count - half)]
    return core


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeList:
    """Edges of a map, by first keyframe.

    Attributes
    ----------
    edges : (m, 2) int
        i < j, sorted.
    first : (n + 1,) int
        Where the edges of each keyframe begin.
    """

    edges: Indices
    first: Indices

    @classmethod
    def of(cls, n: int, edges: Indices) -> EdgeList:
        """Edges of n keyframes.

        Parameters
        ----------
        n : int
        edges : (m, 2) int
            i < j, sorted.
        """
        return cls(edges=edges, first=np.searchsorted(edges[:, 0], np.arange(n + 1)))

    def within(self, vertices: Indices) -> tuple[Indices, Indices]:
        """Rows of the edges between some keyframes, given ascending, and the ends as places in that list, (k, 2)."""
        rows = ranges(self.first[vertices], self.first[vertices + 1])
        ends = np.searchsorted(vertices, self.edges[rows])
        inside = vertices[np.minimum(ends[:, 1], len(vertices) - 1)] == self.edges[rows, 1]
        return rows[inside], ends[inside]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Neighbours:
    """Keyframes a step away: along an edge, or in a cell beside, cells being as wide as two spheres reach.

    Attributes
    ----------
    tied : (n, n) sparse
        Not zero between keyframes with an edge.
    cells : (n, 3) int
    order, codes : (n,) int
        Keyframes by cell, and the cells' numbers in that order.
    """

    tied: sparse.csc_array
    cells: Indices
    order: Indices
    codes: Indices

    @classmethod
    def of(cls, pose_graph: PoseGraph) -> Neighbours:
        """Neighbours in a pose graph."""
        positions = pose_graph.positions - pose_graph.positions.min(axis=0)
        size = max(2 * float(pose_graph.radii.max()) * (1 + 1e-9), float(positions.max()) / (CELLS - 4))
        cells = (positions / size).astype(np.int64) + 1
        codes = _coded(cells)
        order = np.argsort(codes, kind="stable")
        return cls(tied=adjacency(len(pose_graph), pose_graph.edges), cells=cells, order=order, codes=codes[order])

    def around(self, vertices: Indices) -> Indices:
        """The given keyframes and all that may be a step away, ascending."""
        shifts = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3)
        codes = np.unique(_coded(np.unique(self.cells[vertices], axis=0)[:, None] + shifts))
        low, high = (np.searchsorted(self.codes, codes, side=side) for side in ("left", "right"))
        beside = self.order[ranges(low, high)]
        return np.unique(np.concatenate([vertices, beside, stepped(self.tied, vertices)]))


def stepped(tied: sparse.csc_array, vertices: Indices) -> Indices:
    """Keyframes with an edge to some keyframes.

    Parameters
    ----------
    tied : (n, n) sparse
        Not zero between keyframes with an edge.
    vertices : (m,) int
    """
    low, high = (tied.indptr[which].astype(np.int64) for which in (vertices, vertices + 1))
    return np.asarray(tied.indices[ranges(low, high)], dtype=np.int64)


def part_of(pose_graph: PoseGraph, edges: EdgeList, neighbours: Neighbours, core: Indices) -> Part:
    """The part of a core.

    Parameters
    ----------
    pose_graph : PoseGraph
    edges : EdgeList
        Of the pose graph.
    neighbours : Neighbours
    core : (c,) int
        Keyframes, ascending.
    """
    vertices = neighbours.around(neighbours.around(core))
    rows, ends = edges.within(vertices)
    return Part(
        vertices=vertices,
        is_core=np.isin(vertices, core, assume_unique=True),
        positions=pose_graph.positions[vertices],
        radii=pose_graph.radii[vertices],
        edges=ends,
        is_step=pose_graph.edge_sources[rows] & EdgeSource.ODOMETRY > 0,
    )


def ranges(low: Indices, high: Indices) -> Indices:
    """Whole numbers of several ranges in a row: low_0, …, high_0 − 1, low_1, …

    Parameters
    ----------
    low, high : (k,) int
    """
    counts = np.asarray(high - low, dtype=np.int64)
    before = np.cumsum(counts) - counts
    return np.asarray(np.arange(counts.sum()) + np.repeat(low - before, counts), dtype=np.int64)


def _coded(cells: Indices) -> Indices:
    """A number for each cell, (…,)."""
    return np.asarray((cells[..., 0] * CELLS + cells[..., 1]) * CELLS + cells[..., 2])
