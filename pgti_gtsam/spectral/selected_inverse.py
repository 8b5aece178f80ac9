"""The diagonal of (L + zI)⁻¹ for many complex shifts z at once, without the rest of the inverse.

1. *Elimination* (multifrontal LDLᵀ; Duff and Reid, ACM TOMS 9, 1983, doi:10.1145/356044.356047). The supernodes of
   `elimination_tree` are visited from the leaves to the roots. With J the pivots of a supernode and A the rows, the
   front is the rest of the matrix there,

       F_JJ  F_JA    from the entries in the rows of J    D = F_JJ⁻¹ and X = D F_JA are kept,
       F_AJ  F_AA    and the children's updates;          F_AA − F_AJ X is the update for the parent.

2. *Selected inversion* (Takahashi, Fagan and Chin, 1973; Lin et al., SelInv, ACM TOMS 37, 2011,
   doi:10.1145/1916461.1916464, the core of the pole expansion PEXSI). From the roots to the leaves, the inverse Z
   on the rows, which the parent knows, gives the inverse on the pivots:

       Z_JA = −X Z_AA,    Z_JJ = D + X Z_AA Xᵀ.

3. *Row sums* (Grassmann, Taksar and Heyman, Oper. Res. 33, 1985, doi:10.1287/opre.33.5.1107). The rows of L + zI
   sum to z, which for the slowest modes is far below the rounding of the diagonal. So no diagonal is ever updated:
   the row sums are, s_A − Xᵀ s_J, and the diagonal is rebuilt from them as the row sum less the off-diagonal
   entries. These are all negative, all corrections add, and nothing cancels.

The shifts are one leading array axis, so that NumPy's stacked products do the work; fronts too large for the
cache are worked on a few shifts at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.spectral.elimination_tree import EliminationTree, IntArray

ComplexArray = NDArray[np.complex128]
FloatArray = NDArray[np.float64]

MAX_CHUNK = 16  # shifts at once; more gain little over the overhead of a call, and cost memory
MEMORY_BYTES = 100e6  # for the factors of one chunk of shifts: more is no faster below 25 000 vertices
MEMORY_BYTES_PER_VERTEX = 4e3  # long chains would otherwise be left with chunks too small to be worth a call
CACHE_BYTES = 4e6  # for the fronts that are worked on at once
ONE_CALL = 300  # entries of a block up to which all shifts are indexed in one call
INVERSE_BLOCK = 16  # above this size inverses are halved recursively: products are faster than LAPACK's inverse


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrontEntries:
    """Off-diagonal entries of a Laplacian, sorted into the fronts in which they are eliminated.

    Attributes
    ----------
    tree : EliminationTree
    starts : (s + 1,) int
        Where the entries of each supernode begin.
    places : (nnz,) int
        Index of each entry in the flattened front.
    values : (nnz,) float
    grounds : (n,) float
        Row sums of the matrix, in the order of elimination: zero for a Laplacian, positive where a vertex is tied
        to the outside.
    """

    tree: EliminationTree
    starts: IntArray
    places: IntArray
    values: FloatArray
    grounds: FloatArray

    @classmethod
    def of(cls, tree: EliminationTree, laplacian: sparse.csc_array, grounds: FloatArray | None = None) -> FrontEntries:
        """Sort the entries of a Laplacian whose edges are edges of the tree's graph or fewer.

        Parameters
        ----------
        tree : EliminationTree
        laplacian : (n, n) sparse
            Only the off-diagonal entries are read.
        grounds : (n,) float, optional
            Row sums, not negative; zero when left out.
        """
        coo = laplacian.tocoo()
        i, j = tree.positions[coo.row], tree.positions[coo.col]
        off_diagonal = i != j
        i, j, values = i[off_diagonal], j[off_diagonal], coo.data[off_diagonal]
        supernodes = np.repeat(np.arange(tree.n_supernodes), tree.widths)[np.minimum(i, j)]
        places = tree.local(supernodes, i) * tree.fronts[supernodes] + tree.local(supernodes, j)
        by_supernode = np.argsort(supernodes, kind="stable")
        counts = np.bincount(supernodes, minlength=tree.n_supernodes)
        starts = np.concatenate([[0], np.cumsum(counts)])
        grounds = np.zeros(tree.n_vertices) if grounds is None else grounds[tree.order]
        return cls(
            tree=tree,
            starts=starts,
            places=places[by_supernode],
            values=values[by_supernode],
            grounds=grounds,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Factor:
    """D and X of every supernode, for a stack of shifts.

    Attributes
    ----------
    tree : EliminationTree
    inverses : list of (p, w, w) complex
    couplings : list of (p, w, r) complex
    """

    tree: EliminationTree
    inverses: list[ComplexArray]
    couplings: list[ComplexArray]


def inverse_diagonals(entries: FrontEntries, shifts: ComplexArray) -> Iterator[tuple[slice, ComplexArray]]:
    """Diagonals of (L + z_j I)⁻¹, a few shifts at a time.

    Parameters
    ----------
    entries : FrontEntries
        Off-diagonal entries, none positive.
    shifts : (p,) complex
        Off the negative real axis.

    Yields
    ------
    chunk : slice
        The numbers of the shifts.
    diagonals : (len(chunk), n) complex
    """
    memory = max(MEMORY_BYTES, MEMORY_BYTES_PER_VERTEX * entries.tree.n_vertices)
    size = int(np.clip(memory // (16 * entries.tree.n_entries), 1, MAX_CHUNK))
    for start in range(0, len(shifts), size):
        chunk = slice(start, min(start + size, len(shifts)))
        yield chunk, inverse_diagonal(factorise(entries, shifts[chunk]))


def factorise(entries: FrontEntries, shifts: ComplexArray) -> Factor:
    """Eliminate L + z_j I for all shifts, from the leaves to the roots.

    Parameters
    ----------
    entries : FrontEntries
    shifts : (p,) complex
    """
    tree, p, fronts = entries.tree, len(shifts), entries.tree.fronts.tolist()
    pending: dict[int, tuple[ComplexArray, ComplexArray]] = {}
    inverses, couplings = [], []
    for k, (w, m, parent, into) in enumerate(tree.visits()):
        # the front: children's updates and own entries
        front, sums = pending.pop(k) if k in pending else _blank(p, m)
        span = slice(entries.starts[k], entries.starts[k + 1])
        front.reshape(p, m * m)[:, entries.places[span]] += entries.values[span]
        grounds = entries.grounds[tree.starts[k] : tree.starts[k + 1]]
        inverse, coupling = np.empty((p, w, w), dtype=complex), np.empty((p, w, m - w), dtype=complex)
        if parent >= 0 and parent not in pending:
            pending[parent] = _blank(p, fronts[parent])
        places = _places(into, fronts[parent]) if parent >= 0 else into

        # eliminate the pivots, and hand the update to the parent
        for part in _parts(p, m):
            sums[part, :w] += shifts[part, None] + grounds
            _set_diagonal(front[part], sums[part, :w])
            inverse[part] = inverted(front[part, :w, :w])
            np.matmul(inverse[part], front[part, :w, w:], out=coupling[part])
            if parent >= 0:
                update, update_sums = _update(front[part], sums[part], coupling[part])
                front_above, sums_above = pending[parent]
                _add(front_above[part], places, update)
                sums_above[part, into] += update_sums
        inverses.append(inverse)
        couplings.append(coupling)
    return Factor(tree=tree, inverses=inverses, couplings=couplings)


def inverse_diagonal(factor: Factor) -> ComplexArray:
    """Diagonal of every (L + z_j I)⁻¹, from the roots to the leaves: (p, n) complex."""
    tree, p, fronts = factor.tree, len(factor.inverses[0]), factor.tree.fronts.tolist()
    diagonal = np.empty((p, tree.n_vertices), dtype=complex)
    pending: dict[int, ComplexArray] = {}
    children = tree.children()
    for k, (w, m, _, _) in reversed(list(enumerate(tree.visits()))):
        # the inverse on the rows, from the parent
        inverse, coupling = factor.inverses[k], factor.couplings[k]
        z = pending.pop(k) if k in pending else np.empty((p, m, m), dtype=complex)
        vertices = tree.order[tree.starts[k] : tree.starts[k + 1]]
        below = [(c, len(into), _places(into, m)) for c, into in children[k]]
        for c, _, _ in below:
            pending[c] = np.empty((p, fronts[c], fronts[c]), dtype=complex)

        # the inverse on the pivots, and the children's share
        for part in _parts(p, m):
            cross = coupling[part] @ z[part, w:, w:]
            if not below:
                own = np.einsum("pwr,pwr->pw", cross, coupling[part])
                diagonal[part, vertices] = np.einsum("pww->pw", inverse[part]) + own
                continue
            np.matmul(cross, coupling[part].swapaxes(1, 2), out=z[part, :w, :w])
            z[part, :w, :w] += inverse[part]
            np.negative(cross, out=z[part, :w, w:])
            z[part, w:, :w] = z[part, :w, w:].swapaxes(1, 2)
            diagonal[part, vertices] = np.einsum("pww->pw", z[part, :w, :w])
            for c, r, places in below:
                _extract(z[part], places, pending[c][part, -r:, -r:])
    return diagonal


def solve(factor: Factor, b: FloatArray) -> ComplexArray:
    """(L + z_j I)⁻¹ b for every shift, rows of b and of the result in the order of elimination.

    Forward elimination visits only the supernodes on the paths to the roots from rows of b that are not zero.

    Parameters
    ----------
    factor : Factor
    b : (n, k) float

    Returns
    -------
    (p, n, k) complex
    """
    tree, p = factor.tree, len(factor.inverses[0])
    x = np.empty((p, *b.shape), dtype=complex)
    x[:] = b
    starts, rows = tree.starts.tolist(), np.split(tree.rows, tree.row_starts[1:-1])
    touched = tree.closure(np.flatnonzero(b.any(axis=1)))
    for k in touched.tolist():
        own = x[:, starts[k] : starts[k + 1]]
        x[:, rows[k]] -= factor.couplings[k].swapaxes(1, 2) @ own
        own[...] = factor.inverses[k] @ own
    for k in range(tree.n_supernodes - 1, -1, -1):
        if len(rows[k]):
            x[:, starts[k] : starts[k + 1]] -= factor.couplings[k] @ x.take(rows[k], axis=1)
    return x


def inverted(a: ComplexArray) -> ComplexArray:
    """Inverses of symmetric matrices (p, w, w), by halves with the Schur complement."""
    w = a.shape[-1]
    if w == 1:
        return np.asarray(1 / a)
    if w <= INVERSE_BLOCK:
        return np.asarray(np.linalg.inv(a), dtype=np.complex128)
    h = w // 2
    first, border = inverted(a[:, :h, :h]), a[:, :h, h:]
    coupling = first @ border
    last = inverted(a[:, h:, h:] - border.swapaxes(1, 2) @ coupling)
    cross = coupling @ last
    out = np.empty_like(a)
    np.matmul(cross, coupling.swapaxes(1, 2), out=out[:, :h, :h])
    out[:, :h, :h] += first
    np.negative(cross, out=out[:, :h, h:])
    out[:, h:, :h] = out[:, :h, h:].swapaxes(1, 2)
    out[:, h:, h:] = last
    return out


def _blank(p: int, m: int) -> tuple[ComplexArray, ComplexArray]:
    return np.zeros((p, m, m), dtype=complex), np.zeros((p, m), dtype=complex)


def _parts(p: int, m: int) -> Iterator[slice]:
    """Slices of the shifts whose fronts fit the cache together."""
    size = max(1, int(CACHE_BYTES // (16 * m * m)))
    return (slice(start, start + size) for start in range(0, p, size))


def _set_diagonal(front: ComplexArray, pivot_sums: ComplexArray) -> None:
    """Rebuild the pivots' diagonal entries from the row sums."""
    w = pivot_sums.shape[1]
    diagonal = np.einsum("pww->pw", front[:, :w, :w])  # a view
    diagonal[...] = 0
    diagonal[...] = pivot_sums - front[:, :w].sum(axis=2)


