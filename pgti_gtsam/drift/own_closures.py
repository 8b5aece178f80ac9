"""A finished map's own closures, each judged against all the others by the drift model.

False closures that agree support each other, and many false closures bend the whole map. So the worst are taken out,
the rest is looked at again, and closures that fit the rest after all are admitted again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, expit

from pgti_gtsam.drift.left_out import left_out, left_out_together
from pgti_gtsam.drift.log_odds import log_odds, log_odds_together
from pgti_gtsam.drift.model import DriftModel
from pgti_gtsam.drift.settled import Settled, settle, solvable
from pgti_gtsam.drift.ties import OFFSET, OFFSET_RAD
from pgti_gtsam.drift.units import Units
from pgti_gtsam.places import neighbourhoods

PRIOR = float(np.log(19))
"""Log odds before looking that a closure of a finished map is true: 95 %."""

POOREST = 10.0
"""Most by which the odometry's variance may exceed the model's. Of nine well-known graphs eight stay far below the
model; MIT, whose wheels slip, exceeds it by 8."""

TOGETHER = 8
"""Most closures of a revisit that are weighed as one."""

MAX_ROUNDS = 30
"""Times that the rest is looked at again. Each takes out at least all that are half as improbable as the worst."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OwnClosures:
    """A map's closures, in the order of the drift model's ties.

    Attributes
    ----------
    ties : (k,) int
        Indices of the closures among the ties of the drift model.
    slots : (k,) int
        Slots in the factor graph.
    pairs : (k, 2) int
        Keyframes, i < j.
    log_odds : (k,) float
        Of true against false, given the closures that were not taken out; NaN where nothing else leads between the
        keyframes.
    missed_m, missed_rad : (k,) float
        Distance and angle between each closure and the prediction by the others.
    allowed_m : (k,) float
        Standard deviation of the predicted position along the least certain axis.
    is_false : (k,) bool
        Taken out.
    drift_scale : float
        Factor by which the odometry errs more than the model's, at least 1.
    n_rounds : int
        How often the rest was looked at again.
    settled : Settled
        The map without the closures that were taken out.
    """

    ties: NDArray[np.int64]
    slots: NDArray[np.int64]
    pairs: NDArray[np.int64]
    log_odds: Array
    missed_m: Array
    missed_rad: Array
    allowed_m: Array
    is_false: NDArray[np.bool_]
    drift_scale: float
    n_rounds: int
    settled: Settled

    @property
    def probabilities(self) -> Array:
        """Probability that each is true, (k,); NaN where the log odds are."""
        return np.asarray(expit(self.log_odds))


@solvable()
def own_closures(model: DriftModel) -> OwnClosures:
    """Judge every closure of a map against all the others.

    Raises
    ------
    UnsolvableGraphError
        As of `settle`.
    """
    closures, active = model.ties.closures, np.ones(len(model.ties.pairs), dtype=bool)
    returned, against = np.zeros(len(closures), dtype=bool), np.full(len(closures), np.nan)
    groups = _revisits(model)
    settled = settle(model, active)
    for n_rounds in range(MAX_ROUNDS):  # noqa: B007  the last one is a result
        # what the others say of each, and of each revisit
        missed, others = left_out(settled, closures)
        held = active[closures]
        poorer = poorer_odometry(model.units, missed[held], others[held])
        odds = PRIOR + log_odds(model.units, missed, poorer * others)
        together = _together(settled, [group[active[group]] for group in groups], odds, poorer)

        # take out the worst, or let in again what fits after all
        worst = np.fmin(odds, together)
        failing = active[closures] & (worst < 0)
        acquitted = ~active[closures] & (odds > 0) & ~returned
        if failing.any():
            out = failing & (worst <= worst[failing].min() / 2)
            active[closures[out]], against[out] = False, worst[out]
        elif acquitted.any():
            active[closures[acquitted]] = True
            returned |= acquitted
        else:
            break
        settled = settle(model, active, settled)
    own = model.units.translation
    turned = np.delete(missed, np.arange(missed.shape[1])[own], axis=1)
    squares = np.linalg.eigvalsh(np.nan_to_num(poorer * others[:, own, own], nan=0.0))
    return OwnClosures(
        ties=closures,
        slots=model.ties.slots[closures],
        pairs=model.ties.pairs[closures],
        log_odds=np.where(active[closures], odds, np.fmin(odds, against)),
        missed_m=np.hypot.reduce(missed[:, own], axis=1),
        missed_rad=np.minimum(np.hypot.reduce(turned, axis=1), np.pi),
        allowed_m=np.where(np.isnan(odds), np.inf, np.sqrt(np.maximum(squares[:, -1:].sum(axis=1), 0.0))),
        is_false=~active[closures],
        drift_scale=float(np.sqrt(poorer)),
        n_rounds=n_rounds,
        settled=settled,
    )


def _revisits(model: DriftModel) -> list[NDArray[np.int64]]:
    """Ties of closures of a revisit that agree, two to `TOGETHER` of them."""
    closures = model.ties.closures
    group_of = neighbourhoods(model.ties.pairs[closures], model.along).group_of
    order = np.argsort(group_of, kind="stable")
    found = np.split(closures[order], np.flatnonzero(np.diff(group_of[order])) + 1)
    return [group for group in found if 2 <= len(group) <= TOGETHER]


def _together(settled: Settled, groups: list[NDArray[np.int64]], odds: Array, poorer: float) -> Array:
    """Log odds of every closure by the evidence of all other revisits; NaN where the revisit does not agree.

    False closures of a revisit predict each other. So the revisit is weighed as a whole, against a false offset
    shared by all members, wherever each member by itself passes for true.
    """
    model = settled.model
    row = np.full(len(model.ties.pairs), -1)
    row[model.ties.closures] = np.arange(len(odds))
    found = np.full(len(odds), np.nan)
    agreeing = [group for group in groups if len(group) >= 2 and (odds[row[group]] > 0).all()]
    for group, (missed, others) in zip(agreeing, left_out_together(settled, agreeing), strict=True):
        later = model.ties.pairs[group, 1].tolist()
        found[row[group]] = PRIOR + log_odds_together(model.units, settled.poses, later, missed, poorer * others)
    return found


def poorer_odometry(units: Units, missed: Array, others: Array) -> float:
    """Factor by which the odometry's variance exceeds the model's, by the median closure; from 1 to `POOREST`.

    Parameters
    ----------
    units : Units
    missed : (k, d) float
        Differences of closures from the prediction by the others.
    others : (k, d, d) float
        Covariances of the predictions.
    """
    tolerance = np.diag(units.variances(OFFSET, OFFSET_RAD))
    squares = np.einsum("ka,ka->k", missed, np.linalg.solve(others + tolerance, missed[:, :, None])[:, :, 0])
    known = squares[np.isfinite(squares)]
    usual = float(chdtri(missed.shape[1], 0.5))  # the median of χ²
    return float(np.clip(np.median(known) / usual, 1.0, POOREST)) if len(known) else 1.0
