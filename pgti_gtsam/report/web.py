"""A JSON document as an HTML page that needs no network: the document, the plotting library and our scripts inlined.

Every text of the document (file, key and factor names) is untrusted. Text travels as JSON data, reaches the page
through `textContent` alone, and a Content-Security-Policy runs only the two scripts with named hashes and loads
nothing.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from string import Template
from typing import Any

from plotly.offline import get_plotlyjs

from pgti_gtsam import encode
from pgti_gtsam.errors import InvalidValueError

# Inside <script> only "<" could end the block; the others keep the data inert wherever it is pasted.
_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


def assembled(document: Mapping[str, Any], *, what: str, body: str, first: str, scripts: Sequence[str]) -> str:
    """Return a self-contained HTML page that draws a document.

    Parameters
    ----------
    document : Mapping
        With `input.name`, the page's title.
    what : str
        What the page shows of the document, in words.
    body : str
        File of `page/` with the page's cards.
    first : str
        Identifier of the first table, to which a keyboard skips.
    scripts : sequence of str
        Files of `page/` in reading order: a common module scope, in which later files use definitions of earlier files.

    Raises
    ------
    InvalidValueError
        The document holds NaN or an infinite number, impossible in JSON.
    """
    script = "\n".join(asset(name) for name in scripts)
    plotly = get_plotlyjs() if "Plotly." in script else ""  # 4.8 MB, for pages that plot
    return Template(asset("shell.html")).substitute(
        policy=_policy(plotly, script),
        title=html.escape(str(document["input"]["name"])),
        what=what,
        style=asset("page.css"),
        first=first,
        body=asset(body),
        document=_inert_json(document),
        plotly=plotly,
        script=script,
    )


def require_schema(document: Mapping[str, Any], schema: str) -> None:
    """Raise InvalidValueError unless a document is of the schema that this package writes.

    Parameters
    ----------
    document : mapping
    schema : str
        A key of `encode.VERSIONS`.
    """
    expected = encode.heading(schema)
    names = ("schema", "schema_version")
    wanted, found = ([each.get(name) for name in names] for each in (expected, document))
    if found != wanted:
        raise InvalidValueError(
            f'expected "schema": "{wanted[0]}", "schema_version": {wanted[1]}, found {found[0]!r}, {found[1]!r}: '
            "write the document again with this version of the package"
        )


def asset(name: str) -> str:
    """Return the text of a file of the folder `page/` beside this module."""
    return (files("pgti_gtsam.report") / "page" / name).read_text(encoding="utf-8")


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
        raise InvalidValueError(f'expected finite numbers or "infinite" in the document: {error}') from error
    return text.translate(_ESCAPES)
