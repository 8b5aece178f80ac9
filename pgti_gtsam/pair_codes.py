"""Pairs of vertices as single numbers, for the set operations of NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Pairs = NDArray[np.int64]
Codes = NDArray[np.int64]


def codes_of(pairs: Pairs, n: int) -> Codes:
    """low · n + high for each pair of n vertices, (m, 2), in either order: ascending as sorted pairs are.

    Parameters
    ----------
    pairs : (m, 2) int
    n : int
        Number of vertices.
    """
    return np.asarray(pairs.min(axis=1, initial=n) * n + pairs.max(axis=1, initial=0))


def pairs_of(codes: Codes, n: int) -> Pairs:
    """The pairs, low < high, (m, 2).

    Parameters
    ----------
    codes : (m,) int
    n : int
        Number of vertices.
    """
    return np.stack([codes // n, codes % n], axis=1)


def without(pairs: Pairs, others: Pairs, n: int) -> Pairs:
    """The pairs that are not among the others, in either order.

    Parameters
    ----------
    pairs : (m, 2) int
    others : (k, 2) int
    n : int
        Number of vertices.
    """
    return np.asarray(pairs[~np.isin(codes_of(pairs, n), codes_of(others, n))])
