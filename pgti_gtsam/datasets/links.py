"""Links between maps, in a file beside theirs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gtsam

from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.g2o_edges import EDGES, pose_edges
from pgti_gtsam.datasets.source import read_text
from pgti_gtsam.datasets.text import split_lines
from pgti_gtsam.errors import FileFormatError

NAMED = re.compile(r"([A-Za-z])(\d+)")


def read_links(path: Path, dataset: Dataset) -> list[Any]:
    """Between factors of a file of g2o edges between keyframes of a dataset.

    A line is an edge of g2o, ``EDGE_SE2`` or ``EDGE_SE3:QUAT``. Identifiers are those of the dataset: the numbers in
    the files, or, where files share numbers, the letter of the file and the number, a12 (see `read_one_map`).

    Parameters
    ----------
    path : Path
    dataset : Dataset

    Raises
    ------
    FileFormatError
        A malformed line, a line that is no edge between poses, a keyframe that the dataset lacks.
    """
    # names of a letter and a number become keys
    lines = [_with_keys(line) for line in read_text(path).splitlines()]
    file = split_lines(path, "\n".join(lines))
    other = next((line for tag in file.tags if tag not in EDGES for line in file.tags[tag]), None)
    if other is not None:
        raise file.error(f"expected edges between poses of two maps, got {other.fields[0]}", other.number)

    # factors between keyframes of the dataset
    keys = {name: key for key, name in dataset.names.items()}
    found = []
    for entry in pose_edges(file):
        ends = [keys.get(str(key), key) for key in entry.poses]
        missing = next((key for key in ends if not dataset.values.exists(key)), None)
        if missing is not None:
            raise file.error(
                f"expected a keyframe of the maps, got {gtsam.DefaultKeyFormatter(missing)}; where maps share numbers, "
                "name the map by its letter: a0 is keyframe 0 of the first file",
                entry.line,
            )
        factor: Any = entry.factor
        found.append(factor.rekey(ends))
    if not found:
        raise FileFormatError(path, "expected at least one edge between poses, got none")
    return found


def _with_keys(line: str) -> str:
    """The line with keys for names of a letter and a number."""
    words = line.split()
    for k in (1, 2):
        match = NAMED.fullmatch(words[k]) if len(words) > k and words[0] in EDGES else None
        if match:
            words[k] = str(gtsam.symbol(match[1], int(match[2])))
    return " ".join(words)
