"""Bundle adjustment in the large (BAL): cameras, points and the pixels of the points in a text file.

``cameras points observations``, then ``camera point x y`` for every observation, then nine numbers a camera (Rodrigues
vector, translation, both from world to camera, focal length and two distortions) and three a point (Agarwal et al.,
doi:10.1007/978-3-642-15552-9_3). A camera looks along −z there; here along z, as GTSAM has it.
"""

from __future__ import annotations

from itertools import chain

import gtsam
import numpy as np

from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.sparse_model import sparse_model
from pgti_gtsam.datasets.text import parse_numbers, parse_table

NAME = "BAL problem"
CAMERA, POINT = 9, 3  # numbers of each
FLIP = gtsam.Rot3.Rx(np.pi)  # from a camera that looks along z to one that looks along −z


def parse(source: Source) -> Dataset:
    """Cameras, points and sightings; images need not be in the order of time, so nothing else ties the cameras.

    Raises
    ------
    FileFormatError
        A malformed line, more or fewer numbers than the first line announces, or an observation of an unknown camera or
        point.
    """
    file = source.file
    n_cameras, n_points, n_seen = parse_table(file, file.lines[:1], ids=3, widths=[0], first=0).ids[0].tolist()
    seen = parse_table(file, file.lines[1 : 1 + n_seen], ids=2, widths=[2], first=0)
    rest = file.lines[1 + n_seen :]
    numbers = np.array(list(chain.from_iterable(parse_numbers(file, line, line.fields) for line in rest)))
    expected = CAMERA * n_cameras + POINT * n_points
    if len(seen.lines) != n_seen or len(numbers) != expected:
        got = f"got {len(seen.lines)} observations and {len(numbers)} numbers"
        raise file.error(f"expected {n_seen} observations, then {expected} numbers of cameras and points, {got}")
    bad = np.flatnonzero((seen.ids >= (n_cameras, n_points)).any(axis=1) | (seen.ids < 0).any(axis=1))
    if bad.size:
        ends = f"cameras from 0 to {n_cameras - 1} and points from 0 to {n_points - 1}"
        raise file.error(f"expected {ends}, got another", seen.lines[bad[0]])

    # cameras look along minus z, and map the world to themselves
    points = numbers[CAMERA * n_cameras :].reshape(n_points, POINT)
    cameras = numbers[: CAMERA * n_cameras].reshape(n_cameras, CAMERA)
    poses = [gtsam.Pose3(gtsam.Rot3.Expmap(row[:3]), row[3:6]).inverse() for row in cameras]
    return sparse_model(
        source,
        format=NAME,
        poses={key: gtsam.Pose3(pose.rotation() * FLIP, pose.translation()) for key, pose in enumerate(poses)},
        points=dict(enumerate(points)),
        seen=seen.ids,
    )


def _recognises(source: Source) -> bool:
    if len(source.first) != 3 or not all(word.isdecimal() for word in source.first) or len(source.file.lines) < 2:
        return False
    second = source.file.lines[1].fields
    return len(second) == 4 and second[0].isdecimal() and second[1].isdecimal()


FORMAT = Format(NAME, _recognises, parse)
