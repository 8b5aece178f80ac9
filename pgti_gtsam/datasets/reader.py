"""Read a file whatever its format, which its content tells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gtsam

from pgti_gtsam.datasets import robust_slam
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.formats import carmen, flirtlib, g2o, gtsam_archive, kitti_stereo, toro, victoria_park
from pgti_gtsam.datasets.text import UNDERSTOOD, TextFile, is_number, quote, read_text, split_lines
from pgti_gtsam.errors import FileFormatError, InvalidOptionError

# Data in the GTSAM wheel, by a short name
BUILTIN = {
    "kitti00": "VO_stereo_factors00.txt",
    "victoria_park": "victoria_park.txt",
    "victoria_park_1k": "victoriaPark_reduced_1k.g2o",
    "city_trees_1k": "cityTrees_reduced_1k.g2o",
    "sphere2500": "sphere2500.txt",
    "w100": "w100.graph",
    "w10000": "w10000.graph",
}


def read(path: Path | str, values_path: Path | str | None = None) -> Dataset:
    """The dataset in a file; the format is found from the content.

    Parameters
    ----------
    path : Path or str
        g2o, TORO ``.graph``, a GTSAM text archive of a factor graph, ``VO_stereo_factors*.txt``,
        ``victoria_park.txt``, a CARMEN log or a FLIRTLib scan graph; plain, gzip or bzip2.
    values_path : Path or str, optional
        The text archive of the values, for an archive of a graph only.

    Returns
    -------
    Dataset

    Raises
    ------
    FileFormatError
        No such file, a format that is not understood, or a malformed line; the message names file and line.
    """
    path = Path(path)
    text = read_text(path)
    file = split_lines(path, text)
    if gtsam_archive.is_archive(text):
        return gtsam_archive.parse(file, text, None if values_path is None else Path(values_path))
    if values_path is not None:
        raise file.error("is no GTSAM archive, and brings its own values: leave the file of values out")
    dataset = _parser(file)(file)
    return robust_slam.with_truth(robust_slam.with_labels(dataset, path), path, read_plain)


def read_plain(path: Path) -> Dataset:
    """The dataset in a text file, without looking for labels and truth beside it."""
    file = split_lines(path, read_text(path))
    return _parser(file)(file)


def builtin(name: str = "kitti00") -> Dataset:
    """A dataset that comes with the GTSAM wheel.

    Parameters
    ----------
    name : str
        A key of `BUILTIN`.

    Raises
    ------
    InvalidOptionError
        Another name.
    FileFormatError
        The wheel installed here does not hold the file.
    """
    if name not in BUILTIN:
        raise InvalidOptionError(f"expected one of {', '.join(BUILTIN)}, got {quote(name)}")
    try:
        path = str(gtsam.findExampleDataFile(BUILTIN[name]))  # type: ignore[no-untyped-call]
    except (RuntimeError, ValueError):
        raise FileFormatError(BUILTIN[name], "is not among the data of the installed GTSAM") from None
    return replace(read(path), name=name)


def read_carmen(path: Path | str, *, step_m: float = 0.5, step_rad: float = 0.5) -> Dataset:
    """The dataset in a CARMEN log, with a choice of the keyframes' spacing; see `carmen.parse`."""
    path = Path(path)
    file = split_lines(path, read_text(path))
    if _parser(file) is not carmen.parse:
        raise file.error("expected a CARMEN log with FLASER or ROBOTLASER1 lines")
    return carmen.parse(file, step_m=step_m, step_rad=step_rad)


def _parser(file: TextFile) -> Callable[[TextFile], Dataset]:
    """The reader for the tags of a file."""
    tags = set(file.tags)
    if tags >= {"VERTEX2", "ROBOTLASER1"}:
        return flirtlib.parse
    for module in (carmen, g2o, toro, victoria_park):
        if tags & module.TAGS:
            parse: Callable[[TextFile], Dataset] = module.parse
            return parse
    if not file.lines:
        raise file.error(f"holds nothing but comments; {UNDERSTOOD}")
    if numeric := _numeric_parser(file):
        return numeric
    shown = ", ".join(quote(tag, 20) for tag in list(file.tags)[:3])
    raise file.error(f"is of no known format (its lines start with {shown}); {UNDERSTOOD}")


def _numeric_parser(file: TextFile) -> Callable[[TextFile], Dataset] | None:
    """The reader for a file of numbers without tags, of which only the width tells anything."""
    first = file.lines[0].fields
    if not all(map(is_number, first)):
        return None
    if len(first) == kitti_stereo.WIDTH and first[0].isdecimal() and first[1].isdecimal():
        return kitti_stereo.parse
    if len(first) in kitti_stereo.COMPANIONS:
        what = kitti_stereo.COMPANIONS[len(first)]
        raise file.error(f"looks like KITTI {what}; expected the VO_stereo_factors file beside it")
    return None
