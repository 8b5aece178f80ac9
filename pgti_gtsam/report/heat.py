"""A heat study: a record for JSON, and a page of figures drawn from the record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from pgti_gtsam import encode, outputs
from pgti_gtsam.diffusion import Study
from pgti_gtsam.report.digits import in_stable_digits


@in_stable_digits
def heat_document(study: Study, name: str) -> dict[str, Any]:
    """Everything found, ready for JSON; numbers that do not exist are null.

    The keys a program would ask for are at the top level: `laplacian_defect_body`, `laplacian_defect_spatial`,
    `steady_state_error`, `proxy_rank_correlation`, the last in GTSAM's own frame.

    Parameters
    ----------
    study : Study
    name : str
        Name of the map.
    """
    eq11 = study.equation_11
    body = study.body
    return {
        **encode.heading("diffusion"),
        "name": name,
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


_MIDDLE = 20
"""Of the forty matched times: when about half of the heat has gone."""


def _largest(found: Any) -> float | None:
    return float(np.max(found)) if len(found) else None


def write_heat_page(document: Mapping[str, Any], path: Path) -> None:
    """Write the figures to an HTML file that needs no network.

    Parameters
    ----------
    document : mapping
        As `heat_document` makes it.
    path : Path
    """
    figure = make_subplots(
        rows=1,
        cols=3,
        subplot_titles=("Energy along the flow", "Heat left at keyframes", "When half of a shift has arrived"),
    )
    flow, proxy = document["flow"], document["proxy"]
    figure.add_scatter(x=flow["times"], y=flow["energies"], mode="lines", name="heat flow", row=1, col=1)
    figure.add_scatter(
        x=proxy["scalar"],
        y=proxy["block"],
        text=proxy["keyframes"],
        mode="markers",
        name="keyframes",
        marker={"size": 5},
        row=1,
        col=2,
    )
    for frame, found in document["spreading"].items():
        figure.add_scatter(x=found["hops"], y=found["arrivals"], mode="lines+markers", name=frame, row=1, col=3)
    figure.update_xaxes(type="log", title_text="time, 1/H", row=1, col=1)
    figure.update_yaxes(type="log", title_text="½‖e + Jδ‖²", row=1, col=1)
    figure.update_xaxes(title_text="by the scalar Laplacian", row=1, col=2)
    figure.update_yaxes(title_text="by H", row=1, col=2)
    figure.update_xaxes(type="log", title_text="hops", row=1, col=3)
    figure.update_yaxes(type="log", title_text="time, each on its own clock", row=1, col=3)
    correlation = f"{document['proxy_rank_correlation']:.3g}"
    figure.update_layout(
        title={"text": f"{_plain(document['name'])}: rank correlation of the scalar Laplacian {correlation}"},
        template="plotly_white",
        height=520,
    )
    outputs.write_text(path, go.Figure(figure).to_html(include_plotlyjs=True, full_html=True))


def _plain(name: str) -> str:
    """A file's name that a page shows as it is, whatever it holds."""
    return name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
