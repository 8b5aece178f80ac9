"""The heat flow dδ/dt = −H δ − g of Eq. 9 and 12, at any times, and its end.

With δ_∞ a solution of H δ = −g, the flow from δ_0 is δ(t) = δ_∞ + e^(−tH) (δ_0 − δ_∞). Where H is singular,
the part in the null space does not change; g has no part there. The exponential comes from the eigenmodes
of small systems, else at short times from `scipy.sparse.linalg.expm_multiply`, and at long ones from
resolvents (`spectral.poles`), as the number of products that expm_multiply needs grows with t ‖H‖.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator, eigsh, expm_multiply, splu

from pgti_gtsam.checks import finite_array, instance, pairs, real_array, whole
from pgti_gtsam.diffusion.block_laplacian import NormalEquations
from pgti_gtsam.errors import InvalidOptionError, UnsolvableGraphError
from pgti_gtsam.spectral.poles import fit_from_zero, shifts_for

FloatArray = NDArray[np.float64]

MODES_UP_TO = 1500
"""Unknowns up to which all eigenmodes are found: about a second and 18 MB."""

PRODUCTS = 500.0
"""t ‖H‖₁ up to which expm_multiply is asked, which takes about as many products: as cheap as the resolvents,
and exact."""

POLE_TOLERANCE = 1e-10

APART = 1e10
"""t ‖H‖₁ from which on times have resolvents of their own. Where H is singular, resolvents at shifts as small as
‖H‖₁ / 1e15 are rounding, and in one fit for all times that rounding drowned the heat of all earlier times as well: on
chains of 20 to 1600 vertices by 14 to 0.2 of a heat of 1. Apart, no time before is off by more than 8e-5."""

VANISHING_PIVOT = 1e-9
"""A pivot below this share of its diagonal entry is rounding. Of six standard graphs the least held has 2e-8 (CSAIL);
those that nothing holds have 5e-11 at most, or less than nothing."""

NOT_HELD = "expected a graph whose every part has a prior, got a singular one; add its `grounds`"

REFINEMENTS = 3
"""Steps of iterative refinement. Normal equations lose twice the digits that the Jacobian loses; a step with
the gradient taken
from J wins them back. On MIT (condition number of H: 2.5e15) the second one already ends at rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Modes:
    """Eigenmodes of a symmetric positive semidefinite matrix: e^(−tH) = V diag(e^(−tλ)) Vᵀ."""

    eigenvalues: FloatArray
    vectors: FloatArray

    def exponential(self, vectors: FloatArray, times: FloatArray) -> FloatArray:
        """e^(−tH) v, (n_times, N, k), of vectors (N, k).

        Parameters
        ----------
        vectors : (N, k) float
        times : (n_times,) float
            Not negative.
        """
        inside = self.vectors.T @ vectors
        return np.stack([self.vectors @ (np.exp(-t * self.eigenvalues)[:, None] * inside) for t in times])


def modes(matrix: sparse.csr_array) -> Modes:
    """All eigenmodes; eigenvalues that rounding put below zero are zero."""
    eigenvalues, vectors = linalg.eigh(matrix.toarray(), driver="evd", overwrite_a=True, check_finite=False)
    return Modes(eigenvalues=np.maximum(eigenvalues, 0.0), vectors=vectors)


def exponential(matrix: sparse.csr_array, vectors: FloatArray, times: FloatArray) -> FloatArray:
    """e^(−tH) v of vectors (N, k) at times (n_times,), not negative: (n_times, N, k).

    Parameters
    ----------
    matrix : sparse.csr_array
        H, (N, N).
    vectors : (N, k) float
    times : (n_times,) float
        Not negative.
    """
    if matrix.shape[0] <= MODES_UP_TO:
        return modes(matrix).exponential(vectors, times)
    norm = float(abs(matrix).sum(axis=0).max())
    short = times * norm <= PRODUCTS
    values = np.empty((len(times), *vectors.shape))
    for k in np.flatnonzero(short):
        values[k] = expm_multiply(-times[k] * matrix, vectors, traceA=-times[k] * float(matrix.trace()))
    if not short.all():
        values[~short] = _by_resolvents(matrix, vectors, times[~short], norm)
    return values


