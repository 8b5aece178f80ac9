"""Ties that a map lacks: where the audit asks for them, until the drift allows no more than a match errs."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pgti_gtsam.diagnosis.records import Diagnosis, Kind
from pgti_gtsam.drift.own_closures import own_closures
from pgti_gtsam.drift.ties import OFFSET
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.mending.records import Wanted
from pgti_gtsam.places import neighbourhoods, places_on
from pgti_gtsam.track import track_of

APART = 2.0
"""Least way between the ends of a tie, as `places_on` has it: what is nearer on the track the odometry ties."""

SPACED = 1.0
"""Least way between two ties, at one end or the other, as `places_on` has it: five keyframes or 5 ρ."""

LOOSE = OFFSET
"""Allowance of the drift, in ρ, from which one more tie is wanted: what a match errs itself."""

SURER = 2.0
"""Ties of a round: up to this factor of the smallest allowance. Ties that come in make others surer."""

UNASKED: tuple[Kind, ...] = ("undecided contact", "different view", "incomplete fusion")
"""Places where no tie is asked for. Where the audit does not know whether two passes meet, as between storeys that look
alike, scans that fit are no proof: other ties have to tell first."""

Pairs = NDArray[np.int64]
Known = Callable[[tuple[int, int], float], bool]


def asked_for(diagnosis: Diagnosis) -> dict[tuple[int, int], Kind]:
    """Overlaps of places where the audit asks for a tie, and the pairs of its proposals; graver kinds go before."""
    found: dict[tuple[int, int], Kind] = {}
    for place in diagnosis.places:
        if place.kind not in UNASKED:
            proposed = [] if place.proposal is None else [place.proposal.keyframes]
            for i, j in [*place.edges.tolist(), *proposed]:
                found.setdefault((i, j), place.kind)
    return found


def wanted_ties(
    diagnosis: Diagnosis, reference: ReferenceMap, asked_before: Collection[tuple[int, int]], is_known: Known
) -> list[Wanted]:
    """The surest of the ties that a map lacks, the surest first.

    Ties are wanted where the audit asks, and where the audit asked before, until the drift allows no more than a match
    errs. Keyframes that the map ties as it came, directly or by explained overlaps, need none: a consistent map stays.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of the map.
    reference : ReferenceMap
        Of the same map.
    asked_before : collection of (int, int)
        Pairs of keyframes that the audit asked for before other ties came in.
    is_known : callable
        Whether a pair of keys was tried already, with no larger an allowance in m: another pair of the same place may
        see more.
    """
    # one overlap for each neighbourhood: where the audit asks, and where it asked before
    kinds, along = asked_for(diagnosis), places_on(diagnosis.pose_graph, track_of(diagnosis.pose_graph))
    asked = _nearest(diagnosis, np.array(sorted(kinds), dtype=np.int64).reshape(-1, 2), along)
    before = _nearest(diagnosis, _beside(diagnosis.integrity.inserted_edges, asked_before, along), along)
    pairs = np.concatenate([asked, before])
    if not len(pairs):
        return []

    # what the drift allows there
    spreads = reference.settled.covariances(pairs) * own_closures(reference.settled.model).drift_scale ** 2
    allowances = reference.settled.model.units.allowances_m(spreads)
    wanted = np.isfinite(allowances)
    wanted &= (np.arange(len(pairs)) < len(asked)) | (allowances > LOOSE * diagnosis.unit_m)

    # those that were not tried, the surest, apart from each other
    ends = [(int(i), int(j)) for i, j in diagnosis.pose_graph.keys[pairs].tolist()]
    wanted &= [not is_known(keys, allowed) for keys, allowed in zip(ends, allowances.tolist(), strict=True)]
    chosen = np.flatnonzero(wanted & (allowances <= SURER * allowances[wanted].min(initial=np.inf)))
    chosen = chosen[_spaced(along[pairs[chosen]])]
    found = [
        _wanted(reference, (i, j), kinds.get((i, j)), spread, allowed)
        for (i, j), spread, allowed in zip(
            pairs[chosen].tolist(), spreads[chosen], allowances[chosen].tolist(), strict=True
        )
    ]
    return sorted(found, key=lambda each: each.allowance_m)


def _beside(overlaps: Pairs, pairs: Collection[tuple[int, int]], along: NDArray[np.float64]) -> Pairs:
    """Overlaps that lie beside some pair on both stretches."""
    if not pairs or not len(overlaps):
        return overlaps[:0]
    distances, _ = KDTree(along[np.array(list(pairs))]).query(along[overlaps], p=np.inf)
    return overlaps[distances <= SPACED]


def _nearest(diagnosis: Diagnosis, overlaps: Pairs, along: NDArray[np.float64]) -> Pairs:
    """Of overlaps far apart on the track the one of each neighbourhood whose spheres meet most, those first."""
    overlaps = overlaps[np.abs(np.diff(along[overlaps], axis=1)[:, 0]) > APART]
    if not len(overlaps):
        return overlaps
    pose_graph = diagnosis.pose_graph
    gaps = np.linalg.norm(np.diff(pose_graph.positions[overlaps], axis=1)[:, 0], axis=1)
    overlaps = overlaps[np.argsort(gaps / pose_graph.radii[overlaps].sum(axis=1), kind="stable")]
    _, first = np.unique(neighbourhoods(overlaps, along).cell_of, return_index=True)
    return overlaps[np.sort(first)]


def _spaced(ends: NDArray[np.float64]) -> list[int]:
    """Pairs, given best first by their places on the track, that lie apart from all better ones."""
    kept: list[int] = []
    for k, pair in enumerate(ends):
        if not kept or (np.abs(ends[kept] - pair).max(axis=1) > SPACED).all():
            kept.append(k)
    return kept


def _wanted(
    reference: ReferenceMap,
    pair: tuple[int, int],
    kind: Kind | None,
    spread: NDArray[np.float64],
    allowance_m: float,
) -> Wanted:
    """The prediction for a pair, carried from the model's frames to the caller's."""
    turn = reference.settled.model.units.levelling
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
