"""Extreme eigenvalues and the pseudo-determinant of sparse, possibly weighted Laplacians.

Both eigenvalues are bracketed rather than merely iterated for. A Rayleigh quotient bounds one side; Sylvester's
law of inertia bounds the other: as many eigenvalues lie below σ as L − σI = LDLᵀ has negative pivots. Lanczos
steps, counted and few, move the first bound, one factorisation moves the second, and what is returned has been
certified not to have skipped an eigenvalue, as far as double precision can tell a pivot's sign: while
λ_max/λ₂ stays below 1e12. Above, for weights of very different sizes, the smallest is a converged Rayleigh quotient.

* Smallest positive: Lanczos on the pseudo-inverse. One vertex of every component is grounded, the constants of the
  components are projected out, and products are summed edge by edge, so that a weak edge beside strong ones is not
  rounded away with the diagonal.
* Largest: Lanczos on L, which stalls on long bare paths where eigenvalues crowd below the largest; then
  shift-invert Lanczos just above the estimate, whose error shrinks by the square of the number of steps in each
  round (Parlett, The Symmetric Eigenvalue Problem, 1998, doi:10.1137/1.9781611971163).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import SuperLU, eigsh, splu

from pgti_gtsam.errors import UnsolvableGraphError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64] | NDArray[np.int32]
Operator = Callable[[FloatArray], FloatArray]

RELATIVE_TOLERANCE = 1e-9  # of both eigenvalues; the heat kernel's poles need 1e-8
CONVERGED = 1e-11  # residual of an eigenvector, relative to its eigenvalue
CERTIFIED_GAP = 1e-6  # no eigenvalue is skipped that differs by more than this share
CHECK_EVERY = 4  # Lanczos steps between two looks at the residual
MAX_LANCZOS_STEPS = 60  # the basis is kept whole: 48 MB at 100 000 vertices
MAX_ROUNDS = 12  # each divides the bracket by hundreds: three suffice on a path of 100 000
SOLVED = 1e-13  # error of a solve in the energy norm
MAX_REFINEMENTS = 60  # of a solve; one or two suffice unless weights differ by 1e10 or more
DENSE_SIZE = 300  # vertices of a component below which its eigenpairs are computed densely
ROUNDING = 1e-13  # pivots, relative to the largest eigenvalue, whose sign is no longer trusted


def extreme_eigenvalues(
    laplacian: sparse.csc_array,
    labels: IndexArray,
    order: IndexArray | None = None,
) -> tuple[float, float]:
    """Smallest positive and largest eigenvalue of a Laplacian, to a relative 1e-9.

    Parameters
    ----------
    laplacian : (n, n) sparse
        L = D − W with weights W_ij >= 0; only its off-diagonal part is read.
    labels : (n,) int
        Connected component of every vertex; as many eigenvalues are zero as components exist.
    order : (n,) int, optional
        Vertices in an order of elimination with little fill; minimum degree when left out.

    Returns
    -------
    smallest_positive, largest : float
        Both 1.0 for a graph without edges: no eigenvalue is positive.
    """
    order = _minimum_degree_order(laplacian) if order is None else order
    labels = labels[order]
    graph = _WeightedEdges.of(_restrict(laplacian, order))
    if len(graph.weights) == 0:
        return 1.0, 1.0
    largest = _largest(graph)
    return min(_smallest_positive(graph, labels, largest), largest), largest


def smallest_by_component(
    laplacian: sparse.csc_array, labels: IndexArray, order: IndexArray | None = None
) -> FloatArray:
    """Smallest positive eigenvalue of every component; infinite at an isolated vertex.

    Parameters
    ----------
    laplacian, labels, order
        As for `extreme_eigenvalues`.

    Returns
    -------
    (n_components,) float
    """
    order = _minimum_degree_order(laplacian) if order is None else order
    labels = labels[order]
    return np.array(
        [
            _smallest_of_component(_restrict(laplacian, order[members]))
            for members in np.split(np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels))[:-1])
        ]
    )


def log_pseudo_determinant(laplacian: sparse.csc_array, labels: IndexArray) -> float:
    """Logarithm of the product of a Laplacian's positive eigenvalues.

    Kirchhoff's matrix-tree theorem: for a component of n vertices the product is n times the determinant of its
    Laplacian without the row and the column of any vertex.

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
    order = _minimum_degree_order(laplacian)
    labels = labels[order]
    graph = _WeightedEdges.of(_restrict(laplacian, order))
    sizes = np.bincount(labels)
    log_sizes = float(np.log(sizes[sizes > 0]).sum())
    free = _ungrounded(labels)
    if len(free) == 0:
        return log_sizes
    pivots = _factorise(_restrict(graph.laplacian, free)).U.diagonal()
    return log_sizes + float(np.log(np.abs(pivots)).sum())


