"""How far and how fast the perturbation of a keyframe spreads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from pgti_gtsam.checks import finite_array, instance, pairs, shown, whole
from pgti_gtsam.diffusion.block_laplacian import NormalEquations
from pgti_gtsam.diffusion.flow import exponential
from pgti_gtsam.diffusion.proxy import block_edges
from pgti_gtsam.errors import InvalidOptionError

FloatArray = NDArray[np.float64]

TRANSLATION = {3: np.array([0, 1]), 6: np.array([3, 4, 5]), 7: np.array([3, 4, 5])}
"""Coordinates of the translation in the tangent spaces of Pose2, Pose3 and Similarity3."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """The response of every keyframe to unit perturbations of a keyframe.

    Attributes
    ----------
    vertex : int
    times : (n_times,) float
    amplitudes : (n_times, n) float
        Shift of every keyframe for a unit shift of the vertex, root mean square over directions: 1 at the vertex
        at time zero.
    hops : (n,) float
        Edges between the vertex and every other; infinite without a path.
    """

    vertex: int
    times: FloatArray
    amplitudes: FloatArray
    hops: FloatArray

    def arrivals(self) -> FloatArray:
        """When half of its largest response has reached every keyframe, (n,); infinite where nothing comes
        within the times."""
        peak = self.amplitudes.max(axis=0)
        reached = self.amplitudes >= 0.5 * peak
        first = self.times[reached.argmax(axis=0)]
        return np.where((peak > 1e-12) & (self.hops > 0), first, np.where(self.hops == 0, 0.0, np.inf))

    def by_hops(self) -> tuple[FloatArray, FloatArray]:
        """Distances in hops, and the median arrival time at each."""
        arrivals = self.arrivals()
        known = np.isfinite(self.hops) & (self.hops > 0) & np.isfinite(arrivals)
        distances = np.unique(self.hops[known])
        return distances, np.array([np.median(arrivals[known & (self.hops == hop)]) for hop in distances])

    def exponent(self) -> float:
        """p of arrival ~ hops^p, by least squares over logarithms from the second hop on; NaN with fewer
        than two distances.

        Heat on a chain has 2. Bending, in which an elastic beam spreads, has 4.
        """
        distances, arrivals = self.by_hops()
        far = (distances >= 2) & (arrivals > self.times[0]) & (arrivals < self.times[-1])
        if far.sum() < 2:
            return float("nan")
        return float(np.polyfit(np.log(distances[far]), np.log(arrivals[far]), 1)[0])


def spread(equations: NormalEquations, vertex: int, times: FloatArray) -> Spread:
    """Follow a unit shift of a keyframe, residuals left out.

    Shifts alone are followed, as rotations have another unit. A scalar Laplacian has one coordinate.

    Parameters
    ----------
    equations : NormalEquations
        Grounded or not.
    vertex : int
    times : (n_times,) float
        Ascending.

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        No normal equations, no vertex of theirs, or times that are not ascending numbers of zero or more.
    """
    n, d = instance(equations, NormalEquations, "equations").n_vertices, equations.dimension
    whole(vertex, "a vertex", least=0, most=n - 1)
    times = finite_array(times, "times", None)
    if not len(times) or times[0] < 0 or (np.diff(times) <= 0).any():
        raise InvalidOptionError(f"expected ascending times of zero or more, got {shown(times)}")

    # shifts along each axis
    shifts = TRANSLATION.get(d, np.arange(d))
    k = len(shifts)
    units = np.zeros((n * d, k))
    units[vertex * d + shifts, np.arange(k)] = 1.0

    # how they spread
    response = exponential(equations.hessian, units, times).reshape(len(times), n, d, k)[:, :, shifts]
    return Spread(
        vertex=vertex,
        times=times,
        amplitudes=np.linalg.norm(response, axis=(2, 3)) / np.sqrt(k),
        hops=hops_from(vertex, n, block_edges(equations.hessian, d)),
    )


def hops_from(vertex: int, n_vertices: int, edges: NDArray[np.int64]) -> FloatArray:
    """Edges on the shortest way from a vertex to every other, (n,); infinite without a way.

    Parameters
    ----------
    vertex : int
    n_vertices : int
    edges : (m, 2) int

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        No vertices, or edges between others.
    """
    n = whole(n_vertices, "the number of vertices", least=1)
    whole(vertex, "a vertex", least=0, most=n - 1)
    ends = pairs(edges, n, "vertices")
    matrix = sparse.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n)).tocsr()
    hops: FloatArray = csgraph.shortest_path(matrix, directed=False, unweighted=True, indices=vertex)
    return hops
