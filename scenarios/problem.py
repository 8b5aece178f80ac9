"""What an experiment hands to every method: a map without its candidates, the candidates, and the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """A map and its candidate closures, in time order. Keyframe i has the key i.

    Attributes
    ----------
    name : str
    graph : gtsam.NonlinearFactorGraph
        The map without any candidate: a prior, odometry, landmark factors. All noise models are the
        ones that methods are told, whatever the noise was.
    values : gtsam.Values
        First estimates: odometry chained, landmarks placed from there.
    closures : tuple of gtsam.NonlinearFactorGraph
        Candidates, one between factor each, by the later of their keyframes.
    true : (n_closures,) bool
        Labelled by geometry: does the measured relative pose agree with the truth?
    overlapping : (n_closures,) bool
        Of false candidates, those that would lay free space upon free space which nothing connects; the
        others are beyond the reach of PGTI, as its paper states. True of every true one.
    radii : float, mapping from key to float, or None
        m; None where landmark factors give them.
    truth : gtsam.Values
        Poses only, in a frame of their own.
    """

    name: str
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    closures: tuple[gtsam.NonlinearFactorGraph, ...]
    true: NDArray[np.bool_]
    overlapping: NDArray[np.bool_]
    radii: float | Mapping[int, float] | None
    truth: gtsam.Values
