"""The heat kernel's diagonal at every vertex in time nearly linear in the number of vertices.

exp(−tL)_ii of all times comes from the diagonals of one set of resolvents (`poles`), each diagonal from a sparse
factorisation (`selected_inverse`). Graphs on the same vertices share the order of elimination, the fill and the
poles. The constant of each component, eigenvalue zero, is taken off every resolvent exactly: 1/(n_c z) at a vertex
of a component of n_c vertices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.spectral import poles
from pgti_gtsam.spectral.elimination_tree import EliminationTree, analyse
from pgti_gtsam.spectral.laplacian import connected_components, laplacian
from pgti_gtsam.spectral.selected_inverse import FrontEntries, inverse_diagonals
from pgti_gtsam.spectral.spectrum import extreme_eigenvalues, lowest_eigenpairs, smallest_by_component

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ComplexArray = NDArray[np.complex128]

LATE_DECAYS = 23.0  # exp(−23) = 1e-10: slower modes than this, relative to the slowest, are left out at late times


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectrum:
    """A Laplacian with the parts of its spectrum that the fit needs.

    Attributes
    ----------
    laplacian : (n, n) sparse
    n_components : int
    labels : (n,) int
        Connected component of every vertex.
    smallest_positive, largest : float
        An interval that holds all positive eigenvalues; 1 and 1 for a graph without an edge.
    smallest_by_component : (n_components,) float
        Lower bounds of each component's positive eigenvalues, infinite at an isolated vertex.
    """

    laplacian: sparse.csc_array
    n_components: int
    labels: NDArray[np.int32]
    smallest_positive: float
    largest: float
    smallest_by_component: FloatArray

    @classmethod
    def of(cls, n_vertices: int, edges: IntArray, order: IntArray | None = None) -> Spectrum:
        """The Laplacian of a graph with the tightest interval.

        Parameters
        ----------
        n_vertices : int
        edges : (m, 2) int
        order : (n,) int, optional
            Elimination order; without, minimum degree.
        """
        matrix = laplacian(n_vertices, edges)
        count, labels = connected_components(n_vertices, edges)
        smallest, largest = extreme_eigenvalues(matrix, labels, order)
        lows = np.array([smallest]) if count == 1 else smallest_by_component(matrix, labels, order)
        return cls(
            laplacian=matrix,
            n_components=count,
            labels=labels,
            smallest_positive=smallest,
            largest=largest,
            smallest_by_component=lows,
        )

    def octaves(self) -> Iterator[tuple[float, NDArray[np.bool_]]]:
        """Vertices by the smallest positive eigenvalue of their component, an octave at a time.

        Yields
        ------
        smallest : float
            Lower bound of the positive eigenvalues that count at these vertices.
        members : (n,) bool
        """
        lows = np.clip(self.smallest_by_component, self.smallest_positive, self.largest)
        steps = np.floor(np.log2(lows / self.smallest_positive)).astype(np.int64)
        for step in np.unique(steps):
            yield float(lows[steps == step].min()), (steps == step)[self.labels]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoleHeatKernel:
    """Heat kernel from the diagonals of its resolvents.

    Attributes
    ----------
    spectrum : Spectrum
    error_estimate : float
        Estimated error of signatures relative to the largest signature: `poles.Fit.residual` at the reference times.
    shifts : (n_poles,) complex
    resolvents : (2 n_poles, n) float
        Real parts, then negated imaginary parts of diag (L + z_j I)⁻¹ without the zero mode.
    """

    spectrum: Spectrum
    error_estimate: float
    shifts: ComplexArray
    resolvents: FloatArray

    @classmethod
    def of(cls, spectrum: Spectrum, shifts: ComplexArray, diagonals: ComplexArray) -> PoleHeatKernel:
        """Take the zero mode off the diagonals of the resolvents, (n_poles, n).

        Parameters
        ----------
        spectrum : Spectrum
        shifts : (n_poles,) complex
        diagonals : (n_poles, n) complex
        """
        sizes = np.bincount(spectrum.labels)[spectrum.labels]
        positive = diagonals - 1 / np.outer(shifts, sizes)
        positive[:, sizes == 1] = 0
        estimate = poles.reference_residual(shifts, spectrum.smallest_positive, spectrum.largest)
        resolvents = np.concatenate([positive.real, -positive.imag])
        return cls(spectrum=spectrum, error_estimate=estimate, shifts=shifts, resolvents=resolvents)

    @property
    def n_components(self) -> int:
        """Number of connected components: the number of eigenvalues zero."""
        return self.spectrum.n_components

    @property
    def smallest_positive(self) -> float:
        """Smallest positive eigenvalue; 1 for a graph without an edge."""
        return self.spectrum.smallest_positive

    @property
    def largest(self) -> float:
        """Largest eigenvalue; 1 for a graph without an edge."""
        return self.spectrum.largest

    @property
    def zero_mode(self) -> FloatArray:
        """Share of the zero mode in K_ii(t) at all times: 1 over the size of the component, (n,)."""
        return np.asarray(1 / np.bincount(self.spectrum.labels)[self.spectrum.labels])

    def diagonals(self, times: FloatArray) -> FloatArray:
        """K_ii(t), the zero mode kept: (n, n_times), for times in [0, ∞)."""
        decay = np.exp(-self.smallest_positive * np.asarray(times, dtype=float))
        return np.asarray(self.zero_mode[:, None] + self._positive_part(times) * decay)

    def signatures(self, times: FloatArray) -> FloatArray:
        """Scaled heat kernel signatures of Eq. 4: (n, n_times), exactly zero at isolated vertices.

        Later than `poles.LATEST` over the smallest positive eigenvalue, where the trace would underflow, the
        few slowest modes are all that counts and are computed themselves.
        """
        times = np.asarray(times, dtype=float)
        part = np.empty((self.resolvents.shape[1], len(times)))
        late = times * self.smallest_positive > poles.LATEST
        part[:, ~late] = self._positive_part(times[~late])
        if late.any():
            part[:, late] = self._slowest_part(times[late])
        total = part.sum(axis=0)
        return np.asarray(part / np.where(total > 0, total, 1.0))

    def _positive_part(self, times: FloatArray) -> FloatArray:
        """exp(λ₂t) (K_ii(t) − zero mode): (n, n_times).

        Components whose own spectrum begins later are fitted from there, or the error of the slow components would
        drown the small signatures.
        """
        times = np.asarray(times, dtype=float)
        part = np.empty((self.resolvents.shape[1], len(times)))
        for smallest, members in self.spectrum.octaves():
            fit = poles.fit(self.shifts, times, smallest, self.largest)
            weights = np.concatenate([fit.weights.real, fit.weights.imag])
            own = self.resolvents[:, members].T @ weights
            own += np.outer(1 - self.zero_mode[members], fit.constants)
            part[members] = own * np.exp(-(smallest - self.smallest_positive) * times)
        return part

    def _slowest_part(self, times: FloatArray) -> FloatArray:
        matrix, labels = self.spectrum.laplacian, self.spectrum.labels
        bound = self.smallest_positive + LATE_DECAYS / times.min()
        part = np.zeros((self.resolvents.shape[1], len(times)))
        for vertices, values, vectors in lowest_eigenpairs(matrix, labels, bound):
            part[vertices] = vectors**2 @ np.exp(-np.outer(values - self.smallest_positive, times))
        return part


def pole_kernels(
    n_vertices: int, edge_lists: tuple[IntArray, ...], tolerance: float = 1e-8
) -> tuple[PoleHeatKernel, ...]:
    """Heat kernels of several graphs on the same vertices.

    Parameters
    ----------
    n_vertices : int
        At least one.
    edge_lists : tuple of (m, 2) int
        Pairs of distinct vertices; a pair that is listed twice counts twice.
    tolerance : float
        Asked for errors relative to the largest signature.

    Raises
    ------
    InvalidOptionError
        If the tolerance is outside 1e-11 to 1e-2.
    """
    edge_lists = tuple(np.asarray(edges, dtype=np.int64).reshape(-1, 2) for edges in edge_lists)
    tree = analyse(n_vertices, np.concatenate(edge_lists))
    spectra = [Spectrum.of(n_vertices, edges, tree.order) for edges in edge_lists]
    smallest, largest = min(s.smallest_positive for s in spectra), max(s.largest for s in spectra)
    shifts = poles.shifts_for(smallest, largest, tolerance)
    return tuple(_kernel(tree, spectrum, shifts) for spectrum in spectra)


def _kernel(tree: EliminationTree, spectrum: Spectrum, shifts: ComplexArray) -> PoleHeatKernel:
    diagonals = np.empty((len(shifts), tree.n_vertices), dtype=complex)
    for chunk, part in inverse_diagonals(FrontEntries.of(tree, spectrum.laplacian), shifts):
        diagonals[chunk] = part
    return PoleHeatKernel.of(spectrum, shifts, diagonals)
