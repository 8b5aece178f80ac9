"""A map alone: a part of a factor graph that no factor ties to the rest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from pgti_gtsam.adapter.values import insert_point, read_keyframes, typed_value
from pgti_gtsam.errors import InvalidGraphError
from pgti_gtsam.factor_graphs import graph_of, joined, keys_of, slots_of
from pgti_gtsam.pose_graph import key_label


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SingleMap:
    """Factors and values of a map.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
    closures : frozenset of int, or None
        Slots in `graph` that are known to be closures: see `from_gtsam`.
    first, last : int
        Key of the lowest and of the highest keyframe.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    closures: frozenset[int] | None
    first: int
    last: int

    @property
    def name(self) -> str:
        """Letter of the keyframes if all have the same, else the first and the last keyframe."""
        first, last = key_label(self.first), key_label(self.last)
        return first[0] if first[0].isalpha() and first[0] == last[0] else f"{first}–{last}"

    def radii(self, given: float | Mapping[int, float] | None) -> Any:
        """The given radii of this map's keyframes."""
        return (
            {key: each for key, each in given.items() if self.values.exists(key)}
            if isinstance(given, Mapping)
            else given
        )

    def moved(self, motion: Any) -> SingleMap:
        """The same map in another frame: every pose and point moved."""
        values = gtsam.Values()
        for key in self.values.keys():  # noqa: SIM118  no mapping
            _insert(values, key, self.values, motion)
        return SingleMap(graph=self.graph, values=values, closures=self.closures, first=self.first, last=self.last)

    def centred(self) -> SingleMap:
        """The same map with the mean position of the keyframes at the origin."""
        found = read_keyframes(self.values)
        middle, pose = found.positions.mean(axis=0), found.pose(self.first)
        planar = isinstance(pose, gtsam.Pose2)
        return self.moved(gtsam.Pose2(-middle[0], -middle[1], 0.0) if planar else gtsam.Pose3(gtsam.Rot3(), -middle))

    def joined(self, other: SingleMap, links: Iterable[Any]) -> SingleMap:
        """Both maps, and links between the two, in a common frame.

        Parameters
        ----------
        other : SingleMap
        links : iterable of gtsam.NonlinearFactorGraph
        """
        values = gtsam.Values(self.values)
        values.insert(other.values)
        pair = joined(self.graph, other.graph)
        closures = None
        if self.closures is not None and other.closures is not None:
            closures = self.closures | {self.graph.size() + slot for slot in other.closures}
        return SingleMap(
            graph=pair,
            values=values,
            closures=closures,
            first=min(self.first, other.first),
            last=max(self.last, other.last),
        ).tied(links)

    def tied(self, links: Iterable[Any]) -> SingleMap:
        """The map with more factors, as closures."""
        more = joined(*links)
        graph = joined(self.graph, more)
        slots = range(self.graph.size(), graph.size())
        return SingleMap(
            graph=graph,
            values=self.values,
            closures=None if self.closures is None else self.closures | set(slots),
            first=self.first,
            last=self.last,
        )


def maps_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, closures: Iterable[int] | None) -> list[SingleMap]:
    """The maps of a factor graph: parts that no factor ties, by first keyframe.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
    closures : iterable of int, or None
        As in `from_gtsam`.
    """
    # which variables hang together
    keys = list(values.keys())
    place = {key: k for k, key in enumerate(keys)}
    factors = [(slot, factor, keys_of(factor)) for slot, factor in slots_of(graph)]
    ends = [(place[own[0]], place[key]) for _, _, own in factors for key in own if key in place and own[0] in place]
    rows, columns = np.array(ends, dtype=np.int64).reshape(-1, 2).T
    links = sparse.coo_array((np.ones(len(ends)), (rows, columns)), shape=(len(keys), len(keys)))
    n_parts, part = csgraph.connected_components(links, directed=False)

    # the factors and values of each part that has keyframes
    stated = None if closures is None else set(closures)
    found = []
    keyframes = read_keyframes(values).keys.tolist()
    for k in range(n_parts):
        own_keyframes = [key for key in keyframes if part[place[key]] == k]
        if not own_keyframes:
            continue
        own = [(slot, factor) for slot, factor, ties in factors if ties and part[place[ties[0]]] == k]
        inside = gtsam.Values()
        for key in (key for key in keys if part[place[key]] == k):
            _insert(inside, key, values, None)
        found.append(
            SingleMap(
                graph=graph_of(factor for _, factor in own),
                values=inside,
                closures=None if stated is None else frozenset(k for k, (slot, _) in enumerate(own) if slot in stated),
                first=min(own_keyframes),
                last=max(own_keyframes),
            )
        )
    return sorted(found, key=lambda each: each.first)


def _insert(values: gtsam.Values, key: int, source: gtsam.Values, motion: Any) -> None:
    """A pose or point of the source under the same key, moved where there is a motion."""
    for name in ("Pose2", "Pose3"):
        pose = typed_value(source, name, key)
        if pose is not None:
            values.insert(key, pose if motion is None else motion.compose(pose))
            return
    for name in ("Point2", "Point3"):
        point = typed_value(source, name, key)
        if point is not None:
            insert_point(values, key, point if motion is None else motion.transformFrom(point))
            return
    raise InvalidGraphError(f"expected maps of poses and points to merge, got another variable, {key_label(key)}")
