"""The audit of a map in parts as one JSON document, from which the terminal summary is drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from pgti_gtsam import encode
from pgti_gtsam.parts import DiagnosisInParts
from pgti_gtsam.parts.scores import TIMES
from pgti_gtsam.report.digits import in_stable_digits
from pgti_gtsam.report.document import closure_record, estimate_record, numbers, place_record


@in_stable_digits
def parts_document(
    diagnosis: DiagnosisInParts, *, name: str, file_format: str, notes: Sequence[str], options: Mapping[str, Any]
) -> dict[str, Any]:
    """Put everything that was found about a map into one JSON-ready mapping.

    Parameters
    ----------
    diagnosis : DiagnosisInParts
    name, file_format, notes, options
        As in `audit_document`, whose documents have the same fields of these names and the same places and closures;
        only ζ is missing, which no part can tell.
    """
    pose_graph, compared = diagnosis.pose_graph, diagnosis.compared
    adaptation = pose_graph.adaptation
    return {
        **encode.heading("parts"),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "options": dict(options),
        "adaptation": None if adaptation is None else asdict(adaptation),
        "estimate": estimate_record(diagnosis.convergence, diagnosis.unit_m),
        "verdict": {"level": diagnosis.verdict, "text": diagnosis.reason},
        "summary": {
            "n_keyframes": len(pose_graph),
            "n_pose_graph_edges": len(pose_graph.edges),
            "n_fusion_edges": len(compared.fusion_edges),
            "n_collision_edges": len(compared.collision_edges),
            "n_components_pose_graph": compared.n_components_pose_graph,
            "median_radius_m": diagnosis.unit_m,
            "places": dict(Counter(place.kind for place in diagnosis.places)),
            "peak_mb": diagnosis.peak_mb,
            "seconds": dict(diagnosis.seconds),
            "times": TIMES.tolist(),
        },
        "places": [place_record(rank, place, pose_graph) for rank, place in enumerate(diagnosis.places, start=1)],
        "closures": [closure_record(rank, closure) for rank, closure in enumerate(diagnosis.closures, start=1)],
        "keyframes": {
            "label": pose_graph.labels,
            "position": pose_graph.positions.tolist(),
            "stable_score": compared.scores.stable_scores.tolist(),
            "stable_score_bound": numbers(compared.scores.bounds),
        },
        "edges": {"collisions": compared.collision_edges.tolist()},
        "parts": [asdict(part) for part in diagnosis.parts],
    }
