"""How well the scalar Laplacian of PGTI stands for the heat that pose-graph optimisation spreads.

Compared is the heat that is left at each keyframe: K_ii(t) of the scalar Laplacian, and tr K_ii(s) / d of
the block matrix H. The clocks differ, since information has units: times are matched so that the mean over
all keyframes is the same. The remaining difference is where the heat stays, and PGTI compares exactly that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.checks import finite_array, instance, shown, whole, whole_array
from pgti_gtsam.diffusion.block_laplacian import NormalEquations, checked_blocks
from pgti_gtsam.diffusion.flow import MODES_UP_TO, factorised, modes, shared
from pgti_gtsam.diffusion.grounding import components
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.spectral.laplacian import laplacian
from pgti_gtsam.spectral.poles import fit_from_zero, shifts_for

FloatArray = NDArray[np.float64]

N_TIMES = 40
CLOCK_TIMES = 400
"""Logarithmic grid on which the matched times are looked up: some twenty a decade over twenty decades."""

SAMPLED_COLUMNS = 180
"""Columns of the heat kernel that are computed where H is too large for its eigenmodes: those of 60 planar
or 30 spatial keyframes,
evenly spread over the keys. Rank correlations of 60 and 30 have standard errors of 0.13 and 0.19 around
zero, less towards one."""

SAMPLE_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proxy:
    """Heat left at keyframes: scalar Laplacian against block matrix, at matched times.

    Attributes
    ----------
    vertices : (k,) int
        The keyframes compared: all, or a sample.
    times, matched_times : (n_times,) float
        Of the scalar Laplacian, and of H.
    scalar, block : (k, n_times) float
        K_ii(t) and tr K_ii(s) / d.
    rank_correlations : (n_times,) float
        Spearman's, over the keyframes.
    differences : (k,) float
        Largest |block − scalar| / scalar of any time, by keyframe.
    """

    vertices: NDArray[np.int64]
    times: FloatArray
    matched_times: FloatArray
    scalar: FloatArray
    block: FloatArray
    rank_correlations: FloatArray
    differences: FloatArray

    @property
    def rank_correlation(self) -> float:
        """Mean over the times: 1 where the scalar Laplacian orders keyframes as H does, 0 for unrelated orders."""
        return float(self.rank_correlations.mean())

    @property
    def worst(self) -> int:
        """The keyframe with the largest difference."""
        return int(self.vertices[np.argmax(self.differences)])


def compare(equations: NormalEquations, weights: FloatArray | None = None, *, n_times: int = N_TIMES) -> Proxy:
    """Compare H with the scalar Laplacian of the graph that its blocks span.

    Parameters
    ----------
    equations : NormalEquations
        Without grounds, so that both keep their mean.
    weights : (m,) float, optional
        Of the scalar Laplacian's edges, in the order of `block_edges`; 1 when left out, as in PGTI.
    n_times : int

    Returns
    -------
    Proxy
        Correlations are 1 where fewer than two keyframes or equal signatures leave nothing to order.

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        No normal equations, another number of weights, or one below zero, or no time.
    """
    whole(n_times, "the number of times", least=1)
    n, d = instance(equations, NormalEquations, "equations").n_vertices, equations.dimension
    edges = block_edges(equations.hessian, d)
    if weights is not None and (finite_array(weights, "weights", len(edges)) < 0).any():
        raise InvalidOptionError(f"expected weights of zero or more, got {shown(weights)}")

    # how heat fades on either
    plain = sparse.csr_array(laplacian(n, edges, weights))
    vertices = chosen_vertices(n, d)
    labels = components(equations.hessian, d)
    scalar_clock, scalar_heat = _decay(plain, 1, vertices, labels)
    block_clock, block_heat = _decay(equations.hessian, d, vertices, labels)

    # at times at which as much is left
    times = _informative(scalar_clock, scalar_heat, n_times)
    matched = np.exp(
        _lookup(block_heat.mean(axis=0), np.log(block_clock), _at(scalar_clock, scalar_heat, times).mean(axis=0))
    )
    scalar, block = _at(scalar_clock, scalar_heat, times), _at(block_clock, block_heat, matched)
    return Proxy(
        vertices=vertices,
        times=times,
        matched_times=matched,
        scalar=scalar,
        block=block,
        rank_correlations=np.array([spearman(a, b) for a, b in zip(scalar.T, block.T, strict=True)]),
        differences=(np.abs(block - scalar) / scalar).max(axis=1),
    )


def chosen_vertices(n: int, dimension: int) -> NDArray[np.int64]:
    """All vertices of a small system, evenly spread vertices of a large system.

    Parameters
    ----------
    n : int
        Number of vertices.
    dimension : int
        d.
    """
    if n * dimension <= MODES_UP_TO:
        return np.arange(n)
    return np.unique(np.linspace(0, n - 1, SAMPLED_COLUMNS // dimension).round().astype(np.int64))


def block_edges(hessian: sparse.csr_array, dimension: int) -> NDArray[np.int64]:
    """Pairs i < j with a block H_ij, sorted, (m, 2).

    Parameters
    ----------
    hessian : sparse.csr_array
        H, (n d, n d).
    dimension : int
        d.
    """
    blocks = sparse.bsr_array(checked_blocks(hessian, dimension), blocksize=(dimension, dimension))
    blocks.sort_indices()
    rows = np.repeat(np.arange(len(blocks.indptr) - 1), np.diff(blocks.indptr))
    pairs = np.stack([rows, blocks.indices], axis=1).astype(np.int64)
    return pairs[(pairs[:, 0] < pairs[:, 1]) & blocks.data.any(axis=(1, 2))]


def information_weights(equations: NormalEquations) -> FloatArray:
    """D-optimality of every conductance, |det H_ij|^(1/d), (m,), in the order of `block_edges`.

    For a single between factor of a pair the weight is det(Ω)^(1/d), up to det J_r, in the body frame as in the spatial
    frame: the determinant of the adjoint map of a rigid motion is 1. Zero where the information is singular.
    """
    d = instance(equations, NormalEquations, "equations").dimension
    blocks = sparse.bsr_array(equations.hessian, blocksize=(d, d))
    blocks.sort_indices()
    rows = np.repeat(np.arange(equations.n_vertices), np.diff(blocks.indptr))
    keep = (rows < blocks.indices) & blocks.data.any(axis=(1, 2))
    return np.asarray(np.abs(np.linalg.det(blocks.data[keep])) ** (1 / d))


def spearman(first: FloatArray, second: FloatArray) -> float:
    """Rank correlation, ties shared; values that agree to nine digits are ties. 1 where both are constant.

    Parameters
    ----------
    first, second : (n,) float
    """
    first = finite_array(first, "the first series", None)
    second = finite_array(second, "the second series", len(first))
    if not len(first):
        raise InvalidOptionError("expected series of one value or more, got none")
    rounded = [np.round(x / np.abs(x).max(), 9) if np.abs(x).max() > 0 else x for x in (first, second)]
    ranks = map(
        scipy.stats.rankdata, rounded
    )  # scipy loads stats, a third of the command line's start, at its first use
    a, b = (rank - rank.mean() for rank in ranks)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else float(np.linalg.norm(a) == np.linalg.norm(b))


def heat_left(matrix: sparse.csr_array, dimension: int, vertices: NDArray[np.int64], times: FloatArray) -> FloatArray:
    """tr K_ii(t) / d of chosen vertices, (k, n_times): the mean share of a unit of heat that has not left.

    Parameters
    ----------
    matrix : sparse.csr_array
        (n d, n d).
    dimension : int
        d.
    vertices : (k,) int
    times : (n_times,) float

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        No matrix of blocks, vertices of another, or times that are not above 0.
    """
    checked_blocks(matrix, dimension)
    vertices = whole_array(vertices, "vertices")
    if vertices.ndim != 1 or not ((vertices >= 0) & (vertices < matrix.shape[0] // dimension)).all():
        raise InvalidOptionError(
            f"expected a list of vertices of 0 to {matrix.shape[0] // dimension - 1}, got {shown(vertices)}"
        )
    times = finite_array(times, "times", None)
    if not len(times) or (times <= 0).any():
        raise InvalidOptionError(f"expected times above 0, got {shown(times)}")

    # small: from all modes
    columns = (vertices[:, None] * dimension + np.arange(dimension)).ravel()
    shape = (len(vertices), dimension, len(times))
    if matrix.shape[0] <= MODES_UP_TO:
        found = modes(matrix)
        left = found.vectors[columns] ** 2 @ np.exp(-np.outer(found.eigenvalues, times))
        return np.asarray(left.reshape(shape).mean(axis=1))

    # large: from resolvents
    largest = float(abs(matrix).sum(axis=0).max())
    units = np.zeros((matrix.shape[0], len(columns)), dtype=complex)
    units[columns, np.arange(len(columns))] = 1.0
    left = np.empty((len(columns), len(times)))
    for some in shared(times, largest):
        shifts = shifts_for(1 / float(times[some].max()), largest, SAMPLE_TOLERANCE)
        fitted = fit_from_zero(shifts, times[some], largest)
        left[:, some] = fitted.constants
        for shift, weights in zip(shifts, fitted.weights, strict=True):
            solved = factorised(sparse.csc_array(matrix + shift * sparse.eye_array(matrix.shape[0]))).solve(units)
            left[:, some] += np.outer(solved[columns, np.arange(len(columns))], weights).real
    return np.asarray(left.reshape(shape).mean(axis=1))


def _decay(
    matrix: sparse.csr_array, dimension: int, vertices: NDArray[np.int64], labels: NDArray[np.int32]
) -> tuple[FloatArray, FloatArray]:
    """A grid of times from before anything moves to when all has spread, and the heat left at each, (k, n_grid)."""
    norm = float(abs(matrix).sum(axis=0).max()) or 1.0
    clock = np.geomspace(1e-3 / norm, 1e15 / norm, CLOCK_TIMES)
    heat = heat_left(matrix, dimension, vertices, clock)
    floor = (1 / np.bincount(labels)[labels[vertices]]).mean()
    spread = heat.mean(axis=0) - floor < 1e-4 * (1 - floor) if floor < 1 else np.ones(len(clock), dtype=bool)
    last = int(np.argmax(spread)) + 1 if spread.any() else len(clock)
    return clock[:last], heat[:, :last]


def _informative(clock: FloatArray, heat: FloatArray, n_times: int) -> FloatArray:
    """Times between a tenth of the heat gone and all but a hundredth of what can go: before and after all
    keyframes are alike."""
    mean = heat.mean(axis=0)
    gone = (mean[0] - mean) / max(mean[0] - mean[-1], 1e-300)
    first, last = (np.interp(level, gone, np.log(clock)) for level in (0.1, 0.99))
    return np.exp(np.linspace(first, last, n_times))


def _lookup(falling: FloatArray, grid: FloatArray, wanted: FloatArray) -> FloatArray:
    return np.interp(-wanted, np.maximum.accumulate(-falling), grid)


def _at(clock: FloatArray, heat: FloatArray, times: FloatArray) -> FloatArray:
    """Heat at other times, from the grid by linear interpolation over log t."""
    return np.array([np.interp(np.log(times), np.log(clock), row) for row in heat])
