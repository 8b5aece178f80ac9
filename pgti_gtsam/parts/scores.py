"""Stable scores of a map in parts, with a bound of the changes that the rest of the map may make.

ζ divides by the heat of the whole map and asks for times in which heat crosses the map: no part can know either. The
stable score does neither (`integrity.stable_scores`). Over the shorter times a wide part knows the score: heat that
leaves the part is lost, in both graphs alike, and `spectral.locality.kernel_within` bounds the heat that would have
come back.
"""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.integrity import STABLE_TIMES
from pgti_gtsam.parts.cut import EdgeList, Indices, stepped
from pgti_gtsam.spectral.laplacian import adjacency
from pgti_gtsam.spectral.locality import KernelWithin, kernel_within

WIDER = 1.0
"""Keyframes around a core that its scores are computed with, in parts of the core: as many again."""

TIMES = STABLE_TIMES[STABLE_TIMES <= 10.0]
"""Times of the stable score that a part can tell. Along a chain heat spreads four keyframes in 10, where the whole
score goes on to sixty; in streets that are passed three times by spheres that reach three keyframes, it spreads thirty.
There (20 000 keyframes of `python -m scenarios city` in four parts) nine in ten bounds are below 1e-4 and the worst is
0.05; at times up to 20 and 50 nine in ten are below 0.001 and 0.08, and the worst tell nothing."""

GRAPHS = ("pose graph", "explained graph", "merged graph")
COMPARED = ((0, 2), (0, 1), (1, 2))
"""G_p with G_m, G_p with G_e, G_e with G_m."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """A core and the keyframes around, in three graphs.

    Attributes
    ----------
    vertices : (m,) int
        Keyframes, ascending.
    is_core : (m,) bool
    edges : three arrays (k, 2) int
        Of G_p, of G_e beyond those, and of G_m beyond those, as places in `vertices`.
    degrees : (3, m) int
        Of the keyframes in G_p, G_e and G_m of the whole map.
    """

    vertices: Indices
    is_core: NDArray[np.bool_]
    edges: tuple[Indices, Indices, Indices]
    degrees: Indices


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoreScores:
    """Scores of a core's keyframes, for each of `COMPARED`: (3, c) each.

    Attributes
    ----------
    scores, bounds : float
        Stable scores, and the most by which the whole map's may differ.
    late : bool
        Whether the later half of the times makes the larger part.
    n_vertices : int
        Keyframes that the scores were computed with.
    seconds, peak_mb : float
        Time, and peak memory of the process.
    """

    scores: Array
    bounds: Array
    late: NDArray[np.bool_]
    n_vertices: int
    seconds: float
    peak_mb: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalScores:
    """One graph against another, keyframe by keyframe, as far as a part of the map can tell.

    Attributes
    ----------
    stable_scores : (n,) float
    bounds : (n,) float
        Most by which the whole map's may differ.
    late : (n,) bool
    """

    stable_scores: Array
    bounds: Array
    late: NDArray[np.bool_]

    @property
    def keyframe_scores(self) -> Array:
        """ζ, unknown to every part of a map: NaN, (n,)."""
        return np.full(len(self.stable_scores), np.nan)

    def scale(self, keyframe: int) -> Literal["local", "global"]:
        """The half of the times that makes the larger part of the stable score."""
        return "global" if self.late[keyframe] else "local"


def surroundings(
    core: Indices, lists: tuple[EdgeList, EdgeList, EdgeList], tied: sparse.csc_array, degrees: Indices
) -> Surroundings:
    """A core and the keyframes that are fewest hops away in G_m.

    Parameters
    ----------
    core : (c,) int
        Keyframes, ascending.
    lists : three EdgeList
        As `Surroundings.edges`, of the whole map.
    tied : (n, n) sparse
        Adjacency of G_m.
    degrees : (3, n) int
        As `Surroundings.degrees`, of the whole map.
    """
    seen, ring = np.zeros(tied.shape[0], dtype=bool), core
    seen[core] = True
    wanted, count = (1 + WIDER) * len(core), len(core)
    while len(ring) and count < wanted:
        ring = np.unique(stepped(tied, ring))
        ring = ring[~seen[ring]]
        seen[ring] = True
        count += len(ring)
    vertices = np.flatnonzero(seen)
    edges = [own.within(vertices)[1] for own in lists]
    return Surroundings(
        vertices=vertices,
        is_core=np.isin(vertices, core, assume_unique=True),
        edges=(edges[0], edges[1], edges[2]),
        degrees=degrees[:, vertices],
    )


def core_scores(own: Surroundings) -> CoreScores:
    """Stable scores of a core, and the bounds."""
    # the heat kernels; graphs that are the same share theirs
    started, kernels = time.monotonic(), list[KernelWithin]()
    for k in range(len(GRAPHS)):
        is_same = k > 0 and not len(own.edges[k]) and np.array_equal(own.degrees[k], own.degrees[k - 1])
        kernels.append(kernels[-1] if is_same else kernel_within(_block(own, k), TIMES))

    # what differs, in the core
    core = own.is_core
    found = [_compared(kernels[a], kernels[b], core) for a, b in COMPARED]
    scores, bounds, late = (np.stack(each) for each in zip(*found, strict=True))
    return CoreScores(
        scores=scores,
        bounds=bounds,
        late=late,
        n_vertices=len(core),
        seconds=time.monotonic() - started,
        peak_mb=peak_mb(),
    )


def peak_mb() -> float:
    """Peak memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _block(own: Surroundings, k: int) -> sparse.csc_array:
    """Rows and columns of the keyframes in the Laplacian of the k-th graph of the whole map."""
    within = adjacency(len(own.vertices), np.concatenate(own.edges[: k + 1]))
    return sparse.csc_array(sparse.diags_array(own.degrees[k].astype(float)) - within)


def _compared(
    before: KernelWithin, after: KernelWithin, core: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Stable score, bound, and whether late times make most of it, of the core's keyframes."""
    low_p, high_p, low_m, high_m = (each[core] for each in (before.diagonal, before.most, after.diagonal, after.most))
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.nan_to_num(1 - low_m / low_p)
        ends = np.stack([1 - high_m / low_p, 1 - low_m / high_p])
    most = np.nan_to_num(np.abs(ends), nan=np.inf).max(axis=0)
    least = np.where(np.prod(np.sign(np.nan_to_num(ends)), axis=0) > 0, np.abs(ends).min(axis=0), 0.0)

    # over all times
    score, low, high = (np.sqrt(np.mean(each**2, axis=1)) for each in (change, least, most))
    half = change.shape[1] // 2
    late = np.mean(change[:, half:] ** 2, axis=1) > np.mean(change[:, :half] ** 2, axis=1)
    return score, np.maximum(high - score, score - low), late
