"""Explained overlaps of a map in parts: the same least fixpoint as of the whole, reached by exchange.

An overlap that follows in a part follows in the whole, since the whole has all edges of the part. An overlap that
follows in the whole follows in the part with the overlap's first keyframe in the core, once the part knows all overlaps
explained before. So parts tell each other of common overlaps until no part learns anything: every order of steps leads
to the same fixpoint (chaotic iteration of a monotone map; Cousot and Cousot, ACM SIGART Bulletin 1977,
doi:10.1145/872734.806926).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.pair_codes import Codes, codes_of, pairs_of, without
from pgti_gtsam.parts.cut import Indices, Part
from pgti_gtsam.support_graph import explained_overlaps, overlapping_spheres

Each = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""Runs a function on every task, here or elsewhere: results in the order of the tasks, as `map` gives them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """A part, and overlaps that other parts explained since the last question.

    Attributes
    ----------
    part : Part
    overlaps : (k, 2) int
        Without an edge, as places in the part.
    explained : (k,) bool
        All explained overlaps.
    new : (k,) bool
        Overlaps that only other parts explained.
    """

    part: Part
    overlaps: Indices
    explained: NDArray[np.bool_]
    new: NDArray[np.bool_]


def first(part: Part) -> tuple[Indices, NDArray[np.bool_]]:
    """Overlaps of a part without an edge, (k, 2), and whether the part's edges explain each, (k,)."""
    n = len(part.vertices)
    overlaps = without(overlapping_spheres(part.positions, part.radii), part.edges, n)
    return overlaps, explained_overlaps(n, part.edges, overlaps, part.edges[part.is_step])


def next_(told: Told) -> NDArray[np.bool_]:
    """Whether each overlap of a part is explained with the news of other parts, (k,)."""
    part, left = told.part, ~told.explained
    explained = told.explained.copy()
    explained[left] = explained_overlaps(
        len(part.vertices),
        np.concatenate([part.edges, told.overlaps[told.explained]]),
        told.overlaps[left],
        part.edges[part.is_step],
        told.overlaps[told.new],
    )
    return explained


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Overlaps:
    """Overlaps of a map without an edge, in two: see `support_graph.SupportGraph`.

    Attributes
    ----------
    fusion_edges, collision_edges : (f, 2), (c, 2) int
        i < j, sorted.
    n_rounds : int
        How often parts were asked.
    """

    fusion_edges: Indices
    collision_edges: Indices
    n_rounds: int


def overlaps_of(n: int, parts: Sequence[Part], each: Each) -> Overlaps:
    """Ask every part, and parts that learn something again.

    Parameters
    ----------
    n : int
        Keyframes of the map.
    parts : sequence of Part
        The cores together are all keyframes.
    each : callable
        As in `diagnose_parts`.
    """
    # what each explains by itself
    asked = list(each(first, parts))
    overlaps = [found for found, _ in asked]
    codes = [codes_of(part.vertices[found], n) for part, found in zip(parts, overlaps, strict=True)]
    explained, n_rounds = [found for _, found in asked], 1

    # what they learn of each other
    while True:
        known = np.unique(np.concatenate([own[yes] for own, yes in zip(codes, explained, strict=True)]))
        new = [~yes & _among(own, known) for own, yes in zip(codes, explained, strict=True)]
        learning = [k for k in range(len(parts)) if new[k].any()]
        if not learning:
            break
        told = [
            Told(part=parts[k], overlaps=overlaps[k], explained=explained[k] | new[k], new=new[k]) for k in learning
        ]
        for k, found in zip(learning, each(next_, told), strict=True):
            explained[k] = found
        n_rounds += 1

    # those of the cores are all, each once
    own = [part.is_core[found[:, 0]] for part, found in zip(parts, overlaps, strict=True)]
    split = [
        np.sort(
            np.concatenate([code[mine & (yes == kind)] for code, mine, yes in zip(codes, own, explained, strict=True)])
        )
        for kind in (True, False)
    ]
    fusion, collisions = (pairs_of(each_kind, n) for each_kind in split)
    return Overlaps(fusion_edges=fusion, collision_edges=collisions, n_rounds=n_rounds)


def _among(codes: Codes, sorted_: Codes) -> NDArray[np.bool_]:
    """Whether each code is in a sorted list."""
    if not len(sorted_):
        return np.zeros(len(codes), dtype=bool)
    places = np.minimum(np.searchsorted(sorted_, codes), len(sorted_) - 1)
    return np.asarray(sorted_[places] == codes)
