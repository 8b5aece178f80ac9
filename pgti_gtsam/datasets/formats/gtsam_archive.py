"""GTSAM's own text archives: a serialised NonlinearFactorGraph, and its Values in a second file.

A C++ pipeline writes them with ``gtsam::serializeToFile(graph, "graph.txt")`` and Python with
``open("graph.txt", "w").write(graph.serialize())``; the same for values.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TypeVar

import gtsam

from pgti_gtsam.datasets.chain import between_factors, closure_slots, poses_of
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Format, Source, read_text
from pgti_gtsam.errors import FileFormatError

NAME = "GTSAM archive"
MAGIC = b"serialization::archive"
HEAD = 400  # characters in which an archive has named itself, XML prologue included
VALUES_MARK = "gtsam::GenericValue<"
ADVICE = "write it with gtsam::serializeToFile (C++) or graph.serialize() (Python)"

# Boost's text reader follows object numbers unchecked: an archive cut off in the middle of one ends the process
# (measured on 4.3.0). So a second process reads it first.
_PROBE = "import sys, gtsam; gtsam.{kind}().deserialize(sys.stdin.buffer.read().decode())"

Archived = TypeVar("Archived", gtsam.NonlinearFactorGraph, gtsam.Values)


def _recognises(source: Source) -> bool:
    """Whether the source starts as a boost archive does."""
    return MAGIC in source.head[:HEAD] or b"boost_serialization" in source.head[:HEAD]


def parse(source: Source) -> Dataset:
    """A serialised graph and the values in a second file.

    Raises
    ------
    FileFormatError
        An XML archive, an archive of the wrong kind or a damaged one, or no file of values.
    """
    text, values_path = read_text(source.path), source.values
    _refuse_xml(source.path, text)
    if VALUES_MARK in text:
        raise source.error("holds GTSAM values; expected the factor graph here, and these as --values FILE")
    if values_path is None:
        raise source.error("holds a factor graph without values; name the file of its values: --values FILE")
    graph = _deserialize(source.path, text, gtsam.NonlinearFactorGraph)
    values = read_values(values_path)
    notes = [f"values from {values_path.name}"]
    empty = sum(graph.at(slot) is None for slot in range(graph.size()))
    if empty:
        notes.append(f"{empty} slots of the graph are empty: their factors were removed")
    return Dataset(
        name=source.name,
        format=NAME,
        graph=graph,
        values=values,
        closures=closure_slots(list(poses_of(values)), between_factors(graph)),
        notes=tuple(notes),
    )


def read_values(path: Path) -> gtsam.Values:
    """Values from a text archive.

    Raises
    ------
    FileFormatError
        The file is no archive of values, or a damaged one.
    """
    text = read_text(path)
    if MAGIC.decode() not in text[:HEAD] and "boost_serialization" not in text[:HEAD]:
        raise FileFormatError(path, f"expected a text archive of gtsam.Values; {ADVICE}")
    _refuse_xml(path, text)
    if VALUES_MARK not in text:  # GTSAM reads a graph's archive as no values at all, without a word
        raise FileFormatError(path, "expected an archive of gtsam.Values with at least one value")
    return _deserialize(path, text, gtsam.Values)


def write_archive(written: gtsam.NonlinearFactorGraph | gtsam.Values, path: Path) -> None:
    """Write a graph or values as ``gtsam::deserializeFromFile`` reads them; empty slots stay empty slots."""
    path.write_text(written.serialize(), encoding="utf-8")


def _refuse_xml(path: Path, text: str) -> None:
    if not text.lstrip()[:2].isdigit():
        raise FileFormatError(path, f"is an XML archive, expected a text archive; {ADVICE}")


def _deserialize(path: Path, text: str, kind: type[Archived]) -> Archived:
    probe = [sys.executable, "-c", _PROBE.format(kind=kind.__name__)]
    outcome = subprocess.run(probe, input=text.encode(), capture_output=True, check=False)
    if outcome.returncode != 0:
        raise FileFormatError(path, f"is a damaged or cut-off archive of gtsam.{kind.__name__}; {ADVICE}")
    read = kind()
    read.deserialize(text)
    return read


FORMAT = Format(NAME, _recognises, parse, takes_values=True)
