"""Stretches of track in contact: the kind of each contact, by how far the drift allows the two to lie apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pgti_gtsam.diagnosis import words
from pgti_gtsam.diagnosis.levels import rise_m
from pgti_gtsam.diagnosis.meeting import meeting_share, same_space
from pgti_gtsam.diagnosis.records import Kind, Place, Proposal
from pgti_gtsam.diagnosis.views import without_common_view
from pgti_gtsam.drift.model import DriftModel
from pgti_gtsam.drift.own_closures import OwnClosures
from pgti_gtsam.drift.settled import Settled
from pgti_gtsam.pair_codes import codes_of, pairs_of
from pgti_gtsam.places import (
    WINDOW,
    Compared,
    Neighbourhoods,
    Revisit,
    Scored,
    neighbourhoods,
    places_on,
    revisit,
    revisits,
)
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.block_inverse import factorise, own_products
from pgti_gtsam.spectral.elimination_tree import analyse
from pgti_gtsam.spectral.laplacian import connected_components
from pgti_gtsam.track import Track, track_of

DECIDED = 0.75
"""Probability from which a contact is called real. No probability calls a contact chance: of the training contacts of
`meeting.CONTACT` 208 are told less, of which 119 are real, and 53 less than 0.5, of which 20 are."""

UNTIED = 1.0
"""Allowance of the drift, in what two spheres reach, beyond which overlaps that are explained are not tied. Of eight
intact graphs none has an explained overlap with more than 0.8; MIT, a ninth, does."""

CLEAR = 1.0
"""Least reach of two spheres, in ρ, for which a tie near by is enough."""

SAMPLED = 2000
"""Explained overlaps at most whose allowance is asked for: one for each neighbourhood on both stretches."""

NOTABLE_FUSION = 0.26
"""ζ of incomplete fusion from which its worst place is named: between the largest Λ that the paper's Table 4 calls
harmless (KITTI-18, 0.1708) and the one that it calls moderate (Campus-9, 0.3890)."""

SEARCH = 3.0
"""Radius of the sphere to search a tie in, in standard deviations of the predicted position."""

GRAVITY: dict[Kind, int] = {
    "likely false closure": 0,
    "undecided contact": 1,
    "missed closure": 2,
    "untied second pass": 3,
    "tracking gap": 4,
    "different view": 5,
    "incomplete fusion": 6,
}
"""Order in which places are listed."""

Pairs = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """A map with its contacts, and the evidence on each.

    Attributes
    ----------
    pose_graph, integrity, track
        The map as PGTI sees it.
    closures : OwnClosures
    settled : Settled
        The drift model without the false closures.
    predicted : dict from (int, int) to (d, d) float and float
        Of every pair that a place is judged by: covariance of the relative pose, and the allowance in m.
    collisions : list of Revisit
    far : (f, 2) int
        Explained overlaps of keyframes that are far apart on the track.
    loose : (l, 2) int
        The contacts among them that no near tie holds together.
    near_by : Neighbourhoods
        Of the loose contacts.
    labels : list of str
        Names of the keyframes.
    positions : (n, d) float
        Poses of the drift model, m.
    """

    pose_graph: PoseGraph
    integrity: Compared
    track: Track
    closures: OwnClosures
    settled: Settled
    predicted: dict[tuple[int, ...], tuple[NDArray[np.float64], float]]
    collisions: list[Revisit]
    far: Pairs
    loose: Pairs
    near_by: Neighbourhoods
    labels: list[str]
    positions: NDArray[np.float64]

    @classmethod
    def of(cls, pose_graph: PoseGraph, integrity: Compared, model: DriftModel, closures: OwnClosures) -> Contacts:
        """Group the collisions, sample the explained overlaps, and settle the drift model to be asked for both.

        Parameters
        ----------
        pose_graph, integrity, model, closures
        """
        # group the collisions, and the explained overlaps that no tie near by holds
        track, fusion = track_of(pose_graph), integrity.fusion_edges
        places, collisions = places_on(pose_graph, track), revisits(pose_graph, integrity, track)
        far = fusion[np.abs(np.diff(places[fusion], axis=1)[:, 0]) > 2.0]
        loose = far[~_tied_near_by(far, pose_graph.radii, model, closures.settled.active)]
        near_by = neighbourhoods(loose, places, SAMPLED)

        # ask the drift model for one pair of each
        closest = np.array([each.closest for each in collisions], dtype=np.int64).reshape(-1, 2)
        asked = np.concatenate([closest, loose[near_by.first]])
        settled = closures.settled
        covariances = settled.covariances(asked) * closures.drift_scale**2
        allowances = settled.model.units.allowances_m(covariances)
        return cls(
            pose_graph=pose_graph,
            integrity=integrity,
            track=track,
            closures=closures,
            settled=settled,
            predicted={
                pair: (covariance, allowance)
                for pair, covariance, allowance in zip(
                    map(tuple, asked.tolist()), covariances, allowances.tolist(), strict=True
                )
            },
            collisions=collisions,
            far=far,
            loose=loose,
            near_by=near_by,
            labels=pose_graph.labels,
            positions=np.array([pose.translation() for pose in settled.poses]),
        )

    def places(self) -> list[Place]:
        """All places, gravest kinds first, among equals by the overlaps that a tie explains."""
        found = [self._collision(each) for each in self.collisions]
        found += [*self._untied_passes(), *self._fusion()]
        explained = np.concatenate([self.pose_graph.edges, self.integrity.fusion_edges])
        gains = _gains(len(self.pose_graph), explained, [place.revisit.closest for place in found])
        found = [replace(place, gain=gain) for place, gain in zip(found, gains, strict=True)]
        return sorted(found, key=lambda place: (GRAVITY[place.kind], -len(place.edges)))

    def _collision(self, contact: Revisit) -> Place:
        """The place of overlaps that nothing explains."""
        kind: Kind
        probability = self._probability(contact)
        if self._is_gap(contact):
            kind = "tracking gap"
        elif self._is_folded(contact):
            kind = "likely false closure"
        elif probability < DECIDED:
            kind = "undecided contact"
        else:
            kind = "different view" if self._is_elsewhere(contact) else "missed closure"
        return self._place(kind, contact, self.integrity.collisions, probability)

    def _is_gap(self, contact: Revisit) -> bool:
        """Whether the track itself breaks off here and goes on beside."""
        i, j = contact.edges.T
        keys, chain = self.pose_graph.keys, self.track.chain
        same_sensor = keys[i] >> np.uint64(56) == keys[j] >> np.uint64(56)
        return bool((same_sensor & (chain[i] != chain[j]) & (j - i <= 2 * WINDOW)).any())

    def _is_folded(self, contact: Revisit) -> bool:
        """Whether the stretches touch only with the false closures."""
        if not self.closures.is_false.any():
            return False
        i, j = contact.edges.T
        reach = self.pose_graph.radii[i] + self.pose_graph.radii[j]
        return not (np.linalg.norm(self.positions[i] - self.positions[j], axis=1) <= reach).any()

    def _is_elsewhere(self, contact: Revisit) -> bool:
        """Whether the stretches lie where the map says, and neither sees landmarks of the other."""
        sightings, pair = self.pose_graph.sightings, contact.closest
        if self._rise_m(contact):
            return True
        if sightings is None or not self._allowance_m(pair) <= UNTIED * self._reach_m(pair):
            return False
        return without_common_view(sightings, self.pose_graph.positions, contact.resolved)

    def _rise_m(self, contact: Revisit) -> float:
        """Height of the later stretch above the earlier where they are on different levels, else 0."""
        pair, pose_graph = contact.closest, self.pose_graph
        covariance, _ = self.predicted[pair]
        return rise_m(self.settled, pose_graph.positions, pose_graph.radii, contact.resolved, pair, covariance)

    def _probability(self, contact: Revisit) -> float:
        """Probability that the two stretches run through the same space; a half where no tie leads between them."""
        share = self.share(contact)
        return same_space(share) if np.isfinite(share) else 0.5

    def share(self, contact: Revisit) -> float:
        """Share of the positions that the drift allows in which the two stretches meet; NaN where nothing predicts."""
        covariance, allowance = self.predicted[contact.closest]
        if not np.isfinite(allowance):
            return np.nan
        settled, anchor = self.settled, contact.closest[1]
        return meeting_share(
            settled.poses,
            self.positions,
            self.pose_graph.radii,
            self.track,
            contact.stretches,
            anchor,
            covariance,
        )

    def _untied_passes(self) -> list[Place]:
        """Explained overlaps between which the drift allows more than the spheres reach."""
        # how much more, where overlaps were sampled
        sampled, cell_of = self.loose[self.near_by.first], self.near_by.cell_of
        reach = self.pose_graph.radii[sampled].sum(axis=1)
        allowed = np.array([self._allowance_m(tuple(pair)) for pair in sampled.tolist()])
        excess = np.divide(allowed, reach, out=np.zeros_like(reach), where=reach > 0)

        # the passes of such overlaps, loosest first
        untied = np.flatnonzero((excess > UNTIED)[cell_of])
        groups = neighbourhoods(self.loose[untied], places_on(self.pose_graph, self.track), SAMPLED).group_of
        passes = [untied[groups == group] for group in range(groups.max(initial=-1) + 1)]
        passes.sort(key=lambda own: -excess[cell_of[own]].max())

        # a place for all that one tie holds
        found = []
        for together in by_later_stretch(passes, self.loose):
            loosest = sampled[cell_of[together[0]][np.argmax(excess[cell_of[together[0]]])]]
            resolved = self.loose[np.concatenate(together)]
            contact = revisit(self.pose_graph, self.track, self.loose[together[0]], resolved, loosest)
            kind: Kind = "untied second pass"
            if self._is_folded(contact):
                kind = "likely false closure"
            elif self._rise_m(contact):
                kind = "different view"
            found.append(self._place(kind, contact, self.integrity.fusion, self._probability(contact)))
        return found

    def _fusion(self) -> list[Place]:
        """The place where incomplete fusion changes the signatures most, if the change is notable."""
        fusion = self.integrity.fusion
        if not fusion.keyframe_scores.max() >= NOTABLE_FUSION or not len(self.far):
            return []
        peak = int(np.argmax(fusion.stable_scores[self.far].max(axis=1)))
        group_of = neighbourhoods(self.far, places_on(self.pose_graph, self.track), SAMPLED).group_of
        contact = revisit(self.pose_graph, self.track, self.far[group_of == group_of[peak]])
        return [self._place("incomplete fusion", contact, fusion, 1.0)]

    def _place(self, kind: Kind, contact: Revisit, distortion: Scored, probability: float) -> Place:
        """A place of a kind, without its gain."""
        # its numbers
        members = contact.keyframes
        worst = int(members[np.argmax(distortion.stable_scores[members])])
        place = Place(
            kind=kind,
            revisit=contact,
            score=float(distortion.keyframe_scores[members].max()),
            stable_score=float(distortion.stable_scores[worst]),
            worst=worst,
            scale=distortion.scale(worst),
            probability=probability,
            allowance_m=0.0 if kind == "incomplete fusion" else self._allowance_m(contact.closest),
            reach_m=self._reach_m(contact.closest),
            gain=0.0,
            rise_m=self._rise_m(contact) if kind == "different view" else 0.0,
            sentence="",
            remedy="",
            proposal=None if kind in ("incomplete fusion", "different view") else self._proposal(contact.closest),
            closure=self._blamed(contact) if kind == "likely false closure" else None,
        )

        # the words that they make
        sentence, remedy = words.place_words(place, self.labels)
        return replace(place, sentence=sentence, remedy=remedy)

    def _blamed(self, contact: Revisit) -> tuple[int, int]:
        """The false closure whose ends lie nearest to the contact's ends on the track."""
        false = self.closures.pairs[self.closures.is_false]
        way = self.track.way_m
        first, second = false[np.abs(way[false] - way[list(contact.closest)]).sum(axis=1).argmin()].tolist()
        return first, second

    def _allowance_m(self, pair: tuple[int, ...]) -> float:
        return self.predicted[pair][1]

    def _reach_m(self, pair: tuple[int, int]) -> float:
        return float(self.pose_graph.radii[list(pair)].sum())

    def _proposal(self, pair: tuple[int, int]) -> Proposal | None:
        covariance, shift_m = self.predicted[pair]
        if np.isnan(covariance).any():
            return None
        own = np.arange(len(covariance))[self.settled.model.units.translation]
        turn = np.setdiff1d(np.arange(len(covariance)), own)
        turned = np.linalg.eigvalsh(covariance[np.ix_(turn, turn)])[-1]
        if turned < 0:  # rounding beside measurements far beyond the map
            return None

        # from the model's frames to the caller's
        first, second = (self.settled.poses[k] for k in pair)
        turn = self.settled.model.units.levelling
        carry = turn.AdjointMap()
        return Proposal(
            keyframes=pair,
            pose=turn.compose(first.between(second)).compose(turn.inverse()),
            covariance=carry @ covariance @ carry.T,
            sigma_m=shift_m,
            sigma_deg=float(np.degrees(np.sqrt(turned))),
            search_m=SEARCH * shift_m,
        )


