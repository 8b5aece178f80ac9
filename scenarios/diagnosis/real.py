"""Real graphs at their optimum, taken for the truth."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import poses_of
from pgti_gtsam.errors import FileFormatError
from pgti_gtsam.estimate import optimised
from scenarios.diagnosis import damage
from scenarios.diagnosis.damage import Case, Intact
from scenarios.diagnosis.stretches import grouped
from scenarios.worlds import MATCH

RADII: dict[str, float | None] = {
    "intel": 0.5,
    "CSAIL": 0.5,
    "manhattan_olson3500": 1.0,
    "mit-cscail": None,
    "fr079": None,
    "kitti_06_odom_GT_LC": 4.0,
    "kitti_07_odom_GT_LC": 4.0,
}
"""Metres; None where the file's scans tell."""

INCOMPLETE = ("intel", "CSAIL", "fr079")
"""Second passes are known in these that their makers did not tie."""

EVERY = 5
"""Of KITTI's frames, unless closures would get lost."""

DAMAGES = (damage.NOTHING, damage.DROPPED, damage.FALSE, damage.ODOMETRY)
"""Of `damage.DAMAGES`, those that real graphs are given."""


def case(name: str, seed: int, kind: str, data: Path) -> Case:
    """A real graph with damage.

    Parameters
    ----------
    name : str
        One of `RADII`.
    seed : int
    kind : str
        One of `DAMAGES`.
    data : Path
        Folder of all data.
    """
    found, keys, unit_m = intact(name, data)
    random = np.random.default_rng([seed, sorted(RADII).index(name), damage.DAMAGES.index(kind)])
    return damage.damaged(found, kind, random, keys, unit_m)


@functools.lru_cache(maxsize=1)
def intact(name: str, data: Path) -> tuple[Intact, list[int], float]:
    """A graph at its optimum, its keyframes' keys, and its median radius, m.

    Parameters
    ----------
    name : str
        One of `RADII`.
    data : Path
        Folder of all data.
    """
    # the optimum
    dataset, given = _read(name, data), RADII[name]
    radii = dataset.radii if given is None else given
    optimum = optimised(dataset.graph, dataset.values)
    poses, closures = poses_of(optimum), datasets.closure_slots(dataset)

    # factors without closures
    closing = set(closures)
    base = gtsam.NonlinearFactorGraph()
    for slot in range(dataset.graph.size()):
        if slot not in closing:
            base.push_back(dataset.graph.at(slot))

    # the map
    found = Intact(
        base=base,
        revisits=_revisits(dataset, sorted(poses)),
        near=optimum,
        chained=datasets.chain_odometry(dataset),
        radii=radii,
        places=np.array([poses[key].translation() for key in sorted(poses)]),
        noise=dataset.graph.at(closures[0]).noiseModel(),
        match=_identity_2d if isinstance(next(iter(poses.values())), gtsam.Pose2) else _identity_3d,
    )
    return found, sorted(poses), given or float(np.median(list((dataset.radii or {}).values())))


def _read(name: str, data: Path) -> Any:
    path = next((path for path in sorted(data.rglob(f"{name}.*")) if path.suffix in (".g2o", ".log")), None)
    if path is None:
        raise FileFormatError(name, f"is not below {data}")
    dataset = datasets.read(path)
    if not name.startswith("kitti"):
        return dataset
    fewer = datasets.subsample(dataset, EVERY)
    return fewer if len(datasets.closure_slots(fewer)) == len(datasets.closure_slots(dataset)) else dataset


def _revisits(dataset: Any, keys: list[int]) -> tuple[tuple[Any, ...], ...]:
    """Closures beside each other on both stretches, together."""
    row = {key: k for k, key in enumerate(keys)}
    factors = [dataset.graph.at(slot) for slot in datasets.closure_slots(dataset)]
    pairs = np.array([sorted(row[key] for key in factor.keys()) for factor in factors], dtype=np.int64)  # noqa: SIM118
    together: dict[tuple[int, int], list[Any]] = {}
    for pair, factor in zip(pairs.tolist(), factors, strict=True):
        together.setdefault((pair[0], pair[1]), []).append(factor)
    groups = grouped(np.unique(pairs, axis=0))
    return tuple(tuple(f for i, j in group.tolist() for f in together[i, j]) for group in groups)


def _identity_2d(random: np.random.Generator) -> gtsam.Pose2:
    return gtsam.Pose2.Expmap(random.normal(0.0, MATCH[[3, 4, 2]]))


def _identity_3d(random: np.random.Generator) -> gtsam.Pose3:
    return gtsam.Pose3.Expmap(random.normal(0.0, MATCH))
