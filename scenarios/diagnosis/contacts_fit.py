"""Real contacts told from chance: the fit behind `pgti_gtsam.diagnosis.meeting.CONTACT`.

Maps of odometry alone, of training seeds, with drift of two kinds: the simulator's walk and heading bias, several
times as large or small, and a scale that shrinks along the drive, as a single camera's does. Of each contact that
nothing explains the truth says whether the contact is real; a logistic regression says so from the map's own numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import Any, NamedTuple

import gtsam
import numpy as np
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from scipy.special import expit, logit

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.diagnosis.contacts import Contacts
from pgti_gtsam.drift.model import drift_model
from pgti_gtsam.drift.own_closures import own_closures
from pgti_gtsam.integrity import assess
from scenarios.diagnosis import sparse
from scenarios.diagnosis.courses import Course, course
from scenarios.diagnosis.stretches import is_real
from scenarios.worlds.solid import Array

WALKS = (0.5, 1.0, 2.0, 3.0)
"""Errors of odometry in the simulator's own."""

SHRINKS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Logarithms of the scale that a drive loses from its start to its end, without any other error."""


EDGES = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.01)
"""Bounds between which probabilities are compared with shares."""


class Trial(NamedTuple):
    """A world, a seed, and the drift of the odometry: `walk` or `scale`, and how much."""

    world: str
    seed: int
    drift: str
    amount: float


def trials(worlds: Sequence[str], seeds: Sequence[int]) -> Iterator[Trial]:
    """Every drift of every drive.

    Parameters
    ----------
    worlds : sequence of str
    seeds : sequence of int
    """
    drifts = [*product(["walk"], WALKS), *product(["scale"], SHRINKS)]
    for seed, world, (kind, amount) in product(seeds, worlds, drifts):
        yield Trial(world, seed, kind, amount)


def row(trial: Trial) -> dict[str, Any]:
    """The contacts of a map: the share of `meeting_share`, and whether the contact is real."""
    driven = drifting(trial)
    graph, values = sparse.odometry(driven), sparse.values(driven.chained(), driven)
    pose_graph = from_gtsam(graph, values, radii=dict(enumerate(driven.radii.tolist())))
    model = drift_model(graph, values, pose_graph)
    found = Contacts.of(pose_graph, assess(pose_graph), model, own_closures(model))
    places = np.array([pose.translation() for pose in driven.truth])
    gaps = cdist(places, places) / (driven.radii[:, None] + driven.radii)
    contacts = [[found.share(each), is_real(gaps, each.stretches)] for each in found.collisions]
    return trial._asdict() | {"contacts": contacts}


def drifting(trial: Trial) -> Course:
    """A drive whose odometry errs as the trial says."""
    if trial.drift == "walk":
        return course(trial.world, trial.seed, trial.amount)
    driven = course(trial.world, trial.seed)
    true = [one.between(other) for one, other in pairwise(driven.truth)]
    lengths = np.array([np.linalg.norm(step.translation()) for step in true])
    way = np.concatenate([[0.0], np.cumsum(lengths)])
    scales = np.exp(-trial.amount * way[:-1] / way[-1])
    steps = [gtsam.Pose3(step.rotation(), s * step.translation()) for step, s in zip(true, scales, strict=True)]
    return dataclasses.replace(driven, steps=steps)


def fitted(rows: Sequence[dict[str, Any]]) -> Array:
    """Coefficients of `CONTACT`, (2,), by maximum likelihood over all contacts that some tie leads to."""
    terms, real = _terms(rows)
    return np.asarray(minimize(lambda c: _misfit(terms @ c, real), np.zeros(2)).x)


def report(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The fit, and how often contacts are real by the probability of the fit."""
    coefficients = fitted(rows)
    yield f"log odds = {coefficients[0]:.2f} + {coefficients[1]:.2f} logit q\n"
    yield "| probability | " + " | ".join(f"{kind}: contacts | real" for kind in ("walk", "scale", "all")) + " |"
    yield "|" + "---|" * 7
    groups = [[row for row in rows if row["drift"] in kinds] for kinds in (("walk",), ("scale",), ("walk", "scale"))]
    told = [(expit(terms @ coefficients), real) for terms, real in map(_terms, groups)]
    for low, high in pairwise(EDGES):
        cells = []
        for probability, real in told:
            inside = (probability >= low) & (probability < high)
            cells += [str(inside.sum()), f"{100 * real[inside].mean():.0f} %" if inside.any() else "–"]
        yield f"| {low:g} to {min(high, 1.0):g} | " + " | ".join(cells) + " |"


def _terms(rows: Sequence[dict[str, Any]]) -> tuple[Array, Array]:
    """1 and logit q of every contact, and whether the contact is real."""
    found = np.array([contact for row in rows for contact in row["contacts"]], dtype=float).reshape(-1, 2)
    found = found[np.isfinite(found[:, 0])]
    return np.column_stack([np.ones(len(found)), logit(found[:, 0])]), found[:, 1]


def _misfit(log_odds: Array, real: Array) -> float:
    """Minus the logarithm of the likelihood."""
    return float((np.logaddexp(0.0, log_odds) - real * log_odds).sum())
