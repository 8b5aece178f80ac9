"""GTSAM's own archives, text or XML: a serialised NonlinearFactorGraph, and its Values in a second file.

A C++ pipeline writes archives with ``gtsam::serializeToFile(graph, "graph.txt")`` or ``serializeToXMLFile`` and Python
with ``open("graph.txt", "w").write(graph.serialize())``; the same for values. Python's GTSAM reads text alone, so XML
is brought into text: both hold the same tokens in the same order. Binary archives do not describe their bytes.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

import gtsam

from pgti_gtsam import outputs
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.foreign import ENDINGS
from pgti_gtsam.datasets.source import Format, Source, read_bytes, read_text
from pgti_gtsam.errors import FileFormatError

NAME, XML_NAME = "GTSAM archive", "GTSAM archive as XML"
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
    is_boost = MAGIC in source.head[:HEAD] or b"boost_serialization" in source.head[:HEAD]
    return is_boost and source.path.suffix not in ENDINGS


def parse(source: Source) -> Dataset:
    """A serialised graph and the values in a second file.

    Raises
    ------
    FileFormatError
        An XML archive, an archive of the wrong kind or a damaged one, or no file of values.
    """
    text, values_path = as_text(source.path), source.values
    if VALUES_MARK in text:
        raise source.error("holds GTSAM values; expected the factor graph here, and these as --values FILE")
    if values_path is None:
        raise source.error("holds a factor graph without values; name the file of its values: --values FILE")

    # the graph and its values
    graph = _deserialize(source.path, text, gtsam.NonlinearFactorGraph)
    values = read_values(values_path)
    notes = [f"values from {values_path.name}"]
    if empty := sum(graph.at(slot) is None for slot in range(graph.size())):
        notes.append(f"{empty} slots of the graph are empty: their factors were removed")
    return Dataset(
        name=source.name,
        format=XML_NAME if b"boost_serialization" in source.head[:HEAD] else NAME,
        graph=graph,
        values=values,
        notes=tuple(notes),
    )


def read_values(path: Path) -> gtsam.Values:
    """Values from an archive.

    Raises
    ------
    FileFormatError
        The file is no archive of values, or a damaged one.
    """
    text = as_text(path)
    if VALUES_MARK not in text:  # GTSAM reads a graph's archive as no values at all, without a word
        raise FileFormatError(path, "expected an archive of gtsam.Values with at least one value")
    return _deserialize(path, text, gtsam.Values)


def write_archive(written: gtsam.NonlinearFactorGraph | gtsam.Values, path: Path) -> None:
    """Write a graph or values as ``gtsam::deserializeFromFile`` reads them; empty slots stay empty slots.

    Parameters
    ----------
    written : gtsam.NonlinearFactorGraph or gtsam.Values
    path : Path
    """
    outputs.write_text(path, written.serialize())


def as_text(path: Path) -> str:
    """An archive as a text archive.

    Raises
    ------
    FileFormatError
        A binary or damaged archive, or none.
    """
    head = read_bytes(path, HEAD)
    if MAGIC in head and b"\0" in head:
        raise FileFormatError(path, f"is a binary archive, which says nothing of what its bytes mean; {ADVICE}")
    text = read_text(path)
    if b"boost_serialization" in head:
        return _from_xml(path, text)
    if MAGIC not in head:
        raise FileFormatError(path, f"expected a text archive of gtsam.Values; {ADVICE}")
    return text


def _from_xml(path: Path, text: str) -> str:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise FileFormatError(path, f"is a damaged or cut-off XML archive ({error}); {ADVICE}") from None
    tokens = [str(len(MAGIC)), MAGIC.decode(), root.get("version", "")]
    for element in root:
        _add_tokens(element, tokens)
    return " ".join(tokens) + "\n"


def _add_tokens(element: ElementTree.Element, tokens: list[str]) -> None:
    """Append the text before an element of a text archive: class if a pointer names it, tracking, version, identity."""
    if (named := element.get("class_name")) is not None:
        tokens += [element.get("class_id", ""), str(len(named)), named]
    elif element.get("class_id") == "-1":  # a null pointer
        tokens.append("-1")
    for attribute in ("class_id_reference", "tracking_level", "version", "object_id", "object_id_reference"):
        tokens += [element.get(attribute, "").removeprefix("_")] if attribute in element.attrib else []
    if len(element) == 0 and element.text and element.text.strip():
        tokens.append(element.text.strip())
    for child in element:
        _add_tokens(child, tokens)


def _deserialize(path: Path, text: str, kind: type[Archived]) -> Archived:
    probe = [sys.executable, "-c", _PROBE.format(kind=kind.__name__)]
    if subprocess.run(probe, input=text.encode(), capture_output=True, check=False).returncode != 0:
        raise FileFormatError(path, f"is a damaged or cut-off archive of gtsam.{kind.__name__}; {ADVICE}")
    read = kind()
    read.deserialize(text)
    return read


FORMAT = Format(NAME, _recognises, parse, takes_values=True)