def lowest_eigenpairs(
    laplacian: sparse.csc_array, labels: IndexArray, bound: float
) -> Iterator[tuple[IndexArray, FloatArray, FloatArray]]:
    """Positive eigenvalues up to a bound and their eigenvectors, component by component.

    The eigenvalues are counted first (Sylvester), so that none is missed.

    Parameters
    ----------
    laplacian : (n, n) sparse
    labels : (n,) int
        Connected component of every vertex.
    bound : float

    Yields
    ------
    vertices : (n_c,) int
    eigenvalues : (k,) float, ascending
    eigenvectors : (n_c, k) float, orthonormal
    """
    by_component = np.argsort(labels, kind="stable")
    for vertices in np.split(by_component, np.cumsum(np.bincount(labels))[:-1]):
        block = _restrict(laplacian, vertices)
        count = _count_below(block, bound) if len(vertices) > DENSE_SIZE else len(vertices)
        if count > len(vertices) // 4:
            values, vectors = linalg.eigh(block.toarray())
        else:
            start = np.random.default_rng(0).standard_normal(len(vertices))
            values, vectors = eigsh(block, k=count, sigma=-0.01 * bound, v0=start)
        keep = np.flatnonzero(values <= bound)[1:]
        yield vertices, values[keep], vectors[:, keep]


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

    def energy(self, x: FloatArray) -> float:
        """xᵀ L x, a sum of positive terms."""
        return float(self.weights @ (self.incidence @ x) ** 2)

    def rayleigh_quotient(self, x: FloatArray) -> float:
        return self.energy(x) / float(x @ x)

    def upper_bound(self) -> float:
        """Anderson and Morley (1985): the largest eigenvalue is at most max d_i + d_j over edges ij."""
        degrees = self.laplacian.diagonal()
        return float((abs(self.incidence) @ degrees).max())


def _largest(graph: _WeightedEdges) -> float:
    n = graph.laplacian.shape[0]

    # an estimate from below, a bound from above
    vector, residual = _dominant(graph.apply, np.random.default_rng(0).standard_normal(n))
    lower, upper = graph.rayleigh_quotient(vector), graph.upper_bound() * (1 + 1e-12)
    for _ in range(MAX_ROUNDS):
        if upper - lower <= RELATIVE_TOLERANCE * lower:
            break

        # count the eigenvalues above a shift just beyond the estimate
        shift = min(upper, lower + max(2 * residual, CERTIFIED_GAP * lower))
        factor = _factorise(_shifted(graph.laplacian, shift))
        if shift < upper and _negative_pivots(factor) < n:  # an eigenvalue lies above the shift
            lower, residual = shift, 4 * (shift - lower)
            continue
        upper = shift
        if residual <= CONVERGED * lower:
            break

        # improve the estimate by shift-invert at the bound
        vector, relative_residual = _dominant(lambda x, lu=factor: -lu.solve(x), vector)  # type: ignore[misc]
        lower = max(lower, graph.rayleigh_quotient(vector))
        residual = relative_residual * (shift - lower) ** 2
        if residual <= CONVERGED * lower and shift - lower <= 1e3 * CERTIFIED_GAP * lower:
            break
    return lower


def _smallest_positive(graph: _WeightedEdges, labels: IndexArray, largest: float) -> float:
    n_zero = len(np.unique(labels))
    solve = _pseudo_inverse(graph, labels)
    upper = np.inf
    for seed in range(MAX_ROUNDS):
        start = solve(np.random.default_rng(seed).standard_normal(len(labels)))
        vector, _ = _dominant(solve, start)
        upper = min(upper, graph.rayleigh_quotient(vector))
        margin = max(CERTIFIED_GAP, ROUNDING * largest / upper)
        if margin > 0.5 or _count_below(graph.laplacian, upper * (1 - margin)) <= n_zero:
            break
    return upper


def _smallest_of_component(block: sparse.csc_array) -> float:
    n = block.shape[0]
    if n == 1:
        return np.inf
    if n <= DENSE_SIZE:
        return float(linalg.eigvalsh(block.toarray())[1])
    graph = _WeightedEdges.of(block)
    return _smallest_positive(graph, np.zeros(n, dtype=np.int64), graph.upper_bound())


_TOO_FAR_APART = (
    "expected weights of edges that float64 can add up, got some so far apart that the Laplacian is singular"
)


