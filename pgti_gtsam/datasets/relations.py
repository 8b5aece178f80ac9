"""Relations beside a laser log: ``time time x y z roll pitch yaw``, the second scan's pose seen from the first.

The relations were checked by hand. Relations between scans far apart in time are loop closures known to be true.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.source import read_lines
from pgti_gtsam.datasets.text import TextFile

RELATION_SIGMAS = (0.05, 0.05, 0.02)  # assumed, m, m and rad: a scan matched by hand, to about a reading's spacing
LOOP_NODES = 10  # relations between nodes farther apart than this close a loop; in `aces` none has 2 to 81
SAME_TIME_S = 0.05  # half the time between two scans at 10 Hz


class Relation(NamedTuple):
    """Two scans or keyframes, and the pose of the second seen from the first."""

    first: int
    second: int
    pose: gtsam.Pose2


def loop_relations(file: TextFile, times: NDArray[np.float64]) -> tuple[list[Relation], list[str]]:
    """Long-range relations between scans, from the file beside a log, with notes.

    Parameters
    ----------
    file : TextFile
        The log; beside ``NAME.clf`` lies ``NAME.relations``.
    times : (n,) float, s
        Of the log's scans.

    Raises
    ------
    FileFormatError
        A malformed line.
    """
    path = file.path.with_name(f"{file.name}.relations")
    if not path.is_file():
        return [], [f"there is no {path.name} beside the log, and so no closure"]
    table = read_lines(path).rows(ids=0, widths=[8])
    ends, poses = table.numbers[:, :2], table.numbers[:, [2, 3, 7]]

    # relations far apart in time, by the scans next to their times
    nodes = np.searchsorted(np.unique(ends), ends)
    loops = np.flatnonzero(np.abs(nodes[:, 1] - nodes[:, 0]) > LOOP_NODES)
    nearest = np.abs(times[:, None, None] - ends[loops]).argmin(axis=0)
    known = (np.abs(times[nearest] - ends[loops]) <= SAME_TIME_S).all(axis=1) & (nearest[:, 0] != nearest[:, 1])
    relations = [
        Relation(first, second, gtsam.Pose2(*pose))
        for (first, second), pose in zip(nearest[known].tolist(), poses[loops][known].tolist(), strict=True)
    ]

    # what is used and what not
    far = f"{len(relations)} of {len(ends)} relations in {path.name} lie more than {LOOP_NODES} nodes apart and are"
    sigmas = f"with assumed sigmas {RELATION_SIGMAS} (m, m, rad)"
    notes = [f"{far} closures, hand-checked, {sigmas}; the others are not used"]
    if len(relations) < len(loops):
        notes.append(f"{len(loops) - len(relations)} relations name a time at which there is no scan")
    return relations, notes
