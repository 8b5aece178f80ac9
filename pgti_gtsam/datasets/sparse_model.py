"""Sparse models of structure from motion and visual SLAM: posed keyframes, points, and sightings.

A model is the optimum of its own measurements, so a sighting measures here the model's own geometry: bearing and range
of the point from the keyframe, with assumed sigmas. Radii and covisibility, all that an audit needs, follow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import STEP_SIGMAS
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Source

BEARING_SIGMA, RANGE_SIGMA = 0.002, 0.02  # assumed: rad (a pixel or two), and the share of the range


def sparse_model(
    source: Source,
    *,
    format: str,
    poses: Mapping[int, gtsam.Pose3],
    points: Mapping[int, NDArray[np.float64]],
    seen: NDArray[np.int64],
    ties: Sequence[tuple[int, int]] = (),
    loops: Sequence[tuple[int, int]] = (),
    notes: Sequence[str] = (),
) -> Dataset:
    """The dataset of a model.

    Parameters
    ----------
    source : Source
    format : str
    poses : mapping of int to Pose3
        Camera to world, by key.
    points : mapping of int to (3,) float
        By identifier.
    seen : (n, 2) int
        Key of a keyframe and identifier of a point in its view; a repeated pair counts once.
    ties, loops : sequence of pairs of int
        Keys of keyframes that the model ties otherwise than by points, and pairs of keys of closed loops.
    notes : sequence of str

    Raises
    ------
    FileFormatError
        No keyframe, or no point in view of a keyframe.
    """
    # sightings of what the model holds, each once
    seen = np.unique(seen.reshape(-1, 2), axis=0)
    is_known = np.isin(seen[:, 0], list(poses)) & np.isin(seen[:, 1], list(points))
    n_stray, seen = int((~is_known).sum()), seen[is_known]
    if not len(seen):
        raise source.error(f"expected keyframes that see points, got {len(poses)} and {len(points)} without a sighting")
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    held = {*seen[:, 0].tolist(), *(key for pair in (*ties, *loops) for key in pair)}
    kept = {key: pose for key, pose in sorted(poses.items()) if key in held}

    # ties between keyframes
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array(STEP_SIGMAS[3]))
    for i, j in (*ties, *loops):
        graph.push_back(gtsam.BetweenFactorPose3(i, j, kept[i].between(kept[j]), model))

    # landmarks
    for key, pose in kept.items():
        values.insert(key, pose)
    for landmark in np.unique(seen[:, 1]).tolist():
        values.insertPoint3(gtsam.symbol("l", landmark), points[landmark])
    _add_sightings(graph, kept, points, seen)

    return Dataset(
        name=source.name,
        format=format,
        graph=graph,
        values=values,
        closures=tuple(range(len(ties), len(ties) + len(loops))),
        notes=(*notes, *_remarks(len(poses) - len(kept), len(ties) + len(loops), n_stray)),
    )


def _add_sightings(
    graph: gtsam.NonlinearFactorGraph,
    poses: Mapping[int, gtsam.Pose3],
    points: Mapping[int, NDArray[np.float64]],
    seen: NDArray[np.int64],
) -> None:
    starts = np.flatnonzero(np.diff(seen[:, 0], prepend=-1))
    for rows in np.split(seen, starts[1:]):
        key = int(rows[0, 0])
        pose, landmarks = poses[key], rows[:, 1].tolist()
        places = np.array([points[landmark] for landmark in landmarks])
        local = (places - pose.translation()) @ pose.rotation().matrix()
        ranges = np.linalg.norm(local, axis=1).tolist()
        for landmark, point, range_m in zip(landmarks, local, ranges, strict=True):
            if range_m > 0.0:
                sigmas = np.array([BEARING_SIGMA, BEARING_SIGMA, RANGE_SIGMA * range_m])
                model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
                landmark_key, bearing = gtsam.symbol("l", landmark), gtsam.Unit3(point)
                graph.push_back(gtsam.BearingRangeFactor3D(key, landmark_key, bearing, range_m, model))


def _remarks(n_blind: int, n_ties: int, n_stray: int) -> list[str]:
    notes = ["sightings measure what the model says, with assumed sigmas of 0.002 rad and 2 % of the range"]
    notes.append("lengths are in the model's own unit, metres only where its scale is known")
    if n_ties:
        notes.append(
            f"{n_ties} ties between keyframes measure what the model says, with assumed sigmas of 0.01 rad and 0.1 m"
        )
    if n_stray:
        notes.append(f"{n_stray} sightings by keyframes or of points that the model does not hold are left out")
    if n_blind:
        notes.append(f"{n_blind} keyframes see no point of the model and are left out")
    return notes
