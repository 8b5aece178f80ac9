"""The map before any candidate: read, modelled and settled once, for any number of closures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import Keyframes, read_keyframes
from pgti_gtsam.drift.model import DriftModel, drift_model
from pgti_gtsam.drift.settled import Settled, settle
from pgti_gtsam.drift.ties import Offered
from pgti_gtsam.gate.candidates import agreeing, implied_tie, measured_ties
from pgti_gtsam.gate.scored_map import ScoredMap
from pgti_gtsam.gate.terms.contact_rise import Contacts, contacts
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.track import Track, track_of


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceMap:
    """A map that closures are weighed against.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
    keyframes : Keyframes
        Of the estimate.
    pose_graph : PoseGraph
        The map as the gate reads it.
    settled : Settled
        The drift model of all ties.
    beta : float
        β of Λ_glob.
    """

    graph: gtsam.NonlinearFactorGraph
    keyframes: Keyframes
    pose_graph: PoseGraph
    settled: Settled
    beta: float

    @classmethod
    def of(
        cls, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, pose_graph: PoseGraph, beta: float
    ) -> ReferenceMap:
        """Settle the drift model of a map.

        Parameters
        ----------
        graph, values
        pose_graph : PoseGraph
        beta : float
            Share of the times that is local.

        Raises
        ------
        NoRadiusError, UnsolvableGraphError
            As of `drift_model` and `settle`.
        """
        settled = settle(drift_model(graph, values, pose_graph))
        return cls(graph=graph, keyframes=read_keyframes(values), pose_graph=pose_graph, settled=settled, beta=beta)

    @property
    def n_ties(self) -> int:
        """Number of the map's own ties; candidates follow."""
        return len(self.settled.active)

    @property
    def _own(self) -> PoseGraph:
        """The map's own pose graph, where the drift model has the keyframes."""
        return self.drawn(self.settled.model, self.settled.poses, self.settled.active)

    @cached_property
    def contacts(self) -> Contacts:
        """The pairs of keyframes that are connected, and those that only touch, at the drift model's optimum."""
        return contacts(self._own)

    @cached_property
    def track(self) -> Track:
        """The track of the map's own keyframes."""
        return track_of(self.pose_graph)

    @cached_property
    def scored(self) -> ScoredMap:
        """The same map factorised, for Λ and Λ_glob of maps that differ by a few edges."""
        return ScoredMap.of(self._own, self.beta)

    def offered(self, closures: Sequence[gtsam.NonlinearFactorGraph]) -> tuple[Settled, list[list[int]]]:
        """The map with given closures as ties that do not hold yet, and the ties of each closure.

        Sightings of landmarks count as the relative pose that they imply; a closure that ties no two keyframes is no
        tie.
        """
        ties = [measured_ties(each, self.keyframes) or self._implied(each) for each in closures]
        ends = self.n_ties + np.cumsum([0, *map(len, ties)])
        rows = [list(range(a, b)) for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]
        return self.settled.extended([tie for own in ties for tie in own]), rows

    def _implied(self, closure: gtsam.NonlinearFactorGraph) -> list[Offered]:
        tie = implied_tie(closure, self.graph, self.keyframes, self.settled.model.units.unit_m)
        return [] if tie is None else [tie]

    def revisits(self, offered: Settled) -> list[NDArray[np.int64]]:
        """Groups of candidate ties of a revisit that agree."""
        way = self.track.way_m / offered.model.units.unit_m
        return agreeing(offered, np.arange(self.n_ties, len(offered.active)), way)

    def drawn(self, model: DriftModel, poses: Sequence[Any], active: NDArray[np.bool_]) -> PoseGraph:
        """The pose graph with the candidates that hold, where the keyframes are then.

        Parameters
        ----------
        model : DriftModel
            With the candidates as ties.
        poses : sequence of n gtsam.Pose2 or gtsam.Pose3
        active : (m,) bool
            Ties that hold.
        """
        own, places = self.pose_graph, np.zeros((len(self.pose_graph), 3))
        centres = np.array([pose.translation() for pose in poses])
        places[:, : centres.shape[1]] = centres
        more = model.ties.pairs[self.n_ties :][active[self.n_ties :]]
        return PoseGraph(
            keys=own.keys,
            positions=places,
            radii=own.radii,
            edges=np.concatenate([own.edges, more]),
            edge_sources=np.concatenate([own.edge_sources, np.full(len(more), EdgeSource.BETWEEN, np.uint8)]),
        )
