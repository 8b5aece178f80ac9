"""Closures of one revisit: the same stretch of track passed again, match after match."""

from __future__ import annotations

from collections.abc import Sequence

WINDOW = 5
"""Keyframes, at either end, between one match of a revisit and the next: a detector misses a few in between."""


def revisits(ends: Sequence[tuple[int, int]], window: int = WINDOW) -> list[list[int]]:
    """Group closures by revisit.

    A closure joins the latest revisit whose last match it follows within `window` keyframes at both
    ends, in either direction of travel; else it opens a revisit of its own.

    Parameters
    ----------
    ends : sequence of (int, int)
        Earlier and later keyframe of every closure, as places on the track.
    window : int

    Returns
    -------
    list of list of int
        Places in `ends`, by time of the later keyframe; revisits by that of their last match.
    """
    found: list[list[int]] = []
    for k in sorted(range(len(ends)), key=lambda k: (ends[k][1], ends[k][0])):
        early, late = ends[k]
        near = (
            group
            for group in reversed(found)
            if late - ends[group[-1]][1] <= window and abs(early - ends[group[-1]][0]) <= window
        )
        group = next(near, None)
        if group is None:
            found.append([k])
        else:
            group.append(k)
    return sorted(found, key=lambda group: ends[group[-1]][1])
