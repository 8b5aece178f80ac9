"""All metrics of section 6.2 at a size of a growing graph."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.integrity import checked_measure, relative_distortion, stable_scores, time_grid
from pgti_gtsam.optimality import GraphOptimality, optimality
from pgti_gtsam.replaying.growth import Stage
from pgti_gtsam.spectral.heat_kernel import TOLERANCE, Method, heat_kernels

METRICS = {
    "score": "Λ",
    "local": "Λ_loc",
    "global_": "Λ_glob",
    "mean_score": "Z̄",
    "stable_score": "stable score",
    "d": "ΔD",
    "t": "ΔT",
    "e": "ΔE",
    "e_tilde": "ΔẼ",
}
"""The fields of a moment that are metrics, and what the paper calls them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """How a graph is measured; the fields are options of `assess`."""

    beta: float = 0.5
    n_times: int = 100
    norm: int = 2
    method: Method = "auto"
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        checked_measure(self.beta, self.n_times, self.norm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moment:
    """The metrics when a graph had so many keyframes. Arrays are read-only.

    Attributes
    ----------
    n_keyframes : int
    score, local, global_ : float
        Λ, and Λ_loc and Λ_glob at the keyframe that Λ is of.
    mean_score, stable_score : float
        Z̄; the largest stable score.
    d, t, e, e_tilde : float
        ΔD, ΔT, ΔE and ΔẼ: absolute change of each optimality criterion from G_p to G_m.
    n_edges, n_inserted, n_collisions : int
        Edges of G_p, inserted edges, and inserted edges that nothing explains.
    n_new : int
        Inserted edges since the moment before; the paper's edge-insertion signal is whether there are any.
    worst : int
        Index of the keyframe with the largest ζ.
    keyframe_scores : (n_keyframes,) float32
        ζ of every keyframe; single precision suffices to draw.
    positions : (n_keyframes, 3) float32, m
    """

    n_keyframes: int
    score: float
    local: float
    global_: float
    mean_score: float
    stable_score: float
    d: float
    t: float
    e: float
    e_tilde: float
    n_edges: int
    n_inserted: int
    n_collisions: int
    n_new: int
    worst: int
    keyframe_scores: NDArray[np.float32]
    positions: NDArray[np.float32]

    def __post_init__(self) -> None:
        self.keyframe_scores.flags.writeable = False
        self.positions.flags.writeable = False


def measured(stage: Stage, measure: Measure) -> Moment:
    """Measure a stage; where no edge is inserted both graphs are the same, and every change is zero.

    Parameters
    ----------
    stage : Stage
    measure : Measure
    """
    scores, metrics = _metrics(stage, measure) if len(stage.inserted_edges) else (np.zeros(stage.n_keyframes), _NOTHING)
    return Moment(
        n_keyframes=stage.n_keyframes,
        **metrics,
        n_edges=len(stage.edges),
        n_inserted=len(stage.inserted_edges),
        n_collisions=stage.n_collisions,
        n_new=stage.n_new,
        worst=int(np.argmax(scores)),
        keyframe_scores=scores.astype(np.float32),
        positions=stage.positions.astype(np.float32),
    )


_NOTHING = dict.fromkeys(METRICS, 0.0)


def _metrics(stage: Stage, measure: Measure) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """ζ of every keyframe, and the metrics by name."""
    n, merged = stage.n_keyframes, np.concatenate([stage.edges, stage.inserted_edges])
    before, after = heat_kernels(n, stage.edges, merged, method=measure.method, tolerance=measure.tolerance)

    # ζ over all times, and at the worst keyframe over either part
    times = time_grid(after, measure.n_times)
    signatures_p, signatures_m = before.signatures(times), after.signatures(times)
    scores = relative_distortion(signatures_p, signatures_m, measure.norm)
    worst = [int(np.argmax(scores))]
    n_local = min(max(round(measure.beta * measure.n_times), 1), measure.n_times - 1)
    local, far = (
        float(relative_distortion(signatures_p[worst, part], signatures_m[worst, part], measure.norm)[0])
        for part in (slice(n_local), slice(n_local, None))
    )

    # the optimality criteria
    optimality_p, optimality_m = optimality(n, stage.edges, kernel=before), optimality(n, merged, kernel=after)
    change = GraphOptimality(pose_graph=optimality_p, merged_graph=optimality_m).change
    return scores, {
        "score": float(scores.max()),
        "local": local,
        "global_": far,
        "mean_score": float(scores.mean()),
        "stable_score": float(stable_scores(before, after).max()),
        **asdict(change),
    }
