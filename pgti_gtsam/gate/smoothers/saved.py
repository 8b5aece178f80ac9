"""A gated smoother written down: factors, closures and radii, and the map kept between closures.

Factors and values are GTSAM's own text archives, which hold every number exactly; all else is JSON. Smoothers
themselves have no archive: a smoother is made anew from its factors, linearised where it was. The kept map is
written as the arrays that predictions need, so that the next verdicts equal those of a run without a break.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
from collections import ChainMap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam import outputs
from pgti_gtsam.drift.ties import level_closures
from pgti_gtsam.drift.units import Units
from pgti_gtsam.errors import FileFormatError, InvalidGraphError
from pgti_gtsam.factor_graphs import factors_of, graph_of, slots_of
from pgti_gtsam.gate.kept.grown_map import GrownMap, Tail, robot_of
from pgti_gtsam.gate.kept.kept_optimum import KeptOptimum
from pgti_gtsam.gate.kept.known_closures import KnownClosures
from pgti_gtsam.gate.kept.pose_rows import pose_of, rows_of
from pgti_gtsam.gate.smoothers.history import Offer
from pgti_gtsam.gate.smoothers.kept_map import KeptMap, Standing
from pgti_gtsam.pose_graph import Radii
from pgti_gtsam.spectral.block_inverse import BlockFactor
from pgti_gtsam.spectral.elimination_tree import EliminationTree

SCHEMA, VERSION = "pgti-gtsam/gate-state", 3

State = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """The parts of a gated smoother, without gate and smoother; the graph is that of the whole map."""

    graph: gtsam.NonlinearFactorGraph
    radii: Radii | None
    offers: list[Offer]
    waiting: set[int]
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
        {"factors": own, "slots": list(offer.slots), "is_waiting": number in parts.waiting}
        for number, (own, offer) in enumerate(zip(places, parts.offers, strict=True))
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


def decoded(state: State, kinds: Collection[str], *, reuses_slots: bool = False) -> Parts:
    """The parts of a state.

    Parameters
    ----------
    state : State
    kinds : collection of str
        Of smoothers whose states are expected.
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
    offers = [Offer(placed_in(offer["factors"], graph, apart), tuple(offer["slots"])) for offer in state["closures"]]

    # the radii, and the map between closures
    radii, kept = state["radii"], state["kept"]
    radii = dict(radii) if isinstance(radii, list) else radii
    return Parts(
        graph=graph,
        radii=radii,
        offers=offers,
        waiting={number for number, offer in enumerate(state["closures"]) if offer["is_waiting"]},
        kept=KeptMap(
            map=None if kept["map"] is None else _decoded_map(kept["map"]),
            news=[(graph_from(factors), values_from(values)) for factors, values in kept["news"]],
            standing=Standing.of(graph, reuses_slots=reuses_slots),
        ),
    )


def write_state(path: Path | str, state: State) -> None:
    """Write a state with its checksum; a power failure leaves the old file or the new file.

    Parameters
    ----------
    path : Path or str
    state : State
    """
    text = json.dumps(state)
    outputs.write_text(path, text[:-1] + _checksum(text))


def read_state(path: Path, schema: str, version: int) -> State:
    """A state from its file.

    Parameters
    ----------
    path : Path
    schema : str
    version : int

    Raises
    ------
    FileFormatError
        The text is no JSON object, that of another schema, or not what `write_state` wrote.
    """
    # the document
    try:
        text = path.read_text(encoding="utf-8")
        state = json.loads(text)
    except ValueError as error:
        raise FileFormatError(path, f"expected a state of {schema}, got no JSON: {error}") from error
    if not isinstance(state, dict):
        raise FileFormatError(path, f"expected a state of {schema}, got another JSON document")
    if state.get("schema") != schema or state.get("schema_version") != version:
        raise FileFormatError(path, f"expected a state of {schema} {version}, got another; name another file")

    # its checksum
    own, separator, _ = text.rpartition(_BEFORE_CHECKSUM)
    if not separator or text != own + _checksum(own + "}"):
        raise FileFormatError(path, "expected a state as it was written, got one that was changed since; start anew")
    return state


_BEFORE_CHECKSUM = ', "sha256": "'


def _checksum(text: str) -> str:
    """The last key of a state's file, behind the text of all others."""
    return f'{_BEFORE_CHECKSUM}{hashlib.sha256(text.encode()).hexdigest()}"}}'


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


def _encoded_map(grown: GrownMap) -> str:
    """All arrays of a kept map, compressed, as text."""
    # the reference map's optimum
    optimum, units, tail, ties = grown.optimum, grown.units, grown.tail, grown.closures
    planar, factor = units.is_planar, grown.optimum.factor
    arrays: dict[str, Any] = {f"tree_{name}": getattr(factor.tree, name) for name in _TREE}
    arrays |= {name: getattr(optimum, name) for name in ("poses", "component", "pairs", "measured")}
    arrays |= {name: getattr(units, name) for name in ("unit_m", "tilt", "spread")}
    arrays["levelling"] = rows_of([units.levelling], is_planar=planar)
    for name in ("inverses", "couplings"):
        arrays[name] = np.concatenate([block.ravel() for block in getattr(factor, name)])
    if grown.way_m is not None:
        arrays["way_m"] = grown.way_m

    # the keyframes and the closures since
    arrays["keys"] = np.array(list(grown.places), dtype=np.uint64)
    arrays["ends"] = np.array(list(grown.ends.values()), dtype=np.uint64)
    arrays |= {"tail": rows_of(tail.poses, is_planar=planar), "roots": tail.roots, "gathered": tail.gathered}
    arrays |= {"closures": ties.pairs, "closures_measured": rows_of(ties.measured, is_planar=planar)}
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    return base64.b64encode(packed.getvalue()).decode("ascii")


def _decoded_map(text: str) -> GrownMap:
    # the reference map's optimum
    with np.load(io.BytesIO(base64.b64decode(text)), allow_pickle=False) as packed:
        arrays = dict(packed)
    units = Units(
        unit_m=float(arrays["unit_m"]),
        levelling=pose_of(arrays["levelling"][0]),
        tilt=float(arrays["tilt"]),
        spread=arrays["spread"],
    )
    tree = EliminationTree(**{name: arrays[f"tree_{name}"] for name in _TREE})
    factor = BlockFactor.of(tree, len(units.spread), arrays["inverses"], arrays["couplings"])
    own = {name: arrays[name] for name in ("poses", "component", "pairs", "measured")}
    grown = GrownMap(
        optimum=KeptOptimum(units=units, factor=factor, **own),
        way_m=arrays.get("way_m"),
        tail=Tail(poses=_poses(arrays["tail"]), roots=arrays["roots"], gathered=arrays["gathered"]),
        places=ChainMap({}, {key: place for place, key in enumerate(arrays["keys"].tolist())}),
        ends={robot_of(key): key for key in arrays["ends"].tolist()},
        known=KnownClosures.none(factor, units),
    )

    # the closures since, one by one as they came
    for pair, row in zip(arrays["closures"], arrays["closures_measured"], strict=True):
        tie = level_closures(pair[None], [pose_of(row)], units)
        grown = replace(grown, known=grown.known.with_predicted(grown.predicted(tie)))
    return grown


_TREE = tuple(field.name for field in fields(EliminationTree))


def _poses(rows: NDArray[np.float64]) -> tuple[Any, ...]:
    return tuple(pose_of(row) for row in rows)


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
