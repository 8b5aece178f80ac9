"""The pose graph that is assessed: keyframes, edges and radii. The module knows nothing of GTSAM."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pgti_gtsam.checks import pairs, real_array, whole_array
from pgti_gtsam.errors import InvalidGraphError, InvalidValueError, NoPoseError
from pgti_gtsam.pair_codes import codes_of, pairs_of
from pgti_gtsam.sightings import Sightings

Radii: TypeAlias = float | Mapping[int, float]
"""One radius for all keyframes, or one for each key, m."""


class EdgeSource(enum.IntFlag):
    """Why two keyframes count as connected; an edge may have several reasons.

    `ODOMETRY` marks, beside its reason, an edge that is a step of a track: from a keyframe to the next. `SKIP`
    marks factors over several steps that the way between explains. See `track`.
    """

    BETWEEN = 1
    COVISIBILITY = 2
    TRACK = 4
    ODOMETRY = 8
    SKIP = 16


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adaptation:
    """How the adapter used a factor graph, so that nothing is dropped silently.

    Attributes
    ----------
    used, ignored, unknown : mapping from factor class to count
        Factors that shaped the pose graph; known factors that say nothing about connectivity or
        free space; and factors of classes the adapter does not know.
    empty_slots : int
        Slots whose factor had been removed.
    n_landmarks, n_observations : int
        Landmarks placed in space, and the sightings that radii and covisibility came from.
    landmarks_without_position : int
        Landmarks that were seen but could not be placed, such as degenerate triangulations.
    keyframes_without_radius : int
        Keyframes around which nothing is guaranteed free: the radius is zero.
    edges : mapping from source to count
        Pairs connected by "between", "covisibility" and "track", before the merge.
    max_shared_landmarks, min_shared_landmarks : int
        Largest number of landmarks any two keyframes share, and the number that connects two keyframes.
    """

    used: Mapping[str, int]
    ignored: Mapping[str, int]
    unknown: Mapping[str, int]
    empty_slots: int
    n_landmarks: int
    n_observations: int
    landmarks_without_position: int
    keyframes_without_radius: int
    edges: Mapping[str, int]
    max_shared_landmarks: int
    min_shared_landmarks: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseGraph:
    """Keyframes, the edges between them, and the free sphere around each (section 5.1).

    Attributes
    ----------
    keys : (n,) uint64
        Distinct names of the keyframes.
    positions : (n, 3) float, m
        Centres of the keyframes; (n, 2) is accepted and lies in the plane z = 0.
    edges : (m, 2) int
        Indices of connected keyframes, i < j, sorted, unique. Pairs may be given in any order
        and repeatedly: repeated pairs are merged, and likewise the arrays below.
    radii : (n,) float, m
        Distance that is guaranteed free around each keyframe; zero guarantees nothing. A single
        number stands for all.
    edge_sources : (m,) uint8
        `EdgeSource` flags; `EdgeSource.BETWEEN` when left out.
    edge_slots : tuple of m tuples of int
        Slots in the factor graph of the between factors of each edge.
    edge_information : (m, d, d) float, optional
        Sum of the information matrices of the between factors of each edge, in the tangent space
        of its keyframe j; NaN for an edge without information. A block smaller than d is filled with NaN.
    adaptation : Adaptation, optional
        How the graph came about.
    sightings : Sightings, optional
        Sightings of landmarks; None without landmarks.

    Raises
    ------
    NoPoseError, InvalidGraphError, InvalidValueError
        No keyframe at all; arrays that do not fit together; coordinates that are not finite,
        radii that are negative or not finite.
    """

    keys: NDArray[np.uint64]
    positions: NDArray[np.float64]
    edges: NDArray[np.int64]
    radii: NDArray[np.float64]
    edge_sources: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    edge_slots: tuple[tuple[int, ...], ...] = ()
    edge_information: NDArray[np.float64] | None = None
    adaptation: Adaptation | None = None
    sightings: Sightings | None = None

    def __post_init__(self) -> None:
        keys = _checked_keys(self.keys)
        positions = _checked_positions(keys, self.positions)
        radii = _checked_radii(keys, self.radii)
        edges = pairs(self.edges, len(keys), "keyframes")

        # what each edge carries
        m = len(edges)
        sources = np.asarray(self.edge_sources if len(self.edge_sources) else np.full(m, EdgeSource.BETWEEN), np.uint8)
        slots = self.edge_slots or ((),) * m
        if len(sources) != m or len(slots) != m:
            raise InvalidGraphError(
                f"expected one source and one tuple of slots for each of the {m} edges, "
                f"got {len(sources)} and {len(slots)}"
            )
        information = _checked_information(m, self.edge_information)

        # each pair once, and nothing can be changed
        merged = _merge_edges(edges, sources, slots, information, len(keys))
        for name, value in zip(
            ("keys", "positions", "radii", "edges", "edge_sources", "edge_slots", "edge_information"),
            (keys, positions, radii, *merged),
            strict=True,
        ):
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Count the keyframes."""
        return len(self.keys)

    @property
    def labels(self) -> list[str]:
        """Names of the keyframes as GTSAM prints them: `x7` for a symbol, else the number."""
        return [key_label(int(key)) for key in self.keys]


