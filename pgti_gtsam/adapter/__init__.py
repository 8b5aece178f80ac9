"""From a GTSAM factor graph and its values to the pose graph that is assessed."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from numbers import Real
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.factors import FactorReader
from pgti_gtsam.adapter.families import Family
from pgti_gtsam.adapter.values import Keyframes, read_keyframes
from pgti_gtsam.checks import shown, slots, whole
from pgti_gtsam.errors import InvalidOptionError, InvalidValueError, NoRadiusError
from pgti_gtsam.factor_graphs import check_map
from pgti_gtsam.pair_codes import codes_of
from pgti_gtsam.pose_graph import Adaptation, EdgeSource, PoseGraph
from pgti_gtsam.sightings import Sightings, covisibility_edges, minimum_sphere_radii
from pgti_gtsam.track import Roles, Tie, roles, track_edges

EDGE_SOURCES = ("between", "covisibility", "track")

MIN_SHARED_LANDMARKS = 15
"""Landmarks that two keyframes must share to count as connected: what ORB-SLAM's covisibility graph asks
for (Mur-Artal et al., IEEE Transactions on Robotics 2015, https://doi.org/10.1109/TRO.2015.2463671). Where no two
keyframes of a map share so many, as among trees or tags, one is enough: each sighting is a line of free sight, and two
that end at one landmark lead from one keyframe to the other."""


def from_gtsam(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    *,
    radii: float | Mapping[int, float] | None = None,
    edges: Collection[str] | None = None,
    min_shared_landmarks: int | None = None,
    closures: Collection[int] | None = None,
    information: bool = True,
) -> PoseGraph:
    """Adapt a factor graph into a pose graph. Graph and values stay untouched.

    (Smart factors remember their last triangulation, as whenever GTSAM evaluates them.)

    Keyframes are all pose variables: Pose2, Pose3, Similarity2, Similarity3, NavState, Gal3 and cameras.
    Inertial factors and constant velocity are odometry, as are factors that measure a pose from a keyframe to the next.
    Landmark factors give the radii (Eq. 13 with the landmarks of connected keyframes, section 3.1).
    The position of a landmark is its value; without a value, the measurement of the nearest sighting.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Slots of removed factors are skipped.
    values : gtsam.Values
        An estimate of the graph's variables.
    radii : float or mapping from key to float, m, optional
        Radius of every keyframe, or of some, instead of the radius that landmark factors give.
    edges : collection of {"between", "covisibility", "track"}, optional
        The sources of edges: factors between keyframes; landmarks that both keyframes see; the distance
        travelled between keyframes being at most the sum of the radii. The default is the first two, and
        the third as well where `radii` are given or no two keyframes share a landmark: the pose graph
        would be sparser than the free space for want of landmarks, not of connections.
    min_shared_landmarks : int, optional
        Shared landmarks that connect two keyframes by covisibility; without, `MIN_SHARED_LANDMARKS`, or 1
        where no two keyframes share so many.
    closures : collection of int, optional
        Slots of the loop closures: every other factor between keyframes is odometry. Without, `track.roles` tells
        them apart.
    information : bool
        Whether noise models are read, for `edge_information`.

    Returns
    -------
    PoseGraph
        The attribute `adaptation` counts the factors that were used, ignored and not known.

    Raises
    ------
    NoPoseError
        No value is a pose.
    MissingValueError
        A factor between poses or to a landmark has a key without a value.
    UnusedValueError
        A pose appears in no factor.
    NoRadiusError
        Neither landmark factors nor `radii` give any keyframe a radius.
    InvalidGraphError, InvalidValueError, InvalidOptionError
        Another type than graph or values; a position or radius that is not finite, a radius below zero or for no
        keyframe; an unknown source of edges, fewer than one shared landmark, or a closure's slot that holds no factor
        between two keyframes.
    """
    # what connects keyframes
    check_map(graph, values)
    if min_shared_landmarks is not None:
        whole(min_shared_landmarks, "min_shared_landmarks", least=1)
    closing = None if closures is None else slots(closures, "closures")
    chosen = None if edges is None else checked_sources(edges)
    reader = FactorReader(read_keyframes(values), reads_noise=information)
    reader.read(graph)
    keyframes, sightings = reader.keyframes, reader.sightings()
    between = np.array([row[:2] for row in reader.between], dtype=np.int64).reshape(-1, 2)
    enough = min_shared_landmarks or MIN_SHARED_LANDMARKS
    covisible, most_shared = covisibility_edges(sightings, enough)
    if min_shared_landmarks is None and most_shared < enough:
        enough = 1
        covisible, _ = covisibility_edges(sightings, enough)
    sources = chosen or _default_sources(radii_given=radii is not None, covisible=len(covisible) > 0)
    found = {"between": between, "covisibility": covisible}
    pairs = {name: found[name] for name in found if name in sources}
    own = _roles(reader, covisible, closing)

    # how far the space around them is free, and what that connects along the track
    seen = minimum_sphere_radii(sightings, keyframes.positions, np.concatenate([*pairs.values(), _NO_PAIRS]))
    all_radii = _checked_radii(keyframes, seen, radii)
    if "track" in sources:
        order = np.argsort(own.chain, kind="stable")
        pairs["track"] = order[track_edges(_steps(reader, own, order), all_radii[order])]
    return PoseGraph(
        keys=keyframes.keys,
        positions=keyframes.positions,
        radii=all_radii,
        adaptation=_adaptation(reader, sightings, pairs, all_radii, most_shared, enough),
        sightings=sightings if len(sightings.keyframes) else None,
        **_edge_arrays(reader, pairs, own),
    )


_NO_PAIRS = np.empty((0, 2), dtype=np.int64)


def checked_sources(edges: Collection[str]) -> set[str]:
    """Names of the sources of edges; raises InvalidOptionError."""
    chosen = [edges] if isinstance(edges, str) or not isinstance(edges, Iterable) else list(edges)
    if not chosen or any(name not in EDGE_SOURCES for name in chosen):
        raise InvalidOptionError(f"expected edges from {', '.join(EDGE_SOURCES)}, got {shown(edges)}")
    return set(chosen)


def _default_sources(*, radii_given: bool, covisible: bool) -> set[str]:
    """The track is needed where the pose graph is little more than odometry and spheres are larger than its steps."""
    return set(EDGE_SOURCES) if radii_given or not covisible else {"between", "covisibility"}


def _checked_radii(
    keyframes: Keyframes, seen: NDArray[np.float64], given: float | Mapping[int, float] | None
) -> NDArray[np.float64]:
    """Radii from landmarks, replaced by given radii."""
    check_radii(given)

    # given ones replace what landmarks say
    by_key = given if isinstance(given, Mapping) else {} if given is None else dict.fromkeys(keyframes.index, given)
    radii = seen.copy()
    for key, radius in by_key.items():
        place = keyframes.index.get(int(key))
        if place is None:
            raise InvalidValueError(f"expected radii for poses of the graph, got one for {_named(key)}, which is none")
        radii[place] = radius

    # a map needs one at least
    if not radii.any():
        raise NoRadiusError(
            "expected landmarks or radii that say how far the space around keyframes is free, got neither; "
            "give a radius in metres (radii=, on the command line --radius) or a point cloud (--cloud)"
        )
    return radii


LARGEST_M = 1e30
"""Of a radius, as of any number in a file: its square and the inverse of its square are still float64s."""


def check_radii(given: object) -> None:
    """Refuse anything but a radius, a mapping from keys to radii, and None.

    Raises
    ------
    InvalidOptionError, InvalidValueError
    """
    if isinstance(given, bool) or not isinstance(given, Mapping | Real | None):
        raise InvalidOptionError(
            "expected radii as one number of metres or as a mapping from keys to metres, "
            f"got an object of type {type(given).__name__}"
        )
    pairs = given.items() if isinstance(given, Mapping) else [] if given is None else [(None, given)]
    for key, radius in pairs:
        place = "" if key is None else f" for keyframe {_named(whole(key, 'a key of radii', least=0))}"
        if not isinstance(radius, Real) or not 0 <= float(radius) < np.inf:
            raise InvalidValueError(f"expected a radius of zero or more metres, got {shown(radius)}{place}")
        if radius and not 1 / LARGEST_M <= float(radius) <= LARGEST_M:
            raise InvalidValueError(
                f"expected a radius of zero, or from {1 / LARGEST_M:g} to {LARGEST_M:g} m, got {shown(radius)}{place}"
            )


def _named(key: int) -> str:
    return str(gtsam.DefaultKeyFormatter(int(key))) if key < 1 << 64 else str(key)


def _roles(reader: FactorReader, covisible: NDArray[np.int64], closures: list[int] | None) -> Roles:
    """The odometry among the factors between keyframes."""
    own = np.array([row.slot for row in reader.between], dtype=np.int64)
    motions = np.array([row.is_motion for row in reader.between], dtype=bool)
    stray = sorted(set(closures or ()).difference(own[~motions].tolist()))
    if stray:
        raise InvalidOptionError(
            f"expected slots of factors between two keyframes as closures, got slot {stray[0]}, which holds none"
        )
    keys = reader.keyframes.keys
    held = np.zeros(len(keys), dtype=bool)
    held[list(reader.held)] = True
    return roles(
        keys,
        [Tie(row.i, row.j, row.pose) for row in reader.between],
        covisible=covisible,
        held=held,
        motions=motions,
        closures=None if closures is None else np.isin(own, closures),
    )


def _steps(reader: FactorReader, own: Roles, order: NDArray[np.int64]) -> NDArray[np.float64]:
    """Measured distance from each keyframe to the next on the track, NaN without a factor between them.

    A factor that measures no distance (an essential matrix, say) counts with that of the values.
    """
    place, positions = np.argsort(order), reader.keyframes.positions
    steps = np.full(len(order) - 1, np.nan)
    for row in (row for row, is_step in zip(reader.between, own.is_step, strict=True) if is_step):
        first, second = place[[row.i, row.j]]
        if second == first + 1 and np.isnan(steps[first]):
            apart = np.linalg.norm(positions[row.j] - positions[row.i])
            steps[first] = apart if np.isnan(row.length) else row.length
    return steps


def _edge_arrays(reader: FactorReader, pairs: Mapping[str, NDArray[np.int64]], own: Roles) -> dict[str, Any]:
    """Rows of all sources behind each other, as PoseGraph merges rows."""
    used = reader.between if "between" in pairs else []
    edges = np.concatenate([pairs.get(name, _NO_PAIRS) for name in EDGE_SOURCES])
    flags = np.concatenate(
        [np.full(len(pairs.get(name, _NO_PAIRS)), EdgeSource[name.upper()]) for name in EDGE_SOURCES]
    )
    slots = tuple((row.slot,) for row in used) + ((),) * (len(edges) - len(used))
    matrices = [row.information for row in used]
    size = max((len(matrix) for matrix in matrices if matrix is not None), default=0)
    information = np.full((len(edges), size, size), np.nan)
    for k, matrix in enumerate(matrices):
        if matrix is not None:
            information[k, : len(matrix), : len(matrix)] = matrix
    return {
        "edges": edges,
        "edge_sources": flags | _odometry_marks(edges, flags, own, between=pairs.get("between")),
        "edge_slots": slots,
        "edge_information": information if size else None,
    }


def _odometry_marks(
    edges: NDArray[np.int64], flags: NDArray[np.int64], own: Roles, between: NDArray[np.int64] | None
) -> NDArray[np.int64]:
    """`EdgeSource.ODOMETRY` of steps, and `EdgeSource.SKIP` where every factor between two keyframes is a skip."""
    n = len(own.chain)
    codes, steps = codes_of(edges, n), codes_of(own.steps, n)
    marks = np.where(np.isin(codes, steps) & (flags != EdgeSource.TRACK), EdgeSource.ODOMETRY, 0)
    if between is not None and len(between):
        skips, others = (np.unique(codes_of(between[chosen], n)) for chosen in (own.is_skip, ~own.is_skip))
        marks[np.isin(codes, np.setdiff1d(skips, others)) & (flags == EdgeSource.BETWEEN)] = EdgeSource.SKIP
    return marks


def _adaptation(
    reader: FactorReader,
    sightings: Sightings,
    pairs: Mapping[str, NDArray[np.int64]],
    radii: NDArray[np.float64],
    most_shared: int,
    min_shared: int,
) -> Adaptation:
    counts = reader.counts
    used = counts[Family.BETWEEN] + counts[Family.MOTION] + counts[Family.SIGHTING] + counts[Family.SMART]
    placed = np.isfinite(sightings.landmark_positions).all(axis=1)
    return Adaptation(
        used=dict(used),
        ignored=dict(counts[Family.IGNORED]),
        unknown=dict(counts[Family.UNKNOWN]),
        empty_slots=reader.empty_slots,
        n_landmarks=int(placed.sum()),
        n_observations=len(sightings.keyframes),
        landmarks_without_position=int((~placed).sum()),
        keyframes_without_radius=int((radii == 0).sum()),
        edges={name: len(found) for name, found in pairs.items()},
        max_shared_landmarks=most_shared,
        min_shared_landmarks=min_shared,
    )
