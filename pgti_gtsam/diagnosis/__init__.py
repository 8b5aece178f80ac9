"""The whole answer to "is this map right, and where not?": the faults, their places, and the remedies.

1. PGTI scores the map and finds the overlaps that nothing explains (`integrity`); `places` groups the overlaps by
revisit.
2. Each of the map's own closures is judged against all the others (`gate.own_closures`).
3. The drift model says of every contact how far the two stretches may lie apart, given all ties: whether the contact
   is real or drift made (`contacts`). The model says the same of overlaps that are explained: a drive out and back
   along a way is contractible at the turn, so that all overlaps there are explained though nothing ties the two passes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import gtsam
import numpy as np

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.diagnosis import words
from pgti_gtsam.diagnosis.contacts import Contacts
from pgti_gtsam.diagnosis.evidence import counted_once
from pgti_gtsam.diagnosis.records import ClosureFinding, Conclusion, Diagnosis, Place, Proposal
from pgti_gtsam.drift.model import DriftModel, drift_model
from pgti_gtsam.drift.own_closures import OwnClosures, own_closures
from pgti_gtsam.errors import UnsolvableGraphError
from pgti_gtsam.estimate import Convergence, convergence
from pgti_gtsam.integrity import assess
from pgti_gtsam.places import Compared
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.track import track_of

__all__ = ["ClosureFinding", "Diagnosis", "Place", "Proposal", "diagnose"]


def diagnose(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    *,
    radii: float | Mapping[int, float] | None = None,
    edges: Collection[str] | None = None,
    min_shared_landmarks: int | None = None,
    closures: Collection[int] | None = None,
    beta: float = 0.5,
    progress: Callable[[str], None] = lambda step: None,
) -> Diagnosis:
    """Say of a map whether it is right, where not, and how to mend it. Graph and values stay untouched.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        An optimum of the graph: all scores belong to the map that these values draw.
    radii, edges, min_shared_landmarks, closures
        As in `from_gtsam`.
    beta : float
        As in `assess`.
    progress : callable
        Called with a few words on each step.

    Raises
    ------
    UnsolvableGraphError
        Odometry and closures are so far apart in scale that their information is singular to rounding.
    PgtiError
        As of `from_gtsam` and `assess`.
    """
    progress("adapting")
    pose_graph = from_gtsam(
        graph, values, radii=radii, edges=edges, min_shared_landmarks=min_shared_landmarks, closures=closures
    )

    progress("checking the estimate")
    step = convergence_of(graph, values)

    progress(f"spectra of {len(pose_graph)} keyframes")
    integrity = assess(pose_graph, beta=beta)

    found = concluded(graph, values, pose_graph, integrity, progress)
    return Diagnosis(
        verdict=found.verdict,
        reason=found.reason,
        places=found.places,
        closures=found.closures,
        pose_graph=pose_graph,
        integrity=integrity,
        convergence=step,
        unit_m=found.unit_m,
        n_chains=track_of(pose_graph).n_chains,
    )


def concluded(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    pose_graph: PoseGraph,
    compared: Compared,
    progress: Callable[[str], None] = lambda step: None,
) -> Conclusion:
    """What follows from the overlaps of a map and from its ties.

    Parameters
    ----------
    graph, values, progress
        As in `diagnose`.
    pose_graph : PoseGraph
        The map as `from_gtsam` reads it.
    compared : Compared
        Its overlaps and scores.

    Raises
    ------
    UnsolvableGraphError
        As in `diagnose`.
    """
    progress("weighing closures")
    model = drift_model(graph, values, counted_once(pose_graph))
    judged = own_closures(model)

    progress("places")
    contacts = Contacts.of(pose_graph, compared, model, judged)
    places, findings = tuple(contacts.places()), _findings(judged)
    level, reason = words.verdict(compared, places, findings, lacking=_lacking(pose_graph, model))
    return Conclusion(verdict=level, reason=reason, places=places, closures=findings, unit_m=model.units.unit_m)


def _lacking(pose_graph: PoseGraph, model: DriftModel) -> int:
    """How many landmarks fix two keyframes to each other, where no factor ties any and no two share so many; else 0.

    A sighting of a point gives at most as many numbers as the space has dimensions, and a relative pose has three in
    the plane and six in space: a single shared landmark fixes none, and two leave a turn about the line between them in
    space.
    """
    needed = 2 if model.units.is_planar else 3
    adapted = pose_graph.adaptation
    if adapted is None or not adapted.n_landmarks or (pose_graph.edge_sources & EdgeSource.BETWEEN).any():
        return 0
    return 0 if adapted.max_shared_landmarks >= needed else needed


def convergence_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Convergence | None:
    """How far the estimate is from an optimum; None where no step can be tried.

    Parameters
    ----------
    graph, values
        As in `diagnose`.
    """
    try:
        return convergence(graph, values)
    except UnsolvableGraphError:  # a landmark without a value, say, which the audit does without
        return None


def _findings(closures: OwnClosures) -> tuple[ClosureFinding, ...]:
    """Records of the closures, least probable first; closures without a verdict last."""
    found = []
    for k in np.argsort(closures.log_odds, kind="stable").tolist():  # NaN last
        missed, turned = float(closures.missed_m[k]), float(np.degrees(closures.missed_rad[k]))
        allowed, is_false = float(closures.allowed_m[k]), bool(closures.is_false[k])
        known = bool(np.isfinite(closures.log_odds[k]))
        found.append(
            ClosureFinding(
                slot=int(closures.slots[k]),
                keyframes=(int(closures.pairs[k, 0]), int(closures.pairs[k, 1])),
                probability=float(closures.probabilities[k]),
                log_odds=float(closures.log_odds[k]),
                missed_m=missed,
                missed_deg=turned,
                allowed_m=allowed,
                is_false=is_false,
                sentence=words.closure_sentence(missed, turned, allowed, is_false=is_false, known=known),
            )
        )
    return tuple(found)
