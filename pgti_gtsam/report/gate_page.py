"""Gated closures as an HTML page that needs no network: see `web`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgti_gtsam import outputs
from pgti_gtsam.report import web

_SCRIPTS = (
    "text.js",
    "errors.js",
    "gate_model.js",
    "camera.js",
    "plots.js",
    "space.js",
    "canvas.js",
    "gate_map.js",
    "gate_charts.js",
    "gate_tables.js",
    "gate_main.js",
)


def write_gate_page(document: Mapping[str, Any], path: Path) -> None:
    """Write an HTML file that makes no network request: the map, its closures in time, and the reasons of each verdict.

    The page opens at the least probable closure; `#slot=1234` after the address opens at the closure of that factor.

    Parameters
    ----------
    document : Mapping
        As `closures_document` makes it.
    path : Path
        The file to write or overwrite.

    Raises
    ------
    InvalidValueError
        The document has another schema, or holds a number that JSON cannot carry.
    """
    web.require_schema(document, "closures")
    page = web.assembled(document, what="loop closures", body="gate.html", first="closures", scripts=_SCRIPTS)
    outputs.write_text(path, page)
