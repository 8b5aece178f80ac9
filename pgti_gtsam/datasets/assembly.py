"""Vertices, edges and sightings of a file put together as a dataset."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from operator import itemgetter
from types import MappingProxyType
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import insert_point
from pgti_gtsam.datasets.chain import Between, Pose, between_factors, place_by_factors
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import Sighting
from pgti_gtsam.datasets.text import Table, TextFile, quote
from pgti_gtsam.errors import FileFormatError
from pgti_gtsam.factor_graphs import between_factor
from pgti_gtsam.pose_graph import key_label

# Assumed for the steps of a trajectory, which brings no uncertainty: rotation 0.01 rad, translation 0.1 m
STEP_SIGMAS = {2: (0.1, 0.1, 0.01), 3: (0.01, 0.01, 0.01, 0.1, 0.1, 0.1)}


# Names of edges that hold one pose, behind whose identifier a measurement may look like another
UNARY = ("PRIOR", "GRAVITY", "GPS")


class Entry(NamedTuple):
    """A factor on poses: its line and the keys of its poses."""

    line: int
    poses: tuple[int, ...]
    factor: gtsam.NonlinearFactor


def planar_poses(numbers: NDArray[np.float64]) -> list[gtsam.Pose2]:
    """Poses of rows that start with x, y in metres and heading in radians."""
    return [gtsam.Pose2(x, y, heading) for x, y, heading in numbers[:, :3].tolist()]


def quaternion_poses(file: TextFile, table: Table, before: int = 0) -> list[gtsam.Pose3]:
    """Poses of rows that hold, behind ``before`` other numbers, x, y, z in metres and a quaternion x, y, z, w.

    Quaternions are normalised.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    table : Table
    before : int
        Numbers before the pose.

    Raises
    ------
    FileFormatError
        A quaternion is zero.
    """
    return list(stream_of_poses(file, table, before))


def stream_of_poses(file: TextFile, table: Table, before: int = 0) -> Iterator[gtsam.Pose3]:
    """The poses of `quaternion_poses` lazily: the edges of a large file need not be in memory together.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    table : Table
    before : int
        Numbers before the pose.
    """
    quaternions = table.numbers[:, before + 3 : before + 7]
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    bad = np.flatnonzero(norms < 1e-6)  # nothing but rounding is left of a direction of that size
    if bad.size:
        raise file.error("expected a unit quaternion, got zero", table.lines[bad[0]])
    positions = table.numbers[:, before : before + 3]
    turns = (gtsam.Rot3.Quaternion(w, x, y, z) for x, y, z, w in quaternions / norms)
    return (gtsam.Pose3(turn, position) for turn, position in zip(turns, positions, strict=True))


def euler_poses(numbers: NDArray[np.float64]) -> list[gtsam.Pose3]:
    """Poses of rows x, y, z in metres, then roll, pitch, yaw in radians, R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return [gtsam.Pose3(gtsam.Rot3.RzRyRx(row[3:6]), row[:3]) for row in numbers]


def between_entries(
    file: TextFile, table: Table, measured: Iterable[Pose], models: Iterable[gtsam.noiseModel.Base]
) -> list[Entry]:
    """A between factor per row; the first two identifiers are the poses. A row that names a pose twice is left out.

    Parameters
    ----------
    file : TextFile
    table : Table
        Rows of edges.
    measured : iterable of Pose
        Relative poses, a pose a row.
    models : iterable of gtsam.noiseModel.Base
        Noise models, a model a row.
    """
    entries, selves = [], []
    for line, ids, pose, model in zip(table.lines.tolist(), table.ids.tolist(), measured, models, strict=True):
        first, second = ids[:2]
        if first == second:
            selves.append(line)
        else:
            entries.append(Entry(line, (first, second), between_factor(first, second, pose, model)))
    if selves:
        file.notes.append(f"left out {len(selves)} edges from a vertex to itself (first on line {selves[0]})")
    return entries


