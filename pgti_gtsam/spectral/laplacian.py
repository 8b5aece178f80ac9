"""Graph Laplacians and connected components of undirected graphs given as edge arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph


def adjacency(
    n_vertices: int, edges: NDArray[np.int64], weights: NDArray[np.float64] | None = None
) -> sparse.csc_array:
    """Symmetric adjacency matrix W, W_ij = w_ij for every edge.

    Parameters
    ----------
    n_vertices : int
    edges : (m, 2) int
        Pairs of distinct vertices; an edge that is listed twice counts twice.
    weights : (m,) float, optional
        Positive weights; 1 everywhere when left out.

    Returns
    -------
    (n, n) sparse matrix
    """
    w = np.ones(len(edges)) if weights is None else np.asarray(weights, dtype=float)
    i, j = np.asarray(edges, dtype=np.int64).reshape(-1, 2).T
    rows, columns, entries = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([w, w])
    return sparse.coo_array((entries, (rows, columns)), shape=(n_vertices, n_vertices)).tocsc()


def laplacian(
    n_vertices: int, edges: NDArray[np.int64], weights: NDArray[np.float64] | None = None
) -> sparse.csc_array:
    """Combinatorial Laplacian L = D − W (section 3.3 of the paper takes unit weights).

    Parameters
    ----------
    n_vertices, edges, weights
        As for `adjacency`, with the same errors.

    Returns
    -------
    (n, n) sparse matrix, symmetric, positive semidefinite, with rows that sum to zero.
    """
    w = adjacency(n_vertices, edges, weights)
    return sparse.csc_array(sparse.diags_array(w.sum(axis=0)) - w)


def connected_components(n_vertices: int, edges: NDArray[np.int64]) -> tuple[int, NDArray[np.int32]]:
    """Number of connected components, and the component of every vertex, (n,).

    The dimension of the Laplacian's null space is the number of components, counted without a tolerance.

    Parameters
    ----------
    n_vertices : int
    edges : (m, 2) int
    """
    count, labels = csgraph.connected_components(adjacency(n_vertices, edges), directed=False)
    return int(count), labels
