"""The records of a diagnosis: places, closures, proposals, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.estimate import Convergence
from pgti_gtsam.integrity import Integrity
from pgti_gtsam.places import Revisit
from pgti_gtsam.pose_graph import PoseGraph

Kind = Literal[
    "likely false closure",
    "undecided contact",
    "missed closure",
    "untied second pass",
    "tracking gap",
    "different view",
    "incomplete fusion",
]
Level = Literal["consistent", "incomplete", "inconsistent", "undecided"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """A tie that a scan matcher can try.

    Attributes
    ----------
    keyframes : (int, int)
        Indices i and j.
    pose : gtsam.Pose2 or gtsam.Pose3
        Predicted pose of j seen from i.
    covariance : (d, d) float
        Of the prediction, in the tangent space of j in GTSAM's order.
    sigma_m, sigma_deg : float
        Standard deviations of position and angle along the least certain axis of each.
    search_m : float
        Radius of the sphere around the predicted position of j to search in.
    """

    keyframes: tuple[int, int]
    pose: Any
    covariance: NDArray[np.float64]
    sigma_m: float
    sigma_deg: float
    search_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """A place of the map where something is to be done or to be known.

    Attributes
    ----------
    kind : str
    revisit : Revisit
        Overlaps and two stretches of track.
    score, stable_score : float
        Largest ζ and stable score of the place's keyframes, of the comparison that the place comes from: `fusion` for
        an untied second pass and incomplete fusion, else `collisions`.
    worst : int
        The keyframe with that stable score.
    scale : {"local", "global"}
        The half of the time grid in which ζ is larger there.
    probability : float
        That the two stretches run through the same space.
    allowance_m, reach_m : float
        Standard deviation of the drift between the two stretches given all ties, and the sum of the radii.
    gain : float
        ln(1 + R), R the effective resistance between the stretches: by so much a tie raises the logarithm of the
        number of spanning trees, and so D-optimality times the number of keyframes.
    rise_m : float
        Height of the later stretch above the earlier where they are on different levels; 0 where not or not known.
    sentence, remedy : str
    proposal : Proposal or None
        None where no tie leads between the stretches, or none is wanted.
    closure : (int, int) or None
        Keyframes of the false closure that brings the stretches into contact, the earlier first; None of other kinds
        than a likely false closure.
    """

    kind: Kind
    revisit: Revisit
    score: float
    stable_score: float
    worst: int
    scale: Literal["local", "global"]
    probability: float
    allowance_m: float
    reach_m: float
    gain: float
    rise_m: float
    sentence: str
    remedy: str
    proposal: Proposal | None
    closure: tuple[int, int] | None

    @property
    def keyframes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """First and last keyframe of the earlier and of the later stretch."""
        return self.revisit.stretches

    @property
    def edges(self) -> NDArray[np.int64]:
        """Overlaps that a tie of the place explains, (k, 2) int."""
        return self.revisit.resolved


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosureFinding:
    """A closure of the map, judged against all the others.

    Attributes
    ----------
    slot : int
        In the factor graph.
    keyframes : (int, int)
        Indices, the earlier first.
    probability, log_odds : float
        Of a true closure; NaN where no other tie leads between the keyframes.
    missed_m, missed_deg : float
        Difference from the prediction by the others.
    allowed_m : float
        Standard deviation of the prediction.
    is_false : bool
        Less probable than not.
    sentence : str
    """

    slot: int
    keyframes: tuple[int, int]
    probability: float
    log_odds: float
    missed_m: float
    missed_deg: float
    allowed_m: float
    is_false: bool
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conclusion:
    """What overlaps and ties say of a map: the attributes of the same names in `Diagnosis`."""

    verdict: Level
    reason: str
    places: tuple[Place, ...]
    closures: tuple[ClosureFinding, ...]
    unit_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """The result of `diagnose`.

    Attributes
    ----------
    verdict : {"consistent", "incomplete", "inconsistent", "undecided"}
        No contradiction and nothing untied; right as far as can be seen, but untied somewhere; contradictory; or what
        pose graph and radii cannot tell.
    reason : str
        The verdict in a sentence or two.
    places : tuple of Place
        Gravest kinds first, among equals by the overlaps that a tie explains.
    closures : tuple of ClosureFinding
        Least probable first; closures without a verdict last.
    pose_graph : PoseGraph
    integrity : Integrity
    convergence : Convergence or None
        None where no step can be tried: the factor graph is singular, or a landmark has no value.
    unit_m : float
        ρ, the median of the positive radii.
    n_chains : int
        Stretches of unbroken odometry.
    """

    verdict: Level
    reason: str
    places: tuple[Place, ...]
    closures: tuple[ClosureFinding, ...]
    pose_graph: PoseGraph
    integrity: Integrity
    convergence: Convergence | None
    unit_m: float
    n_chains: int
