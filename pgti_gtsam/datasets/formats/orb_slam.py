"""ORB-SLAM as text: a keyframe trajectory (TUM), and the map points that each keyframe sees.

``MapPointsInKeyFrames.txt`` lies beside the trajectory: a keyframe's timestamp, then x, y, z of every point. Points
have no identifiers: points of equal coordinates are the same. Behind a pose may stand its matrix, with the same
content.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import quaternion_poses
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Format, Source, read_lines
from pgti_gtsam.datasets.sparse_model import sparse_model
from pgti_gtsam.datasets.text import TextFile, parse_numbers

NAME = "ORB-SLAM map as text"
TRAJECTORY, POINTS = "KeyFrameTrajectory.txt", "MapPointsInKeyFrames.txt"
WIDTHS = (8, 8 + 16)  # a pose, and one with its matrix


def parse(source: Source) -> Dataset:
    """Keyframes in the order of time, points and sightings.

    Raises
    ------
    FileFormatError
        A malformed line, or points of a keyframe that the trajectory does not hold.
    """
    file = read_lines(_trajectory(source))
    table = file.rows(ids=0, widths=WIDTHS)
    poses = dict(enumerate(quaternion_poses(file, table, 1)))
    times = {time: key for key, time in enumerate(table.numbers[:, 0].tolist())}
    keys, places = _points(read_lines(source.beside(POINTS)), times)
    unique, index = np.unique(places, axis=0, return_inverse=True)
    return sparse_model(
        source,
        format=NAME,
        poses=poses,
        points=dict(enumerate(unique)),
        seen=np.stack([keys, index.ravel()], axis=1),
        notes=["map points of equal coordinates are taken for one"],
    )


def _points(file: TextFile, times: dict[float, int]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Keys (n,) and positions (n, 3) of the points that keyframes see."""
    keys, places = [], []
    for line in file.lines:
        time, *numbers = parse_numbers(file, line, line.fields)
        if time not in times or len(numbers) % 3:
            raise file.error("expected the timestamp of a keyframe, then x y z of every point", line.number)
        keys += [times[time]] * (len(numbers) // 3)
        places.append(np.array(numbers).reshape(-1, 3))
    return np.array(keys, np.int64), np.concatenate([np.empty((0, 3)), *places])


def _trajectory(source: Source) -> Path:
    return source.beside(TRAJECTORY) if source.is_folder or source.path.name == POINTS else source.path


def _recognises(source: Source) -> bool:
    if not source.beside(POINTS).is_file():
        return False
    return _trajectory(source).is_file() and (
        source.is_folder or len(source.first) in WIDTHS or source.path.name == POINTS
    )


FORMAT = Format(NAME, _recognises, parse)
