"""The heat kernel's diagonal at every vertex: the answer of a solver, and the choice of the solver.

K(t) = exp(−tL) is the heat kernel of a graph with Laplacian L; K_ii(t) is the heat that is left after the
time t at the vertex that got a unit of heat. `dense_kernel` decomposes L, `pole_kernel` sums resolvents of sparse
factorisations; both agree to the tolerance of the latter.
"""

from __future__ import annotations

import logging
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph

from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.spectral.dense_kernel import dense_heat_kernel
from pgti_gtsam.spectral.elimination_tree import EliminationTree, analyse
from pgti_gtsam.spectral.laplacian import adjacency
from pgti_gtsam.spectral.pole_kernel import pole_kernels

Method = Literal["auto", "dense", "poles"]

_LOG = logging.getLogger(__name__)

ALWAYS_DENSE = 500
"""Vertices up to which dense wins whatever the graph, or loses by a few hundredths of a second."""

AFFORDABLY_DENSE = 4000
"""Vertices up to which a glance decides: beyond, a dense decomposition would cost more than any look at the fill."""

FULL = 0.1
"""Share of all pairs from which a graph's factor fills whatever the order: not worth a symbolic factorisation."""

TOLERANCE = 1e-8
"""Error of signatures relative to the largest, where nobody asks for another."""


class HeatKernel(Protocol):
    """The answer of a solver: the kernel's diagonal at any times, and the spectrum's two ends.

    Attributes
    ----------
    n_components : int
        Number of connected components: the number of eigenvalues zero.
    smallest_positive, largest : float
        Ends of the positive spectrum; 1 for a graph without an edge.
    error_estimate : float
        Estimated error relative to the largest entry; zero for the dense solver.
    """

    @property
    def n_components(self) -> int: ...  # noqa: D102

    @property
    def smallest_positive(self) -> float: ...  # noqa: D102

    @property
    def largest(self) -> float: ...  # noqa: D102

    @property
    def error_estimate(self) -> float: ...  # noqa: D102

    def diagonals(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """K_ii(t), the zero mode kept: (n, n_times), for times in [0, ∞)."""
        ...

    def signatures(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scaled heat kernel signatures ψ̃_i(t) of Eq. 4: (n, n_times), exactly zero at isolated vertices."""
        ...


def heat_kernels(
    n_vertices: int, *edge_lists: NDArray[np.int64], method: Method = "auto", tolerance: float = TOLERANCE
) -> tuple[HeatKernel, ...]:
    """Heat kernels of several graphs on the same vertices.

    Parameters
    ----------
    n_vertices : int
    *edge_lists : (m, 2) int
        Distinct pairs of distinct vertices.
    method : {"auto", "dense", "poles"}
        The solver; "auto" takes the solver with the smaller estimated time.
    tolerance : float
        Error relative to the largest signature that "poles" may make, from 1e-11 to 1e-2.

    Raises
    ------
    InvalidOptionError
    """
    if method not in ("auto", "dense", "poles"):
        raise InvalidOptionError(f"expected method auto, dense or poles, got {method!r}")
    by_poles = method == "poles" or (method == "auto" and _poles_are_faster(n_vertices, np.concatenate(edge_lists)))
    _LOG.debug("heat kernels of %d vertices by %s", n_vertices, "poles" if by_poles else "dense eigenvectors")
    if by_poles:
        return pole_kernels(n_vertices, edge_lists, tolerance)
    return tuple(dense_heat_kernel(n_vertices, edges) for edges in edge_lists)


def _poles_are_faster(n: int, edges: NDArray[np.int64]) -> bool:
    """Estimate both times from the graph's fill: large for an expander, small for a track."""
    if n <= ALWAYS_DENSE or len(edges) > FULL * n**2 / 2:
        return False
    if n <= AFFORDABLY_DENSE and _widest_level(n, edges) > n / 4:
        return False
    return _pole_seconds(analyse(n, edges)) < 4.5e-10 * n**3 + 1.5e-7 * n**2


def _widest_level(n: int, edges: NDArray[np.int64]) -> int:
    """Most vertices that are equally many hops from the first: some hundreds of a random graph, few of a track."""
    matrix: Any = adjacency(n, edges)
    hops = csgraph.dijkstra(matrix, unweighted=True, indices=np.array([0]))[0]
    return int(np.bincount(hops[np.isfinite(hops)].astype(np.int64)).max())


def _pole_seconds(tree: EliminationTree) -> float:
    """Seconds for two graphs and twenty poles, fitted beside the dense estimate on one core of one machine.

    Chains, laps and random graphs of 50 to 1600 vertices were timed; only the ratio of the two estimates matters.
    """
    fronts = tree.fronts.astype(float)
    return 0.02 + 1.9e-3 * tree.n_supernodes + 4e-8 * float((tree.widths * fronts**2).sum())