def _dominant(operator: Operator, start: FloatArray) -> tuple[FloatArray, float]:
    """Lanczos with full reorthogonalisation: Ritz vector of the largest eigenvalue, and the norm of the residual."""
    # basis and tridiagonal matrix
    n_steps = min(MAX_LANCZOS_STEPS, len(start))
    basis = np.zeros((n_steps, len(start)))
    diagonal, below = np.zeros(n_steps), np.zeros(n_steps)
    q = start / np.linalg.norm(start)
    for k in range(n_steps):
        # one step, orthogonal to all before
        basis[k] = q
        image = operator(q)
        diagonal[k] = q @ image
        image = image - diagonal[k] * q - (below[k - 1] * basis[k - 1] if k else 0)
        image -= basis[: k + 1].T @ (basis[: k + 1] @ image)
        below[k] = np.linalg.norm(image)
        scale = np.abs(diagonal[: k + 1]).max()
        if not np.isfinite(scale):
            raise UnsolvableGraphError(_TOO_FAR_APART)

        # the Ritz vector, now and then
        if k % CHECK_EVERY == 0 or k == n_steps - 1 or below[k] <= CONVERGED * scale:
            value, vectors = linalg.eigh_tridiagonal(diagonal[: k + 1], below[:k], select="i", select_range=(k, k))
            ritz, residual = vectors[:, 0], float(below[k] * abs(vectors[-1, 0]))
            if residual <= CONVERGED * abs(value[0]):
                break
        q = image / below[k]
    return np.asarray(ritz @ basis[: len(ritz)]), residual


def _pseudo_inverse(graph: _WeightedEdges, labels: IndexArray) -> Operator:
    """b -> L⁺ b: conjugate gradients on edge-wise products, preconditioned by a grounded factorisation.

    A single step suffices while the weights are of equal size: the factorisation is then as good as exact. SciPy's `cg`
    forms the energy of a direction as pᵀ L p and so loses weak edges beside strong edges.
    """
    free = _ungrounded(labels)
    factor = _factorise(_restrict(graph.laplacian, free))

    def precondition(b: FloatArray) -> FloatArray:
        x = np.zeros(len(labels))
        x[free] = factor.solve(b[free])
        return _centred(x, labels)

    def solve(b: FloatArray) -> FloatArray:
        residual = _centred(b, labels)
        direction = step = precondition(residual)
        x, size = np.zeros_like(b), residual @ step
        initial = size
        for _ in range(MAX_REFINEMENTS):
            image = graph.apply(direction)
            length = size / graph.energy(direction)
            x += length * direction
            residual = residual - length * image
            step = precondition(residual)
            size, previous = residual @ step, size
            if size <= SOLVED**2 * initial:
                break
            direction = step + size / previous * direction
        return x

    return solve


def _centred(x: FloatArray, labels: IndexArray) -> FloatArray:
    """Without the mean of each component."""
    sizes = np.maximum(np.bincount(labels), 1)
    return np.asarray(x - (np.bincount(labels, weights=x) / sizes)[labels])


def _ungrounded(labels: IndexArray) -> IndexArray:
    """All vertices but the first of each component."""
    is_free = np.ones(len(labels), dtype=bool)
    is_free[np.unique(labels, return_index=True)[1]] = False
    return np.flatnonzero(is_free)


def _restrict(matrix: sparse.csc_array, vertices: IndexArray) -> sparse.csc_array:
    return sparse.csc_array(matrix[:, vertices].tocsr()[vertices])


def _shifted(matrix: sparse.csc_array, shift: float) -> sparse.csc_array:
    return sparse.csc_array(matrix - shift * sparse.eye_array(matrix.shape[0], format="csc"))


def _minimum_degree_order(laplacian: sparse.csc_array) -> IndexArray:
    factor = _factorise(_shifted(laplacian, -1.0), permutation="MMD_AT_PLUS_A")
    return np.argsort(factor.perm_c)


def _factorise(
    matrix: sparse.csc_array, permutation: Literal["NATURAL", "MMD_AT_PLUS_A"] = "NATURAL"
) -> SuperLU[np.float64]:
    """LU without row exchanges, so that U's diagonal holds the pivots of LDLᵀ.

    Narrow panels suit factors of few entries a column better than SuperLU's defaults.
    """
    try:
        return splu(
            matrix,
            permc_spec=permutation,
            diag_pivot_thresh=0.0,
            relax=1,
            panel_size=4,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:  # SuperLU's word for a pivot of zero
        raise UnsolvableGraphError(_TOO_FAR_APART) from error


def _negative_pivots(factor: SuperLU[np.float64]) -> int:
    return int(np.count_nonzero(factor.U.diagonal() < 0))


def _count_below(matrix: sparse.csc_array, shift: float) -> int:
    """Number of eigenvalues below a shift (Sylvester)."""
    try:
        return _negative_pivots(_factorise(_shifted(matrix, shift)))
    except RuntimeError:  # a pivot is exactly zero, as a degree equals the shift
        return _negative_pivots(_factorise(_shifted(matrix, shift * (1 - RELATIVE_TOLERANCE))))
