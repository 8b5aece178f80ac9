"""Log odds of true against false closures, from their differences from the map's prediction.

A closure is true and measures a pose; or true and matches no more than a place; or false, and lies as far off as
keyframes of this map lie apart. Where the drift is as wide as the map the three say the same, and nothing is held
against the closure.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.drift.ties import OFFSET, OFFSET_RAD
from pgti_gtsam.drift.units import Units

NEAR, NEAR_RAD = 0.5, 0.25
"""Standard deviation of a match of places, in ρ and in rad: it misses by less than the free space, and ties what
belongs together. The true loops on KITTI 06 miss the ground truth by 0.57 m in the median and 1.39 m at most, 0.35 ρ
at ρ = 4 m."""

NEAR_SHARE = 0.1
"""Of true closures, those that match places."""

AGREES = 0.4
"""Log odds of each further member of a revisit that agrees: those of false revisits agree less often, ln 1.5."""

Array = NDArray[np.float64]


def log_odds(units: Units, missed: Array, predicted: Array) -> Array:
    """Log odds of single closures before any prior, (k,).

    Parameters
    ----------
    missed : (k, d) float
        Difference of each closure from the map's prediction.
    predicted : (k, d, d) float
        Covariance of that prediction; NaN without a prediction, and then the log odds are NaN.
    """
    known = np.isfinite(predicted).all(axis=(1, 2))
    found = np.full(len(missed), np.nan)
    missed, predicted = missed[known], predicted[known]
    exact, near = (np.diag(units.variances(*sigmas)) for sigmas in ((OFFSET, OFFSET_RAD), (NEAR, NEAR_RAD)))
    is_true = np.logaddexp(
        np.log(1 - NEAR_SHARE) + log_normal(missed, predicted + exact),
        np.log(NEAR_SHARE) + log_normal(missed, predicted + near),
    )
    is_false = np.logaddexp(
        np.log(1 - NEAR_SHARE) + log_normal(missed, predicted + exact + units.spread),
        np.log(NEAR_SHARE) + log_normal(missed, predicted + near + units.spread),
    )
    found[known] = is_true - is_false
    return found


def log_odds_together(
    units: Units, poses: Sequence[Any], later: Sequence[int], missed: Array, predicted: Array
) -> float:
    """Log odds that closures of a revisit are true, against a false offset that all members share.

    Agreement of the members with each other says nothing: members of a false revisit agree as well. Where no offset
    fits all, each is false by itself.

    Parameters
    ----------
    units : Units
    poses : sequence of gtsam.Pose2 or gtsam.Pose3
        Of the map that predicts.
    later : sequence of g int
        Keyframe j of each closure, in whose frame the difference is given.
    missed : (g, d) float
    predicted : (g d, g d) float
        Joint covariance of the predictions.
    """
    moved = np.vstack([poses[j].between(poses[later[0]]).AdjointMap() for j in later])
    offset = moved @ units.spread @ moved.T
    is_true, is_false = (_matched_together(units, missed, predicted + more) for more in (0.0, offset))
    own = np.arange(len(missed))
    alone = predicted.reshape(len(missed), -1, len(missed), missed.shape[1])[own, :, own]
    near = np.diag(units.variances(NEAR, NEAR_RAD))
    each_false = float(log_normal(missed, alone + near + units.spread).sum()) if len(missed) > 1 else -np.inf
    return is_true - max(is_false, each_false)


def _matched_together(units: Units, missed: Array, covariance: Array) -> float:
    """Log density of differences of closures, of which all measure poses or all match places."""
    found = [
        np.log(share) + log_normal(missed.reshape(1, -1), (covariance + np.diag(tolerance))[None])[0]
        for share, tolerance in (
            (1 - NEAR_SHARE, np.tile(units.variances(OFFSET, OFFSET_RAD), len(missed))),
            (NEAR_SHARE, np.tile(units.variances(NEAR, NEAR_RAD), len(missed))),
        )
    ]
    return float(np.logaddexp(*found))


def log_normal(x: Array, covariances: Array) -> Array:
    """log N(x; 0, C), (k,), of (k, d) vectors and (k, d, d) covariances.

    Parameters
    ----------
    x : (k, d) float
    covariances : (k, d, d) float
    """
    _, log_determinants = np.linalg.slogdet(covariances)
    squares = np.einsum("ka,ka->k", x, np.linalg.solve(covariances, x[:, :, None])[:, :, 0])
    return np.asarray(-0.5 * (squares + log_determinants + x.shape[1] * np.log(2 * np.pi)))
