"""Stretches of track in contact: of which kind each contact is, by how far the drift allows the two to lie apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.special import expit

from pgti_gtsam.diagnosis import words
from pgti_gtsam.diagnosis.records import Kind, Place, Proposal
from pgti_gtsam.gate.drift_model import DriftModel, Settled
from pgti_gtsam.gate.own_closures import OwnClosures
from pgti_gtsam.integrity import Distortion, Integrity, relative_distortion
from pgti_gtsam.places import WINDOW, Revisit, grouped, places_on, revisit, revisits
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.laplacian import connected_components, laplacian
from pgti_gtsam.track import Track, track_of

CONTACT = (5.4, 0.8, -2.5)
"""Log odds that two stretches in contact run through the same space: c₀ + c₁ ln ℓ + c₂ ln s, with ℓ the length of the
shorter stretch and s the drift's standard deviation between them, both in units of what their spheres reach. Fitted to
2804 contacts in odometry through the seven ray-cast worlds (seeds 1000 to 1015, drift of 0.5 to 3 times the simulator's),
of which 94 % were real: a long parallel contact is hardly ever chance, a short one after a long drive often is."""

SHORTEST, LEAST_DRIFT = 0.5, 0.3
"""Least ℓ and s: below, the fit had no contacts to tell by."""

DECIDED = 0.75
"""Probability from which a contact is called real; below its complement it is called chance."""

UNTIED = 1.0
"""Allowance of the drift, in what two spheres reach, beyond which overlaps that are explained are not tied. Of the
explained overlaps of nine intact graphs none has more than 0.8."""

SAMPLED = 2000
"""Explained overlaps at most whose allowance is asked for: one for each neighbourhood on both stretches."""

NOTABLE_FUSION = 0.26
"""ζ of incomplete fusion from which its worst place is named: between the largest Λ that the paper's Table 4 calls
harmless (KITTI-18, 0.1708) and the one that it calls moderate (Campus-9, 0.3890)."""

SEARCH = 3.0
"""Radius of the sphere to search a tie in, in standard deviations of the predicted position."""

GRAVITY: dict[Kind, int] = {
    "likely false closure": 0,
    "collision by drift": 1,
    "undecided contact": 2,
    "missed closure": 3,
    "untied second pass": 4,
    "tracking gap": 5,
    "incomplete fusion": 6,
}
"""Order in which places are listed."""

Pairs = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """A map with its contacts: what every place is measured by.

    Attributes
    ----------
    pose_graph, integrity, track
        The map as PGTI sees it.
    closures : OwnClosures
    settled : Settled
        The drift model without the false closures.
    collisions : list of Revisit
    sampled : (k, 2) int
        An explained overlap of every neighbourhood on two stretches that are far apart on the track.
    far : (f, 2) int
        All such explained overlaps, with the row of their sample in `sample_of`, (f,).
    """

    pose_graph: PoseGraph
    integrity: Integrity
    track: Track
    closures: OwnClosures
    settled: Settled
    collisions: list[Revisit]
    sampled: Pairs
    far: Pairs
    sample_of: NDArray[np.int64]

    @classmethod
    def of(
        cls, pose_graph: PoseGraph, integrity: Integrity, model: DriftModel, closures: OwnClosures
    ) -> Contacts:
        """Group the collisions, sample the explained overlaps, and ask the drift model for both."""
        track = track_of(pose_graph)
        collisions = revisits(pose_graph, integrity, track)
        far, sampled, sample_of = _sampled(integrity.fusion_edges, places_on(pose_graph, track))
        asked = np.concatenate([np.array([each.closest for each in collisions], dtype=np.int64).reshape(-1, 2), sampled])
        active = np.ones(len(model.ties.pairs), dtype=bool)
        active[closures.ties[closures.is_false]] = False
        return cls(
            pose_graph=pose_graph,
            integrity=integrity,
            track=track,
            closures=closures,
            settled=model.settled(active, asked=asked, start=closures.settled),
            collisions=collisions,
            sampled=sampled,
            far=far,
            sample_of=sample_of,
        )

    @property
    def explained(self) -> Pairs:
        """E_e."""
        return np.concatenate([self.pose_graph.edges, self.integrity.fusion_edges])

    def places(self) -> list[Place]:
        """All places, gravest kinds first, among equals those that a tie explains most overlaps of."""
        found = [self._collision(each) for each in self.collisions]
        found += self._untied_passes()
        found += self._fusion()
        return sorted(found, key=lambda place: (GRAVITY[place.kind], -len(place.edges)))

    def _collision(self, contact: Revisit) -> Place:
        allowance = self._allowance_m(contact.closest)
        return self._place(self._kind(contact, allowance), contact, allowance, self.integrity.collisions)

    def _kind(self, contact: Revisit, allowance_m: float) -> Kind:
        """Of which kind overlaps are that nothing explains."""
        if self._is_gap(contact):
            return "tracking gap"
        if self.closures.is_false.any() and not self._stays(contact):
            return "likely false closure"
        probability = self.probability(contact, allowance_m)
        if probability >= DECIDED:
            return "missed closure"
        return "collision by drift" if probability <= 1 - DECIDED else "undecided contact"

    def _is_gap(self, contact: Revisit) -> bool:
        """Whether the track itself breaks off here and goes on beside."""
        i, j = contact.edges.T
        same_sensor = self.pose_graph.keys[i] >> np.uint64(56) == self.pose_graph.keys[j] >> np.uint64(56)
        return bool(((j - i <= 2 * WINDOW) & (self.track.chain[i] != self.track.chain[j]) & same_sensor).any())

    def _stays(self, contact: Revisit) -> bool:
        """Whether the stretches touch without the false closures too."""
        i, j = contact.edges.T
        places = np.array([pose.translation() for pose in self.settled.poses])
        reach = self.pose_graph.radii[i] + self.pose_graph.radii[j]
        return bool((np.linalg.norm(places[i] - places[j], axis=1) <= reach).any())

    def probability(self, contact: Revisit, allowance_m: float) -> float:
        """Probability that the two stretches run through the same space."""
        reach = self._reach_m(contact.closest)
        length = max(min(contact.lengths_m) / reach, SHORTEST)
        if not np.isfinite(allowance_m):
            return 0.5  # where one part lies to the other is not known
        drift = max(allowance_m / reach, LEAST_DRIFT)
        return float(expit(CONTACT[0] + CONTACT[1] * np.log(length) + CONTACT[2] * np.log(drift)))

    def _untied_passes(self) -> list[Place]:
        """Explained overlaps between which the drift allows more than the spheres reach."""
        if not len(self.sampled):
            return []
        allowances = self.settled.allowances_m(self.sampled) * self.closures.drift_scale
        reach = self.pose_graph.radii[self.sampled].sum(axis=1)
        excess = np.divide(allowances, reach, out=np.zeros_like(reach), where=reach > 0)
        untied = self.far[(excess > UNTIED)[self.sample_of]]
        groups = grouped(untied, places_on(self.pose_graph, self.track))
        found = []
        for group in range(groups.max(initial=-1) + 1):
            pairs = untied[groups == group]
            own = np.unique(self.sample_of[(excess > UNTIED)[self.sample_of]][groups == group])
            loosest = own[np.argmax(excess[own])]
            contact = revisit(self.pose_graph, self.track, pairs, tied_at=self.sampled[loosest])
            found.append(
                self._place("untied second pass", contact, float(allowances[loosest]), self.integrity.fusion)
            )
        return found

    def _fusion(self) -> list[Place]:
        """The place where incomplete fusion changes Λ most, if it does so notably."""
        fusion = self.integrity.fusion
        if fusion.score < NOTABLE_FUSION or not len(self.far):
            return []
        groups = grouped(self.far, places_on(self.pose_graph, self.track)) if len(self.far) < 20_000 else self.sample_of
        peak = np.argmax(fusion.stable_scores[self.far].max(axis=1))
        contact = revisit(self.pose_graph, self.track, self.far[groups == groups[peak]], tied_at=self.sampled[self.sample_of[peak]])
        return [self._place("incomplete fusion", contact, self._allowance_m(contact.closest), fusion)]

    def _place(self, kind: Kind, contact: Revisit, allowance_m: float, distortion: Distortion) -> Place:
        members = contact.keyframes
        worst = int(members[np.argmax(distortion.stable_scores[members])])
        is_real = kind in ("missed closure", "untied second pass", "tracking gap", "incomplete fusion")
        probability = self.probability(contact, allowance_m)
        numbers = {
            "kind": kind,
            "revisit": contact,
            "score": float(distortion.keyframe_scores[members].max()),
            "stable_score": float(distortion.stable_scores[worst]),
            "worst": worst,
            "scale": _scale(distortion, worst),
            "probability": max(probability, DECIDED) if is_real else probability,
            "allowance_m": allowance_m,
            "reach_m": self._reach_m(contact.closest),
            "gain": _gain(len(self.pose_graph), self.explained, contact.closest),
            "proposal": None if kind == "incomplete fusion" else self._proposal(contact.closest),
        }
        labels = self.pose_graph.labels
        worst_closure = self._blamed(contact) if kind == "likely false closure" else None
        return Place(**numbers, **words.place_words(numbers, labels, worst_closure))

    def _blamed(self, contact: Revisit) -> tuple[int, int]:
        """The false closure that spans most of what lies between the two stretches."""
        false = self.closures.pairs[self.closures.is_false]
        i, j = contact.closest
        common = np.minimum(false[:, 1], j) - np.maximum(false[:, 0], i)
        union = np.maximum(false[:, 1], j) - np.minimum(false[:, 0], i)
        blamed = false[np.argmax(common / union)]
        return int(blamed[0]), int(blamed[1])

    def _allowance_m(self, pair: tuple[int, int]) -> float:
        return float(self.settled.allowances_m(np.array([pair]))[0] * self.closures.drift_scale)

    def _reach_m(self, pair: tuple[int, int]) -> float:
        return float(self.pose_graph.radii[list(pair)].sum())

    def _proposal(self, pair: tuple[int, int]) -> Proposal | None:
        i, j = pair
        covariance = self.settled.covariances(np.array([pair]))[0] * self.closures.drift_scale**2
        if np.isnan(covariance).any():
            return None
        own = self.settled.model.translation
        turn = np.delete(np.arange(len(covariance)), np.arange(len(covariance))[own])
        spread, turned = (float(np.sqrt(np.linalg.eigvalsh(block)[-1])) for block in
                          (covariance[own, own], covariance[np.ix_(turn, turn)]))
        return Proposal(
            keyframes=(i, j),
            pose=self.settled.poses[i].between(self.settled.poses[j]),
            covariance=covariance,
            sigma_m=spread,
            sigma_deg=float(np.degrees(turned)),
            search_m=SEARCH * spread,
        )


def _sampled(fusion: Pairs, places: NDArray[np.float64]) -> tuple[Pairs, Pairs, NDArray[np.int64]]:
    """Explained overlaps of keyframes far apart on the track, one for each neighbourhood, and who stands for whom."""
    far = fusion[places[fusion[:, 1]] - places[fusion[:, 0]] > 2.0]
    size = 0.5
    while True:
        cells = np.floor(places[far] / size)
        _, first, sample_of = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        if len(first) <= SAMPLED:
            return far, far[first], sample_of.reshape(-1)
        size *= 1.5


def _scale(distortion: Distortion, keyframe: int) -> str:
    row = slice(keyframe, keyframe + 1)
    half = len(distortion.times) // 2
    early, late = (
        float(relative_distortion(distortion.signatures_pose_graph[row, part], distortion.signatures_merged_graph[row, part], 2)[0])
        for part in (slice(half), slice(half, None))
    )
    return "global" if late > early else "local"


def _gain(n: int, edges: Pairs, pair: tuple[int, int]) -> float:
    """ln(1 + R), R the effective resistance between two keyframes; infinite between parts."""
    _, part = connected_components(n, edges)
    if part[pair[0]] != part[pair[1]]:
        return np.inf
    grounded = laplacian(n, edges)
    ground = np.zeros(n)
    ground[np.unique(part, return_index=True)[1]] = 1.0
    current = np.zeros(n)
    current[list(pair)] = 1.0, -1.0
    potential = splu(sparse.csc_array(grounded + sparse.diags_array(ground))).solve(current)
    return float(np.log1p(potential[pair[0]] - potential[pair[1]]))
