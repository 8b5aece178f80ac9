"""The cost of everything: heat kernels by solver and size, the audit part by part, a decision of the gate.

Every row has a fresh process with one BLAS thread. Compared solvers run in the same process, one after the other,
so that ratios hold when the machine's speed drifts. Times are processor times, but for the dense solver on all cores,
which is timed by the clock.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pgti_gtsam import outputs
from pgti_gtsam.errors import InvalidOptionError
from scenarios.speed import solvers
from scenarios.speed.figure import draw

Row = dict[str, Any]

GROWN = 3000
"""Vertices from which growth is fitted: below, fixed costs count."""


def run(data: Path | None, largest: int, dense_up_to: int, tell: Callable[[str], None]) -> Row:
    """Measure every graph with every solver that can afford the graph, then the parts; ready for JSON.

    Parameters
    ----------
    data : Path, optional
        Folder of all data.
    largest : int
        Vertices of the largest synthetic graph.
    dense_up_to : int
        Vertices up to which the dense solver runs.
    tell : callable
        Called with a line of progress.
    """
    if data is not None and not data.is_dir():
        raise InvalidOptionError(f"expected a folder with the real graphs, got {data}")

    # solvers
    rows = []
    for case in solvers.cases(data, largest):
        for row in in_fresh_process("solvers", case, dense_up_to, data):
            rows.append(row)
            tell(
                f"{case:16s} {row['solver']:9s} {row['n_vertices']:8d} vertices {row['seconds']:9.3f} s "
                f"{row['peak_megabytes']:7.0f} MB  ζ error {row['zeta_error']}"
            )
    found = {"machine": f"{platform.machine()}, {os.cpu_count()} cores", "solvers": rows, "growth": growth(rows)}
    found["cores"] = on_cores()

    # the parts
    for part, cases in PARTS.items():
        found[part] = [row for case in cases(data) for row in in_fresh_process(part, case, dense_up_to, data)]
        for row in found[part]:
            tell(
                "  ".join(
                    f"{name} {value:.3g}" if isinstance(value, float) else str(value) for name, value in row.items()
                )
            )
    return found


def _audits(data: Path | None) -> Iterator[str]:
    yield from ["kitti_00_stereo", "landmarks-10000", "landmarks-100000"]
    yield from ["city10000"] if data is not None else ()


def _updates(data: Path | None) -> Iterator[str]:
    yield from ["chain-10000-1", "chain-10000-10", "chain-100000-1"]


def _decisions(data: Path | None) -> Iterator[str]:
    yield "w10000"
    yield from ["kitti_00", "intel", "city10000"] if data is not None else ()


PARTS: dict[str, Callable[[Path | None], Iterator[str]]] = {
    "audits": _audits,
    "updates": _updates,
    "decisions": _decisions,
}


def write(found: Row, path: Path) -> None:
    """Write the results as JSON, and the figure beside.

    Parameters
    ----------
    found : Row
    path : Path
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    outputs.write_text(path, json.dumps(found, indent=1) + "\n")
    draw(found, path.with_suffix(".png"))


def growth(rows: list[Row]) -> dict[str, float]:
    """Exponent of each family's time with the poles, from `GROWN` vertices on: slope in log-log."""
    found = {}
    for family in ("chain", "laps"):
        points = [
            (row["n_vertices"], row["seconds"])
            for row in rows
            if row["case"].startswith(family) and row["solver"] == "poles" and row["n_vertices"] >= GROWN
        ]
        if len(points) > 1:
            sizes, seconds = np.log(np.array(points)).T
            found[family] = float(np.polyfit(sizes, seconds, 1)[0])
    return found


def on_cores() -> list[Row]:
    """The dense solver by the clock on a graph as large as the paper's, on one core and on all of the machine."""
    threads = sorted({1, os.cpu_count() or 1})
    return [
        {"threads": count} | row
        for count in threads
        for row in in_fresh_process("cores", "random-1000", 0, None, count)
    ]


def in_fresh_process(part: str, case: str, dense_up_to: int, data: Path | None, threads: int = 1) -> list[Row]:
    """Rows of a case, measured in a process of its own.

    Parameters
    ----------
    part, case : str
    dense_up_to : int
    data : Path, optional
        Folder of all data.
    threads : int
        Of BLAS.
    """
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
    command = [sys.executable, "-m", "scenarios.speed.child", part, case, str(dense_up_to), str(data or "")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    rows: list[Row] = json.loads(done.stdout)
    return rows
