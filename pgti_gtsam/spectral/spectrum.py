"""Extreme eigenvalues and the pseudo-determinant of sparse, possibly weighted Laplacians.

Both eigenvalues are bracketed rather than merely iterated for. A Rayleigh quotient bounds one side; Sylvester's law of
inertia bounds the other: as many eigenvalues lie below σ as L − σI = PᵀLDLᵀP has negative pivots. Lanczos steps, counted and
few, move the first bound, one factorisation moves the second, and what is returned has been certified not to have skipped an
eigenvalue (as far as double precision can tell pivots apart).

* Smallest positive: Lanczos on the pseudo-inverse. One vertex of every component is grounded, the constants of the components
  are projected out, and products and residuals are summed edge by edge, so that a weak edge beside strong ones is not rounded
  away with the diagonal (iterative refinement: Higham, Accuracy and Stability of Numerical Algorithms, 2002, chapter 12).
* Largest: Lanczos on L, which stalls on long bare paths where eigenvalues crowd below the largest; then shift-invert Lanczos
  just above the estimate, whose error shrinks by the square of the number of steps in each round
  (Parlett, The Symmetric Eigenvalue Problem, 1998, doi:10.1137/1.9781611971163).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh_tridiagonal
from scipy.sparse.linalg import SuperLU, splu

FloatArray = NDArray[np.float64]
Operator = Callable[[FloatArray], FloatArray]

RELATIVE_TOLERANCE = 1e-9  # of both eigenvalues; the heat kernel's poles need 1e-8
MAX_LANCZOS_STEPS = 60  # the basis is kept whole: 48 MB at 100 000 vertices
MAX_ROUNDS = 12  # each divides the bracket by hundreds: three suffice on a path of 100 000
MAX_REFINEMENTS = 8  # of a solve; two suffice unless weights differ by 1e10 or more
ROUNDING = 1e-13  # pivots, relative to the largest eigenvalue, whose sign is no longer trusted


def extreme_eigenvalues(laplacian: sparse.csc_array, labels: NDArray[np.integer]) -> tuple[float, float]:
    """Smallest positive and largest eigenvalue of a Laplacian, to a relative 1e-9.

    Parameters
    ----------
    laplacian : (n, n) sparse
        L = D − W with weights W_ij >= 0; only its off-diagonal part is read.
    labels : (n,) int
        Connected component of every vertex; as many eigenvalues are zero as there are components.

    Returns
    -------
    smallest_positive, largest : float
        Both 1.0 for a graph without edges, which has no positive eigenvalue.
    """
    graph = _WeightedEdges.of(laplacian)
    if len(graph.weights) == 0:
        return 1.0, 1.0
    largest = _largest(graph)
    return min(_smallest_positive(graph, np.asarray(labels), largest), largest), largest


def log_pseudo_determinant(laplacian: sparse.csc_array, labels: NDArray[np.integer]) -> float:
    """Logarithm of the product of a Laplacian's positive eigenvalues.

    Kirchhoff's matrix-tree theorem: for a component of n vertices the product is n times the determinant of its Laplacian
    without the row and the column of any one vertex.

    Parameters
    ----------
    laplacian : (n, n) sparse
        L = D − W with weights W_ij >= 0.
    labels : (n,) int
        Connected component of every vertex.

    Returns
    -------
    float
        Zero for a graph without edges: the empty product.
    """
    graph = _WeightedEdges.of(laplacian)
    sizes = np.bincount(labels)
    log_sizes = float(np.log(sizes[sizes > 0]).sum())
    free = _ungrounded(labels)
    if len(free) == 0:
        return log_sizes
    pivots = _factorise(_restrict(graph.laplacian, free)).U.diagonal()
    return log_sizes + float(np.log(np.abs(pivots)).sum())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _WeightedEdges:
    """A weighted graph as edges, so that L x = Bᵀ W B x is summed without cancellation in the diagonal."""

    incidence: sparse.csr_array  # (m, n) B: +1 and −1 in each row
    transposed: sparse.csr_array  # (n, m) Bᵀ
    weights: FloatArray  # (m,)
    laplacian: sparse.csc_array  # (n, n)

    @classmethod
    def of(cls, laplacian: sparse.csc_array) -> _WeightedEdges:
        upper = sparse.triu(laplacian, k=1).tocoo()
        i, j, weights = upper.row, upper.col, -np.asarray(upper.data, dtype=float)
        keep = weights > 0
        i, j, weights = i[keep], j[keep], weights[keep]
        m, n = len(weights), laplacian.shape[0]
        signs, rows = np.repeat([1.0, -1.0], m), np.tile(np.arange(m), 2)
        incidence = sparse.csr_array((signs, (rows, np.concatenate([i, j]))), shape=(m, n))
        transposed = sparse.csr_array(incidence.T)
        summed = sparse.csc_array(transposed @ sparse.diags_array(weights) @ incidence)
        return cls(incidence=incidence, transposed=transposed, weights=weights, laplacian=summed)

    def apply(self, x: FloatArray) -> FloatArray:
        return np.asarray(self.transposed @ (self.weights * (self.incidence @ x)))

    def rayleigh_quotient(self, x: FloatArray) -> float:
        return float(self.weights @ (self.incidence @ x) ** 2 / (x @ x))

    def upper_bound(self) -> float:
        """Anderson and Morley (1985): the largest eigenvalue is at most max d_i + d_j over edges ij."""
        degrees = self.laplacian.diagonal()
        return float((abs(self.incidence) @ degrees).max())


def _largest(graph: _WeightedEdges) -> float:
    n = graph.laplacian.shape[0]
    start = np.random.default_rng(0).standard_normal(n)
    vector, residual = _dominant(graph.apply, start)
    lower, upper = graph.rayleigh_quotient(vector), graph.upper_bound() * (1 + 1e-12)
    for _ in range(MAX_ROUNDS):
        if upper - lower <= RELATIVE_TOLERANCE * lower:
            break
        shift = min(upper, lower + max(2 * residual, 0.5 * RELATIVE_TOLERANCE * lower))
        factor = _factorise(_shifted(graph.laplacian, shift))
        if shift < upper and _negative_pivots(factor) < n:  # an eigenvalue lies above the shift
            lower, residual = shift, 4 * (shift - lower)
            continue
        upper = shift
        vector, relative_residual = _dominant(lambda x, lu=factor: -lu.solve(x), vector)  # type: ignore[misc]
        lower = max(lower, graph.rayleigh_quotient(vector))
        residual = relative_residual * (shift - lower) ** 2
    return lower


def _smallest_positive(graph: _WeightedEdges, labels: NDArray[np.integer], largest: float) -> float:
    n_zero = len(np.unique(labels))
    solve = _pseudo_inverse(graph, labels)
    upper = np.inf
    for seed in range(MAX_ROUNDS):
        start = solve(np.random.default_rng(seed).standard_normal(len(labels)))
        vector, _ = _dominant(solve, start)
        upper = min(upper, graph.rayleigh_quotient(vector))
        margin = max(1e-6, ROUNDING * largest / upper)
        if margin > 0.5 or _count_below(graph.laplacian, upper * (1 - margin)) <= n_zero:
            break
    return upper


def _dominant(operator: Operator, start: FloatArray) -> tuple[FloatArray, float]:
    """Lanczos with full reorthogonalisation: Ritz vector of the largest eigenvalue, and the norm of its residual."""
    n_steps = min(MAX_LANCZOS_STEPS, len(start))
    basis = np.zeros((n_steps, len(start)))
    diagonal, below = np.zeros(n_steps), np.zeros(n_steps)
    q = start / np.linalg.norm(start)
    ritz, residual, k = np.ones(1), 0.0, 0
    for k in range(n_steps):
        basis[k] = q
        image = operator(q)
        diagonal[k] = q @ image
        for _ in range(2):  # once loses orthogonality, twice is enough
            image = image - basis[: k + 1].T @ (basis[: k + 1] @ image)
        below[k] = np.linalg.norm(image)
        value, vectors = eigh_tridiagonal(diagonal[: k + 1], below[:k], select="i", select_range=(k, k))
        ritz, residual = vectors[:, 0], float(below[k] * abs(vectors[-1, 0]))
        if residual <= 0.01 * RELATIVE_TOLERANCE * abs(value[0]):
            break
        q = image / below[k]
    return ritz @ basis[: k + 1], residual


def _pseudo_inverse(graph: _WeightedEdges, labels: NDArray[np.integer]) -> Operator:
    """b -> L⁺ b, by a grounded factorisation refined with residuals summed edge by edge."""
    free = _ungrounded(labels)
    factor = _factorise(_restrict(graph.laplacian, free))

    def correction(b: FloatArray) -> FloatArray:
        x = np.zeros(len(labels))
        x[free] = factor.solve(b[free])
        return _centred(x, labels)

    def solve(b: FloatArray) -> FloatArray:
        b = _centred(b, labels)
        x = step = correction(b)
        for _ in range(MAX_REFINEMENTS):
            previous, step = step, correction(b - graph.apply(x))
            size = np.linalg.norm(step)
            if size > 0.5 * np.linalg.norm(previous):
                break
            x = x + step
            if size <= 1e-12 * np.linalg.norm(x):
                break
        return x

    return solve


def _centred(x: FloatArray, labels: NDArray[np.integer]) -> FloatArray:
    """Without the mean of each component."""
    sizes = np.maximum(np.bincount(labels), 1)
    return np.asarray(x - (np.bincount(labels, weights=x) / sizes)[labels])


def _ungrounded(labels: NDArray[np.integer]) -> NDArray[np.intp]:
    """All vertices but the first of each component."""
    is_free = np.ones(len(labels), dtype=bool)
    is_free[np.unique(labels, return_index=True)[1]] = False
    return np.flatnonzero(is_free)


def _restrict(matrix: sparse.csc_array, vertices: NDArray[np.intp]) -> sparse.csc_array:
    return sparse.csc_array(matrix[:, vertices].tocsr()[vertices])


def _shifted(matrix: sparse.csc_array, shift: float) -> sparse.csc_array:
    return sparse.csc_array(matrix - shift * sparse.eye_array(matrix.shape[0], format="csc"))


def _factorise(matrix: sparse.csc_array) -> SuperLU:
    """LU without row exchanges, so that U's diagonal holds the pivots of LDLᵀ."""
    return splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )


def _negative_pivots(factor: SuperLU) -> int:
    return int(np.count_nonzero(factor.U.diagonal() < 0))


def _count_below(matrix: sparse.csc_array, shift: float) -> int:
    """Number of eigenvalues below a shift (Sylvester)."""
    return _negative_pivots(_factorise(_shifted(matrix, shift)))
