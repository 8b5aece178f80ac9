"""The evidence in a rise of the score at touching free space: the fit behind `pgti_gtsam.gate.terms.contact_rise.RISE`.

Ray-cast worlds of training seeds, as many false closures as true closures. Each revisit is asked in time order, onto a
map that ties all earlier true closures. Where the drift leaves doubt, the revisit is tied and the rise is measured. The
log odds of the rise, added to the drift's, are linear, as likely as possible with most true revisits still accepted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import Any, NamedTuple

import gtsam
import numpy as np
from scipy.special import expit, logit

import pgti_gtsam as pgti
from pgti_gtsam.drift.settled import settle
from pgti_gtsam.factor_graphs import checked_closure
from pgti_gtsam.gate.admission import DOUBT
from pgti_gtsam.gate.candidate_map import CandidateMaps
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.terms.contact_rise import RISE, local_rise
from scenarios import worlds
from scenarios.aliasing import methods
from scenarios.problem import Problem
from scenarios.worlds.solid import Array

ACCEPTED, PASS = logit(pgti.GateOptions().min_probability), 0.95
"""Log odds from which the gate accepts, and the share of true revisits in doubt that must."""

GRID = (np.arange(-60, 31) / 10, np.arange(-80, 1) / 10)
"""Of intercepts and slopes."""

BINS = (0.0, 0.05, 0.2, 0.5, 1.0, np.inf)
"""Rises between which the shares of true revisits are told."""


class Trial(NamedTuple):
    """A world and a seed."""

    world: str
    seed: int


def row(trial: Trial) -> dict[str, Any]:
    """Of every revisit in doubt: the drift's log odds, the rise, and whether the revisit is true."""
    given, gate = worlds.problem(trial.world, trial.seed), pgti.LoopClosureGate()
    found = []
    for arrival in arrivals(given, gate):
        drift = gate.judge(arrival.reference, arrival.closures).decisions[0].terms["drift"].log_odds
        if abs(drift) <= DOUBT:
            is_true = 2 * sum(arrival.true) > len(arrival.true)
            found.append([drift, tied_rise(arrival.reference, arrival.closures), is_true])
    return trial._asdict() | {"revisits": found}


class Arrival(NamedTuple):
    """A map that ties all true closures before a revisit, the revisit's closures, and the truth on each."""

    reference: ReferenceMap
    closures: list[gtsam.NonlinearFactorGraph]
    true: list[bool]


def arrivals(given: Problem, gate: pgti.LoopClosureGate) -> Iterator[Arrival]:
    """Revisits in time order: closures of a revisit that agree, by the last of them.

    Parameters
    ----------
    given : Problem
    gate : pgti.LoopClosureGate
    """
    offered = [checked_closure(closure, given.values) for closure in given.closures]
    bare = gate.reference_map(given.graph, given.values, given.radii)
    parties = [ties - bare.n_ties for ties in bare.revisits(bare.offered(offered)[0])]
    tied, reference = np.zeros(len(offered), dtype=bool), bare
    for party in sorted(parties, key=lambda party: int(party.max())):
        before = given.true & (np.arange(len(offered)) < party.min())
        if (before != tied).any():
            tied, reference = before, gate.reference_map(methods.joined(given, before), given.values, given.radii)
        yield Arrival(reference, [offered[k] for k in party.tolist()], given.true[party].tolist())


def tied_rise(reference: ReferenceMap, closures: Sequence[gtsam.NonlinearFactorGraph]) -> float:
    """Rise of the worst keyframe's score when some closures are tied.

    Parameters
    ----------
    reference : ReferenceMap
    closures : sequence of gtsam.NonlinearFactorGraph
        Of a revisit.
    """
    offered, _ = reference.offered(closures)
    tied = settle(offered.model, np.ones(len(offered.active), dtype=bool), offered)
    maps = CandidateMaps(reference=reference, offered=offered)
    return local_rise(reference.contacts, maps.contacts(tied))[0].rise


def fitted(revisits: Array) -> Array:
    """Coefficients of `RISE`, (2,): the most likely of a grid, of (k, 3) revisits as from `row`.

    The most likely coefficients leave a third of the true revisits undecided, and a gate that waits for more evidence
    then ties too little to ever get more. So a share `PASS` of the true revisits has to be accepted.
    """
    found = max(product(*GRID), key=lambda c: _merit(np.array(c), revisits))
    return np.array(found)


def _merit(coefficients: Array, revisits: Array) -> float:
    """Log likelihood; minus infinity where too few true revisits pass."""
    odds, true = told(coefficients, revisits), revisits[:, 2]
    if (odds[true > 0] > ACCEPTED).mean() < PASS:
        return -np.inf
    return float((true * odds - np.logaddexp(0.0, odds)).sum())


def told(coefficients: Array, revisits: Array) -> Array:
    """Log odds of revisits by both kinds of evidence, (k,).

    Parameters
    ----------
    coefficients : (2,) float
    revisits : (k, 3) float
    """
    return np.asarray(revisits[:, 0] + coefficients[0] + coefficients[1] * np.maximum(revisits[:, 1], 0.0))


def report(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The fit, and the number of true revisits by rise."""
    own = gathered(rows)
    fit, is_true = fitted(own), own[:, 2] > 0
    yield f"of {len(own)} revisits {int(is_true.sum())} are true\n"
    yield "| log odds | true accepted | false accepted | true rejected | mean log likelihood |\n|---|---|---|---|---|"
    for coefficients in (np.array(RISE), fit):
        odds = told(coefficients, own)
        accepted, rejected = odds > ACCEPTED, odds < -ACCEPTED
        counts = [int(both.sum()) for both in (accepted & is_true, accepted & ~is_true, rejected & is_true)]
        likelihood = (is_true * odds - np.logaddexp(0.0, odds)).mean()
        name = "drift {:+.1f} {:+.1f} rise".format(*coefficients)
        yield f"| {name} | " + " | ".join(map(str, counts)) + f" | {likelihood:.3f} |"
    yield "\n| rise | revisits | true | true by the drift alone | by both |\n|---|---|---|---|---|"
    rises = np.maximum(own[:, 1], 0.0)
    for low, high in pairwise(BINS):
        inside = (rises >= low) & (rises < high)
        expected = [float(expit(odds[inside]).sum()) for odds in (own[:, 0], told(fit, own))]
        cells = [inside.sum(), is_true[inside].sum(), *(f"{count:.1f}" for count in expected)]
        yield f"| {low:g} to {high:g} | " + " | ".join(map(str, cells)) + " |"


def gathered(rows: Sequence[dict[str, Any]]) -> Array:
    """Revisits of all rows, (k, 3)."""
    return np.array([each for found in rows for each in found["revisits"]], dtype=float).reshape(-1, 3)