def _by_resolvents(matrix: sparse.csr_array, vectors: FloatArray, times: FloatArray, largest: float) -> FloatArray:
    values = np.empty((len(times), *vectors.shape))
    for some in shared(times, largest):
        shifts = shifts_for(1 / float(times[some].max()), largest, POLE_TOLERANCE)
        fitted = fit_from_zero(shifts, times[some], largest)
        values[some] = fitted.constants[:, None, None] * vectors
        for shift, weights in zip(shifts, fitted.weights, strict=True):
            part = factorised(sparse.csc_array(matrix + shift * sparse.eye_array(matrix.shape[0]))).solve(vectors + 0j)
            values[some] += weights.real[:, None, None] * part.real - weights.imag[:, None, None] * part.imag
    return values


def shared(times: FloatArray, largest: float) -> list[NDArray[np.int64]]:
    """Indices of the times that share resolvents: those before `APART`, and those after.

    Parameters
    ----------
    times : (n_times,) float
    largest : float
        ‖H‖₁.
    """
    is_late = times * largest > APART
    return [own for own in (np.flatnonzero(~is_late), np.flatnonzero(is_late)) if len(own)]


def factorised(matrix: sparse.csc_array) -> Any:
    """Sparse factorisation of a symmetric matrix without pivoting.

    Raises
    ------
    UnsolvableGraphError
        The matrix is singular.
    """
    try:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:
        raise UnsolvableGraphError(NOT_HELD) from error


def steady_state(equations: NormalEquations) -> FloatArray:
    """δ_∞ = −H⁻¹ g of a grounded graph, (N,): the Gauss-Newton step.

    Raises
    ------
    UnsolvableGraphError
        H is singular.
    InvalidOptionError
        No normal equations.
    """
    instance(equations, NormalEquations, "equations")

    # a factorisation without vanishing pivots
    matrix = sparse.csc_array(equations.hessian)
    factor = factorised(matrix)
    if (factor.U.diagonal() < VANISHING_PIVOT * matrix.diagonal()[np.argsort(factor.perm_c)]).any():
        raise UnsolvableGraphError(NOT_HELD)

    # its solution, refined
    solution: FloatArray = factor.solve(-equations.gradient)
    for _ in range(REFINEMENTS):
        solution = solution - factor.solve(equations.gradient_at(solution))
    if not np.isfinite(solution).all():
        raise UnsolvableGraphError(NOT_HELD)
    return solution


def extreme_eigenvalues(equations: NormalEquations) -> tuple[float, float]:
    """λ_min and λ_max of H: the flow starts within 1/λ_max and has ended a few 1/λ_min later. λ_min is 0
    where H is singular."""
    matrix = instance(equations, NormalEquations, "equations").hessian
    if matrix.shape[0] <= MODES_UP_TO // 4:
        found = linalg.eigvalsh(matrix.toarray())
        return max(float(found[0]), 0.0), float(found[-1])
    start = np.random.default_rng(0).normal(size=matrix.shape[0])
    largest = float(eigsh(matrix, 1, return_eigenvectors=False, v0=start, tol=1e-6)[0])
    try:
        factor = factorised(sparse.csc_array(matrix))
    except UnsolvableGraphError:
        return 0.0, largest
    inverse = LinearOperator(matrix.shape, matvec=factor.solve, dtype=float)
    smallest = 1 / float(eigsh(inverse, 1, return_eigenvectors=False, v0=start, tol=1e-6)[0])
    return max(smallest, 0.0), largest


