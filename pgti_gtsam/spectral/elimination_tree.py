"""The order in which a sparse symmetric matrix is eliminated, and where its fill appears.

Minimum degree (SuperLU's MMD on A + Aᵀ) chooses the order and, factorising once in it, tells the exact structure
of L. Column j's parent in the elimination tree is the row of the first entry below its diagonal; visiting the
tree in postorder makes every subtree contiguous without changing the fill
(Liu, The role of elimination trees in sparse factorization, SIAM J. Matrix Anal. Appl. 11, 1990,
doi:10.1137/0611010). Neighbouring columns of nearly the same structure are then merged into supernodes, whose
dense blocks NumPy multiplies far faster than single columns; a few explicit zeros are the price
(Ashcraft and Grimes, The influence of relaxed supernode partitions on the multifrontal method, ACM TOMS 15,
1989, doi:10.1145/76909.76910).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

IntArray = NDArray[np.int64]

TOUCH = 1e-8  # far below the degrees, far above their rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EliminationTree:
    """Supernodes in postorder: each eliminates its pivots and updates its rows, which later supernodes own.

    The front of a supernode is its pivots followed by its rows; positions in the front are called local.

    Attributes
    ----------
    order : (n,) int
        Vertex at every position of the elimination order.
    positions : (n,) int
        Inverse of `order`.
    starts : (s + 1,) int
        Supernode k eliminates the positions starts[k] to starts[k + 1] − 1.
    row_starts : (s + 1,) int
        Where the rows of each supernode begin in `rows` and in `into_parent`.
    rows : (total,) int
        Positions that each supernode updates, ascending.
    parents : (s,) int
        Supernode that owns the first row; −1 at a root, which has no rows.
    into_parent : (total,) int
        Local position of each row in the parent's front.
    """

    order: IntArray
    positions: IntArray
    starts: IntArray
    row_starts: IntArray
    rows: IntArray
    parents: IntArray
    into_parent: IntArray

    @property
    def n_vertices(self) -> int:
        """Number of vertices."""
        return len(self.order)

    @property
    def n_supernodes(self) -> int:
        """Number of supernodes."""
        return len(self.parents)

    @property
    def widths(self) -> IntArray:
        """Number of pivots of every supernode, (s,)."""
        return np.diff(self.starts)

    @property
    def heights(self) -> IntArray:
        """Number of rows of every supernode, (s,)."""
        return np.diff(self.row_starts)

    @property
    def fronts(self) -> IntArray:
        """Number of pivots and rows together, (s,)."""
        return self.widths + self.heights

    @property
    def n_entries(self) -> int:
        """Entries of the dense blocks kept by a factorisation, explicit zeros counted."""
        return int((self.widths * self.fronts).sum())

    def visits(self) -> Iterator[tuple[int, int, int, IntArray]]:
        """Width, size of the front, parent, and the rows' local positions in the parent, in postorder."""
        into = np.split(self.into_parent, self.row_starts[1:-1])
        return zip(self.widths.tolist(), self.fronts.tolist(), self.parents.tolist(), into, strict=True)

    def children(self) -> list[list[tuple[int, IntArray]]]:
        """Children of every supernode, each with the local positions of its rows."""
        result: list[list[tuple[int, IntArray]]] = [[] for _ in range(self.n_supernodes)]
        for child, (_, _, parent, into) in enumerate(self.visits()):
            if parent >= 0:
                result[parent].append((child, into))
        return result

    def closure(self, positions: IntArray) -> IntArray:
        """Supernodes that eliminate given positions, and all their ancestors, ascending."""
        owners = np.repeat(np.arange(self.n_supernodes), self.widths)[positions]
        found: set[int] = set()
        for supernode in owners.tolist():
            while supernode >= 0 and supernode not in found:
                found.add(supernode)
                supernode = int(self.parents[supernode])
        return np.array(sorted(found), dtype=np.int64)

    def local(self, supernodes: IntArray, positions: IntArray) -> IntArray:
        """Local position of given positions in the fronts of given supernodes, (k,) each.

        Parameters
        ----------
        supernodes : (k,) int
        positions : (k,) int
            Positions in the elimination order.
        """
        return _local(self.starts, self.row_starts, self.rows, supernodes, positions)


def analyse(n_vertices: int, edges: IntArray) -> EliminationTree:
    """Order the vertices of a graph and find the supernodes of its Laplacian.

    Parameters
    ----------
    n_vertices : int
    edges : (m, 2) int
        Pairs of distinct vertices. Any graph on a subset of these edges can use the result.
    """
    # order, tree and postorder
    order, structure = _ordered_structure(n_vertices, edges)
    counts, parents = _columns(structure)
    post = _postorder(parents, counts)
    ranks = np.empty_like(post)
    ranks[post] = np.arange(n_vertices)
    parents = np.where(parents[post] >= 0, ranks[parents[post]], -1)

    # supernodes with their rows, and the rows' places in the parents
    starts, tops = _supernodes(counts[post], parents)
    owners = np.repeat(np.arange(len(tops)), np.diff(starts))
    rows, super_parents = _rows(structure, post, ranks, starts, owners)
    row_starts = np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int64)
    flat = np.concatenate([*rows, np.empty(0, dtype=np.int64)])
    into_parent = _local(starts, row_starts, flat, np.repeat(super_parents, np.diff(row_starts)), flat)

    # the vertices in postorder
    order = order[post]
    positions = np.empty_like(order)
    positions[order] = np.arange(n_vertices)
    return EliminationTree(
        order=order,
        positions=positions,
        starts=starts,
        row_starts=row_starts,
        rows=flat,
        parents=super_parents,
        into_parent=into_parent,
    )


