"""Ties that a map lacks: where the audit asks for them, until the drift allows no more than a match errs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pgti_gtsam.diagnosis.records import Diagnosis, Kind
from pgti_gtsam.gate.own_closures import own_closures
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.ties import OFFSET
from pgti_gtsam.mending.records import Attempt, Wanted
from pgti_gtsam.mending.starts import EXTENT, SPACING
from pgti_gtsam.places import neighbourhoods, places_on
from pgti_gtsam.support_graph import support_graph
from pgti_gtsam.track import track_of

APART = 2.0
"""Least way between the ends of a tie, as `places_on` has it: what is nearer on the track the odometry ties."""

SPACED = 1.0
"""Least way between two ties, at one end or the other, as `places_on` has it: five keyframes or 5 ρ."""

LOOSE = OFFSET
"""Allowance of the drift, in ρ, from which one more tie is wanted: what a match errs itself."""

CLOSE = SPACING / (2 * EXTENT)
"""Allowance of the drift, in ρ, up to which no other position is searched (`starts`), so that no surer tie has to come
before."""

SURER = 2.0
"""Ties of a round beyond `CLOSE`: up to this factor of the smallest allowance. Ties that come in make others surer."""

TRIES = 3
"""Pairs of a neighbourhood that are tried in vain: another pair of the same place may see more. On the raw log `aces` a
place stays untied where one pair is tried, and nine pairs tie no more than three."""

BESIDE = 0.5
"""Side of a neighbourhood, as `neighbourhoods` has it."""

SMALLER = 0.5
"""Part of its former allowance to which a prediction must have come down before a neighbourhood is tried again."""

UNASKED: tuple[Kind, ...] = ("undecided contact", "different view", "incomplete fusion")
"""Places where no tie is asked for. Where the audit does not know whether two passes meet, as between storeys that look
alike, scans that fit are no proof: other ties have to tell first."""

Pairs = NDArray[np.int64]


def asked_for(diagnosis: Diagnosis) -> dict[tuple[int, int], Kind]:
    """Overlaps of places where the audit asks for a tie, and the pairs of its proposals; graver kinds go before."""
    found: dict[tuple[int, int], Kind] = {}
    for place in diagnosis.places:
        if place.kind not in UNASKED:
            proposed = [] if place.proposal is None else [place.proposal.keyframes]
            for i, j in [*place.edges.tolist(), *proposed]:
                found.setdefault((i, j), place.kind)
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lacking:
    """Ties that a map may lack: an overlap for each neighbourhood, and how far the drift lets the two lie apart.

    Attributes
    ----------
    reference : ReferenceMap
    pairs : (k, 2) int
        Keyframes, i < j.
    along : (n,) float
        Places of all keyframes on the track, from `places_on`.
    kinds : tuple of k str or None
        Kinds of the audit's places; None where the audit asked before.
    spreads : (k, d, d) float
        Covariances of the predicted relative poses.
    allowances : (k,) float
        In ρ.
    """

    reference: ReferenceMap
    pairs: Pairs
    along: NDArray[np.float64]
    kinds: tuple[Kind | None, ...]
    spreads: NDArray[np.float64]
    allowances: NDArray[np.float64]

    @classmethod
    def of(
        cls, reference: ReferenceMap, asked: Mapping[tuple[int, int], Kind], before: Collection[tuple[int, int]]
    ) -> Lacking:
        """Overlaps where the audit asks, and overlaps beside those where the audit asked before.

        Keyframes that the map ties as it came, directly or by explained overlaps, need none: a consistent map stays.

        Parameters
        ----------
        reference : ReferenceMap
        asked : mapping of (int, int) to str
            From `asked_for`.
        before : collection of (int, int)
            Pairs of keyframes that the audit asked for before other ties came in.
        """
        # one overlap for each neighbourhood
        pose_graph, model = reference.pose_graph, reference.settled.model
        along = places_on(pose_graph, track_of(pose_graph))
        own = _nearest(reference, np.array(sorted(asked), dtype=np.int64).reshape(-1, 2), along)
        more = _nearest(reference, _beside(support_graph(pose_graph).inserted_edges, before, along), along)
        pairs = np.concatenate([own, more])

        # what the drift allows there
        spreads = reference.settled.covariances(pairs) * own_closures(model).drift_scale ** 2
        return cls(
            reference=reference,
            pairs=pairs,
            along=along,
            kinds=tuple(asked.get((i, j)) for i, j in pairs.tolist()),
            spreads=spreads,
            allowances=model.allowances_m(spreads) / model.unit_m,
        )

    def close(self, tried: Collection[Attempt]) -> list[Wanted]:
        """Ties that need no surer tie before.

        Parameters
        ----------
        tried : collection of Attempt
        """
        return self._wanted(self._is_lacking(tried) & (self.allowances <= CLOSE))

    def surest(self, tried: Collection[Attempt]) -> list[Wanted]:
        """The surest ties.

        Parameters
        ----------
        tried : collection of Attempt
        """
        lacking = self._is_lacking(tried)
        return self._wanted(lacking & (self.allowances <= SURER * self.allowances[lacking].min(initial=np.inf)))

    def _is_lacking(self, tried: Collection[Attempt]) -> NDArray[np.bool_]:
        """Whether a tie is wanted and may come in: not tied, nor tried in vain within a region about as small."""
        is_asked = np.array([kind is not None for kind in self.kinds], dtype=bool)
        lacking = np.isfinite(self.allowances) & (is_asked | (self.allowances > LOOSE))
        tied = {attempt.keys for attempt in tried if attempt.outcome == "confirmed"}
        ends = self.reference.pose_graph.keys[self.pairs].tolist()
        lacking &= np.array([(i, j) not in tied for i, j in ends], dtype=bool)

        # what was tried in vain, there or beside
        failed = [each.wanted for each in tried if each.wanted is not None and each.outcome != "confirmed"]
        if not failed:
            return lacking
        before = np.array([each.keyframes for each in failed])
        regions = np.array([each.allowance_m for each in failed]) / self.reference.settled.model.unit_m
        in_vain = self.allowances[:, None] > SMALLER * regions
        is_same = (self.pairs[:, None] == before).all(axis=2)
        is_beside = (np.abs(self.along[self.pairs][:, None] - self.along[before]) < BESIDE).all(axis=2)
        lacking &= ~(in_vain & is_same).any(axis=1) & ((in_vain & is_beside).sum(axis=1) < TRIES)
        return lacking

    def _wanted(self, chosen: NDArray[np.bool_]) -> list[Wanted]:
        """The chosen ties apart from each other, the surest first, carried from the model's frames to the caller's."""
        rows = np.flatnonzero(chosen)
        rows = rows[_spaced(self.along[self.pairs[rows]])]
        turn, poses, keys = (
            self.reference.settled.model.levelling,
            self.reference.settled.poses,
            self.reference.pose_graph.keys,
        )
        carry, unit = turn.AdjointMap(), self.reference.settled.model.unit_m
        found = []
        for k in rows[np.argsort(self.allowances[rows], kind="stable")].tolist():
            i, j = self.pairs[k].tolist()
            found.append(
                Wanted(
                    keyframes=(i, j),
                    keys=(int(keys[i]), int(keys[j])),
                    place=self.kinds[k],
                    pose=turn.compose(poses[i].between(poses[j])).compose(turn.inverse()),
                    covariance=carry @ self.spreads[k] @ carry.T,
                    allowance_m=float(self.allowances[k] * unit),
                )
            )
        return found


def _beside(overlaps: Pairs, pairs: Collection[tuple[int, int]], along: NDArray[np.float64]) -> Pairs:
    """Overlaps that lie beside some pair on both stretches."""
    if not pairs or not len(overlaps):
        return overlaps[:0]
    distances, _ = KDTree(along[np.array(list(pairs))]).query(along[overlaps], p=np.inf)
    return overlaps[distances <= SPACED]


def _nearest(reference: ReferenceMap, overlaps: Pairs, along: NDArray[np.float64]) -> Pairs:
    """Of overlaps far apart on the track the one of each neighbourhood whose spheres meet most, those first."""
    overlaps = overlaps[np.abs(np.diff(along[overlaps], axis=1)[:, 0]) > APART]
    if not len(overlaps):
        return overlaps
    pose_graph = reference.pose_graph
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
