"""Scan graphs of FLIRTLib: optimised vertices, edges, and the laser scan of every vertex.

``VERTEX2 id x y θ``, each followed by a ``ROBOTLASER1`` scan, then ``EDGE2`` lines in TORO's order of
information under the comments ``#SEQUENTIAL EDGES`` and, behind these, ``#LOOP EDGES``. The radius of a vertex is the
smallest range of its scan. The scanner of the two published logs sees 180° only: nothing is known of the space behind.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgti_gtsam.datasets.assembly import assemble
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.formats.toro import edges, vertices
from pgti_gtsam.datasets.scans import Scan, read_scan, smallest_range
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import TextFile, note_ignored

NAME = "FLIRTLib scan graph"
LOOPS = "#LOOP EDGES"
TAGS = {"VERTEX2", "EDGE2", "ROBOTLASER1"}


def parse(source: Source) -> Dataset:
    """The graph of a scan-graph file, with radii.

    Raises
    ------
    FileFormatError
        A malformed line, a scan before the first vertex, two scans of one vertex.
    """
    file = source.file
    file.notes.append("poses are the stored, optimised ones; radii are the smallest valid ranges of the scans")
    poses, entries, scans = vertices(file), edges(file), _scans(file)
    found = {vertex: smallest_range(scan) for vertex, scan in scans.items()}
    radii = {vertex: radius for vertex, radius in found.items() if radius is not None}
    if missing := len(poses) - len(radii):
        file.notes.append(f"{missing} poses have no scan with a valid range and so no radius")
    note_ignored(file, TAGS)

    # edges behind the comment are loops
    first = next((line.number for line in file.comments if line.text == LOOPS), None)
    dataset = assemble(
        file,
        format=NAME,
        poses=poses,
        entries=[entry for entry in entries if first is None or entry.line < first],
        loops=None if first is None else [entry for entry in entries if entry.line > first],
        radii=radii,
        known=TAGS,
    )
    return replace(dataset, scans={vertex: scan.points() for vertex, scan in scans.items()})


def _scans(file: TextFile) -> dict[int, Scan]:
    """The scan that follows each vertex, by vertex."""
    table = file.table("VERTEX2", ids=1, widths=[3])
    scans: dict[int, Scan] = {}
    for line in file.tags["ROBOTLASER1"]:
        row = int(np.searchsorted(table.lines, line.number)) - 1
        if row < 0:
            raise file.error("expected a VERTEX2 line before the first ROBOTLASER1", line.number)
        vertex = int(table.ids[row, 0])
        if vertex in scans:
            raise file.error(f"expected one scan per vertex, got a second one for vertex {vertex}", line.number)
        scans[vertex] = read_scan(file, line)
    return scans


FORMAT = Format(NAME, lambda source: source.tags >= {"VERTEX2", "ROBOTLASER1"}, parse)
