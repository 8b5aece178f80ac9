"""Closures as they arrive on a map: worlds that look alike, and real maps with labelled closures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam import datasets
from pgti_gtsam.datasets import Dataset
from pgti_gtsam.datasets.chain import between_factors, closure_slots
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import graph_of
from scenarios import kitti, scans, worlds
from scenarios.aliasing import field
from scenarios.problem import Problem, alone, between
from scenarios.worlds.layouts import LAYOUTS

MOST = 40
"""Closures of a kind that are drawn from one map."""

KITTI = {"KITTI 00": ("00", ["0.15"]), "KITTI 06": ("06", ["0.15"]), "KITTI 07": ("07", ["0.25"])}
"""Sequences, at the detector's threshold that lets most false loops through."""

BICOCCA = {"Bicocca, 1 m": 1.0, "Bicocca, 2 m": 2.0, "Bicocca, 4 m": 4.0}
"""Radii that are assumed."""

FIELD = ("CSAIL", "MIT", "intel", "manhattan_olson3500")
"""Standard graphs, with as many random false closures as they have true ones."""

REAL = (*KITTI, *scans.LOGS, *BICOCCA, *FIELD)


class Trial(NamedTuple):
    """A world of `LAYOUTS` or a map of `REAL`; the seed of its drive or false closures, and of the sample."""

    map: str
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrivals:
    """Closures by the later keyframe, and the map before each.

    Attributes
    ----------
    odometry : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Odometry chained.
    closures : sequence of gtsam.NonlinearFactorGraph
        A between factor each.
    true, overlapping : (k,) bool
        As in `Problem`.
    radii : float, or mapping from key to float
        m.
    """

    odometry: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    closures: Sequence[gtsam.NonlinearFactorGraph]
    true: NDArray[np.bool_]
    overlapping: NDArray[np.bool_]
    radii: float | Mapping[int, float]


def arrivals(trial: Trial, data: Path | None) -> Arrivals:
    """The closures that arrive on a map.

    Parameters
    ----------
    trial : Trial
    data : Path, optional
        Folder of all data.

    Raises
    ------
    InvalidOptionError
        A real map without the folder of all data, or a missing map.
    """
    name, seed = trial
    if name in LAYOUTS:
        return _of_problem(worlds.problem(name, seed))
    if data is None:
        raise InvalidOptionError(f"expected the folder of all data for {name}, got none; --data names the folder")
    if name in KITTI:
        (path,) = kitti.files(data, *KITTI[name])
        return _labelled(path, kitti.EVERY, kitti.RADIUS_M)
    if name in BICOCCA:
        return _labelled(data / "bicocca" / "bicocca_25b_half_0.000.g2o", 1, BICOCCA[name])
    if name in scans.LOGS:
        return _with_look_alikes(data / "scan_pose_graphs" / f"{name}.log", seed)
    return _of_problem(field.problem(data / "pose_graphs" / f"{name}.g2o", seed, 1.0))


def _of_problem(given: Problem) -> Arrivals:
    return Arrivals(
        odometry=given.graph,
        values=given.values,
        closures=given.closures,
        true=given.true,
        overlapping=given.overlapping,
        radii=given.radii,
    )


def _labelled(path: Path, every: int, radius_m: float) -> Arrivals:
    """A graph with the loops of a detector, labelled."""
    dataset = datasets.subsample(datasets.read(path), every)
    slots = closure_slots(dataset)
    true = [slot in (dataset.true_closures or ()) for slot in slots]
    return in_time_order(dataset, [dataset.graph.at(slot) for slot in slots], true, radius_m)


def _with_look_alikes(path: Path, seed: int) -> Arrivals:
    """A scan graph, and false closures between scans that look alike."""
    dataset = datasets.read(path)
    own = [dataset.graph.at(slot) for slot in closure_slots(dataset)]
    alike = scans.look_alikes(path)
    drawn = np.random.default_rng(seed).permutation(len(alike))[:MOST].tolist()
    false = [between(*alike[k], own[0].noiseModel()) for k in drawn]
    return in_time_order(dataset, [*own, *false], [True] * len(own) + [False] * len(false), dataset.radii)


def in_time_order(dataset: Dataset, factors: Sequence[Any], true: Sequence[bool], radii: Any) -> Arrivals:
    """The odometry of a map, and closures in the order of the later keyframe.

    Parameters
    ----------
    dataset : Dataset
    factors : sequence of gtsam factors
        A closure each.
    true : sequence of bool
        Truth of each closure.
    radii : float, or mapping from key to float, m
    """
    order = sorted(range(len(factors)), key=lambda k: (max(factors[k].keys()), min(factors[k].keys()), k))
    closing = set(closure_slots(dataset))
    return Arrivals(
        odometry=graph_of([each.factor for each in between_factors(dataset.graph) if each.slot not in closing]),
        values=datasets.chain_odometry(dataset),
        closures=[alone(factors[k]) for k in order],
        true=np.array([true[k] for k in order]),
        overlapping=np.ones(len(order), dtype=bool),
        radii=radii,
    )