def trajectory_steps(poses: Mapping[int, Pose]) -> list[Entry]:
    """Between factors from each pose to the next, with assumed sigmas, for files that hold no odometry."""
    entries = []
    for (i, before), (j, after) in pairwise(poses.items()):
        sigmas = STEP_SIGMAS[2 if isinstance(before, gtsam.Pose2) else 3]
        model = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
        entries.append(Entry(0, (i, j), between_factor(i, j, before.between(after), model)))
    return entries


def assemble(
    file: TextFile,
    *,
    format: str,
    poses: Mapping[int, Pose],
    entries: Sequence[Entry],
    loops: Sequence[Entry] | None = None,
    points: Mapping[int, NDArray[np.float64]] | None = None,
    sightings: Sequence[Sighting] = (),
    radii: Mapping[int, float] | None = None,
    known: Collection[str] = (),
) -> Dataset:
    """Check that everything named exists, give every variable a value.

    Parameters
    ----------
    file : TextFile
        Named in errors; the file's notes are handed on.
    format : str
        The format in words.
    poses : mapping of int to pose
        Stored vertices; without any, poses are chained from the factors. A pose without a factor
        is left out, unless no factor is there: then consecutive poses are tied as a trajectory.
    entries : sequence of Entry
        Factors on poses.
    loops : sequence of Entry, optional
        Factors that the file itself calls loop closures: those between the poses of `entries` are odometry then.
    points : mapping of int to (2,) or (3,) float, optional
        Stored landmarks by key; a landmark without a value is put where its nearest sighting places it.
    sightings : sequence of Sighting
        Factors between a pose and a landmark.
    radii : mapping of int to float, optional
        Metres of free space.
    known : collection of str
        Tags that were read; other tags that tie two poses are refused (see `TextFile.ignore_unknown`).

    Raises
    ------
    FileFormatError
        No pose, planar and spatial poses in one file, a pose without a vertex where others have one,
        without vertices a pose that no chain of factors reaches, or an unknown line that ties two poses.
    """
    # every pose that a factor holds
    stated = loops is not None
    loops = loops or ()
    entries = [*entries, *loops]
    held = {key for entry in entries for key in entry.poses} | {sighting.pose for sighting in sightings}
    ignored = _unknown_edges(file, known, held | poses.keys())
    if not held and len(poses) > 1:
        file.notes.append("the file holds no edge: consecutive poses are tied as a trajectory, with assumed sigmas")
        entries = trajectory_steps(dict(sorted(poses.items())))
        held = set(poses)

    if not held:
        raise file.error(f"holds {len(poses) or 'no'} pose and nothing that ties it; expected two keyframes at least")

    # factors in the order of the file
    graph = gtsam.NonlinearFactorGraph()
    by_line: list[Entry | Sighting] = sorted([*entries, *sightings], key=itemgetter(0))
    for named in by_line:
        graph.push_back(named.factor)
    closing = set(map(id, loops))
    betweens = between_factors(graph)

    if sightings and not betweens:
        file.notes.append("no edge ties two poses: landmarks alone do")

    # a value for every variable
    measured = (between.factor.measured() for between in betweens)
    _refuse_mixture(file, chain(poses.values(), measured), sightings, points or {})
    placed, why = poses, "has no vertex line although others have one"
    if not poses:
        placed, why = _place_poses(file, held, betweens)
    if not held <= placed.keys():
        raise _missing(file, entries, sightings, placed, why)
    placed = _with_factors(file, placed, held)
    landmarks = _nearest_sightings(sightings, placed) | dict(points or {})
    unplaced = next((s for s in sightings if s.landmark not in landmarks), None)
    if unplaced is not None:
        label = key_label(unplaced.landmark)
        raise file.error(f"landmark {label} has no vertex line, and no sighting places it", unplaced.line)
    return Dataset(
        name=file.name,
        format=format,
        graph=graph,
        values=_values(placed, landmarks),
        closures=tuple(slot for slot, named in enumerate(by_line) if id(named) in closing) if stated else None,
        radii=None if radii is None else MappingProxyType({key: radii[key] for key in radii if key in placed}),
        notes=tuple(file.notes),
        ignored_edges=ignored,
    )