def key_label(key: int) -> str:
    """Name of a key: letter and index of a GTSAM symbol (letter in the highest byte), else digits."""
    letter, index = chr(key >> 56), key & ((1 << 56) - 1)
    return f"{letter}{index}" if letter.isascii() and letter.isalnum() else str(key)


def _checked_keys(keys: ArrayLike) -> NDArray[np.uint64]:
    given = whole_array(keys, "keys")
    if (given < 0).any():
        raise InvalidGraphError(f"expected keys from zero on, got {given.min()}")
    checked = given.astype(np.uint64)
    if checked.ndim != 1 or len(checked) == 0:
        raise NoPoseError("expected at least one keyframe, got none: nothing can be assessed")
    if len(np.unique(checked)) != len(checked):
        values, counts = np.unique(checked, return_counts=True)
        raise InvalidGraphError(f"expected distinct keys, got {key_label(int(values[counts.argmax()]))} more than once")
    return checked


def _checked_positions(keys: NDArray[np.uint64], positions: ArrayLike) -> NDArray[np.float64]:
    checked = real_array(positions, "positions, m")
    if checked.ndim != 2 or checked.shape[0] != len(keys) or checked.shape[1] not in (2, 3):
        raise InvalidGraphError(
            f"expected positions of shape ({len(keys)}, 3) or ({len(keys)}, 2), got {checked.shape}"
        )
    bad = ~np.isfinite(checked).all(axis=1)
    if bad.any():
        i = int(bad.argmax())
        raise InvalidValueError(
            f"expected a finite position, got {checked[i].tolist()} at keyframe {key_label(int(keys[i]))}"
        )
    return np.pad(checked, ((0, 0), (0, 3 - checked.shape[1])))


def _checked_radii(keys: NDArray[np.uint64], radii: ArrayLike) -> NDArray[np.float64]:
    given = real_array(radii, "radii, m")
    if given.shape not in ((), keys.shape):
        raise InvalidGraphError(f"expected one radius or {len(keys)} of them, got shape {given.shape}")
    checked = np.broadcast_to(given, keys.shape).copy()
    bad = ~(np.isfinite(checked) & (checked >= 0))
    if bad.any():
        i = int(bad.argmax())
        raise InvalidValueError(
            f"expected a radius of zero or more metres, got {checked[i]} at keyframe {key_label(int(keys[i]))}"
        )
    return checked


def _checked_information(m: int, information: ArrayLike | None) -> NDArray[np.float64] | None:
    if information is None:
        return None
    checked = real_array(information, "edge information")
    if checked.ndim != 3 or checked.shape[0] != m or checked.shape[1] != checked.shape[2]:
        raise InvalidGraphError(f"expected edge information of shape ({m}, d, d), got {checked.shape}")
    return checked


def _merge_edges(
    edges: NDArray[np.int64],
    sources: NDArray[np.uint8],
    slots: Sequence[tuple[int, ...]],
    information: NDArray[np.float64] | None,
    n: int,
) -> tuple[NDArray[np.int64], NDArray[np.uint8], tuple[tuple[int, ...], ...], NDArray[np.float64] | None]:
    """Sort the pairs, and merge the data of pairs that occur more than once."""
    codes, row = np.unique(codes_of(edges, n), return_inverse=True)
    merged_edges = pairs_of(codes, n)
    merged_sources = np.zeros(len(codes), dtype=np.uint8)
    np.bitwise_or.at(merged_sources, row, sources)
    gathered: list[tuple[int, ...]] = [()] * len(codes)
    for k, own in zip(row.tolist(), slots, strict=True):
        if own:
            gathered[k] += own
    if information is None:
        return merged_edges, merged_sources, tuple(gathered), None
    known = ~np.isnan(information)
    total = np.zeros((len(codes), *information.shape[1:]))
    np.add.at(total, row, np.where(known, information, 0.0))
    seen = np.zeros(total.shape, dtype=bool)
    np.logical_or.at(seen, row, known)
    return merged_edges, merged_sources, tuple(gathered), np.where(seen, total, np.nan)
