"""The records of mending: closures taken out, ties tried, and the map before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.diagnosis.records import Diagnosis, Kind
from pgti_gtsam.gate.decision import ClosureDecision
from pgti_gtsam.mending.alignment import Alignment
from pgti_gtsam.mending.submap import Submap

Outcome = Literal["confirmed", "refused", "undecided"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wanted:
    """A tie that the map lacks.

    Attributes
    ----------
    keyframes : (int, int)
        Indices i < j.
    keys : (int, int)
    place : str or None
        Kind of the audit's place; None where the map is tied there, but loosely.
    pose : gtsam.Pose2 or gtsam.Pose3
        Predicted pose of j seen from i.
    covariance : (d, d) float
        Of the prediction, in the tangent space of j in GTSAM's order: the region to search.
    allowance_m : float
        Standard deviation of the predicted position along the least certain axis.
    """

    keyframes: tuple[int, int]
    keys: tuple[int, int]
    place: Kind | None
    pose: Any
    covariance: NDArray[np.float64]
    allowance_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attempt:
    """A tie that was tried.

    Attributes
    ----------
    wanted : Wanted or None
        None of a tie that came with the answers of a matcher.
    keys : (int, int)
    pose : gtsam.Pose2 or gtsam.Pose3 or None
        The measured pose of the second key seen from the first; None without a measurement.
    factor : gtsam.BetweenFactorPose2 or gtsam.BetweenFactorPose3 or None
        The tie, with its noise; None without a measurement.
    alignment : Alignment or None
    submaps : (Submap, Submap) or None
        The alignment.
    decision : ClosureDecision or None
        The gate's decision on ties that the sensors confirm.
    outcome : {"confirmed", "refused", "undecided"}
    reason : str
        A sentence.
    round : int
        The round, from 1; 0 of a matcher's answers.
    """

    wanted: Wanted | None
    keys: tuple[int, int]
    pose: Any
    factor: Any
    alignment: Alignment | None
    submaps: tuple[Submap, Submap] | None
    decision: ClosureDecision | None
    outcome: Outcome
    reason: str
    round: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mended:
    """A map before and after.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        The factors in their slots, empty for closures that are out, then the ties that are in.
    values : gtsam.Values
        The optimum.
    out : mapping of slot to ClosureDecision
        Closures of the map that did not pass the gate.
    attempts : tuple of Attempt
        The last attempt at each tie.
    before, after : Diagnosis
        Of the map before mending, at its optimum, and of the mended map.
    before_values : gtsam.Values
    n_rounds : int
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    out: Mapping[int, ClosureDecision]
    attempts: tuple[Attempt, ...]
    before: Diagnosis
    after: Diagnosis
    before_values: gtsam.Values
    n_rounds: int

    def of(self, outcome: Outcome) -> list[Attempt]:
        """Attempts that ended so."""
        return [attempt for attempt in self.attempts if attempt.outcome == outcome]
