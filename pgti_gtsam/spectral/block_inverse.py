"""Parts of the inverse of a sparse symmetric positive definite matrix of equal square blocks.

The multifrontal elimination of `selected_inverse` (sources there), for real matrices of a few dimensions a vertex:
information matrices of pose graphs. The covariance of a relative pose is J H⁻¹ Jᵀ, computed
without blocks of the inverse, whose difference would lose the digits that a small covariance needs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.spectral.elimination_tree import EliminationTree, IntArray

FloatArray = NDArray[np.float64]

TOGETHER = 64
"""Pairs of vertices whose columns are carried to the roots together: those that lie near each other share the way."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlockFactor:
    """D = F_JJ⁻¹ and X = D F_JA of every supernode with pivots J and rows A.

    Attributes
    ----------
    tree : EliminationTree
        Of the graph of blocks.
    size : int
        Rows of a block, d.
    inverses : list of (w d, w d) float
    couplings : list of (w d, r d) float
    """

    tree: EliminationTree
    size: int
    inverses: list[FloatArray]
    couplings: list[FloatArray]

    @classmethod
    def of(cls, tree: EliminationTree, size: int, inverses: FloatArray, couplings: FloatArray) -> BlockFactor:
        """A factor whose matrices lie one behind the other in two arrays, which leave no gaps in memory when they go.

        Parameters
        ----------
        tree : EliminationTree
        size : int
        inverses, couplings : (total,) float
        """
        wide, high = size * tree.widths, size * tree.heights
        found = []
        for entries, columns in ((inverses, wide), (couplings, high)):
            parts = np.split(entries, np.cumsum(wide * columns)[:-1])
            shapes = zip(wide.tolist(), columns.tolist(), strict=True)
            found.append([part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)])
        return cls(tree=tree, size=size, inverses=found[0], couplings=found[1])


@np.errstate(invalid="ignore", over="ignore")
def factorise(tree: EliminationTree, diagonal: FloatArray, pairs: IntArray, blocks: FloatArray) -> BlockFactor:
    """Eliminate a matrix from the leaves to the roots.

    Parameters
    ----------
    tree : EliminationTree
        Of a graph that has all `pairs` as edges.
    diagonal : (n, d, d) float
        Blocks on the diagonal.
    pairs : (m, 2) int
        Different vertices (i, j); a pair may occur repeatedly.
    blocks : (m, d, d) float
        Part of each pair in the block in row i and column j; the mirror image gets the transpose.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular, or float64s cannot hold its inverse.
    """
    d, fronts = diagonal.shape[1], tree.fronts.tolist()
    entries = _Entries.of(tree, pairs)
    pending: dict[int, FloatArray] = {}
    inverses: list[FloatArray] = []
    couplings: list[FloatArray] = []
    for k, (w, m, parent, into) in enumerate(tree.visits()):
        # what is left of the matrix at the pivots and rows of this supernode
        front = pending.pop(k, None)
        front = np.zeros((m, m, d, d)) if front is None else front
        own, i, j = entries.at(k)
        np.add.at(front, (i, j), blocks[own])
        np.add.at(front, (j, i), blocks[own].swapaxes(1, 2))
        pivots = np.arange(w)
        front[pivots, pivots] += diagonal[tree.order[tree.starts[k] : tree.starts[k + 1]]]

        # eliminate the pivots, and hand the rest to the parent
        flat, cut = _flat(front), w * d
        inverse = np.asarray(np.linalg.inv(flat[:cut, :cut]), dtype=np.float64)
        coupling = inverse @ flat[:cut, cut:]
        if parent < 0 and not np.isfinite(inverse).all():  # what is not finite further down has come here
            raise np.linalg.LinAlgError("expected a matrix whose inverse float64s can hold")
        if parent >= 0:
            above = pending.setdefault(parent, np.zeros((fronts[parent], fronts[parent], d, d)))
            above[np.ix_(into, into)] += _blocks(flat[cut:, cut:] - flat[cut:, :cut] @ coupling, d)
        inverses.append(inverse)
        couplings.append(coupling)
    return BlockFactor.of(tree, d, *(np.concatenate([block.ravel() for block in own]) for own in (inverses, couplings)))


