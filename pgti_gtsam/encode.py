"""How this package writes JSON: one encoder, one convention for numbers, and the version of every document.

An infinite number is the text "infinite" or "-infinite", and a number that does not exist is null: JSON has neither.
Every document begins with its schema, the schema's version and the version of the package. A version grows when a
field changes its meaning or disappears; new fields may appear without that. The schemas stand in `report/schemas/`.
"""

from __future__ import annotations

import json
import math
from typing import Any

from pgti_gtsam.version import __version__

VERSIONS = {"audit": 2, "closures": 4, "comparison": 1, "diffusion": 1, "fleet": 1, "mend": 1, "parts": 1, "replay": 1}
"""Schemas of the documents that commands write."""


def heading(schema: str, version: int | None = None) -> dict[str, Any]:
    """The first fields of a document.

    Parameters
    ----------
    schema : str
        Name of the schema, as in `VERSIONS` or of another file of this package.
    version : int, optional
        Of the schema; the version in `VERSIONS` when left out.
    """
    return {
        "schema": f"pgti-gtsam/{schema}",
        "schema_version": VERSIONS[schema] if version is None else version,
        "pgti_gtsam_version": __version__,
    }


def number(value: float | None) -> float | str | None:
    """A number as JSON has numbers."""
    if value is None or math.isnan(value):
        return None
    return value if math.isfinite(value) else "infinite" if value > 0 else "-infinite"


def decoded(value: float | str | None) -> float:
    """The number that `number` encoded."""
    if value is None:
        return math.nan
    return {"infinite": math.inf, "-infinite": -math.inf}[value] if isinstance(value, str) else float(value)


def line(document: Any) -> str:
    """A document as a line of strict JSON.

    Raises
    ------
    ValueError
        The document holds a number that did not go through `number`.
    """
    return json.dumps(document, allow_nan=False, ensure_ascii=False) + "\n"
