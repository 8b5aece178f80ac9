"""Numbers in documents, to the digits that do not depend on the number of threads.

Threads change the order of sums, and with the order the last digits: between one and two threads the scores, evidence
and signatures of the Intel lab differ by up to 7e-11 of themselves.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

Told = ParamSpec("Told")

DIGITS = 6
"""Significant digits of a number. A number in a document of 10 000 numbers that differ by 1e-12 then rounds to another
number in a run of some 300."""

PACKED_DIGITS = 4
"""Significant digits of signatures, which are drawn, and of which a document holds some 300 000."""

AS_READ = frozenset({"position", "pose", "radius", "options"})
"""Parts of a document that stay: lengths of the map, whose digits may be those of a coordinate far from zero."""


def stable(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document with all numbers rounded to `DIGITS`.

    Parameters
    ----------
    document : mapping
        JSON-ready; parts named in `AS_READ` keep all digits.
    """
    return {name: value if name in AS_READ else _rounded(value) for name, value in document.items()}


def in_stable_digits(make: Callable[Told, Mapping[str, Any]]) -> Callable[Told, dict[str, Any]]:
    """Decorator of a function that makes a document: the document is `stable`."""

    @functools.wraps(make)
    def rounded(*args: Told.args, **kwargs: Told.kwargs) -> dict[str, Any]:
        return stable(make(*args, **kwargs))

    return rounded


def _rounded(part: Any) -> Any:
    if isinstance(part, Mapping):
        return stable(part)
    if isinstance(part, list | tuple):
        return [_rounded(value) for value in part]
    return float(f"{part:.{DIGITS - 1}e}") if isinstance(part, float) else part


def packable(values: ArrayLike) -> NDArray[np.float64]:
    """Numbers rounded to `PACKED_DIGITS`, of the same shape.

    Parameters
    ----------
    values : array of float
        Finite.
    """
    found = np.asarray(values, dtype=float)
    size = np.abs(found)
    exponents = np.floor(np.log10(size, out=np.zeros_like(size), where=size > 0))
    steps = 10.0 ** (exponents - (PACKED_DIGITS - 1))
    return np.asarray(np.round(found / steps) * steps)
