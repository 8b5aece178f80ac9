"""Arguments of callers, checked at the door: the message says what was expected and what came."""

from __future__ import annotations

import numbers
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError


def real(given: Any, what: str) -> float:
    """A real number that is not NaN; raises InvalidOptionError.

    Parameters
    ----------
    given : object
    what : str
        Name of the argument, for the message.
    """
    if not isinstance(given, numbers.Real) or isinstance(given, bool) or given != given:
        raise InvalidOptionError(f"expected a number as {what}, got {shown(given)}")
    return float(given)


def whole(given: Any, what: str, *, least: int) -> int:
    """A whole number from ``least`` on; raises InvalidOptionError.

    Parameters
    ----------
    given : object
    what : str
        Name of the argument, for the message.
    least : int
        Smallest number allowed.
    """
    if not isinstance(given, numbers.Integral) or isinstance(given, bool):
        raise InvalidOptionError(f"expected a whole number as {what}, got {shown(given)}")
    if given < least:
        raise InvalidOptionError(f"expected {what} of at least {least}, got {given}")
    return int(given)


def slots(given: Any, what: str) -> list[int]:
    """Slots of a factor graph, or other whole numbers from zero on; raises InvalidOptionError.

    Parameters
    ----------
    given : object
    what : str
        Name of the argument, for the message.
    """
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InvalidOptionError(f"expected a collection of slots as {what}, got {shown(given)}")
    return [whole(slot, f"a slot of {what}", least=0) for slot in given]


def real_array(given: Any, what: str) -> NDArray[np.float64]:
    """A new array of real numbers; raises InvalidGraphError.

    Parameters
    ----------
    given : object
    what : str
        Name of the array, for the message.
    """
    return np.array(_array(given, what, "real numbers", "iuf"), dtype=np.float64)


def whole_array(given: Any, what: str) -> NDArray[Any]:
    """A new array of whole numbers, also from floats without a fraction; raises InvalidGraphError.

    Parameters
    ----------
    given : object
    what : str
        Name of the array, for the message.
    """
    found = _array(given, what, "whole numbers", "iuf")
    if found.dtype.kind == "f" and not (np.isfinite(found).all() and (found == np.floor(found)).all()):
        raise InvalidGraphError(f"expected whole numbers as {what}, got {shown(given)}")
    return found if found.dtype.kind != "f" else found.astype(np.int64)


def _array(given: Any, what: str, kinds: str, codes: str) -> NDArray[Any]:
    try:
        found = np.array(given)
    except (TypeError, ValueError, OverflowError):
        found = np.array(None)
    if found.dtype.kind not in codes:
        raise InvalidGraphError(f"expected {kinds} as {what}, got {shown(given)}")
    return found


def in_a_line(error: Exception) -> str:
    """The first line of an error of GTSAM; text after an empty line explains the class of the error."""
    return " ".join(str(error).strip().split("\n\n")[0].split())


def shown(given: Any) -> str:
    """A value in a short line."""
    text = " ".join(repr(given).split())
    return text if len(text) <= 60 else f"{text[:60]}…"
