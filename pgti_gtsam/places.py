"""Where places touch that no edge ties: pairs of keyframes grouped by revisit.

A *revisit* is two stretches of track that run through the same space. A single tie between the two explains all of
their overlaps, and overlaps with other passes that are tied to either: so the revisits found here are as few as the
ties that are missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import KDTree

from pgti_gtsam.errors import NoRadiusError
from pgti_gtsam.pair_codes import codes_of
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.support_graph import explained_overlaps
from pgti_gtsam.track import Track, closure_edges

WINDOW = 5
"""Keyframes between one overlap of a revisit and the next, on either stretch: a few spheres in between are small."""

REACH = 5.0
"""The same in ρ travelled, where keyframes lie denser than one a free radius."""


class Scored(Protocol):
    """One graph against another, keyframe by keyframe: see `integrity.Distortion`."""

    @property
    def keyframe_scores(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def stable_scores(self) -> NDArray[np.float64]: ...  # noqa: D102
    def scale(self, keyframe: int) -> Literal["local", "global"]: ...  # noqa: D102


class Compared(Protocol):
    """What a map's pose graph and its free space have in common, and what not: see `integrity.Integrity`."""

    @property
    def n_components_pose_graph(self) -> int: ...  # noqa: D102
    @property
    def merged_edges(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def fusion_edges(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def collision_edges(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def keyframe_scores(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def fusion(self) -> Scored: ...  # noqa: D102
    @property
    def collisions(self) -> Scored: ...  # noqa: D102


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Revisit:
    """Two stretches of track in contact.

    Attributes
    ----------
    edges : (k, 2) int
        Overlaps between the two stretches, i < j.
    resolved : (l, 2) int
        Overlaps, these included, that follow once the stretches are tied.
    stretches : ((int, int), (int, int))
        First and last keyframe of the earlier and of the later stretch.
    closest : (int, int)
        The overlap where a tie is best: where the centres lie nearest in units of the sum of the radii, or, along an
        untied pass, where the drift allows most.
    lengths_m : (float, float)
        Way along each stretch.
    """

    edges: NDArray[np.int64]
    resolved: NDArray[np.int64]
    stretches: tuple[tuple[int, int], tuple[int, int]]
    closest: tuple[int, int]
    lengths_m: tuple[float, float]

    @property
    def keyframes(self) -> NDArray[np.int64]:
        """All keyframes that an overlap of the revisit touches, ascending."""
        return np.unique(self.resolved)


def tied_radius_m(pose_graph: PoseGraph) -> float:
    """A radius where nothing tells any, m: the median distance between keyframes that a loop closure ties.

    A map's own closures say at what distance the map's maker takes two keyframes to be at the same place. On the two
    scan graphs with measured radii the rule gives 0.74 and 0.75 m, where the scans give 0.76 and 0.74 m.

    Raises
    ------
    NoRadiusError
        No closure ties keyframes that lie apart.
    """
    i, j = pose_graph.edges[closure_edges(pose_graph)].T
    distances = np.linalg.norm(pose_graph.positions[i] - pose_graph.positions[j], axis=1)
    if not (distances > 0).any():
        raise NoRadiusError(
            "expected loop closures to take a radius from, got none; give metres that are free around every keyframe "
            "(--radius 2)"
        )
    return float(np.median(distances[distances > 0]))


def revisits(pose_graph: PoseGraph, integrity: Compared, track: Track) -> list[Revisit]:
    """The collisions of a map as revisits, those that resolve most overlaps first.

    The largest group of overlaps that lie beside each other on both stretches is taken for tied; overlaps that follow
    belong to the same revisit. So on until nothing is left. Groups of different parts of the map explain none of each
    other's overlaps (`_parts`), so that the largest group of every part is taken at once.

    Parameters
    ----------
    pose_graph, integrity
    track : Track
    """
    n, odometry = len(pose_graph), pose_graph.edges[pose_graph.edge_sources & EdgeSource.ODOMETRY > 0]
    left = integrity.collision_edges
    known = np.concatenate([pose_graph.edges, integrity.fusion_edges])
    known = known[_beside(n, left, odometry)[known].any(axis=1)]
    groups = neighbourhoods(left, places_on(pose_graph, track)).group_of
    parts = _parts(n, left, groups, odometry)
    found: list[tuple[tuple[int, int], Revisit]] = []
    while len(left):
        # tie the largest group of every part, and see what follows
        sizes = np.bincount(groups, minlength=len(parts))
        chosen = _first_of_each(parts, np.lexsort((-sizes, parts)))
        is_own = chosen[parts[groups]] == groups
        known = np.concatenate([known, left[is_own]])
        is_resolved = is_own.copy()
        is_resolved[~is_own] = explained_overlaps(n, known, left[~is_own], odometry, left[is_own])
        for members in _by(parts[groups], is_resolved):
            own, more = members[is_own[members]], members[~is_own[members]]
            each = revisit(pose_graph, track, left[own], left[np.concatenate([own, more])])
            found.append(((-len(own), int(groups[own[0]])), each))

        # what remains is judged anew; edges between other keyframes explain nothing more
        known = np.concatenate([known, left[is_resolved & ~is_own]])
        left, groups = left[~is_resolved], groups[~is_resolved]
        is_open = np.zeros(n, dtype=bool)
        is_open[left] = True
        known = known[is_open[known].all(axis=1)]
    in_turn = [each for _, each in sorted(found, key=lambda each: each[0])]
    return sorted(in_turn, key=lambda each: -len(each.resolved))


def _parts(
    n: int, overlaps: NDArray[np.int64], groups: NDArray[np.int64], odometry: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Part of every group: overlaps of different parts share no keyframe and are no rungs beside each other.

    A triangle that explains an overlap by another one holds a keyframe of both, and a rung leads from one to the other.
    So nothing that is tied in a part explains anything in another.
    """
    n_groups = int(groups.max(initial=-1)) + 1
    one, other = _rungs(n, overlaps, odometry)
    first = np.concatenate([groups, groups, groups[one]])
    second = np.concatenate([*(n_groups + overlaps.T), groups[other]])
    links = sparse.coo_array((np.ones(len(first)), (first, second)), shape=(n_groups + n, n_groups + n))
    _, part = csgraph.connected_components(links, directed=False)
    return np.unique(part[:n_groups], return_inverse=True)[1].astype(np.int64)


def _rungs(
    n: int, overlaps: NDArray[np.int64], odometry: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of overlaps such that a step of odometry leads from either end of the first to an end of the second."""
    i, j = odometry.T
    steps = sparse.coo_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(n, n)).tocsr()
    one, beside = steps[overlaps[:, 0]].nonzero()
    along, across = steps[overlaps[one, 1]].nonzero()
    codes, own = codes_of(np.stack([beside[along], across], axis=1), n), codes_of(overlaps, n)
    order = np.argsort(own)
    other = order[np.searchsorted(own, codes, sorter=order) % max(len(own), 1)]
    met = own[other] == codes
    return one[along[met]], other[met]


def _first_of_each(parts: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first in an order of each of the parts 0, 1, …"""
    return np.asarray(order[np.unique(parts[order], return_index=True)[1]])


def _by(parts: NDArray[np.int64], chosen: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """The chosen rows, part by part."""
    rows = np.flatnonzero(chosen)
    rows = rows[np.argsort(parts[rows], kind="stable")]
    return np.split(rows, np.flatnonzero(np.diff(parts[rows])) + 1)


def _beside(n: int, overlaps: NDArray[np.int64], odometry: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Keyframes of some overlaps and their neighbours on the track, (n,): what explains an overlap has an end there."""
    own = np.zeros(n, dtype=bool)
    own[overlaps.ravel()] = True
    found = own.copy()
    found[odometry[own[odometry].any(axis=1)].ravel()] = True
    return found


def revisit(
    pose_graph: PoseGraph,
    track: Track,
    edges: NDArray[np.int64],
    resolved: NDArray[np.int64] | None = None,
    tied_at: NDArray[np.int64] | None = None,
) -> Revisit:
    """The record of overlaps that were found to belong together.

    A tie is best where the centres lie nearest, in units of the spheres' reach, unless told otherwise.

    Parameters
    ----------
    pose_graph : PoseGraph
    track : Track
    edges : (k, 2) int
        Overlaps of the revisit.
    resolved : (l, 2) int, optional
        Overlaps that a tie resolves; `edges` when left out.
    tied_at : (2,) int, optional
        Where a tie is best.
    """
    early, late = ((int(ends.min()), int(ends.max())) for ends in edges.T)
    gaps = np.linalg.norm(np.diff(pose_graph.positions[edges], axis=1)[:, 0], axis=1)
    reach = np.maximum(pose_graph.radii[edges].sum(axis=1), np.finfo(float).tiny)
    nearest = edges[np.argmin(gaps / reach)] if tied_at is None else tied_at
    return Revisit(
        edges=edges,
        resolved=edges if resolved is None else resolved,
        stretches=(early, late),
        closest=(int(nearest[0]), int(nearest[1])),
        lengths_m=(float(np.ptp(track.way_m[list(early)])), float(np.ptp(track.way_m[list(late)]))),
    )


def places_on(pose_graph: PoseGraph, track: Track) -> NDArray[np.float64]:
    """A coordinate along the track, (n,), that grows by 1 in `WINDOW` keyframes or `REACH` ρ, whichever is more way.

    Between chains, which follow each other, the coordinate grows by more than any neighbourhood spans.

    Parameters
    ----------
    pose_graph : PoseGraph
    track : Track
    """
    positive = pose_graph.radii[pose_graph.radii > 0]
    unit = float(np.median(positive)) if len(positive) else np.inf
    steps = np.minimum(1 / WINDOW, np.diff(track.way_m[track.order]) / (REACH * unit))
    places = np.empty(len(pose_graph))
    places[track.order] = np.concatenate([[0.0], np.cumsum(steps + 10.0 * np.diff(track.chain[track.order]))])
    return places


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Neighbourhoods:
    """Overlaps by their positions on both stretches.

    Attributes
    ----------
    first : (c,) int
        An overlap in each neighbourhood.
    cell_of, group_of : (k,) int
        Neighbourhood and group of every overlap: neighbourhoods that touch are in the same group.
    """

    first: NDArray[np.int64]
    cell_of: NDArray[np.int64]
    group_of: NDArray[np.int64]


def neighbourhoods(edges: NDArray[np.int64], places: NDArray[np.float64], most: int | None = None) -> Neighbourhoods:
    """Sort overlaps into squares of half a unit of `places_on` on either stretch, or larger squares.

    Parameters
    ----------
    edges : (k, 2) int
    places : (n,) float
        As from `places_on`.
    most : int, optional
        Most neighbourhoods: the squares grow until few enough.
    """
    size = 0.5
    while True:
        cells, first, cell_of = np.unique(
            np.floor(np.sort(places[edges], axis=1) / size).reshape(-1, 2),
            axis=0,
            return_index=True,
            return_inverse=True,
        )
        if most is None or len(cells) <= most:
            break
        size *= 1.5
    near = KDTree(cells).query_pairs(1.0, p=np.inf, output_type="ndarray") if len(cells) else np.empty((0, 2))
    links = sparse.coo_array((np.ones(len(near)), near.T.astype(np.int64)), shape=(len(cells), len(cells)))
    _, group = csgraph.connected_components(links, directed=False)
    cell_of = cell_of.reshape(-1).astype(np.int64)
    return Neighbourhoods(first=first, cell_of=cell_of, group_of=group[cell_of].astype(np.int64))
