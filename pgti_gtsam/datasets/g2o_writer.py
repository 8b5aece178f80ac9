"""Factor graphs to g2o text, such that `g2o.parse` reads the same graph again, and other readers can.

Written are between factors (``EDGE_SE2``, ``EDGE_SE3:QUAT``), bearing-range factors as the Cartesian sightings of
the format (``EDGE_SE2_XY``, ``EDGE_SE3_TRACKXYZ`` with a sensor at the body's origin) and GPS factors
(``EDGE_SE3_PRIORXYZ``). Robust losses stand in a comment before their edge (see `losses`). Factors without a line in
the format are counted, never dropped silently: priors of whole poses among them, since no two programs agree on a tag.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam import outputs
from pgti_gtsam.adapter.values import typed_value
from pgti_gtsam.datasets.chain import poses_of
from pgti_gtsam.datasets.edge_lines import (
    TRANSLATION_FIRST,
    EdgeLine,
    Numbers,
    Part,
    check_known,
    checked_numbers,
    edge_lines,
    number_text,
    pose_numbers,
    triangle,
)
from pgti_gtsam.datasets.landmarks import cartesian, landmark_key, planar_point, spatial_point
from pgti_gtsam.pose_graph import key_label

SENSOR = 0  # identifier of the sensor offset, which is none
MAX_NUMBER = 2**53  # for a key that is renumbered: float64, which some readers take, holds every integer up to here
INDEX_BITS = 56  # of a symbol's key; its letter stands above them


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Written:
    """The result of writing a graph.

    Attributes
    ----------
    numbers : mapping of int to int
        Number in the file, by key: the key itself where the graph could come from a text file.
    renumbered : tuple of int
        Keys that a reader does not find again; comments at the end of the file name these keys.
    unwritten : mapping of str to int
        Factors and variables that the format cannot hold, by class or kind.
    """

    numbers: Mapping[int, int]
    renumbered: tuple[int, ...]
    unwritten: Mapping[str, int]


def write_g2o(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    path: Path | str,
    *,
    names: Mapping[int, str] | None = None,
) -> Written:
    """Write poses, landmarks and factors as g2o text.

    Numbers are written with all their digits: a graph that `datasets.read` read from a text file comes back with
    the same keys, factors and order; empty slots are passed over. Poses with symbols for keys are numbered by
    their index where all have the same letter and by their rank otherwise, landmarks by their index where no pose
    has that number.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        The poses, the sighted landmarks, and points that no factor refers to are written.
    path : Path or str
    names : mapping of int to str, optional
        Numbers of variables in the file of origin, by key (`Dataset.names`): the numbers stay, as symbols
        of several robots have to.

    Raises
    ------
    MissingValueError
        A factor refers to a key without a value.
    InvalidValueError
        A value is not finite, or beyond 1e30.
    OutputError
        The file cannot be written.
    """
    poses = poses_of(values)
    edges, unwritten = edge_lines(graph, _PARTS)
    points = _points(graph, values, edges, poses)
    check_known(edges, {*poses, *points})
    if lost := values.size() - len(poses) - len(points):
        unwritten["variables that are no poses or sighted landmarks"] = lost
    kept = _kept_numbers([*poses, *points], names or {})
    numbers = kept or _numbers(list(poses), list(points))
    lines = [f"PARAMS_SE3OFFSET {SENSOR} 0 0 0 0 0 0 1"] if any(edge.parameters for edge in edges) else []
    lines += [_vertex(key, pose, numbers[key], is_pose=True) for key, pose in poses.items()]
    lines += [_vertex(key, point, numbers[key], is_pose=False) for key, point in points.items()]
    for edge in edges:
        lines += edge.lines(numbers)
    renumbered = [] if kept else [key for key in poses if numbers[key] != key]
    renumbered += [] if kept else [key for key in points if landmark_key(numbers[key]) != key]
    lines += [f"# {numbers[key]} is {key_label(key)}" for key in renumbered]  # other readers stumble over it earlier
    outputs.write_text(path, "\n".join(lines) + "\n")
    return Written(numbers=numbers, renumbered=tuple(renumbered), unwritten=dict(unwritten))


def _planar_between(factor: Any, information: Numbers) -> Numbers:
    return np.concatenate([pose_numbers(factor.measured()), triangle(information)])


def _spatial_between(factor: Any, information: Numbers) -> Numbers:
    swapped = information[np.ix_(TRANSLATION_FIRST, TRANSLATION_FIRST)]
    return np.concatenate([pose_numbers(factor.measured()), triangle(swapped)])


def _position(factor: Any, information: Numbers) -> Numbers:
    return np.concatenate([factor.measurementIn(), triangle(information)])


def _planar_sighting(factor: Any, information: Numbers) -> Numbers:
    point = planar_point(factor)
    return np.concatenate([point, triangle(cartesian(point, information))])


def _spatial_sighting(factor: Any, information: Numbers) -> Numbers:
    point = spatial_point(factor)
    return np.concatenate([point, triangle(cartesian(point, information))])


_PARTS = {
    "BetweenFactorPose2": Part("EDGE_SE2", (), _planar_between),
    "BetweenFactorPose3": Part("EDGE_SE3:QUAT", (), _spatial_between),
    "BearingRangeFactor2D": Part("EDGE_SE2_XY", (), _planar_sighting),
    "BearingRangeFactor3D": Part("EDGE_SE3_TRACKXYZ", (SENSOR,), _spatial_sighting),
    "GPSFactor": Part("EDGE_SE3_PRIORXYZ", (), _position),
}
"""By class of factor."""


def _points(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, edges: Iterable[EdgeLine], poses: Collection[int]
) -> dict[int, Numbers]:
    """Points that are sighted or that no factor refers to, by ascending key."""
    sighted = {key for edge in edges for key in edge.keys} - set(poses)
    free = set(values.keys()) - set(poses) - set(graph.keyVector())
    points = {}
    for key in sorted(sighted | free):
        point = typed_value(values, "Point3", key)
        point = typed_value(values, "Point2", key) if point is None else point
        if point is not None:
            points[key] = np.asarray(point, dtype=float)
    return points


def _kept_numbers(keys: Collection[int], names: Mapping[int, str]) -> dict[int, int] | None:
    """The original numbers of all variables, if each variable had a number."""
    if not names or not all(names.get(key, "").lstrip("-").isdecimal() for key in keys):
        return None
    return {key: int(names[key]) for key in keys}


def _numbers(poses: list[int], points: list[int]) -> dict[int, int]:
    """A number for every key; poses and landmarks share none unless numbers were shared in a text file."""
    numbers = _indices(poses) or {key: place for place, key in enumerate(poses)}
    if all(numbers[key] == key for key in poses) and all(landmark_key(_index(key)) == key for key in points):
        return numbers | {key: _index(key) for key in points}
    indices = _indices(points)
    if indices is None or not set(indices.values()).isdisjoint(numbers.values()):
        first = max(numbers.values(), default=-1) + 1
        indices = {key: first + place for place, key in enumerate(points)}
    return numbers | indices


def _indices(keys: list[int]) -> dict[int, int] | None:
    """Index of every key's symbol, if all have the same letter and no index is too large for the file."""
    indices = {key: _index(key) for key in keys}
    is_one = len({key >> INDEX_BITS for key in keys}) <= 1
    return indices if is_one and max(indices.values(), default=0) <= MAX_NUMBER else None


def _index(key: int) -> int:
    return key & ((1 << INDEX_BITS) - 1)


def _vertex(key: int, value: Any, number: int, *, is_pose: bool) -> str:
    numbers = checked_numbers(key, pose_numbers(value) if is_pose else value)
    tag = _POSE_TAGS[len(numbers)] if is_pose else _POINT_TAGS[len(numbers)]
    return f"{tag} {number} {number_text(numbers)}"


_POSE_TAGS = {3: "VERTEX_SE2", 7: "VERTEX_SE3:QUAT"}
_POINT_TAGS = {2: "VERTEX_XY", 3: "VERTEX_TRACKXYZ"}
