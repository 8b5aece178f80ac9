"""The heat kernel of a graph plus a few edges, from what is known of the graph without them.

Let B, (n, k), hold a column e_i − e_j for every inserted edge ij. Then L' = L + B Bᵀ and, with Y = (L + zI)⁻¹ B
(Woodbury, 1950; Hager, SIAM Rev. 31, 1989, doi:10.1137/1031049),

    diag (L' + zI)⁻¹ = diag (L + zI)⁻¹ − diag Y (I + Bᵀ Y)⁻¹ Yᵀ,

at every pole: one sweep over the cached factors for all k columns, instead of a new factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.spectral import poles
from pgti_gtsam.spectral.elimination_tree import EliminationTree, analyse
from pgti_gtsam.spectral.laplacian import laplacian
from pgti_gtsam.spectral.pole_kernel import PoleHeatKernel, Spectrum, pole_kernels
from pgti_gtsam.spectral.selected_inverse import Factor, FrontEntries, factorise, inverse_diagonal, solve
from pgti_gtsam.spectral.spectrum import extreme_eigenvalues

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]

BREAK_EVEN = 40  # inserted edges from which a new factorisation costs less (10 000 keyframes)
CHUNK = 16  # poles whose columns Y are held at once
HEADROOM = 2.0  # by which inserted edges may raise the largest eigenvalue before the poles are placed anew
LOST_DIGITS = 30.0  # by which the error estimate may exceed the tolerance before the poles are placed anew


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpectralState:
    """A graph's heat kernel with the factorisations that inserted edges are judged by.

    Valid until the graph itself changes, whatever is asked of it. Holds 16 bytes for every pole and every entry
    of the factor: about 150 MB for 10 000 keyframes.

    Attributes
    ----------
    edges : (m, 2) int
    tolerance : float
    kernel : PoleHeatKernel
        Of the graph as it is.
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

        Parameters and errors are those of `pole_kernels`, for one graph.
        """
        edges = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
        tree = analyse(n_vertices, edges)
        spectrum = Spectrum.of(n_vertices, edges, tree.order)
        shifts = poles.place(spectrum.smallest_positive, HEADROOM * spectrum.largest, tolerance)
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

    def diagonals_with(self, inserted: IntArray, times: FloatArray) -> FloatArray:
        """K_ii(t) of the graph plus some edges, zero mode kept: (n, n_times).

        Cheaper than asking `kernel_with`: no eigenvalue is computed. Inserted edges lower none, and raise the
        largest by no more than twice the largest number of them at one vertex.

        Parameters
        ----------
        inserted : (k, 2) int
            Pairs of distinct vertices; one that is an edge already counts twice.
        times : (n_times,) float
        """
        inserted = np.asarray(inserted, dtype=np.int64).reshape(-1, 2)
        if len(inserted) == 0:
            return self.kernel.diagonals(times)
        old = self.kernel.spectrum
        largest = old.largest + 2.0 * float(np.bincount(inserted.ravel()).max())
        spectrum = replace(old, laplacian=self._laplacian_with(inserted), largest=largest)
        if not self._can_update(inserted, spectrum):
            return self._refactored(inserted).diagonals(times)
        return self._updated(inserted, spectrum).diagonals(times)

    def kernel_with(self, inserted: IntArray) -> PoleHeatKernel:
        """Heat kernel of the graph plus some edges, with the ends of its spectrum.

        Parameters
        ----------
        inserted : (k, 2) int
            As for `diagonals_with`.
        """
        inserted = np.asarray(inserted, dtype=np.int64).reshape(-1, 2)
        if len(inserted) == 0:
            return self.kernel
        if len(inserted) >= BREAK_EVEN or self._joins_components(inserted):
            return self._refactored(inserted)
        old, matrix = self.kernel.spectrum, self._laplacian_with(inserted)
        low, high = extreme_eigenvalues(matrix, old.labels)
        spectrum = replace(old, laplacian=matrix, smallest_positive=low, largest=high)
        return self._updated(inserted, spectrum) if self._can_update(inserted, spectrum) else self._refactored(inserted)

    def _joins_components(self, inserted: IntArray) -> bool:
        """Whether a zero mode goes, and with it the right placement of the poles."""
        i, j = self.kernel.spectrum.labels[inserted].T
        return bool((i != j).any())

    def _can_update(self, inserted: IntArray, spectrum: Spectrum) -> bool:
        if len(inserted) >= BREAK_EVEN or self._joins_components(inserted):
            return False
        estimate = poles.reference_residual(self.kernel.shifts, spectrum.smallest_positive, spectrum.largest)
        return estimate <= LOST_DIGITS * self.tolerance

    def _laplacian_with(self, inserted: IntArray) -> sparse.csc_array:
        old = self.kernel.spectrum.laplacian
        return sparse.csc_array(old + laplacian(old.shape[0], inserted))

    def _refactored(self, inserted: IntArray) -> PoleHeatKernel:
        edges = np.concatenate([self.edges, inserted])
        return pole_kernels(self.tree.n_vertices, (edges,), self.tolerance)[0]

    def _updated(self, inserted: IntArray, spectrum: Spectrum) -> PoleHeatKernel:
        ends = self.tree.positions[inserted]
        columns = incidence(self.tree.n_vertices, ends)
        drops = np.concatenate([_drop(solve(factor, columns), ends) for factor in self.factors])
        diagonals = self.diagonals - drops[:, self.tree.positions]
        return PoleHeatKernel.of(spectrum, self.kernel.shifts, diagonals)


def incidence(n_vertices: int, edges: IntArray) -> FloatArray:
    """B: a column e_i − e_j for every edge ij, (n, k)."""
    columns, k = np.zeros((n_vertices, len(edges))), np.arange(len(edges))
    columns[edges[:, 0], k], columns[edges[:, 1], k] = 1.0, -1.0
    return columns


def differences(y: ComplexArray, edges: IntArray) -> ComplexArray:
    """Bᵀ Y for Y of shape (p, n, m): (p, k, m)."""
    return np.asarray(y[:, edges[:, 0]] - y[:, edges[:, 1]])


def _drop(y: ComplexArray, edges: IntArray) -> ComplexArray:
    """diag Y (I + Bᵀ Y)⁻¹ Yᵀ for Y of shape (p, n, k): (p, n)."""
    capacitance = np.eye(len(edges)) + differences(y, edges)
    return np.asarray(np.einsum("pnk,pnk->pn", y @ np.linalg.inv(capacitance), y))
