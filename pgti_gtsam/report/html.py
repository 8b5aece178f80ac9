"""The audit as an HTML page that needs no network: see `web`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgti_gtsam import outputs
from pgti_gtsam.report import web

_SCRIPTS = (
    "text.js",
    "errors.js",
    "model.js",
    "camera.js",
    "plots.js",
    "space.js",
    "canvas.js",
    "map.js",
    "marks.js",
    "charts.js",
    "tables.js",
    "main.js",
)


def write_page(document: Mapping[str, Any], path: Path | str) -> None:
    """Write the page of an audit to a file.

    Parameters
    ----------
    document : Mapping
        The JSON document of an audit, schema version 2.
    path : Path or str
        The file to write or overwrite.

    Raises
    ------
    InvalidValueError
        See `page`.
    OutputError
        The file cannot be written.
    """
    outputs.write_text(path, page(document))


def page(document: Mapping[str, Any]) -> str:
    """Return a self-contained HTML page that shows an audit.

    Parameters
    ----------
    document : Mapping
        The JSON document of an audit, schema version 2.

    Returns
    -------
    str
        HTML that makes no network request. The page opens at the first place, or else at the keyframe with the largest
        ζ; `#place=2` after the address opens at the place of rank 2, `#keyframe=17` at the keyframe of index 17.

    Raises
    ------
    InvalidValueError
        The document has another schema, or holds NaN or an infinite number, impossible in JSON.
    """
    require_schema(document)
    return web.assembled(document, what="map integrity", body="audit.html", first="places", scripts=_SCRIPTS)


def require_schema(document: Mapping[str, Any]) -> None:
    """Raise InvalidValueError unless the document is an audit of the schema version that this package draws."""
    web.require_schema(document, "audit")
