"""D-, T-, E- and Ẽ-optimality of a graph, the criteria that the paper's section 6.2 compares PGTI with."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.dense_kernel import DenseHeatKernel
from pgti_gtsam.spectral.heat_kernel import HeatKernel
from pgti_gtsam.spectral.laplacian import connected_components, laplacian
from pgti_gtsam.spectral.spectrum import extreme_eigenvalues, log_pseudo_determinant
from pgti_gtsam.support_graph import SupportGraph

CRITERIA = ("d", "t", "e", "e_tilde")


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimality:
    """Optimality criteria of a graph with n vertices.

    Attributes
    ----------
    d : float
        (n × number of spanning trees)^(1/n): geometric mean of the spectrum; zero if disconnected.
    t : float
        Mean degree: arithmetic mean of the spectrum.
    e : float
        Algebraic connectivity λ_2; zero if disconnected.
    e_tilde : float
        Largest eigenvalue λ_n.

    References
    ----------
    Placed and Castellanos, A General Relationship Between Optimality Criteria and Connectivity
    Indices for Active Graph-SLAM, IEEE Transactions on Robotics 2023, https://arxiv.org/abs/2110.01289
    """

    d: float
    t: float
    e: float
    e_tilde: float


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphOptimality:
    """Criteria of the pose graph, of the merged graph, and |merged − pose graph| of each."""

    pose_graph: Optimality
    merged_graph: Optimality

    @property
    def change(self) -> Optimality:
        """Absolute difference of each criterion: ΔD-opt and so on of section 6.2."""
        before, after = asdict(self.pose_graph), asdict(self.merged_graph)
        return Optimality(**{name: abs(after[name] - before[name]) for name in CRITERIA})


@dataclass(frozen=True, slots=True, kw_only=True)
class OptimalityComparison:
    """Criteria of the unweighted Laplacians, and of the Laplacians weighted by the edges' information.

    Attributes
    ----------
    unweighted : GraphOptimality
    weighted : GraphOptimality, optional
        Each criterion of the Laplacian whose edge weights are the same criterion of the edges'
        information matrices. Edges without information (covisibility, free space) weigh the median of the
        other edges. None if no edge has information.
    """

    unweighted: GraphOptimality
    weighted: GraphOptimality | None

    @property
    def pose_graph(self) -> Optimality:
        """Criteria of the pose graph's unweighted Laplacian."""
        return self.unweighted.pose_graph

    @property
    def merged_graph(self) -> Optimality:
        """Criteria of the merged graph's unweighted Laplacian."""
        return self.unweighted.merged_graph

    @property
    def change(self) -> Optimality:
        """Absolute change of the unweighted criteria."""
        return self.unweighted.change


def optimality(
    n_vertices: int,
    edges: NDArray[np.int64],
    weights: NDArray[np.float64] | None = None,
    kernel: HeatKernel | None = None,
) -> Optimality:
    """Criteria of a graph.

    Parameters
    ----------
    n_vertices : int
    edges : (m, 2) int
    weights : (m, 4) float, optional
        Positive weights of every edge for D, T, E and Ẽ in turn; 1 everywhere when left out.
    kernel : HeatKernel, optional
        Of the graph without weights, where the kernel is already known.

    Returns
    -------
    Optimality
        A single vertex has an empty spectrum: all four are zero.
    """
    # one Laplacian for each criterion
    if n_vertices < 2:
        return Optimality(d=0.0, t=0.0, e=0.0, e_tilde=0.0)
    count, labels = connected_components(n_vertices, edges)
    if weights is None:
        matrices = [laplacian(n_vertices, edges)] * 4
    else:
        matrices = [laplacian(n_vertices, edges, column) for column in weights.T]

    # ends of the spectra, and the product of the eigenvalues
    if kernel is not None:
        smallest, largest = kernel.smallest_positive, kernel.largest
    else:
        smallest, largest = extreme_eigenvalues(matrices[2], labels)
        if weights is not None:
            largest = extreme_eigenvalues(matrices[3], labels)[1]
    if isinstance(kernel, DenseHeatKernel):
        log_determinant = sum(float(np.log(part.eigenvalues).sum()) for part in kernel.components)
    else:
        log_determinant = log_pseudo_determinant(matrices[0], labels)
    return Optimality(
        d=float(np.exp(log_determinant / n_vertices)) if count == 1 else 0.0,
        t=float(matrices[1].trace() / n_vertices),
        e=smallest if count == 1 else 0.0,
        e_tilde=largest if len(edges) else 0.0,
    )


def information_criteria(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """D, T, E and Ẽ of information matrices: the means and ends of their spectra.

    Parameters
    ----------
    information : (m, d, d) float
        NaN beyond the leading block of a smaller matrix, and everywhere for an edge without a matrix.

    Returns
    -------
    (m, 4) float
        NaN without a matrix, or where the matrix is not positive definite.
    """
    sizes = (~np.isnan(np.einsum("kii->ki", information))).sum(axis=1)
    criteria = np.full((len(information), 4), np.nan)
    for size in np.unique(sizes[sizes > 0]):
        rows = np.flatnonzero(sizes == size)
        spectra = np.linalg.eigvalsh(information[rows, :size, :size])
        rows, spectra = rows[spectra[:, 0] > 0], spectra[spectra[:, 0] > 0]
        geometric_mean = np.exp(np.log(spectra).mean(axis=1))
        criteria[rows] = np.stack([geometric_mean, spectra.mean(axis=1), spectra[:, 0], spectra[:, -1]], axis=1)
    return criteria


def compare_optimality(
    pose_graph: PoseGraph, support: SupportGraph, kernels: tuple[HeatKernel, HeatKernel] | None = None
) -> OptimalityComparison:
    """Criteria of a pose graph and of its merged graph, unweighted and by information.

    Parameters
    ----------
    pose_graph, support
    kernels : pair of HeatKernel, optional
        Kernels of the two graphs, where already known.

    """
    n = len(pose_graph)
    known = kernels or (None, None)
    unweighted = GraphOptimality(
        pose_graph=optimality(n, pose_graph.edges, kernel=known[0]),
        merged_graph=optimality(n, support.merged_edges, kernel=known[1]),
    )
    return OptimalityComparison(unweighted=unweighted, weighted=_compare_weighted(pose_graph, support, unweighted))


def _compare_weighted(
    pose_graph: PoseGraph, support: SupportGraph, unweighted: GraphOptimality
) -> GraphOptimality | None:
    if pose_graph.edge_information is None:
        return None
    own = information_criteria(pose_graph.edge_information)
    known = ~np.isnan(own).any(axis=1)
    if not known.any():
        return None
    typical = np.median(own[known], axis=0)
    own[~known] = typical
    n = len(pose_graph)
    if (own == typical).all():
        return GraphOptimality(
            pose_graph=_scaled(unweighted.pose_graph, typical, n),
            merged_graph=_scaled(unweighted.merged_graph, typical, n),
        )
    edges = np.concatenate([pose_graph.edges, support.inserted_edges])
    weights = np.concatenate([own, np.broadcast_to(typical, (len(support.inserted_edges), 4))])
    return GraphOptimality(pose_graph=optimality(n, pose_graph.edges, own), merged_graph=optimality(n, edges, weights))


def _scaled(plain: Optimality, weights: NDArray[np.float64], n: int) -> Optimality:
    """Criteria when all edges weigh the same: the weight scales all n − 1 positive eigenvalues."""
    d, t, e, e_tilde = weights.tolist()
    return Optimality(d=plain.d * d ** ((n - 1) / n), t=plain.t * t, e=plain.e * e, e_tilde=plain.e_tilde * e_tilde)