def solve(factor: BlockFactor, b: FloatArray) -> FloatArray:
    """The inverse times b, (n, d) both.

    Parameters
    ----------
    factor : BlockFactor
    b : (n, d) float
    """
    tree = factor.tree
    x = b[tree.order].copy()
    rows = np.split(tree.rows, tree.row_starts[1:-1])
    spans = [slice(*ends) for ends in zip(tree.starts[:-1], tree.starts[1:], strict=True)]
    for k, span in enumerate(spans):
        x[rows[k]] -= (x[span].ravel() @ factor.couplings[k]).reshape(-1, factor.size)
        x[span] = (factor.inverses[k] @ x[span].ravel()).reshape(-1, factor.size)
    for k, span in reversed(list(enumerate(spans))):
        x[span] -= (factor.couplings[k] @ x[rows[k]].ravel()).reshape(-1, factor.size)
    return x[tree.positions]


def products(factor: BlockFactor, ends: IntArray, jacobians: FloatArray) -> FloatArray:
    """J H⁻¹ Jᵀ of the factorised matrix H, (k d, k d).

    With H = L D Lᵀ the product is Zᵀ D⁻¹ Z, Z = L⁻¹ Jᵀ: a column of Jᵀ touches only the way from its vertices to the
    roots of the elimination tree, and no other supernode is visited.

    Parameters
    ----------
    factor : BlockFactor
    ends : (k, 2) int
        The two vertices at which each block of rows of J has entries; the graph need not have an edge between the two.
    jacobians : (k, 2, d, d) float
        The entries.
    """
    found = np.zeros((len(ends) * factor.size, len(ends) * factor.size))
    for k, z in _half_solved(factor, ends, jacobians):
        found += z.T @ (factor.inverses[k] @ z)
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HalfProducts:
    """J L⁻ᵀ D⁻¹ of some blocks of rows of J, for the products of `products` with further blocks.

    Attributes
    ----------
    factor : BlockFactor
    n_pairs : int
        Number of the blocks, k.
    passed : dict from int to ((m,) int, (m d, w d) float)
        At each supernode on the ways to the roots: which blocks pass there, and the entries.
    """

    factor: BlockFactor
    n_pairs: int
    passed: dict[int, tuple[IntArray, FloatArray]]

    @classmethod
    def none(cls, factor: BlockFactor) -> HalfProducts:
        """No block yet."""
        return cls(factor=factor, n_pairs=0, passed={})

    def extended(self, ends: IntArray, jacobians: FloatArray) -> tuple[HalfProducts, FloatArray, FloatArray]:
        """These blocks and more; the products J H⁻¹ J'ᵀ of these with those, (k d, g d), and of those, (g d, g d).

        Parameters
        ----------
        ends : (g, 2) int
            As for `products`.
        jacobians : (g, 2, d, d) float
            As for `products`.
        """
        d, g, passed = self.factor.size, len(ends), dict(self.passed)
        new = self.n_pairs + np.arange(g)
        across, own = np.zeros((self.n_pairs, d, g * d)), np.zeros((g * d, g * d))
        for k, z in _half_solved(self.factor, ends, jacobians):
            weighted = z.T @ self.factor.inverses[k]
            own += weighted @ z
            passing, entries = self.passed.get(k, (new[:0], weighted[:0]))
            across[passing] += (entries @ z).reshape(len(passing), d, g * d)
            passed[k] = np.concatenate([passing, new]), np.concatenate([entries, weighted])
        extended = HalfProducts(factor=self.factor, n_pairs=self.n_pairs + g, passed=passed)
        return extended, across.reshape(self.n_pairs * d, g * d), own


