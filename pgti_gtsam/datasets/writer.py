"""A changed graph back into its own format, where that format holds graphs; g2o otherwise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import gtsam

from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.formats import g2o, gtsam_archive, pyfg, toro
from pgti_gtsam.datasets.g2o_writer import write_g2o
from pgti_gtsam.datasets.pyfg_writer import write_pyfg
from pgti_gtsam.datasets.toro_writer import write_toro


class Outcome(NamedTuple):
    """The parts of a graph that the file cannot hold, by kind, and the format where unexpected, with the reason."""

    unwritten: Mapping[str, int]
    surprise: str = ""


def write_graph(dataset: Dataset, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, path: Path) -> Outcome:
    """Write a graph on the variables of a dataset, in the dataset's format or in g2o.

    The format is g2o where the path ends with ``.g2o``, and where the dataset's format has no line for an edge between
    keyframes, or is a database of others.

    Parameters
    ----------
    dataset : Dataset
        The source of the graph.
    graph, values
        The graph; empty slots stay empty slots in an archive and are passed over elsewhere.
    path : Path

    Raises
    ------
    MissingValueError, InvalidValueError
        As of `write_g2o`.
    """
    write = WRITERS.get(dataset.format)
    if path.suffix == ".g2o" or write is None:
        written = write_g2o(graph, values, path, names=dataset.names)
        own = {
            "keys, which comments at its end name instead": len(written.renumbered),
            "radii, which g2o has no word for": len(dataset.radii or ()),
        }
        unwritten = {**written.unwritten, **{what: count for what, count in own.items() if count}}
        is_other = path.suffix != ".g2o" and dataset.format != g2o.NAME
        return Outcome(unwritten, f"as g2o: no {dataset.format} is written" if is_other else "")
    is_xml = dataset.format == gtsam_archive.XML_NAME
    return Outcome(write(graph, values, path), "as a text archive: Python's GTSAM writes no XML" if is_xml else "")


def _write_archive(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, path: Path) -> Mapping[str, int]:
    gtsam_archive.write_archive(graph, path)
    return {}


WRITERS: Mapping[str, Callable[[gtsam.NonlinearFactorGraph, gtsam.Values, Path], Mapping[str, int]]] = {
    toro.NAME: write_toro,
    pyfg.NAME: write_pyfg,
    gtsam_archive.NAME: _write_archive,
    gtsam_archive.XML_NAME: _write_archive,
}
"""Of the formats that hold a graph, by name, but for g2o."""