@dataclass(frozen=True, kw_only=True, eq=False)
class HeatFlow:
    """The flow of a grounded graph from δ(0) = `start`.

    Attributes
    ----------
    equations : NormalEquations
    steady : (N,) float
        δ_∞.
    start : (N,) float
        δ(0).
    """

    equations: NormalEquations
    steady: FloatArray
    start: FloatArray

    @cached_property
    def _modes(self) -> Modes:
        return modes(self.equations.hessian)

    def at(self, times: FloatArray) -> FloatArray:
        """δ(t), (n_times, N).

        Parameters
        ----------
        times : (n_times,) float
            Zero or more, in units of 1/H.

        Raises
        ------
        InvalidGraphError, InvalidOptionError
            No numbers; a time below zero or not finite.
        """
        times = np.atleast_1d(real_array(times, "times"))
        if times.ndim != 1 or not len(times) or not (np.isfinite(times).all() and (times >= 0).all()):
            raise InvalidOptionError("expected finite times of zero or more: heat does not flow back")
        away = (self.start - self.steady)[:, None]
        small = len(self.steady) <= MODES_UP_TO
        fading = self._modes.exponential(away, times) if small else exponential(self.equations.hessian, away, times)
        return np.asarray(self.steady + fading[:, :, 0])

    def energies(self, states: FloatArray) -> FloatArray:
        """½‖e + Jδ‖² of states (n_times, N): falls along the flow, at the rate ‖Hδ + g‖²."""
        states = finite_array(states, "states", None, len(self.steady))
        curved = 0.5 * np.einsum("ti,ti->t", states, (self.equations.hessian @ states.T).T)
        return np.asarray(curved + states @ self.equations.gradient + self.equations.constant)


def heat_flow(
    equations: NormalEquations, start: FloatArray | None = None, steady: FloatArray | None = None
) -> HeatFlow:
    """Heat flow of a grounded graph.

    Parameters
    ----------
    equations : NormalEquations
    start : (N,) float, optional
        δ at time zero; zero when left out.
    steady : (N,) float, optional
        The steady state, where already known.

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        No normal equations, or a state that has not as many finite numbers.
    UnsolvableGraphError
        H is singular.
    """
    n = len(instance(equations, NormalEquations, "equations").gradient)
    begin = np.zeros(n) if start is None else finite_array(start, "the start", n)
    ending = steady_state(equations) if steady is None else finite_array(steady, "the steady state", n)
    return HeatFlow(equations=equations, steady=ending, start=begin)


def unforced(equations: NormalEquations) -> NormalEquations:
    """The same without residuals: how a perturbation dies away."""
    instance(equations, NormalEquations, "equations")
    residual = None if equations.residual is None else np.zeros(len(equations.residual))
    return replace(equations, gradient=np.zeros(len(equations.gradient)), constant=0.0, residual=residual)


def relative_consensus(
    n_vertices: int,
    edges: NDArray[np.int64],
    measured: FloatArray,
    weights: FloatArray | None = None,
    held: int | None = None,
) -> NormalEquations:
    """Eq. 8 and 9: f(x) = ½‖Cx − z‖², whose descent dx/dt = −CᵀC x + Cᵀz is heat with a constant source.

    Parameters
    ----------
    n_vertices : int
    edges : (m, 2) int
        The row of C for the edge (i, j) has +1 at i and −1 at j.
    measured : (m, k) float
        z_ij, what x_i − x_j should be.
    weights : (m,) float, optional
        ω_ij of Eq. 6; 1 when left out.
    held : int, optional
        A vertex tied to x = 0 with weight 1, so that the steady state is unique.

    Returns
    -------
    NormalEquations
        With H = CᵀWC ⊗ 1_k: k copies of a scalar Laplacian.

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        Vertices, edges, differences and weights that do not fit together, or are not finite.
    """
    n = whole(n_vertices, "the number of vertices", least=1)
    ends = pairs(edges, n, "vertices")
    m = len(ends)
    z = finite_array(measured, "measured differences", m, None)
    w = np.ones(m) if weights is None else finite_array(weights, "weights", m)

    # CᵀWC, and one vertex held
    incidence = sparse.coo_array((np.tile([1.0, -1.0], m), (np.repeat(np.arange(m), 2), ends.ravel())), shape=(m, n))
    weighted = incidence.tocsr().T @ sparse.diags_array(w)
    matrix = weighted @ incidence
    if held is not None:
        at = whole(held, "the fixed vertex", least=0, most=n - 1)
        matrix = matrix + sparse.coo_array(([1.0], ([at], [at])), shape=(n, n))

    # a copy for each coordinate
    k = z.shape[1]
    return NormalEquations(
        hessian=sparse.csr_array(sparse.kron(matrix, sparse.eye_array(k))),
        gradient=-np.asarray(weighted @ z).ravel(),
        constant=0.5 * float(w @ (z**2).sum(axis=1)),
        dimension=k,
        frame="spatial",
    )
