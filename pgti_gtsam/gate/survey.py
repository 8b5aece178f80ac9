"""The map as it stands before a closure: what every candidate is weighed against, measured once."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.errors import MissingValueError
from pgti_gtsam.factor_graphs import BETWEEN, factors_of, joined, keys_of
from pgti_gtsam.gate.evidence import Contacts, contacts
from pgti_gtsam.gate.trial import anchors, largest_strain_m, optimised
from pgti_gtsam.gate.yardstick import Yardstick, yardstick
from pgti_gtsam.integrity import Integrity, assess
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.track import closure_edges

Radii = float | Mapping[int, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """A factor graph at its optimum, with all that does not depend on a candidate.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        A graph of its own, of the caller's factors.
    values : gtsam.Values
        The optimum.
    adaptation : dict
        Keyword arguments of `from_gtsam`: radii, edges, min_shared_landmarks.
    beta : float
        β of the integrity score.
    seconds : (float, float)
        Time that adaptation and optimisation took, s.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    pose_graph: PoseGraph
    adaptation: dict[str, Any]
    beta: float
    seconds: tuple[float, float]

    @cached_property
    def contacts(self) -> Contacts:
        """Connected and touching keyframes."""
        return contacts(self.pose_graph)

    @cached_property
    def yardstick(self) -> Yardstick:
        """The map as an elastic body."""
        return yardstick(self.pose_graph, self.values)

    @cached_property
    def integrity(self) -> Integrity:
        """PGTI of the map."""
        return assess(self.pose_graph, beta=self.beta)

    @cached_property
    def held(self) -> gtsam.NonlinearFactorGraph:
        """A prior for every component that the graph itself holds by none."""
        return anchors(self.graph, self.values)

    @cached_property
    def strain_m(self) -> float:
        """Largest translation residual of any closure."""
        return largest_strain_m(self.closures, self.values)

    @cached_property
    def closures(self) -> list[Any]:
        """The closures that the map already has."""
        slots, closing = self.pose_graph.edge_slots, closure_edges(self.pose_graph)
        return [self.graph.at(slot) for k in np.flatnonzero(closing).tolist() for slot in slots[k]]

    def adapted(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> PoseGraph:
        """Pose graph of another graph, adapted as this one was."""
        return from_gtsam(graph, values, **self.adaptation)

    def with_closure(self, closure: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> PoseGraph:
        """Pose graph with a closure at new values.

        Where no landmark is seen, a closure of between factors only moves keyframes and adds edges.
        """
        seen = self.pose_graph.adaptation is not None and self.pose_graph.adaptation.n_observations
        factors = factors_of(closure)
        if seen or not all(isinstance(factor, BETWEEN) for factor in factors):
            return self.adapted(joined(self.graph, closure), values)
        moved = read_keyframes(values)
        pairs = [[moved.index[key] for key in keys_of(factor)] for factor in factors]
        ties = np.array([pair for pair in pairs if pair[0] != pair[1]], dtype=np.int64).reshape(-1, 2)
        old = self.pose_graph
        return PoseGraph(
            keys=old.keys,
            positions=moved.positions,
            radii=old.radii,
            edges=np.concatenate([old.edges, ties]),
            edge_sources=np.concatenate([old.edge_sources, np.full(len(ties), EdgeSource.BETWEEN, np.uint8)]),
        )


def survey(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    radii: Radii | None = None,
    *,
    edges: Collection[str] | None = None,
    min_shared_landmarks: int,
    beta: float,
) -> Survey:
    """Bring a copy of the map to its optimum, and adapt it.

    Raises
    ------
    UnsolvableGraphError
    PgtiError
        Those of `from_gtsam`.
    """
    adaptation: dict[str, Any] = {"radii": radii, "edges": edges, "min_shared_landmarks": min_shared_landmarks}
    _check_values(graph, values)
    started = time.perf_counter()
    own = joined(graph)
    best = optimised(own, values)
    optimal = time.perf_counter()
    pose_graph = from_gtsam(own, best, **adaptation)
    return Survey(
        graph=own,
        values=best,
        pose_graph=pose_graph,
        adaptation=adaptation,
        beta=beta,
        seconds=(time.perf_counter() - optimal, optimal - started),
    )


def _check_values(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Refuse, in words plainer than the optimiser's, values that are missing or not finite."""
    missing = next((key for key in graph.keyVector() if not values.exists(key)), None)
    if missing is not None:
        raise MissingValueError(
            f"expected a value for every key, got none for {gtsam.DefaultKeyFormatter(missing)}; "
            "add it to the values or remove its factors"
        )
    read_keyframes(values)
