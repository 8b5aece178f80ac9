"""The audit of a map as one JSON document, from which the terminal summary, page and pictures are drawn.

Its fields are described in `audit.schema.json` beside this module. A score may be the text "infinite",
since JSON has no such number.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.integrity import BetaSplit, Integrity
from pgti_gtsam.optimality import GraphOptimality
from pgti_gtsam.pose_graph import PoseGraph, key_label
from pgti_gtsam.report.places import Place, find_places
from pgti_gtsam.report.verdict import verdict

SCHEMA = "pgti-gtsam/audit"
SCHEMA_VERSION = 1

MAX_SIGNATURES = 5000
"""Keyframes whose two signatures are kept, those with the largest ζ: 5000 take about 5 MB."""

SWEPT_BETAS = tuple(k / 20 for k in range(1, 20))

Document = dict[str, Any]


def audit_document(
    pose_graph: PoseGraph,
    integrity: Integrity,
    *,
    name: str,
    file_format: str,
    notes: Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
) -> Document:
    """Put everything that was found about a map into one JSON-ready mapping.

    Parameters
    ----------
    pose_graph : PoseGraph
    integrity : Integrity
        What `assess` found on it.
    name, file_format : str
        What the map is called, and what it was read from.
    notes : sequence of str
        What a reader should know of the input.
    options : mapping, optional
        Settings of the audit, kept as they are.
    """
    adaptation = pose_graph.adaptation
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "pgti_gtsam_version": version("pgti-gtsam"),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "options": dict(options or {}),
        "adaptation": None if adaptation is None else asdict(adaptation),
        "summary": _summary(pose_graph, integrity),
        "optimality": {
            "unweighted": _optimality(integrity.optimality.unweighted),
            "weighted": None if integrity.optimality.weighted is None else _optimality(integrity.optimality.weighted),
        },
        "beta_sweep": [_split(integrity.split(beta)) for beta in SWEPT_BETAS],
        "places": [
            _place(rank, place, pose_graph, integrity)
            for rank, place in enumerate(find_places(pose_graph, integrity), start=1)
        ],
        "keyframes": {
            "label": pose_graph.labels,
            "position": pose_graph.positions.tolist(),
            "radius": pose_graph.radii.tolist(),
            "score": _numbers(integrity.keyframe_scores),
            "stable_score": integrity.stable_scores.tolist(),
        },
        "edges": {"pose_graph": pose_graph.edges.tolist(), "inserted": integrity.inserted_edges.tolist()},
        "times": integrity.times.tolist(),
        "signatures": _signatures(integrity),
    }


def write_json(document: Mapping[str, Any], path: Path) -> None:
    """Write a document as strict JSON."""
    path.write_text(json.dumps(document, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")


def _summary(pose_graph: PoseGraph, integrity: Integrity) -> Document:
    judged = verdict(integrity)
    return {
        "n_keyframes": len(pose_graph),
        "n_pose_graph_edges": len(pose_graph.edges),
        "n_free_space_edges": len(integrity.free_space_edges),
        "n_merged_edges": len(integrity.merged_edges),
        "n_inserted_edges": len(integrity.inserted_edges),
        "n_components_pose_graph": integrity.n_components_pose_graph,
        "n_components_merged_graph": integrity.n_components_merged_graph,
        "score": _number(integrity.score),
        "mean_score": _number(integrity.mean_score),
        "stable_score": integrity.stable_score,
        "worst": integrity.worst,
        "split": _split(integrity.split()),
        "verdict": {"level": judged.level, "text": judged.text},
    }


def _split(split: BetaSplit) -> Document:
    return {
        "beta": split.beta,
        "local": _number(split.local),
        "global": _number(split.global_),
        "max_local": _number(split.max_local),
        "max_global": _number(split.max_global),
    }


def _optimality(compared: GraphOptimality) -> Document:
    return {name: asdict(getattr(compared, name)) for name in ("pose_graph", "merged_graph", "change")}


def _place(rank: int, place: Place, pose_graph: PoseGraph, integrity: Integrity) -> Document:
    return {
        "rank": rank,
        "score": _number(float(integrity.keyframe_scores[place.keyframes].max())),
        "stable_score": float(integrity.stable_scores[place.worst]),
        "worst": place.worst,
        "label": key_label(int(pose_graph.keys[place.worst])),
        "position": pose_graph.positions[place.worst].tolist(),
        "keyframes": place.keyframes.tolist(),
        "n_inserted_edges": place.n_inserted_edges,
    }


def _signatures(integrity: Integrity) -> Document:
    chosen = np.sort(np.argsort(-integrity.keyframe_scores, kind="stable")[:MAX_SIGNATURES])
    return {
        "keyframes": chosen.tolist(),
        "pose_graph": _packed(integrity.signatures_pose_graph[chosen]),
        "merged_graph": _packed(integrity.signatures_merged_graph[chosen]),
    }


def _packed(array: NDArray[np.float64]) -> Document:
    data = np.ascontiguousarray(array, dtype="<f4")
    return {"dtype": "float32", "shape": list(data.shape), "base64": base64.b64encode(data.tobytes()).decode()}


def _number(value: float) -> float | str:
    return "infinite" if np.isinf(value) else value


def _numbers(values: NDArray[np.float64]) -> list[float | str]:
    return [_number(value) for value in values.tolist()]
