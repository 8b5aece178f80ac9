"""The map with some candidate closures, as PGTI sees it: contacts and scores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.gate.decision import Change
from pgti_gtsam.gate.drift_model import Settled
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.terms.contact_rise import Contacts, contacts
from pgti_gtsam.integrity import Integrity, assess


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidateMaps:
    """Maps with any of the candidates.

    Attributes
    ----------
    reference : ReferenceMap
        Without any.
    beta : float
        As in `assess`.
    """

    reference: ReferenceMap
    beta: float

    def contacts(self, settled: Settled) -> Contacts:
        """Which keyframes are connected, and which only touch."""
        if settled.poses is self.reference.settled.poses:
            return self.reference.contacts
        return contacts(self.reference.drawn(settled))

    def integrity(self, settled: Settled) -> Integrity:
        """PGTI of the map."""
        return assess(self.reference.drawn(settled), beta=self.beta)

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
