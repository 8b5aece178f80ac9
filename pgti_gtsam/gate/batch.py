"""A whole graph through the gate: the robust alternative to handing everything to the optimiser."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import BETWEEN, graph_of, joined, without
from pgti_gtsam.gate.closure_gate import ClosureDecision, GroupDecision, LoopClosureGate
from pgti_gtsam.gate.evidence import travelled
from pgti_gtsam.gate.past import Past
from pgti_gtsam.gate.revisits import revisits
from pgti_gtsam.gate.survey import Radii
from pgti_gtsam.gate.trial import optimised
from pgti_gtsam.pose_graph import PoseGraph, key_label
from pgti_gtsam.track import closure_edges

DOUBTFUL = 0.75
"""Doubt from which an admitted revisit may be overturned by a later and larger one that it shuts out. On ray-cast
worlds (seeds 1000 to 1007 of `scenarios.worlds`) that let 287 of 294 true closures of the streets in where 236 were
without, and changed nothing elsewhere; so did 0.5, which asks more often."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GatedGraph:
    """A graph with only the closures that passed.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        A new graph of the same factors in the same slots; those of rejected closures are empty.
    values : gtsam.Values
        Its optimum.
    decisions : dict of int to ClosureDecision
        By slot of the closure.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    decisions: dict[int, ClosureDecision]

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
    """Slots of the loop closures, with the places of their keyframes in the order of the keys, i < j.

    Without `closures`, their slots, they are the between factors that are no odometry: see `track.roles`.
    """
    closing = closure_edges(pose_graph) if closures is None else np.ones(len(pose_graph.edges), dtype=bool)
    rows = np.flatnonzero(closing).tolist()
    ends = {slot: tuple(pose_graph.edges[k].tolist()) for k in rows for slot in pose_graph.edge_slots[k]}
    chosen = (slot for slot in ends if isinstance(graph.at(slot), BETWEEN)) if closures is None else set(closures)
    return {slot: ends[slot] for slot in sorted(chosen)}


def gate_graph(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    radii: Radii | None = None,
    *,
    closures: Collection[int] | None = None,
    gate: LoopClosureGate | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> GatedGraph:
    """Judge every loop closure of a finished graph. Graph and values stay untouched.

    The map grows again as it once did: each revisit is judged when its last match has come, against the
    keyframes up to there. Of a drifting map's future nothing follows for a closure, least of all from
    where second passes happen to lie that have not been tied yet. Values that false closures have bent
    do no harm: the map starts as what is left without any closure, at its own optimum.

    Parameters
    ----------
    graph, values, radii
        As in `from_gtsam`.
    closures : collection of int, optional
        Slots of the loop closures. Without, they are the between factors that `track.roles` does not take for
        odometry.
    gate : LoopClosureGate, optional
    progress : callable, optional
        Called with the number of closures judged and of all.

    Raises
    ------
    PgtiError
        Those of `from_gtsam`; `UnsolvableGraphError` where the map without closures has no optimum;
        `InvalidOptionError` where without them nothing ties some keyframe.
    """
    gate = gate or LoopClosureGate()
    pose_graph = gate.adapted(graph, values, radii, closures)
    ends = closure_ends(pose_graph, graph, closures)
    slots = list(ends)
    alone = without(graph, slots)
    _check_tied(alone, pose_graph)
    offered = [graph_of([graph.at(slot)]) for slot in slots]
    past = Past.of(alone, optimised(alone, values), pose_graph.keys, radii)
    judged, best = judge_all(gate, past, offered, list(ends.values()), progress)
    decisions = dict(zip(slots, judged, strict=True))
    rejected = [slot for slot, decision in decisions.items() if not decision.accepted]
    return GatedGraph(graph=without(graph, rejected), values=best, decisions=decisions)


def leave_one_out(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    radii: Radii | None = None,
    *,
    closures: Collection[int] | None = None,
    gate: LoopClosureGate | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[dict[int, ClosureDecision], list[int]]:
    """Judge every loop closure of a finished graph against the map with all the others.

    The whole map is brought to its optimum once, from where every map without one closure starts. False closures
    that agree vouch for each other here: those are for `gate_graph`.

    Parameters
    ----------
    graph, values, radii, closures, gate, progress
        As in `gate_graph`.

    Returns
    -------
    decisions : dict of int to ClosureDecision
        By slot.
    alone : list of int
        Slots of closures on which a keyframe hangs alone: the map cannot be had without them.
    """
    gate = gate or LoopClosureGate()
    slots = list(closure_ends(gate.adapted(graph, values, radii, closures), graph, closures))
    best = optimised(graph, values) if slots else values
    decisions, alone = {}, []
    for done, slot in enumerate(slots):
        closure, rest = graph_of([graph.at(slot)]), without(graph, [slot])
        if set(rest.keyVector()).issuperset(closure.keyVector()):
            decisions[slot] = gate.evaluate(rest, best, closure, radii)
        else:
            alone.append(slot)
        if progress:
            progress(done + 1, len(slots))
    return decisions, alone


def judge_all(
    gate: LoopClosureGate,
    past: Past,
    closures: Sequence[gtsam.NonlinearFactorGraph],
    ends: Sequence[tuple[int, int]],
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[ClosureDecision], gtsam.Values]:
    """Judge all closures of a map as it grows, revisit by revisit; returns decisions and the final optimum.

    A revisit that fails may be right where an earlier, smaller one was let in with doubt and was wrong: it is judged
    once more on the map without that one, which then has to pass after it.

    Parameters
    ----------
    gate, past, closures
    ends : sequence of (int, int)
        Earlier and later keyframe of every closure, as places in the order of the keys.
    progress : callable, optional
        Called with the number of closures judged and of all.
    """
    way = travelled(gate.adapted(past.graph, past.values, past.radii))
    decisions: dict[int, ClosureDecision] = {}
    admitted: list[list[int]] = []
    values, last = gtsam.Values(), 0
    for revisit in sorted(revisits(ends, way), key=lambda group: ends[group[0]][1]):
        last = max(last, *(ends[k][1] for k in revisit))
        graph, values, radii = past.until(last, values)
        group = gate.evaluate_group(_with(graph, closures, admitted), values, [closures[k] for k in revisit], radii)
        judged = dict(zip(revisit, group.decisions, strict=True))
        for held in [] if group.accepted else _doubtful(admitted, decisions, len(revisit)):
            rest = [other for other in admitted if other is not held]
            tried = _instead(gate, _with(graph, closures, rest), values, radii, closures, revisit, held)
            if tried is not None:
                admitted, (judged, group) = rest, tried
                break
        values = group.values
        decisions |= judged
        if any(decision.accepted for decision in judged.values()):
            admitted.append([k for k, decision in judged.items() if decision.accepted])
        if progress:
            progress(len(decisions), len(closures))
    graph, values, _ = past.until(len(past.keys) - 1, values)
    return [decisions[k] for k in range(len(closures))], optimised(_with(graph, closures, admitted), values)


def _with(
    graph: gtsam.NonlinearFactorGraph, closures: Sequence[gtsam.NonlinearFactorGraph], admitted: list[list[int]]
) -> gtsam.NonlinearFactorGraph:
    return joined(graph, *(closures[k] for held in admitted for k in held))


def _doubtful(admitted: list[list[int]], decisions: dict[int, ClosureDecision], size: int) -> list[list[int]]:
    """Admitted revisits that a rejected one of some size may overturn."""
    return [held for held in admitted if len(held) < size and max(decisions[k].doubt for k in held) > DOUBTFUL]


def _instead(
    gate: LoopClosureGate,
    rest: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    radii: Radii | None,
    closures: Sequence[gtsam.NonlinearFactorGraph],
    revisit: list[int],
    held: list[int],
) -> tuple[dict[int, ClosureDecision], GroupDecision] | None:
    """Verdicts on a revisit where another one was, and then on that one; None if the revisit fails there too."""
    before = gate.survey(rest, optimised(rest, values), radii)
    offered = [closures[k] for k in revisit]
    if not gate.judge(before, joined(*offered)).accepted:
        return None
    first = gate.judge_group(before, offered)
    second = gate.judge_group(first.survey, [closures[k] for k in held])
    return dict(zip([*revisit, *held], [*first.decisions, *second.decisions], strict=True)), second


def _check_tied(graph: gtsam.NonlinearFactorGraph, pose_graph: PoseGraph) -> None:
    tied = set(graph.keyVector())
    free = next((int(key) for key in pose_graph.keys if int(key) not in tied), None)
    if free is not None:
        raise InvalidOptionError(
            f"expected every keyframe to be tied by more than loop closures, got {key_label(free)}, which only they "
            "tie; add its odometry, or gate closures one by one with LoopClosureGate"
        )
