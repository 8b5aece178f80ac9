"""Ties that a map lacks: at untied places, and at overlaps tied so loosely that a match says more."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.diagnosis.records import Diagnosis, Kind
from pgti_gtsam.gate.own_closures import own_closures
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.ties import OFFSET
from pgti_gtsam.mend.records import Wanted
from pgti_gtsam.places import neighbourhoods, places_on
from pgti_gtsam.track import track_of

APART = 2.0
"""Least way between the ends of a tie, as `places_on` has it: what is nearer on the track the odometry ties."""

SPACED = 1.0
"""Least way between two ties, at one end or the other, as `places_on` has it: five keyframes or 5 ρ."""

LOOSE = OFFSET
"""Allowance of the drift, in ρ, from which a tie is wanted: what a match leaves uncertain itself."""

Pairs = NDArray[np.int64]


def wanted_ties(
    diagnosis: Diagnosis, reference: ReferenceMap, is_known: Callable[[tuple[int, int], float], bool]
) -> list[Wanted]:
    """Ties that a map lacks, at the audit's places first, among equals the surest predictions first.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of the map.
    reference : ReferenceMap
        Of the same map.
    is_known : callable
        Whether a pair of keys was tried already, with no larger an allowance in m: another pair of the same place may
        see more.
    """
    # overlaps of stretches far apart on the track, one for each neighbourhood
    pose_graph, integrity = diagnosis.pose_graph, diagnosis.integrity
    along = places_on(pose_graph, track_of(pose_graph))
    overlaps = np.concatenate([integrity.inserted_edges, *_proposed(diagnosis)])
    overlaps = overlaps[np.abs(np.diff(along[overlaps], axis=1)[:, 0]) > APART]
    kinds = _kinds(diagnosis)
    overlaps = overlaps[[kinds.get((i, j)) != "different view" for i, j in overlaps.tolist()]]
    if not len(overlaps):
        return []
    gaps = np.linalg.norm(np.diff(pose_graph.positions[overlaps], axis=1)[:, 0], axis=1)
    order = np.argsort(gaps / pose_graph.radii[overlaps].sum(axis=1), kind="stable")
    _, first = np.unique(neighbourhoods(overlaps, along).cell_of[order], return_index=True)
    pairs = overlaps[order[np.sort(first)]]

    # of those the loose ones, apart from each other
    own = own_closures(reference.settled.model)
    spreads = reference.settled.covariances(pairs) * own.drift_scale**2
    allowances = reference.settled.model.allowances_m(spreads)
    loose = np.isfinite(allowances) & (allowances > LOOSE * diagnosis.unit_m)
    ends = [(int(i), int(j)) for i, j in pose_graph.keys[pairs].tolist()]
    loose &= [not is_known(keys, allowed) for keys, allowed in zip(ends, allowances.tolist(), strict=True)]
    pairs, spreads, allowances = pairs[loose], spreads[loose], allowances[loose]
    apart = _spaced(along[pairs])
    found = [
        _wanted(reference, (i, j), kinds.get((i, j)), spreads[k], float(allowances[k]))
        for k, (i, j) in enumerate(pairs.tolist())
        if k in apart
    ]
    return sorted(found, key=lambda each: (each.place is None, each.allowance_m))


def _proposed(diagnosis: Diagnosis) -> list[Pairs]:
    """The pairs that the audit proposes."""
    return [np.array([place.proposal.keyframes]) for place in diagnosis.places if place.proposal is not None]


def _kinds(diagnosis: Diagnosis) -> dict[tuple[int, int], Kind]:
    """The place of an overlap, by its keyframes; graver places go before."""
    found: dict[tuple[int, int], Kind] = {}
    for place in diagnosis.places:
        if place.kind != "incomplete fusion":
            for i, j in place.edges.tolist():
                found.setdefault((i, j), place.kind)
    return found


def _spaced(ends: NDArray[np.float64]) -> set[int]:
    """Pairs, given best first by their places on the track, apart from all better pairs."""
    kept: list[int] = []
    for k, pair in enumerate(ends):
        if not kept or (np.abs(ends[kept] - pair).max(axis=1) > SPACED).all():
            kept.append(k)
    return set(kept)


def _wanted(
    reference: ReferenceMap,
    pair: tuple[int, int],
    kind: Kind | None,
    spread: NDArray[np.float64],
    allowance_m: float,
) -> Wanted:
    """The prediction for a pair, carried from the model's frames to the caller's."""
    turn = reference.settled.model.levelling
    first, second = (reference.settled.poses[k] for k in pair)
    carry, keys = turn.AdjointMap(), reference.pose_graph.keys
    return Wanted(
        keyframes=pair,
        keys=(int(keys[pair[0]]), int(keys[pair[1]])),
        place=kind,
        pose=turn.compose(first.between(second)).compose(turn.inverse()),
        covariance=carry @ spread @ carry.T,
        allowance_m=allowance_m,
    )