def _unknown_edges(file: TextFile, known: Collection[str], poses: Collection[int]) -> int:
    """Lines of unknown tags that tie two poses: refused, or counted where that is asked for."""
    names = {str(key) for key in poses}
    tying: dict[str, list[int]] = {}
    for tag in set(file.tags) - set(known):
        if "EDGE" in tag.upper() and not any(word in tag.upper() for word in UNARY):
            lines = [line for line in file.tags[tag] if _ties(line.fields[1:3], names)]
            tying |= {tag: [line.number for line in lines]} if lines else {}
    shown = ", ".join(f"{len(lines)} {quote(tag)}" for tag, lines in sorted(tying.items()))
    if tying and not file.ignore_unknown:
        message = f"{shown} tie two poses in a way that is not known; rewrite them as EDGE_SE2 or EDGE_SE3:QUAT, "
        raise file.error(message + "or leave them out with --ignore-unknown", min(map(min, tying.values())))
    return sum(map(len, tying.values()))


def _ties(ends: Sequence[str], poses: Collection[str]) -> bool:
    return len(ends) == 2 and ends[0] != ends[1] and ends[0] in poses and ends[1] in poses


def _with_factors(file: TextFile, poses: Mapping[int, Pose], held: Collection[int]) -> dict[int, Pose]:
    """Poses that a factor holds; the others float freely, so that nothing can be said of them."""
    alone = [key for key in poses if key not in held]
    if alone and held:
        file.notes.append(f"{len(alone)} {'vertex' if len(alone) == 1 else 'vertices'} without edges left out")
        return {key: pose for key, pose in poses.items() if key in held}
    return dict(poses)


def _refuse_mixture(
    file: TextFile, poses: Iterable[Pose], sightings: Iterable[Sighting], points: Mapping[int, NDArray[np.float64]]
) -> None:
    dimensions = {2 if isinstance(pose, gtsam.Pose2) else 3 for pose in poses}
    dimensions |= {len(sighting.point) for sighting in sightings if sighting.point is not None}
    dimensions |= {len(point) for point in points.values()}
    if len(dimensions) > 1:
        raise file.error("expected either planar or spatial vertices and edges, got both; write two files")


def _place_poses(file: TextFile, held: Collection[int], betweens: Sequence[Between]) -> tuple[dict[int, Pose], str]:
    """Poses chained from the factors, and the reason why a pose may be missing."""
    if not betweens:
        raise file.error("holds no pose and no edge between poses")
    keys = sorted(held)
    origin = type(betweens[0].factor.measured())()
    placed, others_used = place_by_factors(keys, betweens, origin)
    file.notes.append("the file stores no poses: they are chained from the odometry")
    if others_used:
        file.notes.append(f"the odometry is broken: poses were placed through {others_used} closures")
    advice = "add vertex lines, or an edge that ties the two parts"
    return placed, f"has no vertex line, and no chain of edges leads there from {keys[0]}; {advice}"


def _missing(
    file: TextFile, entries: Iterable[Entry], sightings: Iterable[Sighting], poses: Mapping[int, Pose], why: str
) -> FileFormatError:
    """The error about the first line that names a pose without a place."""
    named = [(entry.line, key) for entry in entries for key in entry.poses]
    named += [(sighting.line, sighting.pose) for sighting in sightings]
    line, key = min((line, key) for line, key in named if key not in poses)
    return file.error(f"vertex {key} {why}", line)


def _nearest_sightings(sightings: Iterable[Sighting], poses: Mapping[int, Pose]) -> dict[int, NDArray[np.float64]]:
    """Every landmark at the point of the sighting of smallest range."""
    placing = [(float(np.linalg.norm(s.point)), s.landmark, s.pose, s.point) for s in sightings if s.point is not None]
    farthest_first = sorted(placing, key=lambda seen: -seen[0])
    nearest = {landmark: (pose, point) for _, landmark, pose, point in farthest_first}
    return {key: np.asarray(poses[pose].transformFrom(point)) for key, (pose, point) in nearest.items()}


def _values(poses: Mapping[int, Pose], points: Mapping[int, NDArray[np.float64]]) -> gtsam.Values:
    values = gtsam.Values()
    for key, pose in poses.items():
        values.insert(key, pose)
    for key, point in points.items():
        insert_point(values, key, point)
    return values
