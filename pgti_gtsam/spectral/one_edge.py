"""Signatures of a connected graph plus one edge, for many edges in turn.

With y = (L + zI)⁻¹ (e_i − e_j) an inserted edge ij lowers diag (L + zI)⁻¹ by y ∘ y / (1 + y_i − y_j), and the trace by
yᵀy / (1 + y_i − y_j) (`low_rank`). One sweep over the factors gives y for many edges. The weights that turn resolvents
into heat kernels are the same for all edges: an inserted edge lowers no eigenvalue and raises none by more than two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.spectral import poles
from pgti_gtsam.spectral.low_rank import SpectralState, incidence
from pgti_gtsam.spectral.selected_inverse import solve

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]

CHUNK_ENTRIES = 4_000_000
"""Complex numbers y held at once: 64 MB."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OneMoreEdge:
    """A connected graph at given times, ready for any single inserted edge.

    Attributes
    ----------
    state : SpectralState
    weights : (n_poles, n_times) complex
        Of the exponentials exp(−t(λ − λ₂)) of the graph without an inserted edge.
    parts : (n, n_times) float
        Positive part of the kernel's diagonal without an inserted edge, scaled likewise.
    totals : (n_times,) float
    """

    state: SpectralState
    weights: ComplexArray
    parts: FloatArray
    totals: FloatArray

    @classmethod
    def of(cls, n_vertices: int, edges: IntArray, times: FloatArray, tolerance: float) -> OneMoreEdge:
        """Factorise a connected graph.

        Parameters
        ----------
        n_vertices : int
        edges : (m, 2) int
        times : (n_times,) float
            At most `poles.LATEST` over the smallest positive eigenvalue.
        tolerance : float
            As for `pole_kernels`.
        """
        state = SpectralState.of(n_vertices, edges, tolerance)
        kernel = state.kernel
        fit = poles.fit(kernel.shifts, times, kernel.smallest_positive, kernel.largest + 2)
        resolvents = state.diagonals - 1 / np.outer(kernel.shifts, np.full(n_vertices, n_vertices))
        parts = (resolvents.T @ fit.weights).real + (1 - 1 / n_vertices) * fit.constants
        return cls(state=state, weights=fit.weights, parts=parts, totals=parts.sum(axis=0))

    def signatures(self, inserted: IntArray, vertices: IntArray) -> Iterator[FloatArray]:
        """Scaled signatures at some vertices with each edge in turn: (n_vertices, n_times) for every edge.

        Parameters
        ----------
        inserted : (k, 2) int
            Pairs of distinct vertices.
        vertices : (n_vertices,) int
            Vertices whose signatures are returned.
        """
        n_poles = len(self.weights)
        chunk = max(1, CHUNK_ENTRIES // (n_poles * self.state.tree.n_vertices))
        rows = self.state.tree.positions[vertices]
        for start in range(0, len(inserted), chunk):
            ends = self.state.tree.positions[inserted[start : start + chunk]]
            y = self._columns(ends)
            k = np.arange(len(ends))
            capacitance = 1 + y[:, ends[:, 0], k] - y[:, ends[:, 1], k]
            trace_drops = np.einsum("pnk,pnk->pk", y, y) / capacitance
            drops = y[:, rows] ** 2 / capacitance[:, None]
            for each in k:
                part = self.parts[vertices] - (drops[:, :, each].T @ self.weights).real
                yield part / (self.totals - (trace_drops[:, each] @ self.weights).real)

    def _columns(self, ends: IntArray) -> ComplexArray:
        """y for edges between rows of the factor: (n_poles, n, k)."""
        columns = incidence(self.state.tree.n_vertices, ends)
        return np.concatenate([solve(factor, columns) for factor in self.state.factors])
