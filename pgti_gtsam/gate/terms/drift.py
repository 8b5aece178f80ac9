"""The drift in words: how far a closure lies from where all other ties put its keyframes; see `drift.log_odds`."""

from __future__ import annotations

import numpy as np

from pgti_gtsam.gate.decision import Term, metres

SEEN = 1e-3
"""Part of its standard deviation below which a miss is told as none."""


def term(odds: float, missed_m: float, missed_rad: float, allowed_m: float) -> Term:
    """The evidence in words.

    Parameters
    ----------
    odds : float
    missed_m, missed_rad : float
        Difference from the prediction.
    allowed_m : float
        Standard deviation of the prediction.
    """
    if np.isnan(odds):
        sentence = "No tie leads between its keyframes: nothing predicts the closure."
    else:
        shown = missed_m if missed_m > SEEN * allowed_m else 0.0
        sentence = (
            f"The other ties put its later keyframe {metres(shown)} and {np.degrees(missed_rad):.0f}° from where "
            f"the closure does, give or take {metres(allowed_m)}."
        )
    return Term(value=missed_m, log_odds=odds, sentence=sentence)
