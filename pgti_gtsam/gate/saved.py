"""A gated smoother written down: factors, values, closures and radii, and the map kept between closures.

Factors and values are GTSAM's own text archives, which hold every number exactly; all else is JSON. iSAM2 itself has no
archive: the smoother is made anew from its factors, linearised where it was. The kept map's reference is settled anew
from the factors and the estimate at that time, so that the next verdicts equal those of a run without a break.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.errors import FileFormatError, InvalidGraphError
from pgti_gtsam.factor_graphs import factors_of, graph_of
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.grown_map import GrownMap, Tail
from pgti_gtsam.gate.history import Offer, smoother_of
from pgti_gtsam.gate.kept_map import KeptMap, Standing
from pgti_gtsam.gate.ties import Ties
from pgti_gtsam.pose_graph import Radii

SCHEMA, VERSION = "pgti-gtsam/gate-state", 1

State = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """The parts of a gated smoother, without the gate."""

    smoother: gtsam.ISAM2
    radii: Radii | None
    offers: list[Offer]
    kept: KeptMap


def encoded(parts: Parts) -> State:
    """The parts as JSON-ready state.

    Raises
    ------
    InvalidGraphError
        A factor that GTSAM has no archive of, a `gtsam.CustomFactor` say.
    """
    graph, radii = parts.smoother.getFactorsUnsafe(), parts.radii
    apart = gtsam.NonlinearFactorGraph()
    offers = [
        {"factors": _placed(offer, graph, apart), "slots": list(offer.slots), "is_waiting": offer.is_waiting}
        for offer in parts.offers
    ]

    # all of it; a map that the caller changed is not kept
    kept = parts.kept
    stands = kept.standing.is_that_of(graph)
    return {
        "schema": SCHEMA,
        "schema_version": VERSION,
        "factors": _archive(graph),
        "values": parts.smoother.getLinearizationPoint().serialize(),
        "radii": [[int(key), float(radius)] for key, radius in radii.items()] if isinstance(radii, Mapping) else radii,
        "closures": offers,
        "closures_apart": _archive(apart),
        "kept": {
            "map": _encoded_map(kept.map) if kept.map is not None and stands else None,
            "news": [[_archive(factors), values.serialize()] for factors, values in kept.news],
        },
    }


def decoded(state: State, parameters: gtsam.ISAM2Params, gate: LoopClosureGate) -> Parts:
    """The parts of a state.

    Parameters
    ----------
    state : State
    parameters : gtsam.ISAM2Params
        Of iSAM2.
    gate : LoopClosureGate

    Raises
    ------
    InvalidGraphError
        No state, or a state of another version.
    """
    if state.get("schema") != SCHEMA or state.get("schema_version") != VERSION:
        raise InvalidGraphError(
            f"expected a state of {SCHEMA} {VERSION}, got {state.get('schema')} {state.get('schema_version')}; "
            "start without"
        )

    # the smoother, and the closures' factors, which it shares
    graph, apart = _graph(state["factors"]), _graph(state["closures_apart"])
    slots = [graph.at(slot) for slot in range(graph.size())]
    smoother = smoother_of(slots, _values(state["values"]), parameters)
    offers = [
        Offer(
            graph_of([slots[k] if k >= 0 else apart.at(-1 - k) for k in offer["factors"]]),
            tuple(offer["slots"]),
            offer["is_waiting"],
        )
        for offer in state["closures"]
    ]

    # the radii, and the map between closures
    radii, kept = state["radii"], state["kept"]
    radii = dict(radii) if isinstance(radii, list) else radii
    return Parts(
        smoother=smoother,
        radii=radii,
        offers=offers,
        kept=KeptMap(
            map=None if kept["map"] is None else _decoded_map(kept["map"], gate, radii),
            news=[(_graph(factors), _values(values)) for factors, values in kept["news"]],
            standing=Standing.of(smoother.getFactorsUnsafe(), reuses_slots=parameters.findUnusedFactorSlots),
        ),
    )


def read_state(path: Path) -> State:
    """A state's file as JSON.

    Raises
    ------
    FileFormatError
        The text is no JSON object.
    """
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise FileFormatError(path, f"expected the state of a gate, got no JSON: {error}") from error
    if not isinstance(state, dict):
        raise FileFormatError(path, "expected the state of a gate, got another JSON document")
    return state


def _placed(offer: Offer, graph: gtsam.NonlinearFactorGraph, apart: gtsam.NonlinearFactorGraph) -> list[int]:
    """Place of each factor of a closure: the slot in the smoother, or −1 − the slot among the separate factors."""
    standing, factors = set(offer.standing(graph)), factors_of(offer.closure)
    found = [slot if slot in standing else -1 for slot in offer.slots] or [-1] * len(factors)
    for k, factor in enumerate(factors):
        if found[k] < 0:
            found[k] = -1 - apart.size()
            apart.push_back(factor)
    return found


def _encoded_map(grown: GrownMap) -> State:
    # what the reference map was made of, and the keyframes since
    reference = grown.reference
    state: State = {
        "factors": _archive(reference.graph),
        "values": reference.keyframes.values.serialize(),
        "keys": list(grown.places)[len(reference.pose_graph) :],
        "ends": [[robot, key] for robot, key in grown.ends.items()],
    }

    # where these are, and the closures since
    tail, ties = grown.tail, grown.closures
    state["tail"] = {
        "poses": _archived_poses(tail.poses),
        "roots": tail.roots.tolist(),
        "gathered": tail.gathered.tolist(),
    }
    state["closures"] = {
        "pairs": ties.pairs.tolist(),
        "measured": _archived_poses(ties.measured),
        "variances": ties.variances.tolist(),
        "slots": ties.slots.tolist(),
        "drifts": ties.drifts.tolist(),
    }
    return state


def _decoded_map(state: State, gate: LoopClosureGate, radii: Radii | None) -> GrownMap:
    # the reference map, settled anew
    values = _values(state["values"])
    if isinstance(radii, Mapping):
        radii = {key: radius for key, radius in radii.items() if values.exists(key)}
    reference = gate.reference_map(_graph(state["factors"]), values, radii)

    # the keyframes and the closures since
    model, n = reference.settled.model, len(reference.pose_graph)
    d, is_planar, tail, ties = len(model.spread), model.is_planar, state["tail"], state["closures"]
    return GrownMap(
        reference=reference,
        tail=Tail(
            poses=_poses(tail["poses"], is_planar=is_planar),
            roots=np.array(tail["roots"], dtype=np.int64),
            gathered=np.array(tail["gathered"]).reshape(-1, d, d),
        ),
        places=reference.keyframes.index | {key: n + k for k, key in enumerate(state["keys"])},
        ends=dict(state["ends"]),
        closures=Ties(
            pairs=np.array(ties["pairs"], dtype=np.int64).reshape(-1, 2),
            measured=_poses(ties["measured"], is_planar=is_planar),
            variances=np.array(ties["variances"]).reshape(-1, d),
            slots=np.array(ties["slots"], dtype=np.int64),
            drifts=np.array(ties["drifts"], dtype=float),
        ),
    )


def _archive(graph: gtsam.NonlinearFactorGraph) -> str:
    try:
        return str(graph.serialize())
    except RuntimeError as error:
        raise InvalidGraphError(
            f"expected factors that GTSAM has archives of, got: {str(error).strip()}; a gate with others is not saved"
        ) from error


def _graph(archive: str) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.deserialize(archive)
    return graph


def _values(archive: str) -> gtsam.Values:
    values = gtsam.Values()
    values.deserialize(archive)
    return values


def _archived_poses(poses: Sequence[Any]) -> str:
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, pose)
    return str(values.serialize())


def _poses(archive: str, *, is_planar: bool) -> tuple[Any, ...]:
    values = _values(archive)
    at = values.atPose2 if is_planar else values.atPose3
    return tuple(at(k) for k in range(values.size()))