def own_products(factor: BlockFactor, ends: IntArray, jacobians: FloatArray) -> FloatArray:
    """The diagonal blocks of `products`, (k, d, d).

    Parameters
    ----------
    factor : BlockFactor
    ends : (k, 2) int
        As for `products`.
    jacobians : (k, 2, d, d) float
        As for `products`.
    """
    d, found = factor.size, np.zeros((len(ends), factor.size, factor.size))
    order = np.argsort(factor.tree.positions[ends].max(axis=1, initial=0), kind="stable")
    for part in np.split(order, np.arange(TOGETHER, len(order), TOGETHER)):
        for k, z in _half_solved(factor, ends[part], jacobians[part]):
            weighted = (factor.inverses[k] @ z).reshape(-1, len(part), d)
            found[part] += np.einsum("rka,rkb->kab", z.reshape(weighted.shape), weighted, optimize=True)
    return found


def _half_solved(factor: BlockFactor, ends: IntArray, jacobians: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Every supernode on the way from some vertices to the roots, and Z = L⁻¹ Jᵀ there, (w d, k d)."""
    tree, d, k = factor.tree, factor.size, len(ends)
    visited = tree.closure(tree.positions[ends].ravel())

    # Jᵀ, of the visited supernodes' pivots alone
    widths = tree.widths[visited]
    firsts = np.concatenate([[0], np.cumsum(widths)])
    place = np.full(tree.n_vertices, -1)
    place[np.repeat(tree.starts[visited] - firsts[:-1], widths) + np.arange(firsts[-1])] = np.arange(firsts[-1])
    x = np.zeros((firsts[-1], d, k, d))
    for end in (0, 1):
        x[place[tree.positions[ends[:, end]]], :, np.arange(k)] += jacobians[:, end].swapaxes(1, 2)
    x = x.reshape(firsts[-1], d, k * d)

    # from the leaves to the roots
    for own, start, width in zip(visited.tolist(), firsts.tolist(), widths.tolist(), strict=False):
        z = x[start : start + width].reshape(width * d, k * d)
        rows = place[tree.rows[tree.row_starts[own] : tree.row_starts[own + 1]]]
        x[rows] -= (factor.couplings[own].T @ z).reshape(len(rows), d, k * d)
        yield own, z


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Entries:
    """Pairs of vertices, sorted into the fronts where the first of the two is eliminated."""

    sorted: IntArray
    starts: IntArray
    i: IntArray
    j: IntArray

    @classmethod
    def of(cls, tree: EliminationTree, pairs: IntArray) -> _Entries:
        i, j = tree.positions[np.asarray(pairs, dtype=np.int64).reshape(-1, 2).T]
        supernodes = np.repeat(np.arange(tree.n_supernodes), tree.widths)[np.minimum(i, j)]
        order = np.argsort(supernodes, kind="stable")
        starts = np.searchsorted(supernodes[order], np.arange(tree.n_supernodes + 1))
        i, j = (tree.local(supernodes, ends)[order] for ends in (i, j))
        return cls(sorted=order, starts=starts, i=i, j=j)

    def at(self, supernode: int) -> tuple[IntArray, IntArray, IntArray]:
        """The pairs that are eliminated at a supernode, and their local positions there."""
        span = slice(self.starts[supernode], self.starts[supernode + 1])
        return self.sorted[span], self.i[span], self.j[span]


def _flat(front: FloatArray) -> FloatArray:
    """Blocks (m, m, d, d) as a matrix."""
    m, _, d, _ = front.shape
    return front.transpose(0, 2, 1, 3).reshape(m * d, m * d)


def _blocks(matrix: FloatArray, d: int) -> FloatArray:
    """A matrix as blocks (m, m, d, d)."""
    m = len(matrix) // d
    return matrix.reshape(m, d, m, d).transpose(0, 2, 1, 3)
