"""A running pipeline that asks the gate through a pipe: how long a closure waits for its verdict.

The drive of `scenarios.pipeline`, as g2o lines to a process of `pgti-gtsam gate --stream`. Times run from the write of
a line to the answer: wall time, the wait of a pipeline, which grows with the load of the machine; and processor time of
the process, which Linux tells in nanoseconds. The client waits for each answer, and after odometry
until the process is idle, like a pipeline with slower keyframes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pgti_gtsam.datasets.chain import between_factors
from pgti_gtsam.factor_graphs import graph_of
from scenarios.pipeline import RADIUS_M, SIZES, drive

WINDOW = 1000
"""Keyframes before each size whose closures count: 100 of them, with one every ten keyframes."""

COMMAND = [sys.executable, "-c", "from pgti_gtsam.cli import main; main()", "gate", "--stream", "--radius"]
PROBE = b"RADIUS 0 0\n"
"""A line that is refused at once: its answer tells that all lines before it were taken in."""

Row = dict[str, Any]
Times = tuple[float, float]


def run(largest: int, seed: int, state: Path | None, tell: Callable[[str], None]) -> list[Row]:
    """Drive up to a number of keyframes; a row for each of the sizes on the way.

    Parameters
    ----------
    largest : int
    seed : int
    state : Path, optional
        A file that keeps the stream's map.
    tell : callable
        Told each row in words.
    """
    # the stream as a process
    words = [*COMMAND, str(RADIUS_M), *([] if state is None else ["--state", str(state)])]
    rows: list[Row] = []
    steps, closings, accepted = list[Times](), list[tuple[int, Times]](), 0
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as stream:

        def asked(text: bytes) -> tuple[Row, Times]:
            busy, started = _busy_s(stream.pid), time.perf_counter()
            stream.stdin.write(text)
            stream.stdin.flush()
            answer = json.loads(stream.stdout.readline())
            return answer, (time.perf_counter() - started, _busy_s(stream.pid) - busy)

        # every keyframe, answer by answer
        for k, (factors, _, closures) in enumerate(drive(largest, seed)):
            for between in between_factors(factors):
                steps.append(asked(g2o_line(between) + PROBE)[1])
            for closure in closures:
                answer, times = asked(g2o_line(between_factors(graph_of([closure]))[0]))
                closings.append((k, times))
                accepted += answer["accepted"]
            if k + 1 in SIZES and closings:
                own = [times for at, times in closings if at >= k - WINDOW]
                rows.append(_row(k + 1, steps[-WINDOW:], own) | {"offered": len(closings), "accepted": accepted})
                tell(line(rows[-1]))
        stream.stdin.close()
    return rows


def _row(n_keyframes: int, steps: Sequence[Times], closings: Sequence[Times]) -> Row:
    row: Row = {"n_keyframes": n_keyframes, "measured": len(closings)}
    for name, times in (("step", steps), ("closing", closings)):
        for kind, own in zip(("wall", "processor"), np.array(times).T, strict=True):
            row[f"{name}_{kind}_s"] = float(np.median(own))
            row[f"{name}_{kind}_p99_s"] = float(np.quantile(own, 0.99))
            row[f"{name}_{kind}_slowest_s"] = float(own.max())
    return row


def line(row: Row) -> str:
    """A row in words."""

    def words(name: str) -> str:
        wall, busy = (
            f"{row[f'{name}_{kind}_s'] * 1e3:.1f} ms (p99 {row[f'{name}_{kind}_p99_s'] * 1e3:.0f}, "
            f"slowest {row[f'{name}_{kind}_slowest_s'] * 1e3:.0f})"
            for kind in ("wall", "processor")
        )
        return f"{wall}, on the processor {busy}"

    return (
        f"{row['n_keyframes']:6d} keyframes: a verdict takes {words('closing')}, the last {row['measured']}; "
        f"a step {words('step')}; {row['accepted']} of {row['offered']} closures"
    )


def _busy_s(process: int) -> float:
    """Seconds that the first thread of a process was on a processor."""
    return int(Path(f"/proc/{process}/schedstat").read_text(encoding="ascii").split()[0]) * 1e-9


def g2o_line(between: Any) -> bytes:
    """A planar between factor as g2o text."""
    measured, information = between.factor.measured(), between.factor.noiseModel().information()
    upper = [float(information[i, j]) for i in range(3) for j in range(i, 3)]
    numbers = " ".join(map(repr, [measured.x(), measured.y(), measured.theta(), *upper]))
    return f"EDGE_SE2 {between.first} {between.second} {numbers}\n".encode()
