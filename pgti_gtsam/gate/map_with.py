"""The map with some candidate closures, drawn at the drift model's optimum, as PGTI sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.gate.decision import Change
from pgti_gtsam.gate.drift_model import Settled
from pgti_gtsam.gate.terms.contact_rise import Contacts, contacts
from pgti_gtsam.integrity import Integrity, assess
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapWith:
    """A map without candidates, and how to draw it with some.

    Attributes
    ----------
    pose_graph : PoseGraph
        Without any candidate.
    first : int
        Ties of the drift model from this one on are candidates.
    beta : float
        As in `assess`.
    """

    pose_graph: PoseGraph
    first: int
    beta: float

    def drawn(self, settled: Settled) -> PoseGraph:
        """The pose graph with the candidates that hold."""
        own, places = self.pose_graph, np.zeros((len(self.pose_graph), 3))
        centres = np.array([pose.translation() for pose in settled.poses])
        places[:, : centres.shape[1]] = centres
        more = settled.model.ties.pairs[self.first :][settled.active[self.first :]]
        return PoseGraph(
            keys=own.keys,
            positions=places,
            radii=own.radii,
            edges=np.concatenate([own.edges, more]),
            edge_sources=np.concatenate([own.edge_sources, np.full(len(more), EdgeSource.BETWEEN, np.uint8)]),
        )

    def contacts(self, settled: Settled) -> Contacts:
        """Which keyframes are connected, and which only touch."""
        return contacts(self.drawn(settled))

    def integrity(self, settled: Settled) -> Integrity:
        """PGTI of the map."""
        return assess(self.drawn(settled), beta=self.beta)

    def scores(self, settled: Settled, ties: NDArray[np.int64]) -> tuple[Change, Change]:
        """Λ and Λ_glob of the map without and with some of the candidates, all else as it is."""
        found = []
        for held in (False, True):
            active = settled.active.copy()
            active[ties] = held
            integrity = self.integrity(settled.model.settled(active, settled))
            found.append((integrity.score, integrity.split(self.beta).global_))
        (score, global_), (new_score, new_global) = found
        return Change(before=score, after=new_score), Change(before=global_, after=new_global)
