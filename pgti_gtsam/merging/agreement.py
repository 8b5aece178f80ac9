"""Probability of links between two maps, given each other: nothing else predicts how the maps lie.

A link (a, b) with the measurement z puts map B beside map A. A second link (c, d) is then predicted by the way from c
to a on A, z, and the way from b to d on B, and is as uncertain as these three. Links that are true agree; false links
agree by chance, and not so seldom: streets and halls have few directions, and a place taken for another place of the
same street keeps heading and lane. So a false link is as likely to lie anywhere, to keep the heading, or to be off
along a single line. Links of one revisit count once, for the same look-alike may make all of them. The odds of a set of
links must outweigh the number of sets of that size that could have been picked. (Largest set of links that agree pair
by pair: Mangelson, Dominic, Eustice, Vasudevan, ICRA 2018, doi:10.1109/ICRA.2018.8460217.)
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from pgti_gtsam.drift.log_odds import NEAR, NEAR_RAD, NEAR_SHARE, log_normal
from pgti_gtsam.drift.settled import Settled
from pgti_gtsam.drift.ties import OFFSET, OFFSET_RAD
from pgti_gtsam.drift.units import Units

SEEDS = 10
"""Pairs of revisits, those that agree best, from which a set is grown."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Agreement:
    """The revisits between two maps with the best agreement.

    Attributes
    ----------
    groups : tuple of (g,) int
        Ties of each revisit, two revisits at least.
    log_odds : float
        Of all being true against chance, over all sets of so many.
    missed_m : float
        Largest distance between a link and the prediction of another link.
    """

    groups: tuple[NDArray[np.int64], ...]
    log_odds: float
    missed_m: float


def best_agreement(settled: Settled, groups: list[NDArray[np.int64]]) -> Agreement | None:
    """The revisits that agree best; None with fewer than two revisits.

    Parameters
    ----------
    settled : Settled
        Two maps that no tie holds together, with links between them that do not hold yet.
    groups : list of (g,) int
        Ties of the links, revisit by revisit.
    """
    n = len(groups)
    if n < 2:
        return None

    # every two revisits by the middle link of each
    odds, missed = np.zeros((n, n)), np.zeros((n, n))
    for i, j in combinations(range(n), 2):
        found = _given_each_other(settled, *(int(groups[k][len(groups[k]) // 2]) for k in (i, j)))
        (odds[i, j], missed[i, j]), (odds[j, i], missed[j, i]) = found, found

    # sets grown from the best pairs, and the set that outweighs chance most
    first, second = np.triu_indices(n, 1)
    best = np.argsort(-odds[first, second])[:SEEDS]
    grown = [each for k in best.tolist() for each in _grown(odds, [int(first[k]), int(second[k])])]
    total, chosen = max(grown, key=lambda each: each[0])
    return Agreement(
        groups=tuple(groups[k] for k in chosen),
        log_odds=total,
        missed_m=float(missed[np.ix_(chosen, chosen)].max()),
    )


def _grown(odds: Array, chosen: list[int]) -> list[tuple[float, list[int]]]:
    """Log odds of a pair and of ever larger sets around the pair, each member counted by the worst agreement."""
    n, total = len(odds), float(odds[chosen[0], chosen[1]])
    found = [(total - _log_choices(n, 2), list(chosen))]
    while len(chosen) < n:
        rest = [k for k in range(n) if k not in chosen]
        worst = odds[np.ix_(rest, chosen)].min(axis=1)
        total, chosen = total + float(worst.max()), [*chosen, rest[int(worst.argmax())]]
        found.append((total - _log_choices(n, len(chosen)), chosen))
    return found


def _log_choices(n: int, k: int) -> float:
    """ln of the number of sets of k among n."""
    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))


def _given_each_other(settled: Settled, first: int, second: int) -> tuple[float, float]:
    """Log odds of the second link where the first holds, before any prior, and the miss, m."""
    # the second link as the first predicts it
    (a, b, z, tolerance), (c, d, measured, _) = (_oriented(settled, tie) for tie in (first, second))
    on_a, on_b = settled.poses[c].between(settled.poses[a]), settled.poses[b].between(settled.poses[d])
    predicted = on_a.compose(z).compose(on_b)
    missed = np.asarray(type(z).Logmap(measured.between(predicted)))

    # how certain the three are, seen from the end
    own = settled.covariances(np.array([[c, a], [b, d]]))
    after_a, after_z = z.compose(on_b).inverse().AdjointMap(), on_b.inverse().AdjointMap()
    covariance = after_a @ own[0] @ after_a.T + after_z @ tolerance @ after_z.T + own[1]
    units = settled.model.units
    return _log_odds(units, missed, covariance), float(np.linalg.norm(missed[units.translation]))


def _log_odds(units: Units, missed: Array, predicted: Array) -> float:
    """Of true against false: a false link lies anywhere, or keeps the heading, or is off along a line."""
    place = units.translation
    shifted, along = np.zeros_like(units.spread), np.zeros_like(units.spread)
    shifted[place, place] = units.spread[place, place]
    line = missed[place] / max(float(np.linalg.norm(missed[place])), np.finfo(float).tiny)
    along[place, place] = units.spread[place, place].max() * np.outer(line, line)
    false = [_log_matched(units, missed, predicted + more) for more in (units.spread, shifted, along)]
    return float(_log_matched(units, missed, predicted) - (logsumexp(false) - np.log(len(false))))


def _log_matched(units: Units, missed: Array, covariance: Array) -> float:
    """Log density of a miss by a link that measures a pose, or matches no more than a place."""
    shares = ((1 - NEAR_SHARE, OFFSET, OFFSET_RAD), (NEAR_SHARE, NEAR, NEAR_RAD))
    found = [
        np.log(share) + log_normal(missed[None], (covariance + np.diag(units.variances(length, angle)))[None])[0]
        for share, length, angle in shares
    ]
    return float(np.logaddexp(*found))


def _oriented(settled: Settled, tie: int) -> tuple[int, int, Any, Array]:
    """A link from the part with the lower number to the other: keyframes, measurement, covariance at the end."""
    ties = settled.model.ties
    i, j = ties.pairs[tie].tolist()
    measured, tolerance = ties.measured[tie], np.diag(ties.variances[tie])
    if settled.component[i] <= settled.component[j]:
        return i, j, measured, tolerance
    carry = measured.AdjointMap()
    return j, i, measured.inverse(), carry @ tolerance @ carry.T
