"""Vertices, edges and sightings of a text file put together as a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from types import MappingProxyType
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.chain import Between, Pose, between_factors, closure_slots, insert_point, place_by_factors
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting
from pgti_gtsam.datasets.text import UNDERSTOOD, Table, TextFile


class Entry(NamedTuple):
    """A factor on poses: its line and the keys of its poses."""

    line: int
    poses: tuple[int, ...]
    factor: gtsam.NonlinearFactor


def planar_poses(numbers: NDArray[np.float64]) -> list[gtsam.Pose2]:
    """Poses of (n, 3) rows x, y in metres and heading in radians."""
    return [gtsam.Pose2(x, y, heading) for x, y, heading in numbers.tolist()]


def quaternion_poses(file: TextFile, table: Table) -> list[gtsam.Pose3]:
    """Poses of rows that start with x, y, z in metres and a quaternion x, y, z, w, which is normalised.

    Raises
    ------
    FileFormatError
        A quaternion is zero.
    """
    quaternions = table.numbers[:, 3:7]
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    bad = np.flatnonzero(norms < 1e-6)  # nothing but rounding is left of a direction of that size
    if bad.size:
        raise file.error("expected a unit quaternion, got zero", table.lines[bad[0]])
    poses = []
    for position, (x, y, z, w) in zip(table.numbers[:, :3], (quaternions / norms).tolist(), strict=True):
        poses.append(gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), position))
    return poses


def euler_poses(numbers: NDArray[np.float64]) -> list[gtsam.Pose3]:
    """Poses of rows x, y, z in metres, then roll, pitch, yaw in radians, R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return [gtsam.Pose3(gtsam.Rot3.RzRyRx(row[3:6]), row[:3]) for row in numbers]


def between_entries(
    file: TextFile, table: Table, measured: Iterable[Pose], models: Iterable[gtsam.noiseModel.Base]
) -> list[Entry]:
    """One between factor per row, whose first two identifiers are its poses."""
    entries = []
    for line, ids, pose, model in zip(table.lines.tolist(), table.ids.tolist(), measured, models, strict=True):
        first, second = ids[:2]
        if first == second:
            raise file.error(f"expected an edge between two vertices, got {first} twice", line)
        make = gtsam.BetweenFactorPose2 if isinstance(pose, gtsam.Pose2) else gtsam.BetweenFactorPose3
        entries.append(Entry(line, (first, second), make(first, second, pose, model)))
    return entries


def assemble(
    file: TextFile,
    *,
    format: str,
    poses: Mapping[int, Pose],
    entries: Sequence[Entry],
    points: Mapping[int, NDArray[np.float64]] | None = None,
    sightings: Sequence[Sighting] = (),
    radii: Mapping[int, float] | None = None,
    notes: Sequence[str] = (),
) -> Dataset:
    """Check that everything named exists, give every variable a value, find the closures.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    format : str
        The format in words.
    poses : mapping of int to pose
        Stored vertices; where there is none at all, poses are chained from the factors.
    entries : sequence of Entry
        Factors on poses.
    points : mapping of int to (2,) or (3,) float, optional
        Stored landmarks by key; one without a value is put where its nearest sighting has it.
    sightings : sequence of Sighting
        Factors between a pose and a landmark.
    radii : mapping of int to float, optional
        Metres of free space.
    notes : sequence of str
        Sentences to hand on.

    Raises
    ------
    FileFormatError
        No pose, planar and spatial poses in one file, a pose without a vertex where others have one, or
        without vertices a pose that no chain of factors reaches.
    """
    named = [(entry.line, key) for entry in entries for key in entry.poses]
    named += [(sighting.line, sighting.pose) for sighting in sightings]
    graph = gtsam.NonlinearFactorGraph()
    factors = [(entry.line, entry.factor) for entry in entries] + [(s.line, s.factor) for s in sightings]
    for _, factor in sorted(factors, key=itemgetter(0)):
        graph.push_back(factor)
    betweens = between_factors(graph)
    _refuse_mixture(file, [*poses.values(), *(b.factor.measured() for b in betweens)], sightings, points or {})
    placed, placing_notes = (poses, []) if poses else _place_poses(file, named, betweens)
    _refuse_missing(file, named, placed, "has no vertex line although others have one")
    landmarks = _nearest_sightings(sightings, placed) | dict(points or {})
    return Dataset(
        name=file.name,
        format=format,
        graph=graph,
        values=_values(placed, landmarks),
        radii=None if radii is None else MappingProxyType(dict(radii)),
        closures=closure_slots(sorted(placed), betweens),
        notes=(*notes, *placing_notes),
    )


def _refuse_mixture(
    file: TextFile, poses: Iterable[Pose], sightings: Iterable[Sighting], points: Mapping[int, NDArray[np.float64]]
) -> None:
    dimensions = {2 if isinstance(pose, gtsam.Pose2) else 3 for pose in poses}
    dimensions |= {len(sighting.point) for sighting in sightings} | {len(point) for point in points.values()}
    if len(dimensions) > 1:
        raise file.error("expected either planar or spatial vertices and edges, got both")


def _place_poses(
    file: TextFile, named: Sequence[tuple[int, int]], betweens: Sequence[Between]
) -> tuple[dict[int, Pose], list[str]]:
    if not betweens:
        raise file.error(f"holds no pose and no edge between poses; {UNDERSTOOD}")
    keys = sorted({key for _, key in named})
    origin = type(betweens[0].factor.measured())()
    placed, closures_used = place_by_factors(keys, betweens, origin)
    _refuse_missing(file, named, placed, f"has no vertex line, and no chain of edges leads there from {keys[0]}")
    notes = ["the file stores no poses: they are chained from the odometry"]
    if closures_used:
        notes.append(f"the odometry is broken: poses were placed through {closures_used} closures")
    return placed, notes


def _refuse_missing(file: TextFile, named: Iterable[tuple[int, int]], poses: Mapping[int, Pose], why: str) -> None:
    for line, key in sorted(named):
        if key not in poses:
            raise file.error(f"vertex {key} {why}", line)


def _nearest_sightings(sightings: Iterable[Sighting], poses: Mapping[int, Pose]) -> dict[int, NDArray[np.float64]]:
    """Every landmark where the sighting of the smallest range puts it."""
    farthest_first = sorted(sightings, key=lambda sighting: -float(np.linalg.norm(sighting.point)))
    nearest = {sighting.landmark: sighting for sighting in farthest_first}
    return {
        landmark: np.asarray(poses[sighting.pose].transformFrom(sighting.point))
        for landmark, sighting in nearest.items()
    }


def _values(poses: Mapping[int, Pose], points: Mapping[int, NDArray[np.float64]]) -> gtsam.Values:
    values = gtsam.Values()
    for key, pose in poses.items():
        values.insert(key, pose)
    for key, point in points.items():
        insert_point(values, key, point)
    return values
