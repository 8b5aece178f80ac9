"""Whether a radius that collapses says more than drift and rise do: landmarks of the other pass inside free spheres.

A closure brings the landmarks of one pass near the keyframes of the other. Where some of them lie inside a sphere that
was free, either the map is bent or the closure is false. The revisits are those of `rise_fit`: training seeds, in time
order, and in doubt by the drift. What the loss is worth is the log likelihood of a logistic regression, each seed told
by a fit of all the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

import pgti_gtsam as pgti
from pgti_gtsam.drift.settled import settle
from pgti_gtsam.gate.admission import DOUBT
from pgti_gtsam.gate.reference_map import ReferenceMap
from scenarios import measures, worlds
from scenarios.evidence.rise_fit import arrivals, tied_rise
from scenarios.problem import space
from scenarios.worlds import Drive
from scenarios.worlds.solid import Array

RIDGE = 0.1
"""Weight of the squares of coefficients: true and false that no line parts badly have no likeliest one."""

BINS = (0.0, 0.1, 0.3, 0.6, 1.01)
"""Losses between which the shares of true revisits are told."""


class Trial(NamedTuple):
    """A world and a seed."""

    world: str
    seed: int


def row(trial: Trial) -> dict[str, Any]:
    """Of every revisit in doubt: the drift's log odds, the rise, the loss of radius, and whether the revisit is true.

    Parameters
    ----------
    trial : Trial
    """
    driven, gate = worlds.drive(trial.world, trial.seed), pgti.LoopClosureGate()
    found = []
    for arrival in arrivals(worlds.problem(trial.world, trial.seed), gate):
        drift = gate.judge(arrival.reference, arrival.closures).decisions[0].terms["drift"].log_odds
        if abs(drift) <= DOUBT:
            rise, loss = (measure(arrival.reference, arrival.closures) for measure in (tied_rise, _loss_on(driven)))
            found.append([drift, rise, loss, 2 * sum(arrival.true) > len(arrival.true)])
    return trial._asdict() | {"revisits": found}


def _loss_on(driven: Drive) -> Any:
    """Largest loss of a drive's radii when some closures are tied, as a function of a map and closures."""

    def loss(reference: ReferenceMap, closures: Sequence[gtsam.NonlinearFactorGraph]) -> float:
        offered, _ = reference.offered(closures)
        tied = settle(offered.model, np.ones(len(offered.active), dtype=bool), offered)
        level = offered.model.units.levelling.inverse()
        poses = [space(pose.compose(level)) for pose in tied.poses]
        pairs = offered.model.ties.pairs[reference.n_ties :].tolist()
        ends = [end for i, j in pairs for end in ((i, j), (j, i))]
        return max(lost(poses[a], driven.radii[a], poses[b], driven.landmarks[b]) for a, b in ends)

    return loss


def lost(here: gtsam.Pose3, radius_m: float, there: gtsam.Pose3, landmarks: Array) -> float:
    """Share of a keyframe's radius that another keyframe's landmarks take, 0 to 1.

    Parameters
    ----------
    here : gtsam.Pose3
    radius_m : float
        Before.
    there : gtsam.Pose3
        Of the keyframe that saw the landmarks.
    landmarks : (k, 3) float
        m, from there.
    """
    away = landmarks @ there.rotation().matrix().T + there.translation() - here.translation()
    nearest = float(np.linalg.norm(away, axis=1).min(initial=np.inf))
    return 1.0 - min(nearest / radius_m, 1.0)


def likelihood(features: Array, true: NDArray[np.bool_], groups: NDArray[np.int64]) -> float:
    """Mean log likelihood of truths, each group told by a logistic regression of all the others.

    Parameters
    ----------
    features : (n, k) float
    true : (n,) bool
    groups : (n,) int
    """
    columns = np.column_stack([np.ones(len(true)), features])
    told = np.empty(len(true))
    for group in np.unique(groups):
        own = groups == group
        told[own] = columns[own] @ regression(columns[~own], true[~own])
    return float((true * told - np.logaddexp(0.0, told)).mean())


def regression(columns: Array, true: NDArray[np.bool_]) -> Array:
    """Coefficients of a logistic regression, (k,).

    Parameters
    ----------
    columns : (n, k) float
        The first is one.
    true : (n,) bool
    """

    def misfit(c: Array) -> tuple[float, Array]:
        odds, penalty = columns @ c, RIDGE * np.concatenate([[0.0], c[1:]])
        value = (np.logaddexp(0.0, odds) - true * odds).sum() + 0.5 * penalty @ c
        return float(value), columns.T @ (expit(odds) - true) + penalty

    return np.asarray(minimize(misfit, np.zeros(columns.shape[1]), jac=True).x)


def report(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Likelihoods with and without the loss, and the revisits that are true by their loss.

    Parameters
    ----------
    rows : sequence of mapping
        As of `row`.
    """
    own = np.array([each for row in rows for each in row["revisits"]], dtype=float).reshape(-1, 4)
    groups = np.repeat([row["seed"] for row in rows], [len(row["revisits"]) for row in rows])
    true = own[:, 3] > 0
    yield f"of {len(own)} revisits in doubt {int(true.sum())} are true\n"
    yield "| evidence | area under the curve | mean log likelihood, held-out seeds |\n|---|---|---|"
    chosen = {"drift": [0], "drift, rise": [0, 1], "drift, loss": [0, 2], "drift, rise, loss": [0, 1, 2]}
    for name, columns in chosen.items():
        told = np.column_stack([np.ones(len(own)), own[:, columns]])
        area = measures.area_under_curve(true, told @ regression(told, true))
        yield f"| {name} | {area:.3f} | {likelihood(own[:, columns], true, groups):.3f} |"
    yield f"| loss alone | {measures.area_under_curve(true, -own[:, 2]):.3f} | – |"
    yield "\n| loss of radius | revisits | true |\n|---|---|---|"
    for low, high in pairwise(BINS):
        inside = (own[:, 2] >= low) & (own[:, 2] < high)
        yield f"| {low:g} to {min(high, 1):g} | {inside.sum()} | {true[inside].sum()} |"
