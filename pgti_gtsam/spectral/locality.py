"""How a few inserted edges change the heat kernel nearby, at a cost that does not grow with the graph.

Heat reaches about √t hops in the time t. So the kernel's change at times up to t is computed on a ball U of
vertices around the ends of the inserted edges, which heat leaves for good: with D the Laplacian's block on U,
the killed kernel exp(−tD). How much is lost is known afterwards. For an inserted edge ab and b = e_a − e_b,
Duhamel's formula gives the change at a vertex i,

    K'_ii(t) − K_ii(t) = −Σ_ab ∫₀ᵗ u(t − s) v(s) ds,   u = (K b)_i,  v = (K' b)_i,

and the same on U with the killed kernels. K_ai exceeds its killed version by at most the probability ε_ab(t) that
the walk from an end of the edge has left U by the time t (ε' with the inserted edges), and ∫ v² ≤ bᵀ(2L')⁺b ≤ 1/2,
as ab is an edge of L'. By Cauchy and Schwarz the error of the change is at most

    Σ_ab √(t/2) (ε_ab(t) + ε'_ab(t) √R),   R = e bᵀ(D + I/(2t))⁻¹b ≥ 2 ∫₀ᵗ |exp(−sD)b|² ds,

at every vertex of the graph, the change outside U taken as zero. (Walks killed at the rim of a set: Grigor'yan,
Introduction to Analysis on Graphs, 2018, doi:10.1090/ulect/071; the bound is derived here.)

The killed kernel alone, `kernel_within`, is below the graph's, by at most ε_i(t)² at a vertex i, with ε_i(t) the
probability that a walk from i has left U by the time t. For the heat that is missing has left U and come back. It has
left with probability ε_i at most; and from a vertex w outside it is at i after a time s with probability
K_wi(s) = K_iw(s), which is at most that of having left from i by then.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.spectral import poles
from pgti_gtsam.spectral.elimination_tree import analyse
from pgti_gtsam.spectral.low_rank import differences, incidence
from pgti_gtsam.spectral.selected_inverse import FrontEntries, factorise, inverse_diagonal, solve

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]

FIRST_BALL = 400  # vertices; doubled until the bound is met
POLE_TOLERANCE = 1e-9
TOGETHER = 6  # poles whose factors are kept at once where only diagonals are wanted
SLOWEST_POLE = 0.1  # over the longest time: the fit from λ = 0 on is then good to 1e-7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalChange:
    """Heat kernel near inserted edges, without and with them.

    Attributes
    ----------
    vertices : (m,) int
        Of the ball; the changes elsewhere are below the bound.
    before, after : (m, n_times) float
        K_ii(t) of the ball, which heat leaves for good: below the graph's K_ii(t) near its rim.
    bound : (n_times,) float
        Largest error of after − before as the change of K_ii(t), at any vertex of the graph.
    """

    vertices: IntArray
    before: FloatArray
    after: FloatArray
    bound: FloatArray


def local_change(
    laplacian: sparse.csc_array,
    inserted: IntArray,
    times: FloatArray,
    tolerance: float = 1e-4,
    max_vertices: int = 4000,
) -> LocalChange:
    """Change of K_ii(t) near inserted edges.

    Parameters
    ----------
    laplacian : (n, n) sparse
        Of the graph without the inserted edges, unweighted.
    inserted : (k, 2) int
        At least one pair of distinct vertices.
    times : (n_times,) float
        Positive.
    tolerance : float
        Largest bound allowed, on K_ii(t) between zero and one.
    max_vertices : int
        Where the ball stops growing even if the bound is not met.
    """
    inserted = np.asarray(inserted, dtype=np.int64).reshape(-1, 2)
    seeds = np.unique(inserted)
    size = min(FIRST_BALL * len(seeds), max_vertices)
    while True:
        vertices = _ball(laplacian, seeds, size)
        change = _on_ball(laplacian, vertices, inserted, np.asarray(times, dtype=float))
        if change.bound.max() <= tolerance or len(vertices) < size or size >= max_vertices:
            return change
        size = min(2 * size, max_vertices)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KernelWithin:
    """Heat kernel of some vertices of a graph, from which heat leaves for good.

    Attributes
    ----------
    diagonal : (m, n_times) float
        Of the killed kernel: K_ii(t) of the graph is from here on up to `most`.
    left : (m, n_times) float
        Probability that a walk has left the vertices by the time t.
    """

    diagonal: FloatArray
    left: FloatArray

    @property
    def most(self) -> FloatArray:
        """Upper bound of the graph's K_ii(t), (m, n_times)."""
        return np.asarray(self.diagonal + self.left**2)


