"""Probability of two links between two maps, given each other: nothing else predicts how the maps lie.

A link (a, b) with the measurement z puts map B beside map A. A second link (c, d) is then predicted by the way from c
to a on A, z, and the way from b to d on B, and is as uncertain as these three. Links that are true agree; a false link
agrees with another only by chance, unless both see the same two places that look alike. So links of one revisit count
once, and the odds of the best pair must outweigh the number of pairs that were tried. (Sets of links that agree pair by
pair: Mangelson, Dominic, Eustice, Vasudevan, ICRA 2018, doi:10.1109/ICRA.2018.8460217.)
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.gate.settled import Settled
from pgti_gtsam.gate.terms.drift import log_odds

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Agreement:
    """The two revisits between two maps with the best agreement.

    Attributes
    ----------
    groups : (NDArray, NDArray)
        Ties of both.
    log_odds : float
        Of both being true against chance, over all pairs that were tried.
    missed_m : float
        Distance between a link and the prediction of the other link.
    """

    groups: tuple[NDArray[np.int64], NDArray[np.int64]]
    log_odds: float
    missed_m: float


def best_agreement(settled: Settled, groups: list[NDArray[np.int64]]) -> Agreement | None:
    """The pair of revisits that agrees best; None with fewer than two revisits.

    Parameters
    ----------
    settled : Settled
        Two maps that no tie holds together, with links between them that do not hold yet.
    groups : list of (g,) int
        Ties of the links, revisit by revisit.
    """
    pairs = list(combinations(groups, 2))
    found = [_given_each_other(settled, *(int(group[len(group) // 2]) for group in pair)) for pair in pairs]
    if not found:
        return None
    best = int(np.argmax([odds for odds, _ in found]))
    odds, missed_m = found[best]
    return Agreement(groups=pairs[best], log_odds=odds - float(np.log(len(pairs))), missed_m=missed_m)


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
    odds = log_odds(settled.model, missed[None], covariance[None])[0]
    return float(odds), float(np.linalg.norm(missed[settled.model.translation]))


def _oriented(settled: Settled, tie: int) -> tuple[int, int, Any, Array]:
    """A link from the part with the lower number to the other: keyframes, measurement, covariance at the end."""
    ties = settled.model.ties
    i, j = ties.pairs[tie].tolist()
    measured, tolerance = ties.measured[tie], np.diag(ties.variances[tie])
    if settled.component[i] <= settled.component[j]:
        return i, j, measured, tolerance
    carry = measured.AdjointMap()
    return j, i, measured.inverse(), carry @ tolerance @ carry.T
