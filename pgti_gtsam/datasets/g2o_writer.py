"""Factor graphs to g2o text, such that `g2o.parse` reads the same graph again, and other readers can.

Written are between factors (``EDGE_SE2``, ``EDGE_SE3:QUAT``), bearing-range factors as the Cartesian sightings of
the format (``EDGE_SE2_XY``, ``EDGE_SE3_TRACKXYZ`` with a sensor at the body's origin) and GPS factors
(``EDGE_SE3_PRIORXYZ``). Robust losses stand in a comment before their edge (see `losses`). What the format cannot
hold is counted, never dropped silently: priors of whole poses are, since no two programs agree on their tag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import typed_value
from pgti_gtsam.datasets.chain import Pose, poses_of
from pgti_gtsam.datasets.landmarks import landmark_key, planar_jacobian, spatial_jacobian
from pgti_gtsam.datasets.losses import loss_comment, loss_words
from pgti_gtsam.datasets.noise import ROTATION_FIRST
from pgti_gtsam.datasets.text import LARGEST
from pgti_gtsam.errors import InvalidValueError, MissingValueError
from pgti_gtsam.pose_graph import key_label

SENSOR = 0  # identifier of the sensor offset, which is none
TRANSLATION_FIRST = np.argsort(ROTATION_FIRST)
MAX_NUMBER = 2**53  # for a key that is renumbered: float64, which some readers take, holds every integer up to here
INDEX_BITS = 56  # of a symbol's key; its letter stands above them

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Written:
    """What became of a graph.

    Attributes
    ----------
    numbers : mapping of int to int
        Number in the file, by key: the key itself where the graph could come from a text file.
    renumbered : tuple of int
        Keys that a reader does not find again; comments at the end of the file name them.
    unwritten : mapping of str to int
        Factors and variables that the format cannot hold, by class or kind.
    """

    numbers: Mapping[int, int]
    renumbered: tuple[int, ...]
    unwritten: Mapping[str, int]


class _Edge(NamedTuple):
    """Tag, keys, parameters behind them, measurement, information in the file's order, words of the loss."""

    tag: str
    keys: list[int]
    parameters: list[int]
    measured: Numbers
    information: Numbers
    loss: list[str]


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
    their index where all have one letter and by their place otherwise, landmarks by their index where no pose
    has that number.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Written are its poses, the landmarks that are sighted, and points that no factor refers to.
    path : Path or str
    names : mapping of int to str, optional
        Numbers that variables have in the file they come from, by key (`Dataset.names`): they keep them, as symbols
        of several robots have to.

    Raises
    ------
    MissingValueError
        A factor refers to a key without a value.
    InvalidValueError
        A value is not finite, or beyond 1e30.
    """
    poses = poses_of(values)
    edges, unwritten = _edges(graph)
    points = _points(graph, values, edges, poses)
    _check_known(edges, {*poses, *points})
    if lost := values.size() - len(poses) - len(points):
        unwritten["variables that are no poses or sighted landmarks"] = lost
    kept = _kept_numbers([*poses, *points], names or {})
    numbers = kept or _numbers(list(poses), list(points))
    lines = [f"PARAMS_SE3OFFSET {SENSOR} 0 0 0 0 0 0 1"] if any(edge.parameters for edge in edges) else []
    lines += [_vertex(key, pose, numbers[key], is_pose=True) for key, pose in poses.items()]
    lines += [_vertex(key, point, numbers[key], is_pose=False) for key, point in points.items()]
    for edge in edges:
        lines += _edge_lines(edge, numbers)
    renumbered = [] if kept else [key for key in poses if numbers[key] != key]
    renumbered += [] if kept else [key for key in points if landmark_key(numbers[key]) != key]
    lines += [f"# {numbers[key]} is {key_label(key)}" for key in renumbered]  # other readers stumble over it earlier
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Written(numbers=numbers, renumbered=tuple(renumbered), unwritten=dict(unwritten))


def _edges(graph: gtsam.NonlinearFactorGraph) -> tuple[list[_Edge], Counter[str]]:
    """What the format can hold, by slot, and the count of what it cannot, by class."""
    edges, unwritten = [], Counter[str]()
    for slot in range(graph.size()):
        factor = graph.at(slot)
        if factor is None:
            continue
        name, edge = type(factor).__name__, None
        if name in _PARTS:
            edge = _edge(name, factor)
            name += "" if edge else " with a noise model or a measurement that the format has no word for"
        if edge:
            edges.append(edge)
        else:
            unwritten[name] += 1
    return edges, unwritten


def _edge(name: str, factor: Any) -> _Edge | None:
    """The line of a factor of a known class; None where its noise or measurement cannot be written."""
    model, loss = factor.noiseModel(), list[str]()
    if isinstance(model, gtsam.noiseModel.Robust):
        loss, model = loss_words(model.robust()), model.noise() if loss_words(model.robust()) else None
    if not isinstance(model, gtsam.noiseModel.Gaussian) or model.isConstrained():
        return None
    tag, parameters, parts = _PARTS[name]
    measured, information = parts(factor, np.asarray(model.information()))
    sizes = np.abs(np.concatenate([measured, information.ravel()]))
    if not (sizes <= LARGEST).all():  # false of NaN too, which is what a sighting at range zero has
        return None
    return _Edge(tag, list(factor.keys()), parameters, measured, information, loss)


def _planar_between(factor: Any, information: Numbers) -> tuple[Numbers, Numbers]:
    return _pose_numbers(factor.measured()), information


def _spatial_between(factor: Any, information: Numbers) -> tuple[Numbers, Numbers]:
    return _pose_numbers(factor.measured()), information[np.ix_(TRANSLATION_FIRST, TRANSLATION_FIRST)]


def _position(factor: Any, information: Numbers) -> tuple[Numbers, Numbers]:
    return np.asarray(factor.measurementIn()), information


def _planar_sighting(factor: Any, information: Numbers) -> tuple[Numbers, Numbers]:
    seen = factor.measured()
    point = seen.range() * np.array([seen.bearing().c(), seen.bearing().s()])
    return point, _cartesian(point, information, planar_jacobian)


def _spatial_sighting(factor: Any, information: Numbers) -> tuple[Numbers, Numbers]:
    seen = factor.measured()
    point = seen.range() * np.asarray(seen.bearing().point3())
    return point, _cartesian(point, information, spatial_jacobian)


_PARTS: dict[str, tuple[str, list[int], Callable[[Any, Numbers], tuple[Numbers, Numbers]]]] = {
    "BetweenFactorPose2": ("EDGE_SE2", [], _planar_between),
    "BetweenFactorPose3": ("EDGE_SE3:QUAT", [], _spatial_between),
    "BearingRangeFactor2D": ("EDGE_SE2_XY", [], _planar_sighting),
    "BearingRangeFactor3D": ("EDGE_SE3_TRACKXYZ", [SENSOR], _spatial_sighting),
    "GPSFactor": ("EDGE_SE3_PRIORXYZ", [], _position),
}
"""Tag, parameters, and what makes measurement and information, by class of factor."""


def _cartesian(point: Numbers, information: Numbers, jacobian: Callable[[Numbers], Numbers]) -> Numbers:
    """Λ with Kᵀ Λ K the information in bearing and range: what `landmarks.sightings` does, undone."""
    if not np.linalg.norm(point) > 0.0:
        return np.full_like(information, np.nan)
    inverse = np.linalg.inv(jacobian(point[None])[0])
    return np.asarray(inverse.T @ information @ inverse)


def _points(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, edges: Iterable[_Edge], poses: Collection[int]
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


def _check_known(edges: Iterable[_Edge], known: Collection[int]) -> None:
    missing = next((key for edge in edges for key in edge.keys if key not in known), None)
    if missing is not None:
        raise MissingValueError(
            f"expected a value for every key, got none for {key_label(missing)}; add it or remove its factors"
        )


def _kept_numbers(keys: Collection[int], names: Mapping[int, str]) -> dict[int, int] | None:
    """The numbers that all variables had, if each had one."""
    if not names or not all(names.get(key, "").lstrip("-").isdecimal() for key in keys):
        return None
    return {key: int(names[key]) for key in keys}


def _numbers(poses: list[int], points: list[int]) -> dict[int, int]:
    """A number for every key; poses and landmarks share none unless they already do in a text file."""
    numbers = _indices(poses) or {key: place for place, key in enumerate(poses)}
    if all(numbers[key] == key for key in poses) and all(landmark_key(_index(key)) == key for key in points):
        return numbers | {key: _index(key) for key in points}
    indices = _indices(points)
    if indices is None or not set(indices.values()).isdisjoint(numbers.values()):
        first = max(numbers.values(), default=-1) + 1
        indices = {key: first + place for place, key in enumerate(points)}
    return numbers | indices


def _indices(keys: list[int]) -> dict[int, int] | None:
    """Index of every key's symbol, if all have one letter and no index is too large for the file."""
    indices = {key: _index(key) for key in keys}
    is_one = len({key >> INDEX_BITS for key in keys}) <= 1
    return indices if is_one and max(indices.values(), default=0) <= MAX_NUMBER else None