def by_later_stretch(passes: list[NDArray[np.int64]], overlaps: Pairs) -> list[list[NDArray[np.int64]]]:
    """Passes that a common tie holds: a pass runs beside several earlier passes, and a tie to any of the earlier holds
    all.

    Passes are given and grouped loosest first. A pass joins a group if at least half of the shorter of the two later
    stretches is common to both; ties between the earlier passes belong to other groups.

    Parameters
    ----------
    passes : list of (k,) int
        Rows of the overlaps of each pass.
    overlaps : (n, 2) int
        Keyframes, i < j.
    """
    groups: list[list[NDArray[np.int64]]] = []
    ranges: list[tuple[int, int]] = []
    for own in passes:
        low, high = int(overlaps[own, 1].min()), int(overlaps[own, 1].max())
        for group, (first, last) in zip(groups, ranges, strict=True):
            common = min(high, last) - max(low, first) + 1
            if 2 * common >= min(high - low, last - first) + 1:
                group.append(own)
                break
        else:
            groups.append([own])
            ranges.append((low, high))
    return groups


def _tied_near_by(
    overlaps: Pairs, radii: NDArray[np.float64], model: DriftModel, active: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Overlaps with a tie between the two stretches so near on both that the drift in between does not matter, (k,).

    A unit of way along the track is five keyframes or 5 ρ. From a tie at that distance on both stretches a position is
    off by √(0.125² + (5 · 0.075)² + 2 · (0.03² · 5 + 0.03² · 5³ / 3)) = 0.5 ρ, and so by less than spheres that reach
    farther than `CLEAR`.
    """
    along, pairs = model.along, model.ties.pairs[active]
    across = pairs[np.abs(along[pairs[:, 1]] - along[pairs[:, 0]]) > 1.0]
    if not len(across) or not len(overlaps):
        return np.zeros(len(overlaps), dtype=bool)
    distances, _ = KDTree(along[across]).query(along[overlaps], p=np.inf)
    return np.asarray((distances <= 1.0) & (radii[overlaps].sum(axis=1) >= CLEAR * model.units.unit_m))


def _gains(n: int, edges: Pairs, pairs: list[tuple[int, int]]) -> list[float]:
    """ln(1 + R) of some pairs, R the effective resistance between the two keyframes; infinite between parts.

    One keyframe of each part is tied to the ground. A pair costs its way to the root of the elimination, not the map.
    """
    if not pairs:
        return []
    edges = pairs_of(np.unique(codes_of(edges, n)), n)
    _, part = connected_components(n, edges)
    diagonal = np.bincount(edges.ravel(), minlength=n).astype(float)
    diagonal[np.unique(part, return_index=True)[1]] += 1.0
    factor = factorise(analyse(n, edges), diagonal[:, None, None], edges, np.full((len(edges), 1, 1), -1.0))

    # from one end of each pair to the other
    ends = np.array(pairs)
    along = np.broadcast_to(np.array([1.0, -1.0])[:, None, None], (len(pairs), 2, 1, 1))
    gains = np.log1p(own_products(factor, ends, along)[:, 0, 0])
    return [float(gain) if part[i] == part[j] else np.inf for gain, (i, j) in zip(gains, pairs, strict=True)]
