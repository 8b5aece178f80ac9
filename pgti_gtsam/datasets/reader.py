"""Read a file in any format; the content tells the format."""

from __future__ import annotations

import gc
import logging
from dataclasses import replace
from pathlib import Path

import gtsam

from pgti_gtsam.datasets import robust_slam
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.foreign import refuse
from pgti_gtsam.datasets.formats import FORMATS, carmen
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import quote
from pgti_gtsam.errors import FileFormatError, InvalidOptionError

# Data in the GTSAM wheel, by a short name
_LOG = logging.getLogger(__name__)

BUILTIN = {
    "kitti00": "VO_stereo_factors00.txt",
    "victoria_park": "victoria_park.txt",
    "victoria_park_1k": "victoriaPark_reduced_1k.g2o",
    "city_trees_1k": "cityTrees_reduced_1k.g2o",
    "sphere2500": "sphere2500.txt",
    "w100": "w100.graph",
    "w10000": "w10000.graph",
}


def read(
    path: Path | str,
    values_path: Path | str | None = None,
    *,
    loops: Path | str | None = None,
    ignore_unknown: bool = False,
) -> Dataset:
    """The dataset in a file or folder; the format is found from the content.

    Parameters
    ----------
    path : Path or str
        Of a format in `formats.FORMATS`; plain or compressed with gzip, bzip2, xz or lzma, or alone in a zip archive.
    values_path : Path or str, optional
        The archive of the values, for an archive of a graph only.
    loops : Path or str, optional
        The loops of a trajectory, for a trajectory only.
    ignore_unknown : bool
        Count lines that tie two poses in an unknown way instead of refusing the file.

    Returns
    -------
    Dataset

    Raises
    ------
    FileFormatError
        No such file, a format that is not understood, or a malformed line; the message names file and line.
    """
    source = Source(
        path=Path(path),
        values=None if values_path is None else Path(values_path),
        loops=None if loops is None else Path(loops),
        ignore_unknown=ignore_unknown,
    )
    dataset = read_source(source)
    if source.is_folder:
        return dataset
    return robust_slam.with_truth(robust_slam.with_labels(dataset, source.path), source.path, read_plain)


def is_map(path: Path) -> bool:
    """Whether a reader takes a file or folder for its own, by its first look."""
    return any(format.recognises(Source(path=path)) for format in FORMATS)


def read_source(source: Source) -> Dataset:
    """The dataset in a source, without labels and truth in further files.

    Reading makes millions of objects and no cycle: the collector would walk through all objects again
    and again, takes a third of the time of a large file and rests.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        dataset = _format(source).parse(source)
        counts = dataset.values.size(), dataset.graph.nrFactors()
        _LOG.info("%s read as %s: %d variables, %d factors", source.path, dataset.format, *counts)
        return dataset
    finally:
        if was_on:
            gc.enable()


def read_plain(path: Path) -> Dataset:
    """The dataset in a file, without labels and truth in further files."""
    return read_source(Source(path=path))


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
    except (OSError, RuntimeError, ValueError):
        raise FileFormatError(BUILTIN[name], "is not among the data of the installed GTSAM") from None
    return replace(read(path), name=name)


def read_carmen(path: Path | str, *, step_m: float = 0.5, step_rad: float = 0.5) -> Dataset:
    """The dataset in a CARMEN log, with a choice of the keyframes' spacing; see `carmen.parse`.

    Parameters
    ----------
    path : Path or str
    step_m, step_rad : float
        A scan becomes a keyframe after this way or turn.
    """
    source = Source(path=Path(path))
    if _format(source) is not carmen.FORMAT:
        raise source.error("expected a CARMEN log with FLASER or ROBOTLASER1 lines")
    return carmen.parse(source, step_m=step_m, step_rad=step_rad)


def _format(source: Source) -> Format:
    """The first format that recognises the source with its companion files."""
    if not source.path.exists():
        raise source.error("no such file")
    found = next((format for format in FORMATS if format.recognises(source)), None)
    if found is None:
        refuse(source)
    if source.values is not None and not found.takes_values:
        raise source.error("is no GTSAM archive, and brings its own values: leave the file of values out")
    if source.loops is not None and not found.takes_loops:
        raise source.error("is no trajectory, and brings its own loops: leave the list of loops out")
    return found
