"""The audit of a map as one JSON document, from which the terminal summary, page and pictures are drawn.

Its fields are described in `schemas/audit.schema.json` beside this module, its numbers in `encode`.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam import encode, outputs
from pgti_gtsam.diagnosis.records import ClosureFinding, Diagnosis, Place, Proposal
from pgti_gtsam.diagnosis.sweep import Swept, fragile
from pgti_gtsam.estimate import Convergence
from pgti_gtsam.integrity import BetaSplit, Distortion
from pgti_gtsam.optimality import GraphOptimality
from pgti_gtsam.pose_graph import PoseGraph, key_label
from pgti_gtsam.report.digits import in_stable_digits, packable

MAX_SIGNATURES = 5000
"""Keyframes whose two signatures are kept, those with the largest ζ: 5000 take about 5 MB."""

SWEPT_BETAS = tuple(k / 20 for k in range(1, 20))

Document = dict[str, Any]


@in_stable_digits
def audit_document(
    diagnosis: Diagnosis,
    *,
    name: str,
    file_format: str,
    notes: Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
) -> Document:
    """Put the whole diagnosis of a map into a JSON-ready mapping.

    Parameters
    ----------
    diagnosis : Diagnosis
        The diagnosis.
    name, file_format : str
        Name of the map, and its file format.
    notes : sequence of str
        Notes on the input for a reader.
    options : mapping, optional
        Settings of the audit, kept as they are.
    """
    pose_graph, integrity = diagnosis.pose_graph, diagnosis.integrity
    adaptation = pose_graph.adaptation
    return {
        **encode.heading("audit"),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "options": dict(options or {}),
        "adaptation": None if adaptation is None else asdict(adaptation),
        "estimate": estimate_record(diagnosis.convergence, diagnosis.unit_m),
        "verdict": {"level": diagnosis.verdict, "text": diagnosis.reason},
        "summary": _summary(diagnosis),
        "optimality": {
            "unweighted": _optimality(integrity.optimality.unweighted),
            "weighted": None if integrity.optimality.weighted is None else _optimality(integrity.optimality.weighted),
        },
        "beta_sweep": [_split(integrity.split(beta)) for beta in SWEPT_BETAS],
        "places": [place_record(rank, place, pose_graph) for rank, place in enumerate(diagnosis.places, start=1)],
        "closures": [closure_record(rank, closure) for rank, closure in enumerate(diagnosis.closures, start=1)],
        "keyframes": {
            "label": pose_graph.labels,
            "position": pose_graph.positions.tolist(),
            "radius": pose_graph.radii.tolist(),
            "score": numbers(integrity.keyframe_scores),
            "collision_score": numbers(integrity.collisions.keyframe_scores),
            "stable_score": integrity.stable_scores.tolist(),
        },
        "edges": {
            "pose_graph": pose_graph.edges.tolist(),
            "fusion": integrity.fusion_edges.tolist(),
            "collisions": integrity.collision_edges.tolist(),
        },
        "times": integrity.times.tolist(),
        "signatures": _signatures(diagnosis),
    }


def sweep_rows(swept: Sequence[Swept]) -> Document:
    """Verdict and places at every factor of the radii, and whether the verdict depends on the factor."""
    return {
        "fragile": fragile({each.factor: each.diagnosis.verdict for each in swept}),
        "rows": [
            {
                "factor": each.factor,
                "median_radius_m": each.diagnosis.unit_m,
                "verdict": each.diagnosis.verdict,
                "places": dict(Counter(place.kind for place in each.diagnosis.places)),
                "score": encode.number(each.diagnosis.integrity.score),
            }
            for each in swept
        ],
    }


def write_json(document: Mapping[str, Any], path: Path) -> None:
    """Write a document as strict JSON; raises as `outputs.write_bytes` does.

    Parameters
    ----------
    document : mapping
    path : Path
    """
    outputs.write_text(path, encode.line(document))


def estimate_record(step: Convergence | None, unit_m: float) -> Document | None:
    """How far an estimate is from an optimum.

    Parameters
    ----------
    step : Convergence or None
    unit_m : float
        ρ.
    """
    if step is None:
        return None
    return {
        "error": step.error,
        "error_after_step": step.error_after,
        "step_m": step.step_m,
        "keyframe": step.keyframe,
        "is_optimum": step.is_optimum(unit_m),
    }


def _summary(diagnosis: Diagnosis) -> Document:
    pose_graph, integrity = diagnosis.pose_graph, diagnosis.integrity
    return {
        "n_keyframes": len(pose_graph),
        "n_chains": diagnosis.n_chains,
        "n_pose_graph_edges": len(pose_graph.edges),
        "n_free_space_edges": len(integrity.free_space_edges),
        "n_merged_edges": len(integrity.merged_edges),
        "n_inserted_edges": len(integrity.inserted_edges),
        "n_fusion_edges": len(integrity.fusion_edges),
        "n_collision_edges": len(integrity.collision_edges),
        "n_components_pose_graph": integrity.n_components_pose_graph,
        "n_components_merged_graph": integrity.n_components_merged_graph,
        "median_radius_m": diagnosis.unit_m,
        **_scores(integrity),
        "fusion": _scores(integrity.fusion),
        "collisions": _scores(integrity.collisions),
    }


def _scores(distortion: Distortion) -> Document:
    return {
        "score": encode.number(distortion.score),
        "mean_score": encode.number(distortion.mean_score),
        "stable_score": distortion.stable_score,
        "worst": distortion.worst,
        "split": _split(distortion.split()),
    }


def _split(split: BetaSplit) -> Document:
    return {
        "beta": split.beta,
        "local": encode.number(split.local),
        "global": encode.number(split.global_),
        "max_local": encode.number(split.max_local),
        "max_global": encode.number(split.max_global),
    }


def _optimality(compared: GraphOptimality) -> Document:
    return {name: asdict(getattr(compared, name)) for name in ("pose_graph", "merged_graph", "change")}


def place_record(rank: int, place: Place, pose_graph: PoseGraph) -> Document:
    """A place as documents have it.

    Parameters
    ----------
    rank : int
        From one on.
    place : Place
    pose_graph : PoseGraph
    """
    return {
        "rank": rank,
        "kind": place.kind,
        "sentence": place.sentence,
        "remedy": place.remedy,
        "scale": place.scale,
        "score": encode.number(place.score),
        "stable_score": place.stable_score,
        "worst": place.worst,
        "label": key_label(int(pose_graph.keys[place.worst])),
        "position": pose_graph.positions[place.worst].tolist(),
        "stretches": [list(ends) for ends in place.keyframes],
        "lengths_m": list(place.revisit.lengths_m),
        "closest": list(place.revisit.closest),
        "keyframes": place.revisit.keyframes.tolist(),
        "edges": place.edges.tolist(),
        "probability": place.probability,
        "allowance_m": encode.number(place.allowance_m),
        "reach_m": place.reach_m,
        "gain": encode.number(place.gain),
        "proposal": None if place.proposal is None else _proposal(place.proposal),
        "closure": None if place.closure is None else list(place.closure),
    }


def _proposal(proposal: Proposal) -> Document:
    """Position in m, and the rotation matrix, of the second keyframe seen from the first."""
    pose = proposal.pose
    return {
        "keyframes": list(proposal.keyframes),
        "position": np.asarray(pose.translation()).tolist(),
        "rotation": np.asarray(pose.rotation().matrix()).tolist(),
        "covariance": proposal.covariance.tolist(),
        "sigma_m": proposal.sigma_m,
        "sigma_deg": proposal.sigma_deg,
        "search_m": proposal.search_m,
    }


def closure_record(rank: int, closure: ClosureFinding) -> Document:
    """A closure as documents have it.

    Parameters
    ----------
    rank : int
        From one on.
    closure : ClosureFinding
    """
    return {
        "rank": rank,
        "slot": closure.slot,
        "keyframes": list(closure.keyframes),
        "probability": encode.number(closure.probability),
        "log_odds": encode.number(closure.log_odds),
        "missed_m": closure.missed_m,
        "missed_deg": closure.missed_deg,
        "allowed_m": encode.number(closure.allowed_m),
        "is_false": closure.is_false,
        "sentence": closure.sentence,
    }


def _signatures(diagnosis: Diagnosis) -> Document:
    """Of the keyframes with the largest ζ, and of those that places are about."""
    integrity = diagnosis.integrity
    worst = np.argsort(-integrity.keyframe_scores, kind="stable")[:MAX_SIGNATURES]
    named = [k for place in diagnosis.places for k in (*place.revisit.closest, place.worst)]
    chosen = np.union1d(worst, np.array(named, dtype=np.int64))
    return {
        "keyframes": chosen.tolist(),
        "pose_graph": _packed(integrity.signatures_pose_graph[chosen]),
        "merged_graph": _packed(integrity.signatures_merged_graph[chosen]),
    }


def _packed(array: NDArray[np.float64]) -> Document:
    data = np.ascontiguousarray(packable(array), dtype="<f4")
    return {"dtype": "float32", "shape": list(data.shape), "base64": base64.b64encode(data.tobytes()).decode()}


def numbers(values: NDArray[np.float64]) -> list[float | str | None]:
    """An array as JSON has numbers."""
    return [encode.number(value) for value in values.tolist()]