def kernel_within(block: sparse.csc_array, times: FloatArray) -> KernelWithin:
    """K_ii(t) on a part of a graph, and how much the rest of the graph can add.

    Parameters
    ----------
    block : (m, m) sparse
        Rows and columns of the part in the graph's unweighted Laplacian: row sums count the edges that lead out.
    times : (n_times,) float
        Positive.
    """
    grounds = np.maximum(block.sum(axis=0), 0.0)
    upper = sparse.triu(block, k=1).tocoo()
    tree = analyse(block.shape[0], np.stack([upper.row, upper.col], axis=1))
    shifts, fit = _fitted(tuple(times.tolist()), 2.0 ** np.ceil(np.log2(max(2 * block.diagonal().max(), 1.0))))

    # a few poles at a time: their factors are by far the most of the memory
    entries, found = FrontEntries.of(tree, block, grounds), []
    for some in np.array_split(shifts, -(-len(shifts) // TOGETHER)):
        factor = factorise(entries, some)
        found.append((inverse_diagonal(factor), solve(factor, grounds[tree.order, None])[:, tree.positions, 0]))
    diagonals, escape = (np.concatenate(each) for each in zip(*found, strict=True))

    # from resolvents to heat
    inside = (((1 - escape) / shifts[:, None]).T @ fit.weights).real + fit.constants
    return KernelWithin(
        diagonal=np.maximum(_sum(diagonals, fit) - fit.largest_error, 0.0),
        left=np.clip(1 - inside + fit.largest_error, 0.0, 1.0),
    )


def _ball(laplacian: sparse.csc_array, seeds: IntArray, size: int) -> IntArray:
    """The vertices fewest hops from the seeds, about as many as asked for, ascending."""
    starts, neighbours = laplacian.indptr, laplacian.indices
    seen, ring, found = set(seeds.tolist()), seeds.tolist(), seeds.tolist()
    while ring and len(found) < size:
        reached = {v for u in ring for v in neighbours[starts[u] : starts[u + 1]].tolist()}
        ring = sorted(reached - seen)
        seen.update(ring)
        found += ring
    return np.sort(np.array(found, dtype=np.int64))


def _on_ball(laplacian: sparse.csc_array, vertices: IntArray, inserted: IntArray, times: FloatArray) -> LocalChange:
    # the ball and the fit
    block = sparse.csc_array(laplacian[:, vertices].tocsr()[vertices])
    grounds = np.maximum(block.sum(axis=0), 0.0)  # edges that lead out of the ball
    upper = sparse.triu(block, k=1).tocoo()
    tree = analyse(len(vertices), np.stack([upper.row, upper.col], axis=1))
    ends = tree.positions[np.searchsorted(vertices, inserted)]
    degree = block.diagonal().max() + np.bincount(inserted.ravel()).max()
    slowest = 1 / float(times.max())
    shifts, fit = _fitted(tuple(times.tolist()), 2.0 ** np.ceil(np.log2(2 * degree)))

    # the resolvents' change by the inserted edges, and of the heat that leaves
    factor = factorise(FrontEntries.of(tree, block, grounds), np.append(shifts, 0.5 * slowest))
    columns = solve(factor, np.column_stack([incidence(len(vertices), ends), grounds[tree.order]]))
    y, escape = columns[:-1, :, :-1], columns[:-1, :, -1]
    inverse = np.linalg.inv(np.eye(len(ends)) + differences(y, ends))
    drop = np.einsum("pnk,pnk->pn", y @ inverse, y)[:, tree.positions]
    escape_after = escape - (y @ (inverse @ differences(escape[:, :, None], ends)))[:, :, 0]

    # bound: heat that has left reaches the ball again by the ends alone
    diagonals = inverse_diagonal(factor)[:-1]
    left, left_after = (_probability_left(e[:, ends], shifts, fit) for e in (escape, escape_after))
    resistances = np.e * np.diagonal(differences(columns[-1:, :, :-1], ends)[0]).real
    if grounds.any():
        left, left_after = left + fit.largest_error, left_after + fit.largest_error
    lost = left + left_after * np.sqrt(resistances)[:, None]
    return LocalChange(
        vertices=vertices,
        before=_sum(diagonals, fit),
        after=_sum(diagonals - drop, fit),
        bound=np.sqrt(times / 2) * lost.sum(axis=0),
    )


@lru_cache(maxsize=16)
def _fitted(times: tuple[float, ...], largest: float) -> tuple[ComplexArray, poles.Fit]:
    """Poles and weights for a spectrum from zero to `largest`, shared by most candidates of a map."""
    slowest = SLOWEST_POLE / max(times)
    shifts = poles.shifts_for(min(slowest, largest), largest, POLE_TOLERANCE)
    return shifts, poles.fit_from_zero(shifts, np.array(times), largest)


def _sum(resolvents: ComplexArray, fit: poles.Fit) -> FloatArray:
    """The exponentials from the resolvents, (p, m) -> (m, n_times)."""
    return np.asarray((resolvents.T @ fit.weights).real + fit.constants)


def _probability_left(escape: ComplexArray, shifts: ComplexArray, fit: poles.Fit) -> FloatArray:
    """Probability to have left the ball, of the worse end of every inserted edge: (k, n_times).

    A walk is still inside with probability exp(−tD)1, and (D + zI)⁻¹ 1 = (1 − escape)/z, where escape, of shape
    (p, k, 2), is (D + zI)⁻¹ times the number of edges that lead out. The fit's value at λ = 0 is one.
    """
    p, k, _ = escape.shape
    left = ((escape / shifts[:, None, None]).reshape(p, 2 * k).T @ fit.weights).real
    return np.asarray(np.clip(left, 0.0, 1.0).reshape(k, 2, -1).max(axis=1))
