"""A map with and without a candidate closure, as PGTI sees the map: contacts, Λ and Λ_glob."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.drift.settled import Settled, settle
from pgti_gtsam.gate.decision import Change
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.scored_map import ScoredMap
from pgti_gtsam.gate.terms.contact_rise import Contacts, contacts
from pgti_gtsam.integrity import Integrity, assess
from pgti_gtsam.pose_graph import PoseGraph


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidateMaps:
    """Maps with any of the candidates.

    Attributes
    ----------
    reference : ReferenceMap
        Without any.
    offered : Settled
        The same with the candidates as ties that do not hold.
    """

    reference: ReferenceMap
    offered: Settled

    def contacts(self, settled: Settled) -> Contacts:
        """The pairs of keyframes that are connected, and those that only touch."""
        if settled.poses is self.reference.settled.poses:
            return self.reference.contacts
        return contacts(self._drawn(settled))

    def integrity(self, settled: Settled) -> Integrity:
        """PGTI of the map."""
        return assess(self._drawn(settled), beta=self.reference.beta)

    def scores(self, active: NDArray[np.bool_], revisits: Sequence[NDArray[np.int64]]) -> list[tuple[Change, Change]]:
        """Λ and Λ_glob without and with each of some revisits, with all else as in the final map.

        Parameters
        ----------
        active : (m,) bool
            Ties that hold in the end.
        revisits : sequence of (g,) int
            Ties of each.
        """
        # one map is factorised: for a lone revisit that which is kept, else the last one
        lone = len(revisits) == 1
        base = self.offered if lone else settle(self.offered.model, active, self.offered)
        scored = self.reference.scored if lone else ScoredMap.of(self._drawn(base), self.reference.beta)

        # the other side of each
        changes = []
        for ties in revisits:
            other = scored.scores_of(self.reference.drawn(base.model, *base.toggled(ties)))
            before, after = (other, scored.scores) if base.active[ties].all() else (scored.scores, other)
            changes.append((Change(before=before[0], after=after[0]), Change(before=before[1], after=after[1])))
        return changes

    def _drawn(self, settled: Settled) -> PoseGraph:
        return self.reference.drawn(settled.model, settled.poses, settled.active)
