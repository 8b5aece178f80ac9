"""Arguments of callers, checked at the door: the message says what was expected and what came."""

from __future__ import annotations

import numbers
from collections.abc import Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError

Kind = TypeVar("Kind")


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


def whole(given: Any, what: str, *, least: int, most: int | None = None) -> int:
    """A whole number from ``least`` on, up to ``most``; raises InvalidOptionError.

    Parameters
    ----------
    given : object
    what : str
        Name of the argument, for the message.
    least, most : int
        Smallest and largest number allowed; without a largest where left out.
    """
    if not isinstance(given, numbers.Integral) or isinstance(given, bool):
        raise InvalidOptionError(f"expected a whole number as {what}, got {shown(given)}")
    number = int(given)
    if number < least or (most is not None and number > most):
        limits = f"at least {least}" if most is None else f"{least} to {most}"
        raise InvalidOptionError(f"expected {what} of {limits}, got {number}")
    return number


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


def finite_array(given: Any, what: str, *shape: int | None) -> NDArray[np.float64]:
    """A new array of finite real numbers of a shape, None being any length; raises InvalidGraphError.

    Parameters
    ----------
    given : object
    what : str
        Name of the argument, for the message.
    shape : int or None
        Length along each axis.
    """
    found = real_array(given, what)
    fits = found.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, found.shape, strict=True))
    if not fits or not np.isfinite(found).all():
        lengths = " × ".join("any" if want is None else str(want) for want in shape)
        raise InvalidGraphError(
            f"expected {lengths} finite numbers as {what}, got {shown(given)} of shape {found.shape}"
        )
    return found


def pairs(given: Any, n: int, what: str) -> NDArray[np.int64]:
    """A new array of edges (m, 2) between two different vertices of 0 to n − 1; raises InvalidGraphError.

    Parameters
    ----------
    given : object
    n : int
        Number of vertices.
    what : str
        Name of the vertices, for the message.
    """
    found = whole_array(given, "edges")
    found = found.reshape(-1, 2) if found.size == 0 else found
    if found.ndim != 2 or found.shape[1] != 2:
        raise InvalidGraphError(f"expected edges of shape (m, 2), got {found.shape}")
    wrong = (found < 0).any(axis=1) | (found >= n).any(axis=1) | (found[:, 0] == found[:, 1])
    if wrong.any():
        i, j = found[np.argmax(wrong)]
        raise InvalidGraphError(f"expected edges between two different {what} of 0 to {n - 1}, got ({i}, {j})")
    return found.astype(np.int64)


def instance(given: Any, kind: type[Kind], what: str) -> Kind:
    """An object of a class; raises InvalidOptionError.

    Parameters
    ----------
    given : object
    kind : type
    what : str
        Name of the argument, for the message.
    """
    if not isinstance(given, kind):
        raise InvalidOptionError(f"expected {what} of type {kind.__name__}, got {shown(given)}")
    return given


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
