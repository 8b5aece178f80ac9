"""The heat kernel's diagonal at every vertex of a graph, by dense eigendecomposition.

With L = Φ diag(λ) Φᵀ the heat kernel is K(t) = exp(−tL), and K_ii(t) = Σ_k exp(−λ_k t) φ_k(i)²: the heat
that is left after the time t at the vertex that got a unit of heat. A graph falls into connected components,
between which no heat flows; each has exactly one eigenvalue zero, with a constant eigenvector.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pgti_gtsam.spectral.laplacian import connected_components, laplacian


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Component:
    """Positive spectrum of a connected component: vertices, λ_k, and φ_k(i)²."""

    vertices: NDArray[np.int64]
    eigenvalues: NDArray[np.float64]
    squared_vectors: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DenseHeatKernel:
    """Heat kernel from the full eigendecomposition of every connected component.

    Costs O(n³) time and O(n²) memory in the largest component. Attributes are those of `heat_kernel.HeatKernel`.
    """

    n_vertices: int
    components: tuple[_Component, ...]
    smallest_positive: float
    largest: float
    error_estimate: float = 0.0

    @property
    def n_components(self) -> int:
        """Number of connected components."""
        return len(self.components)

    def diagonals(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """K_ii(t), the zero mode kept: (n, n_times)."""
        kernel = np.empty((self.n_vertices, len(times)))
        for part in self.components:
            decay = np.exp(-np.outer(part.eigenvalues, times))
            kernel[part.vertices] = 1 / len(part.vertices) + part.squared_vectors @ decay
        return kernel

    def signatures(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Eq. 4: (n, n_times).

        Exponents are shifted by the smallest positive eigenvalue in numerator and denominator, so
        that the ratio survives times at which either alone would underflow.
        """
        scaled, total = np.zeros((self.n_vertices, len(times))), np.zeros(len(times))
        for part in self.components:
            decay = np.exp(-np.outer(part.eigenvalues - self.smallest_positive, times))
            scaled[part.vertices] = part.squared_vectors @ decay
            total += decay.sum(axis=0)
        return scaled / np.where(total > 0, total, 1.0)


def dense_heat_kernel(n_vertices: int, edges: NDArray[np.int64]) -> DenseHeatKernel:
    """Decompose the Laplacian of an unweighted graph, component by component.

    The smallest eigenvalue of each component is left out: that is the component's zero, which
    is a matter of counting and needs no tolerance.

    Parameters
    ----------
    n_vertices : int
    edges : (m, 2) int
        Distinct pairs of distinct vertices.
    """
    count, labels = connected_components(n_vertices, edges)
    matrix = laplacian(n_vertices, edges).tocsr()
    order = np.argsort(labels, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(labels, minlength=count))[:-1])
    components = []
    for vertices in members:
        block = matrix[vertices][:, vertices].toarray()
        eigenvalues, vectors = linalg.eigh(block, driver="evd", overwrite_a=True, check_finite=False)
        components.append(
            _Component(vertices=vertices, eigenvalues=eigenvalues[1:], squared_vectors=vectors[:, 1:] ** 2)
        )
    positive = np.concatenate([part.eigenvalues for part in components])
    return DenseHeatKernel(
        n_vertices=n_vertices,
        components=tuple(components),
        smallest_positive=float(positive.min()) if len(positive) else 1.0,
        largest=float(positive.max()) if len(positive) else 1.0,
    )
