"""Closure upon closure: does a gate that runs for days need more than its map does?

The drive of `scenarios.pipeline` with closures from every keyframe to the five laps before, through three takers at
once, each in a process of its own: iSAM2 alone, `GatedISAM2`, and `pgti-gtsam gate --stream`. Each closure is offered
alone. At forty points of the way: processor time of a closure with its share of the odometry, resident memory, open
files, threads.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import gtsam
import matplotlib

import pgti_gtsam as pgti
from pgti_gtsam import outputs
from pgti_gtsam.datasets.chain import between_factors
from pgti_gtsam.factor_graphs import graph_of
from scenarios.pipeline import LAP, RADIUS_M, drive
from scenarios.stream import COMMAND, g2o_line

matplotlib.use("Agg")
from matplotlib import pyplot as plt

POINTS, LAPS = 40, 5
TAKERS = ("iSAM2 alone", "GatedISAM2", "gate --stream")
Row = dict[str, Any]
Step = tuple[gtsam.NonlinearFactorGraph, gtsam.Values, list[Any]]


def run(n_closures: int, seed: int, path: Path, tell: Callable[[str], None]) -> list[Row]:
    """A row for each taker and point, written as they come.

    Parameters
    ----------
    n_closures : int
    seed : int
        Of the drive.
    path : Path
        Of the JSON.
    tell : callable
        Told each row in words.
    """
    rows: list[Row] = []
    open_ = [_started(taker, n_closures, seed) for taker in (_alone, _gated, _streamed)]
    while open_:
        for pipe in wait(open_):
            row = _received(pipe)
            if row is None:
                open_.remove(pipe)
                continue
            rows.append(row)
            rows.sort(key=lambda each: TAKERS.index(each["taker"]))
            outputs.write_text(path, json.dumps(rows, indent=1) + "\n")
            tell(line(row))
    return rows


def _started(taker: Callable[[int, int, Connection], None], n_closures: int, seed: int) -> Connection:
    """The end of a pipe from a taker in a process of its own."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    multiprocessing.get_context("spawn").Process(target=taker, args=(n_closures, seed, theirs)).start()
    theirs.close()
    return ours


def line(row: Row) -> str:
    """A row in words."""
    return (
        f"{row['taker']:12s} {row['n_closures']:6d} closures, {row['accepted']} accepted: "
        f"{row['closure_s'] * 1e3:.2f} ms a closure, {row['n_keyframes']} keyframes, {row['megabytes']:.1f} MB, "
        f"{row['files']} files, {row['threads']} threads"
    )


def draw(rows: list[Row], path: Path) -> None:
    """Time, memory and open files by the number of closures.

    Parameters
    ----------
    rows : list of Row
    path : Path
    """
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    for taker in dict.fromkeys(row["taker"] for row in rows):
        own = [row for row in rows if row["taker"] == taker]
        closures = [row["n_closures"] for row in own]
        for axis, name, scale in zip(axes, ("closure_s", "megabytes", "files"), (1e3, 1.0, 1.0), strict=True):
            axis.plot(closures, [scale * row[name] for row in own], label=taker)
    for axis, label in zip(axes, ("processor time of a closure, ms", "resident memory, MB", "open files"), strict=True):
        axis.set(xlabel="closures", ylabel=label, ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].legend()
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def _received(ours: Connection) -> Row | None:
    try:
        return ours.recv()
    except EOFError:
        return None


def _alone(n_closures: int, seed: int, pipe: Connection) -> None:
    smoother = gtsam.ISAM2()

    def take(step: Step) -> int:
        factors, values, closures = step
        smoother.update(factors, values)
        for closure in closures:
            smoother.update(graph_of([closure]), gtsam.Values())
        return len(closures)

    _drive(TAKERS[0], n_closures, seed, take, os.getpid(), pipe)


def _gated(n_closures: int, seed: int, pipe: Connection) -> None:
    smoother = pgti.GatedISAM2(radii=RADIUS_M)

    def take(step: Step) -> int:
        factors, values, closures = step
        smoother.update(factors, values)
        return sum(len(smoother.update(closures=[closure]).accepted) for closure in closures)

    _drive(TAKERS[1], n_closures, seed, take, os.getpid(), pipe)


def _streamed(n_closures: int, seed: int, pipe: Connection) -> None:
    with subprocess.Popen([*COMMAND, str(RADIUS_M)], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as stream:

        def take(step: Step) -> int:
            factors, _, closures = step
            lines = [g2o_line(between) for graph in (factors, graph_of(closures)) for between in between_factors(graph)]
            stream.stdin.write(b"".join(lines))
            stream.stdin.flush()
            return sum(json.loads(stream.stdout.readline())["accepted"] for _ in closures)

        _drive(TAKERS[2], n_closures, seed, take, stream.pid, pipe)
        stream.stdin.close()


def _drive(taker: str, n_closures: int, seed: int, take: Callable[[Step], int], process: int, pipe: Connection) -> None:
    """Drive, and report on the process of the taker."""
    offered, accepted, reported, busy = 0, 0, 0, _busy_s(process)
    steps: Iterator[Step] = drive(LAPS * LAP + n_closures, seed, every=1, laps=LAPS)
    for n_keyframes, step in enumerate(steps, start=1):
        accepted += take(step)
        offered += len(step[2])

        # report now and then
        if offered - reported >= max(n_closures // POINTS, 1) or offered >= n_closures:
            now = _busy_s(process)
            pipe.send(
                {
                    "taker": taker,
                    "n_keyframes": n_keyframes,
                    "n_closures": offered,
                    "accepted": accepted,
                    "closure_s": (now - busy) / (offered - reported),
                    "megabytes": int(_told(process, "statm").split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20,
                    "files": len(os.listdir(f"/proc/{process}/fd")),
                    "threads": len(os.listdir(f"/proc/{process}/task")),
                }
            )
            busy, reported = now, offered
        if offered >= n_closures:
            break


def _busy_s(process: int) -> float:
    """Processor time of a process."""
    fields = _told(process, "stat").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _told(process: int, name: str) -> str:
    return Path(f"/proc/{process}/{name}").read_text(encoding="ascii")
