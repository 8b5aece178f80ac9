"""Dumps of GLIM: ``graph.txt`` with the submaps that were matched, and the pose of every submap in its own folder.

``graph.txt`` says ``num_submaps: n`` and ``matching_cost TYPE i j`` for every pair of submaps whose point clouds are
registered; ``000000/data.txt`` holds ``T_world_origin:`` and the four rows of a matrix. The factors themselves
are point clouds (``graph.bin`` holds only the factors that GTSAM can write): a tie measures here the map's own pose.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import gtsam
import numpy as np

from pgti_gtsam.datasets.assembly import Entry, assemble
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.formats.trajectory import matrix_poses
from pgti_gtsam.datasets.source import Format, Source, read_lines
from pgti_gtsam.datasets.text import parse_table
from pgti_gtsam.factor_graphs import between_factor

NAME = "GLIM dump"
GRAPH = "graph.txt"
SIGMAS = np.array([0.01, 0.01, 0.01, 0.05, 0.05, 0.05])  # assumed: rad and m, a registration of two submaps


def parse(source: Source) -> Dataset:
    """Submaps as keyframes, ties from each submap to the next and between matched submaps.

    Raises
    ------
    FileFormatError
        A submap's folder is missing, or a malformed line.
    """
    # poses of the submaps
    file = read_lines(_graph(source))
    count = [line.fields[1:] for line in file.tags.get("num_submaps:", ())]
    if len(count) != 1 or len(count[0]) != 1 or not count[0][0].isdecimal():
        raise file.error("expected one line 'num_submaps: n'")
    n_submaps = parse_table(file, file.tags["num_submaps:"], ids=1, widths=[0], first=1).ids[0, 0]
    paths: list[Path] = []
    for index in range(n_submaps):
        paths.append(source.beside(f"{index:06d}") / "data.txt")
        if not paths[-1].is_file():
            advice = "name the folder of the dump, which holds a folder for every submap"
            raise file.error(f"looks like a dump of GLIM without {paths[-1].parent.name}/data.txt; {advice}")
    poses = dict(enumerate(map(_pose, paths)))

    # ties: from each submap to the next, and between matched submaps
    lines = file.tags.get("matching_cost", ())
    matched = parse_table(file, lines, ids=2, widths=[0], first=2).ids.tolist()
    ties = dict.fromkeys([*pairwise(sorted(poses)), *((min(pair), max(pair)) for pair in matched)])

    # factors that measure the poses
    blank = source.blank()
    blank.notes.append(f"{len(matched)} registrations between submaps measure what the map says, with assumed sigmas")
    model = gtsam.noiseModel.Diagonal.Sigmas(SIGMAS)
    entries = [
        Entry(0, (i, j), between_factor(i, j, poses[i].between(poses[j]), model))
        for i, j in ties
        if i != j and {i, j} <= poses.keys()
    ]
    return assemble(blank, format=NAME, poses=poses, entries=entries)


def _pose(path: Path) -> gtsam.Pose3:
    file = read_lines(path)
    starts = [place for place, line in enumerate(file.lines) if line.fields[0] == "T_world_origin:"]
    rows = file.lines[starts[0] + 1 : starts[0] + 4] if starts else ()
    if len(rows) < 3:
        raise file.error("expected 'T_world_origin:' and the rows of a 4x4 matrix")
    table = parse_table(file, rows, ids=0, widths=[4], first=0)
    joined = type(table)(lines=table.lines[:1], ids=table.ids[:1], numbers=table.numbers.reshape(1, 12))
    return matrix_poses(file, joined)[0]


def _graph(source: Source) -> Path:
    return source.beside(GRAPH) if source.is_folder else source.path


def _recognises(source: Source) -> bool:
    if source.is_folder:
        return source.beside(GRAPH).is_file() and Source(path=source.beside(GRAPH)).head.startswith(b"num_submaps:")
    return source.head.startswith(b"num_submaps:")


FORMAT = Format(NAME, _recognises, parse)
