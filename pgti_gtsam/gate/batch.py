"""A whole graph through the gate: the robust alternative to handing everything to the optimiser."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.adapter.families import Family, family_of
from pgti_gtsam.adapter.values import measures_pose, typed_value
from pgti_gtsam.checks import shown
from pgti_gtsam.drift.settled import Settled
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import check_map, checked_closure, graph_of, without
from pgti_gtsam.gate.decision import ClosureDecision
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.pose_graph import PoseGraph, Radii, key_label
from pgti_gtsam.track import closure_edges


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GatedGraph:
    """A graph with only the closures that passed.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        A new graph of the same factors in the same slots; slots of closures that did not pass are empty.
    values : gtsam.Values
        Its optimum.
    decisions : dict of int to ClosureDecision
        By slot of the closure.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    decisions: Mapping[int, ClosureDecision]

    @property
    def accepted(self) -> tuple[int, ...]:
        """Slots of the closures that passed."""
        return tuple(slot for slot, decision in self.decisions.items() if decision.accepted)

    @property
    def rejected(self) -> tuple[int, ...]:
        """Slots of the closures that did not."""
        return tuple(slot for slot, decision in self.decisions.items() if not decision.accepted)


def closure_ends(
    pose_graph: PoseGraph, graph: gtsam.NonlinearFactorGraph, closures: Collection[int] | None = None
) -> dict[int, tuple[int, int]]:
    """Slots of the loop closures, with the indices of their keyframes in the order of the keys, i < j.

    Without `closures`, factors that are no odometry (see `track.roles`) and measure poses or are of an unknown class.

    Parameters
    ----------
    pose_graph : PoseGraph
    graph : gtsam.NonlinearFactorGraph
    closures : collection of int, optional
        Slots; None for those factors.
    """
    closing = closure_edges(pose_graph) if closures is None else np.ones(len(pose_graph.edges), dtype=bool)
    rows = np.flatnonzero(closing).tolist()
    ends = {slot: tuple(pose_graph.edges[k].tolist()) for k in rows for slot in pose_graph.edge_slots[k]}
    chosen = (slot for slot in ends if _may_close(graph.at(slot))) if closures is None else set(closures)
    return {slot: ends[slot] for slot in sorted(chosen)}


def _may_close(factor: Any) -> bool:
    return measures_pose(factor) or family_of(type(factor).__name__) is Family.UNKNOWN


def gate_graph(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    radii: Radii | None = None,
    *,
    closures: Collection[int] | None = None,
    gate: LoopClosureGate | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> GatedGraph:
    """Judge every loop closure of a finished graph. Graph and values stay untouched.

    The surest revisit is tied first, and the others are asked again: see `admission`. Values that false closures have
    bent do no harm: the map starts as its odometry draws it.

    Parameters
    ----------
    graph, values, radii
        As in `from_gtsam`.
    closures : collection of int, optional
        Slots of the loop closures. Without, they are the between factors that `track.roles` does not take for
        odometry.
    gate : LoopClosureGate, optional
    progress : callable
        Called with the number of closures judged and of all.

    Raises
    ------
    PgtiError
        As of `from_gtsam`; `UnsolvableGraphError` where the map without closures has no optimum;
        `InvalidOptionError` where without the closures nothing ties some keyframe.
    """
    check_map(graph, values)
    gate = checked_gate(gate)
    whole = gate.adapted(graph, values, radii, closures)
    slots = list(closure_ends(whole, graph, closures))
    alone = without(graph, slots)
    _check_tied(alone, whole)
    offered = [checked_closure(graph.at(slot), values) for slot in slots]
    reference = gate.reference_map(alone, values, radii, None if closures is None else ())
    judged = gate.judge(reference, offered, progress)
    decisions = dict(zip(slots, judged.decisions, strict=True))
    passed = without(graph, [slot for slot, decision in decisions.items() if not decision.accepted])
    return GatedGraph(graph=passed, values=optimum(passed, values, judged.settled, whole), decisions=decisions)


def checked_gate(gate: LoopClosureGate | None) -> LoopClosureGate:
    """The gate, by default with default options; raises InvalidOptionError."""
    if not isinstance(gate, LoopClosureGate | None):
        raise InvalidOptionError(f"expected a LoopClosureGate as the gate, got {shown(gate)}")
    return gate or LoopClosureGate()


def leave_one_out(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    radii: Radii | None = None,
    *,
    closures: Collection[int] | None = None,
    gate: LoopClosureGate | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[dict[int, ClosureDecision], list[int]]:
    """Judge every loop closure of a finished graph against the map with all the others, each by itself.

    The whole map is optimised once, the start of every map without a single closure. False closures
    that agree support each other here: use `gate_graph` for such maps.

    Parameters
    ----------
    graph, values, radii, closures, gate, progress
        As in `gate_graph`.

    Returns
    -------
    decisions : dict of int to ClosureDecision
        By slot.
    alone : list of int
        Slots of closures without which a keyframe would hang on nothing: no map exists without such a closure.
    """
    gate = checked_gate(gate)
    slots = list(closure_ends(gate.adapted(graph, values, radii, closures), graph, closures))
    best = optimised(graph, values) if slots else values
    decisions, alone = {}, []
    for done, slot in enumerate(slots):
        closure, rest = graph_of([graph.at(slot)]), without(graph, [slot])
        if set(rest.keyVector()).issuperset(closure.keyVector()):
            decisions[slot] = gate.evaluate(rest, best, closure, radii)
        else:
            alone.append(slot)
        progress(done + 1, len(slots))
    return decisions, alone


def optimum(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, settled: Settled, pose_graph: PoseGraph
) -> gtsam.Values:
    """Optimum in the caller's noise models: from where the drift model has the keyframes, if the map is of poses.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
    settled : Settled
    pose_graph : PoseGraph
    """
    start = gtsam.Values(values)
    if values.size() == len(pose_graph):
        turn = settled.model.units.levelling.inverse()
        for key, pose in zip(pose_graph.keys.tolist(), settled.poses, strict=True):
            if typed_value(values, type(pose).__name__, key) is not None:
                start.update(key, pose.compose(turn))
    return optimised(graph, start)


def _check_tied(graph: gtsam.NonlinearFactorGraph, pose_graph: PoseGraph) -> None:
    tied = set(graph.keyVector())
    free = next((int(key) for key in pose_graph.keys if int(key) not in tied), None)
    if free is not None:
        raise InvalidOptionError(
            f"expected every keyframe to be tied by more than loop closures, got {key_label(free)}, which only they "
            "tie; add its odometry, or gate closures one by one with LoopClosureGate"
        )
