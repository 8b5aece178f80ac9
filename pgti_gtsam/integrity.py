"""Topological integrity of a pose graph: ζ, Z, Λ and the β-split (section 5 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.checks import real, shown, whole
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError
from pgti_gtsam.optimality import OptimalityComparison, compare_optimality
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.heat_kernel import TOLERANCE, HeatKernel, Method, heat_kernels
from pgti_gtsam.support_graph import SupportGraph, support_graph

STABLE_TIMES = np.geomspace(0.5, 2000.0, 40)
"""Fixed times of the stable score, in units of the unweighted Laplacian's time.

Along an odometry chain heat spreads √(2t) keyframes in the time t. At 0.5 that is to the next keyframe,
so shorter times tell nothing; at 2000 it is some sixty, where a repeated pass, a corner or a room shows.
Longer times would ask how large the map is, and the score is meant not to. Forty logarithmic steps
resolve a signature that varies over decades.
"""

N_TIMES, NORM = 100, 2
"""Number of times in the paper's grid, and p of its Eq. 17."""


MAX_TIMES = 100_000
"""Times beyond which only the memory changes: signatures are smooth, and the paper has 100."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BetaSplit:
    """Scores over the short and the long part of the time grid (section 6.3.1).

    Attributes
    ----------
    beta : float
        Share of the grid that counts as local.
    local, global_ : float
        Λ_loc and Λ_glob: ζ over each part at the keyframe where the ζ of the whole grid is largest.
    max_local, max_global : float
        Largest ζ over each part at any keyframe.
    keyframe_locals, keyframe_globals : (n,) float
        ζ of every keyframe over each part.
    """

    beta: float
    local: float
    global_: float
    max_local: float
    max_global: float
    keyframe_locals: NDArray[np.float64]
    keyframe_globals: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Distortion:
    """How differently heat spreads on two graphs; the second has all edges of the first. Arrays are read-only.

    Attributes
    ----------
    keyframe_scores : (n,) float
        Z: ζ of every keyframe (Eq. 17). Zero where both graphs agree; infinite at a keyframe without any
        edge in the first graph and an edge in the second, since the change is infinite.
    stable_scores : (n,) float
        Score that does not shrink as the map grows: see `stable_scores`.
    times : (n_times,) float
        τ, common to both graphs.
    signatures_pose_graph, signatures_merged_graph : (n, n_times) float
        Ψ_i(τ) of every keyframe in the first and in the second graph (Eq. 3).
    norm : int
        p of Eq. 17.
    beta : float
        Share at which `split` divides the time grid when not told.
    n_components_pose_graph, n_components_merged_graph : int
        Connected components of the first and of the second graph.
    error_estimate : float
        Estimated error of the signatures relative to the largest signature; zero where the signatures come from a
        dense eigendecomposition.
    """

    keyframe_scores: NDArray[np.float64]
    stable_scores: NDArray[np.float64]
    times: NDArray[np.float64]
    signatures_pose_graph: NDArray[np.float64]
    signatures_merged_graph: NDArray[np.float64]
    norm: int
    beta: float
    n_components_pose_graph: int
    n_components_merged_graph: int
    error_estimate: float

    def __post_init__(self) -> None:
        for name in ("keyframe_scores", "stable_scores", "times"):
            getattr(self, name).flags.writeable = False
        self.signatures_pose_graph.flags.writeable = False
        self.signatures_merged_graph.flags.writeable = False

    @property
    def score(self) -> float:
        """Λ: the largest ζ (Eq. 18)."""
        return float(self.keyframe_scores[self.worst])

    @property
    def mean_score(self) -> float:
        """Z̄: the mean ζ."""
        return float(self.keyframe_scores.mean())

    @property
    def worst(self) -> int:
        """Index of the keyframe with the largest ζ; the first of equals."""
        return int(np.argmax(self.keyframe_scores))

    @property
    def stable_score(self) -> float:
        """Largest stable score of any keyframe."""
        return float(self.stable_scores.max())

    def scale(self, keyframe: int) -> Literal["local", "global"]:
        """The half of the time grid in which the keyframe's ζ is larger."""
        before, after = (
            each[keyframe : keyframe + 1] for each in (self.signatures_pose_graph, self.signatures_merged_graph)
        )
        early, late = (
            relative_distortion(before[:, part], after[:, part], self.norm)[0] for part in _halves(len(self.times))
        )
        return "global" if late > early else "local"

    def split(self, beta: float | None = None) -> BetaSplit:
        """Local and global part of the score (Eq. 19 and section 6.3.1).

        Parameters
        ----------
        beta : float, optional
            Share of the time grid that is local, in (0, 1); the share given to `assess` when left out.

        Raises
        ------
        InvalidOptionError
            β outside (0, 1).
        """
        share = self.beta if beta is None else _checked_beta(beta)
        local, far = (
            relative_distortion(self.signatures_pose_graph[:, part], self.signatures_merged_graph[:, part], self.norm)
            for part in _local_and_global(len(self.times), share)
        )
        return BetaSplit(
            beta=share,
            local=float(local[self.worst]),
            global_=float(far[self.worst]),
            max_local=float(local.max()),
            max_global=float(far.max()),
            keyframe_locals=local,
            keyframe_globals=far,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Integrity(Distortion):
    """The result of `assess`: the pose graph G_p against the merged graph G_m, and the same in two steps.

    Attributes
    ----------
    free_space_edges, inserted_edges, merged_edges : (k, 2) int
        E_f, E_m \\ E_p and E_m.
    fusion_edges, collision_edges : (k, 2) int
        The inserted edges in two sets: overlaps that follow from the edges of G_p, and overlaps that nothing explains
        (see `support_graph.explained_overlaps`).
    fusion : Distortion
        G_p against the explained graph G_e: incomplete loop fusion, mostly harmless.
    collisions : Distortion
        G_e against G_m: places in contact that no chain of overlaps joins. Zero on a map without any.
    optimality : OptimalityComparison
        D-, T-, E- and Ẽ-optimality of G_p and G_m.
    """

    free_space_edges: NDArray[np.int64]
    inserted_edges: NDArray[np.int64]
    merged_edges: NDArray[np.int64]
    fusion_edges: NDArray[np.int64]
    collision_edges: NDArray[np.int64]
    fusion: Distortion
    collisions: Distortion
    optimality: OptimalityComparison


def assess(
    pose_graph: PoseGraph,
    *,
    beta: float = 0.5,
    n_times: int = N_TIMES,
    norm: int = NORM,
    method: Method = "auto",
    tolerance: float = TOLERANCE,
) -> Integrity:
    """Score how far a pose graph disagrees with the free space that was seen (section 5).

    Parameters
    ----------
    pose_graph : PoseGraph
    beta : float
        Share of the time grid that counts as local, in (0, 1).
    n_times : int
        Number of times in the grid, two or more.
    norm : {1, 2}
        p of Eq. 17.
    method : {"auto", "dense", "poles"}
        Dense eigendecomposition, or resolvents of sparse factorisations in nearly linear time; "auto"
        takes the faster solver.
    tolerance : float
        Error relative to the largest signature that "poles" may make, from 1e-11 to 1e-2.

    Returns
    -------
    Integrity
        A single keyframe, or a keyframe that both graphs leave isolated, scores zero.

    Raises
    ------
    InvalidOptionError
        An option outside its range.

    References
    ----------
    Xie et al., PGTI: Pose-Graph Topological Integrity for Map Quality Assessment in SLAM, Robotics
    2025, 14(12), 189, https://doi.org/10.3390/robotics14120189
    """
    if not isinstance(pose_graph, PoseGraph):
        raise InvalidGraphError(f"expected a PoseGraph, got {shown(pose_graph)}; from_gtsam makes one")
    checked_measure(beta, n_times, norm)

    # the graphs, and how heat spreads on each (sections 5.1 and 3.3)
    support: SupportGraph = support_graph(pose_graph)
    kernel_p, kernel_e, kernel_m = _kernels(pose_graph, support, method, tolerance)

    # what differs (section 5.2)
    whole, fusion, collisions = (
        _distortion(before, after, n_times=n_times, norm=norm, beta=beta)
        for before, after in ((kernel_p, kernel_m), (kernel_p, kernel_e), (kernel_e, kernel_m))
    )
    return Integrity(
        **{each.name: getattr(whole, each.name) for each in fields(Distortion)},
        free_space_edges=support.free_space_edges,
        inserted_edges=support.inserted_edges,
        merged_edges=support.merged_edges,
        fusion_edges=support.fusion_edges,
        collision_edges=support.collision_edges,
        fusion=fusion,
        collisions=collisions,
        optimality=compare_optimality(pose_graph, support, (kernel_p, kernel_m)),
    )


def _kernels(
    pose_graph: PoseGraph, support: SupportGraph, method: Method, tolerance: float
) -> tuple[HeatKernel, HeatKernel, HeatKernel]:
    """Heat kernels of G_p, G_e and G_m; equal graphs share a kernel."""
    edge_lists = [pose_graph.edges, support.merged_edges]
    if len(support.fusion_edges) and len(support.collision_edges):
        edge_lists.insert(1, support.explained_edges)
    kernels = heat_kernels(len(pose_graph), *edge_lists, method=method, tolerance=tolerance)
    if len(kernels) == 3:
        return kernels[0], kernels[1], kernels[2]
    return kernels[0], kernels[0 if len(support.collision_edges) else 1], kernels[1]


def _distortion(before: HeatKernel, after: HeatKernel, *, n_times: int, norm: int, beta: float) -> Distortion:
    """A graph against a graph with more edges, on the time grid of the second."""
    times = time_grid(after, n_times)
    signatures_p, signatures_m = before.signatures(times), after.signatures(times)
    return Distortion(
        keyframe_scores=relative_distortion(signatures_p, signatures_m, norm),
        stable_scores=stable_scores(before, after),
        times=times,
        signatures_pose_graph=signatures_p,
        signatures_merged_graph=signatures_m,
        norm=norm,
        beta=beta,
        n_components_pose_graph=before.n_components,
        n_components_merged_graph=after.n_components,
        error_estimate=max(before.error_estimate, after.error_estimate),
    )


def scores(before: HeatKernel, after: HeatKernel, *, beta: float) -> tuple[float, float]:
    """Λ and Λ_glob of two graphs alone, as `assess` has them with the paper's number of times and norm.

    Parameters
    ----------
    before, after : HeatKernel
        Heat kernels of the two graphs.
    beta : float
        Share of the times that is local.
    """
    times = time_grid(after, N_TIMES)
    first, second = before.signatures(times), after.signatures(times)
    zeta = relative_distortion(first, second, NORM)
    worst = int(np.argmax(zeta))
    _, far = _local_and_global(N_TIMES, beta)
    return float(zeta[worst]), float(relative_distortion(first[[worst], far], second[[worst], far], NORM)[0])


def _local_and_global(n_times: int, beta: float) -> tuple[slice, slice]:
    """The two parts of a time grid, each of one time at least."""
    n_local = min(max(round(beta * n_times), 1), n_times - 1)
    return slice(n_local), slice(n_local, None)


def _halves(n_times: int) -> tuple[slice, slice]:
    """The early and the late half of a time grid."""
    return slice(n_times // 2), slice(n_times // 2, None)


def time_grid(kernel: HeatKernel, n_times: int) -> NDArray[np.float64]:
    """Logarithmic times from 4 ln 10 / λ_max to 4 ln 10 / λ_2 (section 5.2), of the merged graph.

    λ_2 is the smallest positive eigenvalue where the graph is disconnected.

    Parameters
    ----------
    kernel : HeatKernel
    n_times : int
    """
    span = 4 * np.log(10)
    return np.geomspace(span / kernel.largest, span / kernel.smallest_positive, n_times)


def relative_distortion(
    signatures_p: NDArray[np.float64], signatures_m: NDArray[np.float64], norm: int
) -> NDArray[np.float64]:
    """ζ_i = ‖Ψ_i(G_p) − Ψ_i(G_m)‖_p / ‖Ψ_i(G_p)‖_p (Eq. 17), (n,).

    Where the pose graph's signature vanishes, ζ is zero if the other does too, else infinite.

    Parameters
    ----------
    signatures_p, signatures_m : (n, n_times) float
    norm : int
        The p of the p-norm.
    """
    change = np.linalg.norm(signatures_p - signatures_m, ord=norm, axis=1)
    size = np.linalg.norm(signatures_p, ord=norm, axis=1)
    return np.asarray(np.divide(change, size, out=np.where(change > 0, np.inf, 0.0), where=size > 0))


def stable_scores(
    kernel_p: HeatKernel, kernel_m: HeatKernel, times: NDArray[np.float64] = STABLE_TIMES
) -> NDArray[np.float64]:
    """Score of every keyframe that does not shrink as the map grows, (n,).

    σ_i = √ mean_t ((K_ii^p(t) − K_ii^m(t)) / K_ii^p(t))², over fixed times and with the heat kernel itself: no
    division by the trace, no time that depends on the map's extent, and the zero mode kept, so that
    K_ii is at least 1 over the size of the map and nothing is divided by zero. In a time t heat
    comes from a few √t hops around, so parts of the map farther away change σ_i by less than the Gaussian tail of
    that walk: a defect keeps its score however the other end of the map is extended.
    The score answers the open question of the paper's section 7, with an exception: an end of the track reflects heat,
    and where a map grows at an end within reach of the defect, σ_i moves once, by a third or so, and stays. The reach
    is some sixty keyframes along bare odometry, and √(k (k + 1) (2k + 1) / 6) times as many where every keyframe is
    tied to the next k. (The ratio of resistances between the ends of an inserted edge keeps to a hundredth at any
    end, as a way that ends carries no current, but is no keyframe's score: `scenarios/paper/growth.py` measures both.)

    Parameters
    ----------
    kernel_p, kernel_m : HeatKernel
    times : (n_times,) float, optional
    """
    before, after = kernel_p.diagonals(times), kernel_m.diagonals(times)
    scores: NDArray[np.float64] = np.sqrt(np.mean(((before - after) / before) ** 2, axis=1))
    return scores


def checked_measure(beta: float, n_times: int, norm: int) -> None:
    """Refuse options that `assess` cannot measure with; raises InvalidOptionError.

    Parameters
    ----------
    beta : float
        Share of the times that is local, in (0, 1).
    n_times : int
        At least 2.
    norm : int
        The p of the p-norm.
    """
    _checked_beta(beta)
    if whole(n_times, "n_times", least=2) > MAX_TIMES:
        raise InvalidOptionError(f"expected n_times up to {MAX_TIMES}, got {n_times}")
    if norm not in (1, 2):
        raise InvalidOptionError(f"expected norm 1 or 2, got {shown(norm)}")


def _checked_beta(beta: float) -> float:
    if not 0 < real(beta, "beta") < 1:
        raise InvalidOptionError(f"expected beta between 0 and 1, got {beta}")
    return beta
