"""A heat study as a JSON document, and the page drawn from the document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pgti_gtsam import encode, outputs
from pgti_gtsam.diffusion import Study
from pgti_gtsam.report import web
from pgti_gtsam.report.digits import in_stable_digits

_SCRIPTS = ("text.js", "errors.js", "plots.js", "heat.js")


@in_stable_digits
def heat_document(study: Study, *, name: str, file_format: str, notes: Sequence[str] = ()) -> dict[str, Any]:
    """Everything found, ready for JSON; numbers that do not exist are null.

    The keys a program would ask for are at the top level: `laplacian_defect_body`, `laplacian_defect_spatial`,
    `steady_state_error`, `proxy_rank_correlation`, the last in GTSAM's own frame.

    Parameters
    ----------
    study : Study
    name, file_format : str
        Name of the map, and its file format.
    notes : sequence of str
        Notes on the input.
    """
    eq11 = study.equation_11
    body = study.body
    document: dict[str, Any] = {
        **encode.heading("diffusion"),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "group": body.group,
        "n_keyframes": len(body.keys),
        "n_other_variables": len(body.other_keys),
        "n_edges": len(study.edges),
        "parts": study.parts,
        "grounds_added": [str(ground.key) for ground in study.grounds],
        "robust_factors": len(study.robust),
        "laplacian_defect_body": study.laplacian_defect_body,
        "laplacian_defect_spatial": study.laplacian_defect_spatial,
        "equation_11_factors": len(eq11.slots),
        "equation_11_antisymmetry": _largest(eq11.antisymmetry),
        "equation_11_gtsam_jacobian": _largest(eq11.gtsam_jacobian),
        "equation_11_right_jacobian": _largest(eq11.right_jacobian),
        "largest_residual_rotation_rad": _largest(eq11.rotation_rad),
        "steady_state_error": study.steady_state_error,
        "slowest_eigenvalue": study.slowest,
        "fastest_eigenvalue": study.fastest,
        "proxy_rank_correlation": study.proxy_body.rank_correlation,
        "proxy_rank_correlation_spatial": study.proxy_spatial.rank_correlation,
        "proxy_largest_difference": _largest(study.proxy_body.differences),
        "proxy_worst_keyframe": body.labels[study.proxy_body.worst],
        "spreading_exponents": {
            "body": encode.number(study.spread_body.exponent()),
            "spatial": encode.number(study.spread_spatial.exponent()),
            "scalar": encode.number(study.spread_scalar.exponent()),
        },
        "optimisers": [
            {
                "method": run.method,
                "energies": run.energies.tolist(),
                "first_step_is_flow_at": encode.number(run.time),
                "first_step_missed_by": encode.number(run.miss),
            }
            for run in study.optimisers
        ],
        "flow": {"times": study.times.tolist(), "energies": study.energies.tolist()},
        "proxy": {
            "keyframes": [body.labels[vertex] for vertex in study.proxy_body.vertices],
            "scalar": study.proxy_body.scalar[:, _MIDDLE].tolist(),
            "block": study.proxy_body.block[:, _MIDDLE].tolist(),
        },
        "spreading": {
            frame: dict(zip(("hops", "arrivals"), (part.tolist() for part in found.by_hops()), strict=True))
            for frame, found in (
                ("body", study.spread_body),
                ("spatial", study.spread_spatial),
                ("scalar", study.spread_scalar),
            )
        },
    }
    return document | {"findings": _findings(document)}


_MIDDLE = 20
"""Of the forty matched times: when about half of the heat has gone."""


def _largest(found: Any) -> float | None:
    return float(np.max(found)) if len(found) else None


def _findings(document: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """What was found, the number, and its meaning."""
    exponents = document["spreading_exponents"]
    others = document["n_other_variables"]
    rows = [
        ("keyframes", f"{document['n_keyframes']} {document['group']}", f"{document['n_edges']} pairs exchange heat"),
        (
            "parts",
            f"{document['parts']}",
            f"{len(document['grounds_added'])} fixed here, as no factor does",
        ),
        *([("marginalised", f"{others}", "landmarks and other variables")] if others else []),
        ("defect, GTSAM's frame", _short(document["laplacian_defect_body"]), "0 for a block Laplacian"),
        ("defect, spatial frame", _short(document["laplacian_defect_spatial"]), "Eq. 12 holds where 0"),
        (
            "Eq. 11, A = −B",
            _short(document["equation_11_antisymmetry"]),
            f"worst of {document['equation_11_factors']} between factors",
        ),
        ("steady state, Gauss-Newton", _short(document["steady_state_error"]), "distance relative to the step"),
        (
            "scalar Laplacian as a proxy",
            _short(document["proxy_rank_correlation"]),
            "rank correlation of heat left",
        ),
        (
            "arrival ~ hops to the power",
            ", ".join(f"{frame} {value:.1f}" for frame, value in exponents.items() if value is not None) or "–",
            "2 is heat, 4 is bending",
        ),
    ]
    for run in document["optimisers"]:
        rows.append((run["method"], *_first_step(run)))
    return rows


def _first_step(run: Mapping[str, Any]) -> tuple[str, str]:
    if not run["energies"]:
        return "none", "the optimiser found the graph singular"
    at = run["first_step_is_flow_at"]
    time = "the end" if at == "infinite" else f"t = {_short(at)}"
    return time, f"time on the flow nearest the first step, off by {_short(run['first_step_missed_by'])}"


def _short(value: float | None) -> str:
    """A number to three digits; below a thousand millionths a number is rounding."""
    return "–" if value is None else "< 1e-9" if 0 < abs(value) < 1e-9 else f"{value:.3g}"


def write_heat_page(document: Mapping[str, Any], path: Path | str) -> None:
    """Write an HTML file that needs no network; raises as `web.assembled` does.

    Parameters
    ----------
    document : mapping
        As `heat_document` makes it.
    path : Path or str
    """
    web.require_schema(document, "diffusion")
    page = web.assembled(document, what="the heat view", body="heat.html", first="findings", scripts=_SCRIPTS)
    outputs.write_text(path, page)
