"""Whether the sensors confirm a tie, and the measurement of a confirmed tie.

Constants are chosen on pairs of the scan logs `fr079` and `aces` and of ray-cast worlds (seeds 1000 and 1001), whose
submaps drift and whose predictions are off by 0.3 to 3 ρ, and checked on pairs of another log and of other seeds:
`scenarios.mend.fits` counts the fits that are confirmed, of true ones and of others.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from pgti_gtsam.drift.ties import OFFSET, OFFSET_RAD
from pgti_gtsam.drift.units import translation_of, variances_of
from pgti_gtsam.factor_graphs import BETWEEN, between_factor
from pgti_gtsam.gate.decision import metres
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.mending.alignment import FIT, Alignment, lengths
from pgti_gtsam.mending.common_view import AGREES
from pgti_gtsam.mending.records import Outcome, Wanted

CONTRADICTS = 0.8
"""Agreement below which they refuse the fit: one point in five lies where the other keyframe saw free space."""

SEEN = 0.1
"""Least share of points that both keyframes see."""

RIVAL = 0.8
"""Share of points, in those of the best fit, that a fit elsewhere must see to be as good."""

FREE = 1e-9
"""Stiffness of motions that are free, but for rounding."""

HELD = 2 * OFFSET
"""Standard deviation of the prediction, in ρ, along a free motion up to which a fit is of use all the same where the
audit asks for a tie. Elsewhere the map is tied already, and the gate takes every tie for one that holds all motions."""

BEYOND = 0.999
"""Probability with which a true fit lies within the region that the drift leaves, widened by what a match errs."""

Array = NDArray[np.float64]


def sensors_say(wanted: Wanted, alignment: Alignment | None, unit_m: float) -> tuple[Outcome, str]:
    """Whether the sensors confirm a fit, and why or why not.

    Parameters
    ----------
    wanted : Wanted
    alignment : Alignment, optional
        None where nothing was aligned.
    unit_m : float
        The free radius ρ, m.
    """
    if alignment is None:
        return "undecided", "Nothing in the two clouds lies near enough to match."
    view, rival = alignment.view, alignment.rival

    # what each says of the other's points
    seen = f"{100 * view.seen:.0f} % of the points are seen by both"
    through = (
        f"The best fit puts {100 * (1 - view.agreement):.0f} % of the points where the other keyframe saw free space."
    )
    if view.agreement < CONTRADICTS:
        return "refused", through
    if view.seen < SEEN:
        return "undecided", f"The two have little in view in common: {seen}."
    if view.agreement < AGREES:
        return "undecided", through

    # whether the fit is the only one, and where the drift lets it be
    if rival is not None and rival.weight > RIVAL * view.weight:
        return "undecided", f"A fit elsewhere is as good: {seen} here, {100 * rival.seen:.0f} % there."
    moved_m, is_beyond = _off(wanted, alignment, unit_m)
    if is_beyond:
        allowed = f"{metres(moved_m)} from where the drift model predicts it, give or take {metres(wanted.allowance_m)}"
        return "refused", f"The best fit lies {allowed}."
    free_m = free_allowance_m(wanted, alignment, unit_m)
    if free_m > (0.0 if wanted.place is None else HELD * unit_m):
        return "undecided", f"Blank walls: the fit may slide, and the drift allows {metres(free_m)} that way."
    return "confirmed", f"The views agree in {100 * view.agreement:.0f} % of what both must see; {seen}."


def free_allowance_m(wanted: Wanted, alignment: Alignment, unit_m: float) -> float:
    """Standard deviation of the prediction along motions that no surface holds, m; 0 where all are held.

    Parameters
    ----------
    wanted : Wanted
    alignment : Alignment
    unit_m : float
        The free radius ρ, m.
    """
    squares, axes = np.linalg.eigh(alignment.stiffness)
    free = axes[:, squares < FREE]
    if not free.shape[1]:
        return 0.0
    scale = lengths(len(squares), unit_m)
    spread = free.T @ (wanted.covariance / np.outer(scale, scale)) @ free
    return float(np.sqrt(np.linalg.eigvalsh(spread)[-1]) * unit_m)


def _off(wanted: Wanted, alignment: Alignment, unit_m: float) -> tuple[float, bool]:
    """How far a fit lies from the prediction, m, and whether that is beyond the region."""
    off = np.asarray(type(wanted.pose).Logmap(wanted.pose.between(alignment.pose)))
    is_planar = len(off) == 3
    spread = wanted.covariance + np.diag(variances_of(OFFSET * unit_m, OFFSET_RAD, is_planar=is_planar))
    square = float(off @ np.linalg.solve(spread, off))
    return float(np.linalg.norm(off[translation_of(is_planar)])), square > float(chdtri(len(off), 1 - BEYOND))


def tie(wanted: Wanted, alignment: Alignment, unit_m: float, sigma_unit: float) -> Any:
    """The between factor of a fit: as certain as its surfaces allow, without information along motions that no surface
    fixes.

    Parameters
    ----------
    wanted, alignment, unit_m
        The fit.
    sigma_unit : float
        The caller's number for a standard deviation of 1: see `sigma_unit`.
    """
    squares, axes = np.linalg.eigh(alignment.stiffness)
    roots = np.sqrt(np.maximum(squares, 0.0)) / (FIT * sigma_unit)
    root = roots[:, None] * axes.T / lengths(len(squares), unit_m)
    return between_factor(*wanted.keys, alignment.pose, gtsam.noiseModel.Gaussian.SqrtInformation(root, False))


def sigma_unit(graph: gtsam.NonlinearFactorGraph, reference: ReferenceMap) -> float:
    """Factor by which a caller's standard deviations are larger than lengths are, at least 1.

    The drift model grants a step of the odometry the error of a poor odometer. A caller who grants more than that tells
    sigmas in a unit of his own, and a fit needs the same unit, or fits would outweigh odometry that is better.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    reference : ReferenceMap
    """
    pose_graph, ties = reference.pose_graph, reference.settled.model.ties
    own = translation_of(reference.settled.model.units.is_planar)
    granted = {
        (i, j): variances[own].mean()
        for (i, j), variances, drift in zip(ties.pairs.tolist(), ties.variances, ties.drifts, strict=True)
        if drift > 0
    }
    ratios = []
    for (i, j), slots in zip(pose_graph.edges.tolist(), pose_graph.edge_slots, strict=True):
        factor = graph.at(slots[0]) if slots and (i, j) in granted else None
        if isinstance(factor, BETWEEN):
            model = factor.noiseModel()
            gaussian: Any = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
            squares = np.diag(np.linalg.pinv(np.asarray(gaussian.information())))
            ratios.append(
                squares[own if len(squares) == len(ties.variances[0]) else slice(0, 2)].mean() / granted[i, j]
            )
    return max(1.0, float(np.sqrt(np.median(ratios)))) if ratios else 1.0
