"""Several files as one map: the sessions of a robot, or the robots of a team."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import gtsam

from pgti_gtsam.adapter.values import insert_point
from pgti_gtsam.datasets.chain import point_of, poses_of
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.reader import read, read_source
from pgti_gtsam.datasets.source import Source
from pgti_gtsam.datasets.text import TextFile
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.pose_graph import key_label

LETTERS = ascii_lowercase.replace("l", "")  # of keyframes; l is for landmarks that belong to no session
INDEX = (1 << 56) - 1


def read_one_map(paths: Sequence[Path], *, ignore_unknown: bool = False) -> Dataset:
    """The files of several sessions or robots as a dataset in one frame.

    Where no identifier of a vertex comes twice (GTSAM symbols of several robots, sessions that count on), an edge
    of any file may tie vertices of another. Repeated identifiers are taken for different keyframes:
    keyframes of the first file become a0, a1, …, of the second b0, b1, …, and landmarks A0, B0, ….

    Parameters
    ----------
    paths : sequence of Path
        At least two.
    ignore_unknown : bool
        As in `read`.

    Raises
    ------
    InvalidOptionError
        Fewer than two files, more than there are letters, or planar files beside spatial ones.
    FileFormatError
        As of `read`.
    """
    if not 2 <= len(paths) <= len(LETTERS):
        raise InvalidOptionError(f"expected 2 to {len(LETTERS)} files of one map, got {len(paths)}")
    sources = [Source(path=path, ignore_unknown=ignore_unknown) for path in paths]
    if all(source.is_text for source in sources) and _is_disjoint([source.file for source in sources]):
        joined = Source(path=paths[0], more=tuple(paths[1:]), ignore_unknown=ignore_unknown)
        return read_source(joined)
    return _side_by_side([read(path, ignore_unknown=ignore_unknown) for path in paths])


def _is_disjoint(files: Sequence[TextFile]) -> bool:
    """Whether no two files define the same vertex; files without vertices may define any."""
    seen: set[str] = set()
    for file in files:
        vertices = [line for tag in file.tags if "VERTEX" in tag for line in file.tags[tag]]
        names = {line.text.split(None, 2)[1] for line in vertices if len(line.fields) > 1}
        if not names or not seen.isdisjoint(names):
            return False
        seen |= names
    return True


def _side_by_side(datasets: Sequence[Dataset]) -> Dataset:
    """A dataset whose keys tell their file by the letter."""
    # files of one dimension
    kinds = {type(pose).__name__ for dataset in datasets for pose in poses_of(dataset.values).values()}
    if len(kinds) > 1:
        raise InvalidOptionError("expected files of one map, got poses in the plane in some and in space in others")

    # factors, poses and landmarks of each file under their new keys
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    radii: dict[int, float] = {}
    closures: list[int] = []
    notes = ["identifiers come in several files: they are taken for different keyframes"]
    for letter, dataset in zip(LETTERS, datasets, strict=False):
        poses = poses_of(dataset.values)
        keys = {key: _renamed(key, letter if key in poses else letter.upper()) for key in dataset.values.keys()}  # noqa: SIM118
        stated = set(dataset.closures or ())
        for slot in range(dataset.graph.size()):
            factor: Any = dataset.graph.at(slot)
            if factor is not None:
                closures += [graph.size()] if slot in stated else []
                graph.push_back(factor.rekey([keys[key] for key in factor.keys()]))  # noqa: SIM118  no mapping
        for key, pose in poses.items():
            values.insert(keys[key], pose)
        for key in keys.keys() - poses.keys():
            point = point_of(dataset.values, key, next(iter(poses.values())))
            if point is not None:
                insert_point(values, keys[key], point)
        radii |= {keys[key]: radius for key, radius in (dataset.radii or {}).items()}
        first, last = (key_label(keys[key]) for key in (min(poses), max(poses)))
        notes += [f"{dataset.name}: {len(poses)} keyframes {first} to {last}", *dataset.notes]

    # one dataset
    return Dataset(
        name=" + ".join(dataset.name for dataset in datasets),
        format=datasets[0].format,
        graph=graph,
        values=values,
        radii=radii or None,
        closures=tuple(closures) if all(dataset.closures is not None for dataset in datasets) else None,
        notes=tuple(dict.fromkeys(notes)),
        ignored_edges=sum(dataset.ignored_edges for dataset in datasets),
    )


def _renamed(key: int, letter: str) -> int:
    return int(gtsam.symbol(letter, key & INDEX))
