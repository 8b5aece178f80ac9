"""A gated smoother written down: factors, closures and radii, and the map kept between closures.

Factors and values are GTSAM's own text archives, which hold every number exactly; all else is JSON. Smoothers
themselves have no archive: a smoother is made anew from its factors, linearised where it was. The kept map's reference
is settled anew from the factors and the estimate at that time, so that the next verdicts equal those of a run without a
break.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.errors import FileFormatError, InvalidGraphError
from pgti_gtsam.factor_graphs import factors_of, graph_of, slots_of
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.grown_map import GrownMap, Tail
from pgti_gtsam.gate.history import Offer
from pgti_gtsam.gate.kept_map import KeptMap, Standing
from pgti_gtsam.gate.ties import Ties
from pgti_gtsam.pose_graph import Radii

SCHEMA, VERSION = "pgti-gtsam/gate-state", 2

State = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """The parts of a gated smoother, without gate and smoother; the graph is that of the whole map."""

    graph: gtsam.NonlinearFactorGraph
    radii: Radii | None
    offers: list[Offer]
    kept: KeptMap


def encoded(parts: Parts, smoother: State) -> State:
    """The parts as JSON-ready state.

    Parameters
    ----------
    parts : Parts
    smoother : State
        What the smoother has beyond these, with its kind.

    Raises
    ------
    InvalidGraphError
        A factor that GTSAM has no archive of, a `gtsam.CustomFactor` say.
    """
    graph, radii = parts.graph, parts.radii
    places, apart = placed([offer.closure for offer in parts.offers], graph)
    offers = [
        {"factors": own, "slots": list(offer.slots), "is_waiting": offer.is_waiting}
        for own, offer in zip(places, parts.offers, strict=True)
    ]

    # all of it; a map that the caller changed is not kept
    kept = parts.kept
    stands = kept.standing.is_that_of(graph)
    return {
        "schema": SCHEMA,
        "schema_version": VERSION,
        "smoother": smoother,
        "factors": archive_of(graph),
        "radii": [[int(key), float(radius)] for key, radius in radii.items()] if isinstance(radii, Mapping) else radii,
        "closures": offers,
        "closures_apart": apart,
        "kept": {
            "map": _encoded_map(kept.map) if kept.map is not None and stands else None,
            "news": [[archive_of(factors), values.serialize()] for factors, values in kept.news],
        },
    }


def decoded(state: State, kinds: Collection[str], gate: LoopClosureGate, *, reuses_slots: bool = False) -> Parts:
    """The parts of a state.

    Parameters
    ----------
    state : State
    kinds : collection of str
        Of smoothers whose states are expected.
    gate : LoopClosureGate
    reuses_slots : bool
        Whether new factors take the map's empty slots.

    Raises
    ------
    InvalidGraphError
        No state, a state of another version, or of another kind of smoother.
    """
    if state.get("schema") != SCHEMA or state.get("schema_version") != VERSION:
        raise InvalidGraphError(
            f"expected a state of {SCHEMA} {VERSION}, got {state.get('schema')} {state.get('schema_version')}; "
            "start without"
        )
    if state["smoother"]["kind"] not in kinds:
        raise InvalidGraphError(f"expected the state of {' or '.join(kinds)}, got that of {state['smoother']['kind']}")

    # the factors of the map, and the closures' factors, which are factors of the map
    graph, apart = graph_from(state["factors"]), graph_from(state["closures_apart"])
    offers = [
        Offer(placed_in(offer["factors"], graph, apart), tuple(offer["slots"]), offer["is_waiting"])
        for offer in state["closures"]
    ]

    # the radii, and the map between closures
    radii, kept = state["radii"], state["kept"]
    radii = dict(radii) if isinstance(radii, list) else radii
    return Parts(
        graph=graph,
        radii=radii,
        offers=offers,
        kept=KeptMap(
            map=None if kept["map"] is None else _decoded_map(kept["map"], gate, radii),
            news=[(graph_from(factors), values_from(values)) for factors, values in kept["news"]],
            standing=Standing.of(graph, reuses_slots=reuses_slots),
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


def placed(
    groups: Sequence[gtsam.NonlinearFactorGraph], graph: gtsam.NonlinearFactorGraph
) -> tuple[list[list[int]], str]:
    """Place of each factor of some groups: the slot in a graph, or −1 − the slot among the others; these as an archive.

    Parameters
    ----------
    groups : sequence of gtsam.NonlinearFactorGraph
    graph : gtsam.NonlinearFactorGraph

    Raises
    ------
    InvalidGraphError
        As of `archive_of`.
    """
    held, apart = slots_of(graph), gtsam.NonlinearFactorGraph()
    slots, found = {id(factor): slot for slot, factor in held}, []
    for group in groups:
        own = []
        for factor in factors_of(group):
            if id(factor) not in slots:
                apart.push_back(factor)
            own.append(slots.get(id(factor), -apart.size()))
        found.append(own)
    return found, archive_of(apart)


def placed_in(
    places: Sequence[int], graph: gtsam.NonlinearFactorGraph, apart: gtsam.NonlinearFactorGraph
) -> gtsam.NonlinearFactorGraph:
    """The graph of the factors at some places, as `placed` names them.

    Parameters
    ----------
    places : sequence of int
    graph, apart : gtsam.NonlinearFactorGraph
        Factors of the map, and the others.
    """
    return graph_of(graph.at(place) if place >= 0 else apart.at(-1 - place) for place in places)


def _encoded_map(grown: GrownMap) -> State:
    # what the reference map was made of, and the keyframes since
    state: State = {
        "factors": archive_of(grown.graph),
        "values": grown.values.serialize(),
        "keys": list(grown.places)[len(grown.optimum) :],
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
    values = values_from(state["values"])
    if isinstance(radii, Mapping):
        radii = {key: radius for key, radius in radii.items() if values.exists(key)}
    grown = GrownMap.of(gate.reference_map(graph_from(state["factors"]), values, radii))

    # the keyframes since
    units, n = grown.units, len(grown.optimum)
    d, is_planar, tail, ties = len(units.spread), units.is_planar, state["tail"], state["closures"]
    grown = replace(
        grown,
        tail=Tail(
            poses=_poses(tail["poses"], is_planar=is_planar),
            roots=np.array(tail["roots"], dtype=np.int64),
            gathered=np.array(tail["gathered"]).reshape(-1, d, d),
        ),
        places=grown.places | {key: n + k for k, key in enumerate(state["keys"])},
        ends=dict(state["ends"]),
    )

    # the closures since, one by one as they came
    closures = Ties(
        pairs=np.array(ties["pairs"], dtype=np.int64).reshape(-1, 2),
        measured=_poses(ties["measured"], is_planar=is_planar),
        variances=np.array(ties["variances"]).reshape(-1, d),
        slots=np.array(ties["slots"], dtype=np.int64),
        drifts=np.array(ties["drifts"], dtype=float),
    )
    for own in np.eye(len(closures.pairs), dtype=bool):
        grown = replace(grown, known=grown.known.with_predicted(grown.predicted(closures.only(own))))
    return grown


def archive_of(graph: gtsam.NonlinearFactorGraph) -> str:
    """GTSAM's archive of a graph; raises InvalidGraphError for factors that have none."""
    try:
        return str(graph.serialize())
    except RuntimeError as error:
        raise InvalidGraphError(
            f"expected factors that GTSAM has archives of, got: {str(error).strip()}; a gate with others is not saved"
        ) from error


def graph_from(archive: str) -> gtsam.NonlinearFactorGraph:
    """The graph of an archive."""
    graph = gtsam.NonlinearFactorGraph()
    graph.deserialize(archive)
    return graph


def values_from(archive: str) -> gtsam.Values:
    """The values of an archive."""
    values = gtsam.Values()
    values.deserialize(archive)
    return values


def _archived_poses(poses: Sequence[Any]) -> str:
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, pose)
    return str(values.serialize())


def _poses(archive: str, *, is_planar: bool) -> tuple[Any, ...]:
    values = values_from(archive)
    at = values.atPose2 if is_planar else values.atPose3
    return tuple(at(k) for k in range(values.size()))
