"""The audit as one HTML page that needs no network: the JSON document, the plotting library and our scripts inlined.

Every text of the document (file, key and factor names) is untrusted. It travels as JSON data, reaches the page through
`textContent` alone, and a Content-Security-Policy runs only the two scripts whose hashes it names and loads nothing.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from plotly.offline import get_plotlyjs

from pgti_gtsam.errors import InvalidValueError

SCHEMA, SCHEMA_VERSION = "pgti-gtsam/audit", 2

# One module scope, in reading order: later files use what earlier ones define.
_SCRIPTS = ("text.js", "model.js", "camera.js", "map.js", "marks.js", "charts.js", "tables.js", "main.js")

# Inside <script> only "<" could end the block; the others keep the data inert wherever it is pasted.
_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


def write_page(document: Mapping[str, Any], path: Path | str) -> None:
    """Write the page of an audit to a file.

    Parameters
    ----------
    document : Mapping
        The JSON document of an audit, schema version 2.
    path : Path or str
        The file; it is overwritten.

    Raises
    ------
    InvalidValueError
        See `page`.
    OSError
        The file cannot be written.
    """
    Path(path).write_bytes(page(document).encode("utf-8"))


def page(document: Mapping[str, Any]) -> str:
    """Return one self-contained HTML page that shows an audit.

    Parameters
    ----------
    document : Mapping
        The JSON document of an audit, schema version 2.

    Returns
    -------
    str
        HTML that makes no network request. It opens at the first place, or else at the keyframe with the largest ζ;
        `#place=2` after its address at the place of rank 2, `#keyframe=17` at the keyframe of index 17.

    Raises
    ------
    InvalidValueError
        The document has another schema, or holds NaN or an infinite number, which JSON cannot carry.
    """
    require_schema(document)
    plotly, script = get_plotlyjs(), "\n".join(_asset(name) for name in _SCRIPTS)
    return Template(_asset("page.html")).substitute(
        policy=_policy(plotly, script),
        title=html.escape(str(document["input"]["name"])),
        style=_asset("page.css"),
        document=_inert_json(document),
        plotly=plotly,
        script=script,
    )


def require_schema(document: Mapping[str, Any]) -> None:
    """Raise InvalidValueError unless the document is an audit of the schema version that this package draws."""
    found = document.get("schema"), document.get("schema_version")
    if found != (SCHEMA, SCHEMA_VERSION):
        raise InvalidValueError(
            f'expected "schema": "{SCHEMA}", "schema_version": {SCHEMA_VERSION}, found {found[0]!r}, {found[1]!r}: '
            "write the document again with this version of pgti-gtsam"
        )


def _policy(*scripts: str) -> str:
    """Return a Content-Security-Policy that runs only these inline scripts and reaches no address.

    plotly.js writes style attributes and takes pictures through data: and blob: addresses, which stay in the browser.
    """
    hashes = (base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode() for script in scripts)
    sources = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src {sources}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _inert_json(document: Mapping[str, Any]) -> str:
    """Return the document as JSON whose text cannot end, open or alter any HTML element."""
    try:
        text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    except ValueError as error:
        raise InvalidValueError(f'expected finite numbers or "infinite" in the audit document: {error}') from error
    return text.translate(_ESCAPES)


def _asset(name: str) -> str:
    """Return the text of a file beside this module, in `page/`."""
    return (files("pgti_gtsam.report") / "page" / name).read_text(encoding="utf-8")