def _index(key: int) -> int:
    return key & ((1 << INDEX_BITS) - 1)


def _vertex(key: int, value: Any, number: int, *, is_pose: bool) -> str:
    numbers = _pose_numbers(value) if is_pose else value
    if not (np.abs(numbers) <= LARGEST).all():
        raise InvalidValueError(
            f"expected finite values up to {LARGEST:g}, got {numbers.tolist()} at {key_label(key)}; leave it out"
        )
    tag = {2: "VERTEX_XY", 3: "VERTEX_TRACKXYZ"}[len(numbers)] if not is_pose else _POSE_TAGS[len(numbers)]
    return f"{tag} {number} {_text(numbers)}"


_POSE_TAGS = {3: "VERTEX_SE2", 7: "VERTEX_SE3:QUAT"}


def _edge_lines(edge: _Edge, numbers: Mapping[int, int]) -> list[str]:
    ids = [*(numbers[key] for key in edge.keys), *edge.parameters]
    triangle = edge.information[np.triu_indices(len(edge.information))]
    line = f"{edge.tag} {' '.join(map(str, ids))} {_text(edge.measured)} {_text(triangle)}"
    return [loss_comment(ids, edge.loss), line] if edge.loss else [line]


def _pose_numbers(pose: Pose) -> Numbers:
    """x, y, heading; in space x, y, z and a quaternion x, y, z, w."""
    if isinstance(pose, gtsam.Pose2):
        return np.array([pose.x(), pose.y(), pose.theta()])
    turn = pose.rotation().toQuaternion()
    return np.array([*pose.translation(), turn.x(), turn.y(), turn.z(), turn.w()])


def _text(numbers: Numbers) -> str:
    return " ".join(map(repr, numbers.tolist()))
