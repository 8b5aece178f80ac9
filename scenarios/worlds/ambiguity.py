"""How often what is seen does not say where it is: perceptual aliasing of a drive as one figure.

TOPO-Bench (Wang et al., arXiv 2510.04100) tells cases apart by whether the map holds a look-alike of the true place
that is about as similar as that place. The figure here is the share of such cases among keyframes that see a place
again, by the views that the detector compares (`appearance`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.worlds.solid import Array

HERE_STEPS, ELSEWHERE_STEPS = 1.0, 5.0
"""Distance, in steps of the drive, up to which a view is of the same place, and from which it is of another."""


def ambiguity(unlike: Array, places: Array, step_m: float) -> float:
    """Share of keyframes whose place has a look-alike.

    Parameters
    ----------
    unlike : (n, n) float
        Difference of the views of a later and an earlier keyframe, infinite where the two are not compared.
    places : (n, 3) float
        True places, m.
    step_m : float
        Way between keyframes.

    Returns
    -------
    float
        Of the keyframes that have been to their place before, those to which some view from elsewhere is at least as
        much alike as the best view from there. NaN where no place is passed again.
    """
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    here = _best(unlike, apart <= HERE_STEPS * step_m)
    elsewhere = _best(unlike, apart >= ELSEWHERE_STEPS * step_m)
    again = np.isfinite(here)
    return float((elsewhere <= here)[again].mean()) if again.any() else np.nan


def _best(unlike: Array, chosen: NDArray[np.bool_]) -> Array:
    """Least difference of every keyframe's view from the chosen earlier ones, (n,)."""
    return np.asarray(np.where(chosen, unlike, np.inf).min(axis=1))
