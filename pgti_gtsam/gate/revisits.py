"""Closures of a revisit: the same stretch of track passed again, match after match."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

WINDOW = 5
"""Keyframes, at either end, between one match of a revisit and the next: a detector misses a few in between."""

REACH = 5.0
"""The same in ρ travelled, where keyframes lie denser than one a free radius. Five keyframes of KITTI, one every half
second, are about that far apart."""

SPAN = 10
"""Longest revisit, in keyframes or ρ travelled from its first match to its last, whichever is farther. Where the scale
drifts, fitting a long stretch upon the pass before strains it everywhere; what is admitted piece by piece corrects the
map before the next piece is judged. On ray-cast worlds (seeds 1000 to 1007 of `scenarios.worlds`) a span of 10 ρ let
6543 of 6944 true closures in, 20 let 6320, none at all 6241, and each 73 or 74 of 5946 false ones."""


def revisits(
    ends: Sequence[tuple[int, int]], travelled: NDArray[np.float64], window: int = WINDOW, reach: float = REACH
) -> list[list[int]]:
    """Group closures by revisit.

    A closure joins the latest revisit if the last match lies within `window` keyframes or `reach`, whichever is
    farther, at both ends, in either direction of travel, unless the revisit grows longer than `SPAN`; else the closure
    opens a revisit.

    Parameters
    ----------
    ends : sequence of (int, int)
        Earlier and later keyframe of every closure, as places on the track.
    travelled : (n,) float
        Way along the track to every place, in ρ, ascending.
    window : int
    reach : float

    Returns
    -------
    list of list of int
        Indices in `ends`, by time of the later keyframe; revisits by time of the last match.
    """

    def near(one: int, other: int) -> bool:
        return abs(one - other) <= window or abs(travelled[one] - travelled[other]) <= reach

    def joins(early: int, late: int, group: list[int]) -> bool:
        (first, last), start = ends[group[-1]], ends[group[0]][1]
        long = min(late - start, travelled[late] - travelled[start]) > SPAN
        return near(late, last) and near(early, first) and not long

    found: list[list[int]] = []
    recent: list[list[int]] = []
    for k in sorted(range(len(ends)), key=lambda k: (ends[k][1], ends[k][0])):
        early, late = ends[k]
        recent = [group for group in recent if near(late, ends[group[-1]][1])]
        group = next((g for g in reversed(recent) if joins(early, late, g)), None)
        if group is None:
            group = []
            found.append(group)
            recent.append(group)
        group.append(k)
    return sorted(found, key=lambda group: ends[group[-1]][1])
