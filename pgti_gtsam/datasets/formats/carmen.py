"""CARMEN logs: a raw laser log to a pose graph.

Scans are ``FLASER`` or, in newer logs, ``ROBOTLASER1`` messages (see `scans`). A scan becomes a keyframe where
the robot has moved far enough since the last keyframe. Odometry between keyframes is the log's, with sigmas
assumed. Beside ``NAME.clf`` may lie ``NAME.relations``; long-range relations become closures that are known to be
true (see `relations`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np

from pgti_gtsam.datasets.assembly import Entry, assemble, planar_poses
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.relations import RELATION_SIGMAS, Relation, loop_relations
from pgti_gtsam.datasets.scans import Scan, read_scan, smallest_range
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import note_ignored
from pgti_gtsam.errors import InvalidOptionError

NAME = "CARMEN log"
SCANS = ("FLASER", "ROBOTLASER1")
TAGS = set(SCANS)

# Assumed, x and y in metres and heading in radians per step between keyframes. Measured on the log `aces`: its
# odometry leaves its 1191 short relations, 0.27 m in the median, by 0.05 m, 0.02 m and 0.025 rad (standard
# deviations). A default step is about twice as long.
ODOMETRY_SIGMAS = (0.1, 0.1, 0.05)


def parse(source: Source, *, step_m: float = 0.5, step_rad: float = 0.5) -> Dataset:
    """Keyframes, their odometry and radii, and closures where a file of relations lies beside the log.

    Parameters
    ----------
    source : Source
    step_m, step_rad : float
        A scan becomes a keyframe when the robot has travelled so far, or turned so much, since the last keyframe;
        the ends of closures do so in any case. Keyframes are numbered from 0.

    Raises
    ------
    FileFormatError
        A malformed line of the log or of the relations.
    InvalidOptionError
        A step is not positive.
    """
    if not (step_m > 0.0 and step_rad > 0.0):
        raise InvalidOptionError(f"expected positive steps, got step_m={step_m} and step_rad={step_rad}")
    file = source.file
    tag = next(tag for tag in SCANS if tag in file.tags)
    scans = [read_scan(file, line) for line in file.tags[tag]]
    relations, remarks = loop_relations(file, np.array([scan.time_s for scan in scans]))

    # keyframes, and what ties them
    chosen = _choose_keyframes(scans, step_m, step_rad, {end for loop in relations for end in loop[:2]})
    keys = {index: key for key, index in enumerate(chosen)}
    robot = planar_poses(np.array([scans[index].robot for index in chosen]))
    odometry = [Relation(i, j, robot[i].between(robot[j])) for i, j in pairwise(range(len(chosen)))]
    loops = [Relation(keys[loop.first], keys[loop.second], loop.pose) for loop in relations]
    lines = [scans[index].line for index in chosen]
    file.notes.extend(
        [
            f"{len(chosen)} of {len(scans)} scans are keyframes: after {step_m:g} m or {step_rad:g} rad",
            f"odometry is the log's, with assumed sigmas {ODOMETRY_SIGMAS} (m, m, rad) per step",
            "radii are the smallest valid ranges of the keyframes' scans",
            *remarks,
        ]
    )
    note_ignored(file, {tag})
    dataset = assemble(
        file,
        format=NAME,
        poses=dict(enumerate(robot)),
        entries=_entries(odometry, ODOMETRY_SIGMAS, lines),
        loops=_entries(loops, RELATION_SIGMAS, lines),
        radii=_radii(scans, chosen),
    )
    no_echo = _no_echo(scans)
    dataset = replace(dataset, scans={key: scans[i].points(no_echo) for key, i in enumerate(chosen)})
    return replace(dataset, true_closures=frozenset(dataset.closures or ())) if relations else dataset


def _choose_keyframes(scans: Sequence[Scan], step_m: float, step_rad: float, wanted: Collection[int]) -> list[int]:
    """Indices of the first scan, of the wanted scans, and of scans far enough behind the keyframe before."""
    robot = np.array([scan.robot for scan in scans])
    moved = np.diff(robot, axis=0, prepend=robot[:1])
    travelled = np.cumsum(np.hypot(moved[:, 0], moved[:, 1])).tolist()
    turned = np.cumsum(np.abs(np.arctan2(np.sin(moved[:, 2]), np.cos(moved[:, 2])))).tolist()
    chosen = [0]
    for i in range(1, len(scans)):
        last = chosen[-1]
        is_far = travelled[i] - travelled[last] >= step_m or turned[i] - turned[last] >= step_rad
        if is_far or i in wanted:
            chosen.append(i)
    return chosen


def _entries(relations: Iterable[Relation], sigmas: Sequence[float], lines: Sequence[int]) -> list[Entry]:
    """Between factors of relations between keyframes, each at the line of the later scan."""
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
    return [Entry(lines[max(i, j)], (i, j), gtsam.BetweenFactorPose2(i, j, pose, model)) for i, j, pose in relations]


def _radii(scans: Sequence[Scan], chosen: Sequence[int]) -> dict[int, float]:
    """Smallest valid range of every keyframe's scan."""
    no_echo = _no_echo(scans)
    ranges = {key: smallest_range(scans[i], no_echo) for key, i in enumerate(chosen)}
    return {key: radius for key, radius in ranges.items() if radius is not None}


def _no_echo(scans: Sequence[Scan]) -> float:
    """The log's largest reading, the value for 'no echo', m."""
    return max(float(scan.ranges_m.max(initial=0.0)) for scan in scans)


FORMAT = Format(NAME, lambda source: bool(TAGS & source.tags), parse)