def _ordered_structure(n_vertices: int, edges: IntArray) -> tuple[IntArray, sparse.csc_array]:
    """Minimum-degree order, and the structure of the lower triangle in that order.

    The values are those of a Laplacian with a touch on the diagonal: all updates have one sign, so that no entry
    cancels, and none fades away along a path; the stored entries are the symbolic ones.
    """
    i, j = np.asarray(edges, dtype=np.int64).reshape(-1, 2).T
    ones = np.ones(2 * len(i))
    w = sparse.coo_array((ones, (np.r_[i, j], np.r_[j, i])), shape=(n_vertices, n_vertices)).tocsc()
    matrix = sparse.csc_array(sparse.diags_array(w.sum(axis=0) + TOUCH) - w)
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    structure = sparse.csc_array(factor.L)
    structure.sort_indices()
    order = np.empty(n_vertices, dtype=np.int64)
    order[factor.perm_c] = np.arange(n_vertices)
    return order, structure


def _columns(structure: sparse.csc_array) -> tuple[IntArray, IntArray]:
    """Entries below the diagonal of every column of L, and the column's parent (−1 at a root)."""
    starts, indices = structure.indptr.astype(np.int64), structure.indices.astype(np.int64)
    counts = np.diff(starts) - 1
    parents = np.full(len(counts), -1, dtype=np.int64)
    inner = counts > 0
    parents[inner] = indices[starts[:-1][inner] + 1]
    return counts, parents


def _postorder(parents: IntArray, counts: IntArray) -> IntArray:
    """Visit children before parents, the child with the largest front last, next to its parent."""
    n = len(parents)
    children: list[list[int]] = [[] for _ in range(n + 1)]
    for child in np.argsort(counts, kind="stable").tolist():
        children[parents[child]].append(child)  # roots collect in the last list
    post, stack = [], children[n]
    while stack:  # reverse postorder is preorder with the children reversed
        column = stack.pop()
        post.append(column)
        stack.extend(children[column])
    return np.array(post[::-1], dtype=np.int64)


def _supernodes(counts: IntArray, parents: IntArray) -> tuple[IntArray, IntArray]:
    """First columns (with n appended) and last columns of the supernodes of postordered columns.

    A column joins the preceding supernode when that lowers the estimated time: of the two together, and per
    pivot, so that a long chain is cut at the best width instead of absorbing column after column. A root stays
    alone: with all other vertices eliminated the row sum is the pivot, and the null vector survives any shift.
    """
    # the supernodes so far: first columns, estimated times, last columns
    first, costs, tops = [0], [_cost(1, counts[0])] if len(counts) else [], [0]
    count, parent = counts.tolist(), parents.tolist()
    for column in range(1, len(count)):
        start, height = column, count[column]

        # merge the column with its children as long as that saves time
        cost = _cost(1, height)
        while height and tops and parent[tops[-1]] == column:
            merged_width = column + 1 - first[-1]
            merged = _cost(merged_width, height)
            width = start - first[-1]
            no_fill = count[tops[-1]] == height + column + 1 - start
            if not no_fill and (merged > cost + costs[-1] or merged * width > costs[-1] * merged_width):
                break
            start, cost = first.pop(), merged
            costs.pop()
            tops.pop()

        # a supernode that ends at this column
        first.append(start)
        costs.append(cost)
        tops.append(column)
    return np.array([*first[: len(tops)], len(count)], dtype=np.int64), np.array(tops, dtype=np.int64)


def _cost(width: int, height: int) -> float:
    """Microseconds for one supernode and sixteen poles: calls, inverse, four products, copies of the front.

    Fitted to NumPy's stacked `inv` and `matmul` of complex matrices on one core.
    """
    front = width + height
    return 100 + 0.02 * width**3 + 0.01 * width * height * front + 0.03 * front**2


def _rows(
    structure: sparse.csc_array, post: IntArray, ranks: IntArray, starts: IntArray, owners: IntArray
) -> tuple[list[IntArray], IntArray]:
    """Rows of every supernode, and the parent that owns the first row (−1 without rows).

    The parent must also update every row that a child updates beyond the parent's pivots. Exact structures say so
    already; passing rows on keeps the tree closed where an entry underflowed and was not stored.
    """
    postordered = structure[:, post]
    columns, indices = postordered.indptr, ranks[postordered.indices]
    inherited: list[list[IntArray]] = [[] for _ in range(len(starts) - 1)]
    rows, parents = [], np.full(len(starts) - 1, -1, dtype=np.int64)
    for k, (start, end) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)):
        own = np.unique(np.concatenate([indices[columns[start] : columns[end]], *inherited[k]]))
        own = own[np.searchsorted(own, end) :]
        if len(own):
            parents[k] = owners[own[0]]
            inherited[parents[k]].append(own)
        rows.append(own)
    return rows, parents


def _local(
    starts: IntArray, row_starts: IntArray, rows: IntArray, supernodes: IntArray, positions: IntArray
) -> IntArray:
    first, last = starts[supernodes], starts[supernodes + 1]
    stride = len(rows) + int(starts[-1]) + 1
    keys = np.repeat(np.arange(len(starts) - 1), np.diff(row_starts)) * stride + rows
    among_rows = np.searchsorted(keys, supernodes * stride + positions) - row_starts[supernodes]
    return np.where(positions < last, positions - first, last - first + among_rows)
