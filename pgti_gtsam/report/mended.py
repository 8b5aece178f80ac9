"""A mended map as a JSON document, and the page drawn from the document: before and after on one map.

Clouds travel as whole centimetres, in the frame of their keyframe and from above.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pgti_gtsam import encode, outputs
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.diagnosis import Diagnosis
from pgti_gtsam.factor_graphs import keys_of, slots_of
from pgti_gtsam.mending import Attempt, Mended
from pgti_gtsam.mending.exchange import degrees, g2o_lines, planar
from pgti_gtsam.pose_graph import EdgeSource, key_label
from pgti_gtsam.report import web
from pgti_gtsam.report.digits import in_stable_digits
from pgti_gtsam.report.document import Document

_SCRIPTS = ("text.js", "errors.js", "plots.js", "mend_plan.js", "mend.js")

DRAWN = 400
"""Points of a cloud that are kept for the page, evenly drawn."""

NEAR_M = 300.0
"""Distance beyond which points are left out: int16 holds centimetres up to there."""


@in_stable_digits
def mended_document(
    mended: Mended,
    graph: Any,
    *,
    name: str,
    file_format: str,
    notes: Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
    names: Mapping[int, str] | None = None,
) -> Document:
    """Put the whole result of mending into a JSON-ready mapping.

    Parameters
    ----------
    mended : Mended
    graph : gtsam.NonlinearFactorGraph
        The map before mending.
    name, file_format, notes, options
        As in `audit_document`.
    names : mapping of int to str, optional
        Numbers of variables in the map's file: see `write_g2o`.
    """
    # ties that were tried, confirmed ones first
    pose_graph = mended.before.pose_graph
    rows = {int(key): k for k, key in enumerate(pose_graph.keys)}
    order = {"confirmed": 0, "undecided": 1, "refused": 2}
    attempts = sorted(mended.attempts, key=lambda each: (order[each.outcome], _is_extra(each), sorted(each.keys)))
    vertices, edges = g2o_lines(attempts, mended.values, names)

    # the map before and after, and all closures
    return {
        **encode.heading("mend"),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "options": dict(options or {}),
        "n_rounds": mended.n_rounds,
        "before": _side(mended.before, mended.before_values),
        "after": _side(mended.after, mended.values),
        "keyframes": {"label": pose_graph.labels},
        "odometry": pose_graph.edges[pose_graph.edge_sources & EdgeSource.ODOMETRY > 0].tolist(),
        "kept": _kept(mended, graph),
        "out": [
            {
                "slot": slot,
                "keyframes": [rows[key] for key in keys_of(graph.at(slot)) if key in rows],
                "verdict": decision.verdict,
                "probability": encode.number(decision.probability),
                "reason": " ".join(decision.reasons[:1]),
            }
            for slot, decision in sorted(mended.out.items(), key=lambda item: np.nan_to_num(item[1].log_odds, nan=0.0))
        ],
        "attempts": [{**_attempt(each, rows), "g2o": edge} for each, edge in zip(attempts, edges, strict=True)],
        "g2o_vertices": vertices,
    }


def write_mended_page(document: Mapping[str, Any], path: Path | str) -> None:
    """Write an HTML file that needs no network; raises as `web.assembled` does.

    Parameters
    ----------
    document : mapping
        As `mended_document` makes it.
    path : Path or str
    """
    web.require_schema(document, "mend")
    page = web.assembled(document, what="map mended", body="mend.html", first="attempts", scripts=_SCRIPTS)
    outputs.write_text(path, page)


def _side(diagnosis: Diagnosis, values: Any) -> Document:
    integrity, keyframes = diagnosis.integrity, read_keyframes(values)
    return {
        "verdict": {"level": diagnosis.verdict, "text": diagnosis.reason},
        "places": dict(Counter(place.kind for place in diagnosis.places)),
        "n_collisions": len(integrity.collision_edges),
        "n_closures": len(diagnosis.closures),
        "score": encode.number(integrity.score),
        "collision_score": encode.number(integrity.collisions.score),
        "position": np.round(diagnosis.pose_graph.positions, 3).tolist(),
        "pose": [planar(keyframes.pose(key)) for key in diagnosis.pose_graph.keys.tolist()],
        "stretches": [
            {"kind": place.kind, "keyframes": place.revisit.keyframes.tolist()}
            for place in diagnosis.places
            if place.kind != "incomplete fusion"
        ],
    }


def _kept(mended: Mended, graph: Any) -> list[list[int]]:
    """Keyframes of the map's own closures that stayed."""
    own = {closure.slot: closure.keyframes for closure in mended.after.closures}
    return [list(own[slot]) for slot, _ in slots_of(graph) if slot in own]


def _attempt(attempt: Attempt, rows: Mapping[int, int]) -> Document:
    wanted, fit = attempt.wanted, attempt.alignment
    off = None if wanted is None or attempt.pose is None else wanted.pose.between(attempt.pose)
    return {
        "keyframes": [rows[key] for key in attempt.keys],
        "labels": [key_label(key) for key in attempt.keys],
        "outcome": attempt.outcome,
        "reason": attempt.reason,
        "round": attempt.round,
        "place": None if wanted is None else wanted.place,
        "allowance_m": None if wanted is None else wanted.allowance_m,
        "predicted": None if wanted is None else planar(wanted.pose),
        "measured": None if attempt.pose is None else planar(attempt.pose),
        "moved_m": None if off is None else float(np.linalg.norm(off.translation())),
        "moved_deg": None if off is None else degrees(off),
        "agreement": None if fit is None else fit.view.agreement,
        "seen": None if fit is None else fit.view.seen,
        "matched": None if fit is None else fit.matched,
        "residual_m": None if fit is None else fit.residual_m,
        "stiffness": None if fit is None else np.linalg.eigvalsh(fit.stiffness).tolist(),
        "probability": None if attempt.decision is None else encode.number(attempt.decision.probability),
        "clouds": None if attempt.submaps is None else [_packed(submap.view) for submap in attempt.submaps],
    }


def _is_extra(attempt: Attempt) -> bool:
    """Whether a tie belongs to none of the audit's places."""
    return attempt.wanted is not None and attempt.wanted.place is None


def _packed(points: Any) -> str:
    """Points seen from above, in cm, as base64 of little-endian int16."""
    near = points[(np.abs(points[:, :2]) < NEAR_M).all(axis=1), :2]
    some = near[np.unique(np.linspace(0, max(len(near) - 1, 0), DRAWN).round().astype(int))] if len(near) else near
    return base64.b64encode(np.round(100 * some).astype("<i2").tobytes()).decode()