def _places(local: IntArray, m: int) -> IntArray:
    """Indices of the rows and columns `local` in flattened (m, m) matrices."""
    return (local[:, None] * m + local).ravel()


def _update(front: ComplexArray, sums: ComplexArray, coupling: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """F_AA − F_AJ X and the row sums s_A − Xᵀ s_J, for the parent."""
    w = coupling.shape[1]
    update = front[:, :w, w:].swapaxes(1, 2) @ coupling
    np.subtract(front[:, w:, w:], update, out=update)
    return update, sums[:, w:] - (sums[:, None, :w] @ coupling)[:, 0]


def _add(fronts: ComplexArray, places: IntArray, updates: ComplexArray) -> None:
    fronts, updates = fronts.reshape(len(fronts), -1), updates.reshape(len(fronts), -1)
    if len(places) < ONE_CALL:
        fronts[:, places] += updates
        return
    for front, update in zip(fronts, updates, strict=True):
        np.add.at(front, places, update)


def _extract(fronts: ComplexArray, places: IntArray, out: ComplexArray) -> None:
    r, fronts = out.shape[1], fronts.reshape(len(fronts), -1)
    if len(places) < ONE_CALL:
        out[...] = fronts.take(places, axis=1, mode="clip").reshape(out.shape)
        return
    for front, block in zip(fronts, out, strict=True):
        block[...] = front.take(places, mode="clip").reshape(r, r)
