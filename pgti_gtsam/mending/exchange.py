"""Ties that leave and come back: questions to a matcher or a human, and the answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam import datasets
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.datasets import write_g2o
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import BETWEEN, between_factor, factors_of, keys_of
from pgti_gtsam.mending.records import Attempt, Mended


def open_ties(mended: Mended) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The wanted ties without confirmation, as predicted, with the region to search as covariance."""
    graph, poses, keyframes = gtsam.NonlinearFactorGraph(), gtsam.Values(), read_keyframes(mended.values)
    for attempt in mended.attempts:
        if attempt.wanted is None or attempt.outcome == "confirmed":
            continue
        region = gtsam.noiseModel.Gaussian.Covariance(attempt.wanted.covariance)
        graph.push_back(between_factor(*attempt.keys, attempt.wanted.pose, region))
        for key in attempt.keys:
            if not poses.exists(key):
                poses.insert(key, keyframes.pose(key))
    return graph, poses


def ties_in(path: Path, dataset: datasets.Dataset) -> list[Any]:
    """The between factors of a file of ties, on the keys of the map.

    Parameters
    ----------
    path : Path
    dataset : datasets.Dataset
        The map.

    Raises
    ------
    InvalidOptionError
        The file names a keyframe that the map does not have.
    """
    keys = read_keyframes(dataset.values).keys.tolist()
    own = {**{str(key): key for key in keys}, **{name: key for key, name in dataset.names.items()}}
    by_index = {str(gtsam.Symbol(key).index()): key for key in keys if key >> 56}
    named = {**(by_index if len(by_index) == len(keys) else {}), **own}
    ties = datasets.read(path)
    found = []
    for factor in factors_of(ties.graph):
        if not isinstance(factor, BETWEEN):
            continue
        ends = [ties.names.get(key, str(key)) for key in keys_of(factor)]
        unknown = next((end for end in ends if end not in named), None)
        if unknown is not None:
            raise InvalidOptionError(f"expected ties between keyframes of the map, got {unknown} in {path}")
        found.append(between_factor(named[ends[0]], named[ends[1]], factor.measured(), factor.noiseModel()))
    return found


def g2o_lines(
    attempts: Sequence[Attempt], values: gtsam.Values, names: Mapping[int, str] | None
) -> tuple[list[str], list[str | None]]:
    """Lines of the vertices of all attempts and of each one's edge, None where nothing was measured.

    Parameters
    ----------
    attempts : sequence of Attempt
    values : gtsam.Values
    names : mapping, optional
        Names of keys in the map's file; None where names are the keys.
    """
    graph, poses = gtsam.NonlinearFactorGraph(), gtsam.Values()
    keyframes = read_keyframes(values)
    for attempt in attempts:
        if attempt.factor is not None:
            graph.push_back(attempt.factor)
            for key in attempt.keys:
                if not poses.exists(key):
                    poses.insert(key, keyframes.pose(key))
    if not graph.size():
        return [], [None] * len(attempts)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "ties.g2o"
        write_g2o(graph, poses, path, names=names)
        lines = path.read_text(encoding="utf-8").splitlines()
    edges = iter([line for line in lines if line.startswith("EDGE")])
    vertices = [line for line in lines if line.startswith("VERTEX")]
    return vertices, [None if attempt.factor is None else next(edges) for attempt in attempts]


def planar(pose: Any) -> list[float]:
    """x and y in m and heading in rad, seen from above."""
    heading = pose.theta() if isinstance(pose, gtsam.Pose2) else pose.rotation().yaw()
    return [round(float(value), 5) for value in (pose.x(), pose.y(), heading)]


def degrees(pose: Any) -> float:
    """Angle that a relative pose turns by."""
    turn = pose.rotation()
    angle = turn.theta() if isinstance(pose, gtsam.Pose2) else np.linalg.norm(gtsam.Rot3.Logmap(turn))
    return float(np.degrees(abs(angle)))
