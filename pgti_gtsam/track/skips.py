"""Skips: factors over several steps of one chain that the way between their ends explains."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.track.steps import NEIGHBOURS, dense_to

AGREES, AGREES_RAD = 0.25, 0.25
"""Most by which a skip may miss the chained steps, in parts of the way between its ends and in rad. Of 511 factors over
at most ten keyframes of intel, manhattan and city10000 the worst misses by 0.2 of the way and by 0.18 rad; the two of
MIT, across steps on which the wheels slip, miss by 0.26 and 0.42 and stay closures."""

RETURNS = 0.75
"""Distance between its ends, in parts of how far the way led off from the first, below which a factor brings the sensor
back to where it was, and is a loop closure however short the way."""


class Tie(NamedTuple):
    """A factor between two keyframes, `first` < `second`, and the pose of the second that it measures from the first.

    The pose is a gtsam.Pose2 or gtsam.Pose3, or None where the factor measures no whole pose.
    """

    first: int
    second: int
    pose: Any


def explained(n: int, chain: NDArray[np.int64], steps: Sequence[Tie], ties: Sequence[Tie]) -> NDArray[np.bool_]:
    """The ties that the way along the steps explains, (k,) bool.

    Parameters
    ----------
    n : int
        Number of keyframes.
    chain : (n,) int
        Chain of every keyframe.
    steps : sequence of Tie
    ties : (k,) sequence of Tie
        Ties between keyframes of a chain.
    """
    # ties that may be skips, by their places on the track
    order = np.argsort(chain, kind="stable")
    pairs = np.array([tie[:2] for tie in ties], dtype=np.int64).reshape(-1, 2)
    ends = np.argsort(order)[pairs]
    gaps, dense = np.diff(ends, axis=1)[:, 0], dense_to(chain, pairs, ends)[chain[pairs[:, 0]]]
    measured = np.array([tie.pose is not None for tie in ties], dtype=bool)
    asked = np.flatnonzero(measured & (gaps <= np.maximum(NEIGHBOURS, dense)))
    found = np.zeros(len(ties), dtype=bool)
    if not len(asked):
        return found

    # where the steps alone lead, and how far off from the first end
    poses, part = _reckoned(n, steps)
    positions = np.array([pose.translation() for pose in poses])[order]
    lengths, whole = np.linalg.norm(np.diff(positions, axis=0), axis=1), np.diff(part[order]) == 0
    way, break_ = (np.concatenate([[0.0], np.cumsum(each)]) for each in (lengths, ~whole))
    usual = float(np.median(lengths[whole])) if whole.any() else 0.0
    i, j = ends[asked].T
    off = np.zeros(len(asked))
    for ahead in range(1, int(gaps[asked].max()) + 1):
        off = np.maximum(off, np.linalg.norm(positions[np.minimum(i + ahead, j)] - positions[i], axis=1))

    # what agrees with the steps, and does not bring the sensor back or does so as a matter of course
    missed = [_missed(ties[k], poses) for k in asked.tolist()]
    missed_m, missed_rad, measured_m = np.array(missed).T
    agrees = (missed_m <= AGREES * np.maximum(way[j] - way[i], usual)) & (missed_rad <= AGREES_RAD)
    returns = (measured_m < RETURNS * off) & (off > usual)
    usual_gap = (gaps[asked] <= NEIGHBOURS) & ~returns | (gaps[asked] <= dense[asked])
    found[asked] = agrees & usual_gap & (break_[i] == break_[j])
    return found


def _reckoned(n: int, steps: Sequence[Tie]) -> tuple[list[gtsam.Pose3], NDArray[np.int64]]:
    """Poses of n keyframes chained from the first of every part that measured steps hold together, and the parts.

    Each search is as long as its part; a search of SciPy's csgraph is as long as the whole graph.
    """
    leading: list[list[tuple[int, gtsam.Pose3]]] = [[] for _ in range(n)]
    for tie in steps:
        if tie.pose is not None:
            step = _spatial(tie.pose)
            leading[tie.first].append((tie.second, step))
            leading[tie.second].append((tie.first, step.inverse()))
    poses, part = [gtsam.Pose3()] * n, np.full(n, -1, dtype=np.int64)
    for root in range(n):
        if part[root] >= 0:
            continue
        part[root], queue = root, deque([root])
        while queue:
            here = queue.popleft()
            for there, step in leading[here]:
                if part[there] < 0:
                    poses[there], part[there] = poses[here].compose(step), root
                    queue.append(there)
    return poses, part


def _missed(tie: Tie, poses: Sequence[gtsam.Pose3]) -> tuple[float, float, float]:
    """Difference of a tie from the way along the steps, m and rad, and the distance that the tie measures, m."""
    measured = _spatial(tie.pose)
    missed = measured.between(poses[tie.first].between(poses[tie.second]))
    turned = np.linalg.norm(gtsam.Rot3.Logmap(missed.rotation()))
    return float(np.linalg.norm(missed.translation())), float(turned), float(np.linalg.norm(measured.translation()))


def _spatial(pose: gtsam.Pose2 | gtsam.Pose3) -> gtsam.Pose3:
    return gtsam.Pose3(pose) if isinstance(pose, gtsam.Pose2) else pose
