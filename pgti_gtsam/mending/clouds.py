"""Where the points come from that a keyframe's sensor saw: a file's own laser scans, or a folder of clouds."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.dense_map import load_open3d
from pgti_gtsam.errors import FileFormatError

ENDINGS = (".pcd", ".ply")

KEPT = 64
"""Clouds that are kept in memory: those of a submap are asked for again by its neighbour."""

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Clouds:
    """Points of every keyframe that has some, seen from the keyframe.

    Attributes
    ----------
    scans : mapping of key to (n, 2) or (n, 3) float, m
        Clouds in memory.
    files : mapping of key to Path
        Files of other clouds.
    """

    scans: Mapping[int, Points]
    files: Mapping[int, Path]

    def __contains__(self, key: object) -> bool:
        return key in self.scans or key in self.files

    def points(self, key: int) -> Points:
        """Finite points of a keyframe, (n, 2) of a laser scanner of one plane and (n, 3) otherwise, m.

        Raises
        ------
        FileFormatError
            The file of the keyframe holds no cloud.
        """
        return self.scans[key] if key in self.scans else _read(self.files[key])


def scans_of(scans: Mapping[int, Any]) -> Clouds:
    """Clouds of points in memory, by key."""
    found = {int(key): np.asarray(points, dtype=np.float64) for key, points in scans.items()}
    return Clouds(scans={key: points[np.isfinite(points).all(axis=1)] for key, points in found.items()}, files={})


def clouds_in(folder: Path | str, keys: Sequence[int]) -> Clouds:
    """Clouds of a folder, a PCD or PLY file per keyframe.

    The last number in a file's name, or in the name of the file's own folder (hdl_graph_slam's ``000012/cloud.pcd``),
    is the keyframe's key. Where these numbers are no keys of the map, but as many files as keyframes lie there, the
    files are those of the keyframes in order (LIO-SAM and Manual-Loop-Closure-Tools count from 0 or from 1).

    Parameters
    ----------
    folder : Path or str
    keys : sequence of int
        Keys of the keyframes, ascending.

    Raises
    ------
    FileFormatError
        No such folder, no cloud inside, two clouds of the same number, or numbers that fit no keyframe.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileFormatError(folder, "expected a folder with a PCD or PLY file for each keyframe, found no folder")
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in ENDINGS)
    if not paths:
        raise FileFormatError(folder, "expected a PCD or PLY file for each keyframe, found none in this folder")

    # by the numbers in their names
    numbered: dict[int, Path] = {}
    for path in paths:
        number = _number(path, folder)
        if number is None:
            continue
        if number in numbered:
            raise FileFormatError(path, f"expected one cloud of number {number}, found {numbered[number]} too")
        numbered[number] = path

    # which are keys, or count the keyframes
    own = set(keys)
    if set(numbered) <= own and numbered:
        return Clouds(scans={}, files=numbered)
    if len(numbered) == len(keys):
        return Clouds(
            scans={}, files={key: numbered[number] for key, number in zip(keys, sorted(numbered), strict=True)}
        )
    some = sorted(set(numbered) - own)[:3]
    raise FileFormatError(
        folder,
        f"expected clouds numbered as keyframes, or {len(keys)} of them in the keyframes' order, found {len(paths)} "
        f"with numbers such as {', '.join(map(str, some)) or 'none'}; rename the files",
    )


def _number(path: Path, folder: Path) -> int | None:
    """The last number in a file's own name, or else in the name of its folder."""
    for name in (path.stem, *(part.name for part in path.relative_to(folder).parents[:-1])):
        found = re.findall(r"\d+", name)
        if found:
            return int(found[-1])
    return None


@lru_cache(maxsize=KEPT)
def _read(path: Path) -> Points:
    open3d = load_open3d()
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        points = np.asarray(open3d.io.read_point_cloud(str(path)).points, dtype=np.float64)
    points = points[np.isfinite(points).all(axis=1)] if len(points) else points
    if not len(points):
        raise FileFormatError(path, "expected a cloud that Open3D reads, found no finite point in it")
    return points
