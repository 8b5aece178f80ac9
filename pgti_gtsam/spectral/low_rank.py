"""The heat kernel of a graph with a few edges more or less, from the factors of the graph without the change.

Let B, (n, k), hold a column e_i − e_j for every changed edge ij, and S, (k, k), diagonal, 1 where the edge is
inserted and −1 where the edge is removed. Then L' = L + B S Bᵀ and, with Y = (L + zI)⁻¹ B (Woodbury, 1950; Hager,
SIAM Rev. 31, 1989, doi:10.1137/1031049),

    diag (L' + zI)⁻¹ = diag (L + zI)⁻¹ − diag Y (S + Bᵀ Y)⁻¹ Yᵀ,

at every pole: one sweep over the cached factors for all k columns, instead of a new factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from pgti_gtsam.spectral import poles
from pgti_gtsam.spectral.elimination_tree import EliminationTree, analyse
from pgti_gtsam.spectral.laplacian import laplacian
from pgti_gtsam.spectral.pole_kernel import PoleHeatKernel, Spectrum, pole_kernels
from pgti_gtsam.spectral.selected_inverse import Factor, FrontEntries, factorise, inverse_diagonal, solve
from pgti_gtsam.spectral.spectrum import extreme_eigenvalues, smallest_by_component

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]

NO_EDGES: IntArray = np.empty((0, 2), dtype=np.int64)

BREAK_EVEN = 40  # changed edges from which a new factorisation costs less (10 000 keyframes)
CHUNK = 16  # poles whose columns Y are held at once
HEADROOM = 2.0  # by which inserted edges may raise the largest eigenvalue before the poles are placed anew
LOST_DIGITS = 30.0  # by which the error estimate may exceed the tolerance before the poles are placed anew


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpectralState:
    """A graph's heat kernel with the factorisations that inserted edges are judged by.

    Valid until the graph itself changes. Holds 16 bytes for every pole and every entry
    of the factor: about 150 MB for 10 000 keyframes.

    Attributes
    ----------
    edges : (m, 2) int
    tolerance : float
    kernel : PoleHeatKernel
        Of the graph without changes.
    tree : EliminationTree
    diagonals : (n_poles, n) complex
        diag (L + z_j I)⁻¹, zero mode kept.
    factors : tuple of Factor
        Of L + z_j I, `CHUNK` poles each.
    """

    edges: IntArray
    tolerance: float
    kernel: PoleHeatKernel
    tree: EliminationTree
    diagonals: ComplexArray
    factors: tuple[Factor, ...]

    @classmethod
    def of(cls, n_vertices: int, edges: IntArray, tolerance: float = 1e-8) -> SpectralState:
        """Factorise a graph and compute its heat kernel.

        Parameters
        ----------
        n_vertices : int
        edges : (m, 2) int
            Pairs of distinct vertices.
        tolerance : float
            As for `pole_kernels`, with the same errors.

        """
        edges = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
        tree = analyse(n_vertices, edges)
        spectrum = Spectrum.of(n_vertices, edges, tree.order)
        shifts = poles.shifts_for(spectrum.smallest_positive, HEADROOM * spectrum.largest, tolerance)
        entries = FrontEntries.of(tree, spectrum.laplacian)
        factors = tuple(factorise(entries, shifts[k : k + CHUNK]) for k in range(0, len(shifts), CHUNK))
        diagonals = np.concatenate([inverse_diagonal(factor) for factor in factors])
        return cls(
            edges=edges,
            tolerance=tolerance,
            kernel=PoleHeatKernel.of(spectrum, shifts, diagonals),
            tree=tree,
            diagonals=diagonals,
            factors=factors,
        )

    def bounded_kernel_with(self, inserted: IntArray) -> PoleHeatKernel:
        """Heat kernel of the graph plus some edges, with bounds for the ends of its spectrum.

        Cheaper than `kernel_with`: no eigenvalue is computed. Inserted edges lower none, and raise the largest by no
        more than twice the largest number of inserted edges at a vertex.

        Parameters
        ----------
        inserted : (k, 2) int
            Pairs of distinct vertices; a pair that is an edge already counts twice.
        """
        inserted = np.asarray(inserted, dtype=np.int64).reshape(-1, 2)
        if len(inserted) == 0:
            return self.kernel
        old = self.kernel.spectrum
        first, second = old.labels[inserted].T
        if len(inserted) >= BREAK_EVEN or (first != second).any():
            return self._refactored(inserted)
        largest = old.largest + 2.0 * float(np.bincount(inserted.ravel()).max())
        spectrum = replace(old, laplacian=self._laplacian_with(inserted), largest=largest)
        return self._updated(spectrum, inserted) if self._can_update(spectrum) else self._refactored(inserted)

    def kernel_with(self, inserted: IntArray, removed: IntArray = NO_EDGES) -> PoleHeatKernel:
        """Heat kernel of the graph with some edges more or less, with the ends of its spectrum.

        Parameters
        ----------
        inserted : (k, 2) int
            As for `bounded_kernel_with`.
        removed : (l, 2) int, optional
            Edges of the graph that are listed once.
        """
        inserted, removed = (np.asarray(edges, dtype=np.int64).reshape(-1, 2) for edges in (inserted, removed))
        n_changed, old = len(inserted) + len(removed), self.kernel.spectrum
        if n_changed == 0:
            return self.kernel

        # the ends of the spectrum, where its zero modes stay
        matrix = self._laplacian_with(inserted, removed)
        count, labels = csgraph.connected_components(matrix, directed=False)
        if n_changed >= BREAK_EVEN or count != old.n_components or not np.array_equal(labels, old.labels):
            return self._refactored(inserted, removed)
        low, high = extreme_eigenvalues(matrix, old.labels)
        spectrum = replace(old, laplacian=matrix, smallest_positive=low, largest=high)
        if len(removed):  # an edge less lets the spectrum of its component begin lower
            lows = np.array([low]) if count == 1 else smallest_by_component(matrix, old.labels)
            spectrum = replace(spectrum, smallest_by_component=lows)
        if self._can_update(spectrum):
            return self._updated(spectrum, inserted, removed)
        return self._refactored(inserted, removed)

    def _can_update(self, spectrum: Spectrum) -> bool:
        """Whether the poles still serve."""
        estimate = poles.reference_residual(self.kernel.shifts, spectrum.smallest_positive, spectrum.largest)
        return estimate <= LOST_DIGITS * self.tolerance

    def _laplacian_with(self, inserted: IntArray, removed: IntArray = NO_EDGES) -> sparse.csc_array:
        old = self.kernel.spectrum.laplacian
        more, less = (laplacian(old.shape[0], edges) for edges in (inserted, removed))
        found = sparse.csc_array(old + more - less)
        found.eliminate_zeros()
        return found

    def _refactored(self, inserted: IntArray, removed: IntArray = NO_EDGES) -> PoleHeatKernel:
        codes, gone = (edges.min(axis=1) * self.tree.n_vertices + edges.max(axis=1) for edges in (self.edges, removed))
        edges = np.concatenate([self.edges[~np.isin(codes, gone)], inserted])
        return pole_kernels(self.tree.n_vertices, (edges,), self.tolerance)[0]

    def _updated(self, spectrum: Spectrum, inserted: IntArray, removed: IntArray = NO_EDGES) -> PoleHeatKernel:
        ends = self.tree.positions[np.concatenate([inserted, removed])]
        signs = np.repeat([1.0, -1.0], [len(inserted), len(removed)])
        columns = incidence(self.tree.n_vertices, ends)
        drops = np.concatenate([_drop(solve(factor, columns), ends, signs) for factor in self.factors])
        diagonals = self.diagonals - drops[:, self.tree.positions]
        return PoleHeatKernel.of(spectrum, self.kernel.shifts, diagonals)


def incidence(n_vertices: int, edges: IntArray) -> FloatArray:
    """B: a column e_i − e_j for every edge ij, (n, k).

    Parameters
    ----------
    n_vertices : int
    edges : (k, 2) int
    """
    columns, k = np.zeros((n_vertices, len(edges))), np.arange(len(edges))
    columns[edges[:, 0], k], columns[edges[:, 1], k] = 1.0, -1.0
    return columns


def differences(y: ComplexArray, edges: IntArray) -> ComplexArray:
    """Bᵀ Y for Y of shape (p, n, m): (p, k, m).

    Parameters
    ----------
    y : (p, n, m) complex
    edges : (k, 2) int
    """
    return np.asarray(y[:, edges[:, 0]] - y[:, edges[:, 1]])


def _drop(y: ComplexArray, edges: IntArray, signs: FloatArray) -> ComplexArray:
    """diag Y (S + Bᵀ Y)⁻¹ Yᵀ for Y of shape (p, n, k) and the diagonal of S: (p, n)."""
    capacitance = np.diag(signs) + differences(y, edges)
    return np.asarray(np.einsum("pnk,pnk->pn", y @ np.linalg.inv(capacitance), y))
