"""How soon a metric answers to inserted edges: the cross-correlation of section 6.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FARTHEST = 10
"""Lags that are looked at, in moments either way: an answer that comes later is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """The correlation of a metric's changes with the edge-insertion signal.

    Attributes
    ----------
    lag : int
        Moments by which the metric follows the signal at the best agreement; the shortest of equals. Negative: the
        metric comes first.
    correlation, at_zero : float
        Normalised cross-correlation there, and without any lag; NaN where metric or signal never changes.
    """

    lag: int
    correlation: float
    at_zero: float


def lag(metric: NDArray[np.float64], signal: NDArray[np.bool_], farthest: int = FARTHEST) -> Lag:
    """Cross-correlate |metric(k) − metric(k − 1)| with the signal.

    The paper does not say how its curves enter. The signal marks events, so that changes of the metric are what can
    answer to events: the level of a metric that has risen and stays would correlate with whatever comes later.

    Parameters
    ----------
    metric : (n,) float
    signal : (n,) bool
        Whether edges were inserted.
    farthest : int
        Largest lag either way.
    """
    changes = np.abs(np.diff(metric, prepend=metric[:1]))
    x, y = changes - changes.mean(), signal - np.mean(signal)
    size = np.sqrt((x @ x) * (y @ y))
    if not size > 0:
        return Lag(lag=0, correlation=np.nan, at_zero=np.nan)
    lags = sorted(range(-farthest, farthest + 1), key=abs)
    found = {k: float(_overlap(x, y, k) / size) for k in lags if abs(k) < len(x)}
    best = max(found, key=lambda k: found[k])
    return Lag(lag=best, correlation=found[best], at_zero=found[0])


def _overlap(x: NDArray[np.float64], y: NDArray[np.float64], k: int) -> float:
    """Σ x(m + k) y(m)."""
    return float(x[max(k, 0) : len(x) + min(k, 0)] @ y[max(-k, 0) : len(y) - max(k, 0)])
