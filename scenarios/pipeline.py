"""A running pipeline: the cost of the gate in front of iSAM2, update by update, beside iSAM2 alone.

A robot drives laps with drifting odometry and offers a closure to the lap before every ten keyframes. Two smoothers get
the same factors in turn, in the same process: iSAM2 alone, which takes every closure, and the gated smoother. Times are
processor times of single updates. Memory is what each needs in a process of its own, after the free pages of the heap
went back to the system.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import gtsam
import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt

import pgti_gtsam as pgti
from pgti_gtsam import outputs
from pgti_gtsam.factor_graphs import graph_of, joined
from scenarios.problem import between

LAP = 200
EVERY = 10
RADIUS_M = 2.0
SIZES = (250, 500, 1000, 2000, 5000, 10_000)
WINDOW = 200  # keyframes before each size whose updates count
REVIEWS = 20  # closures, evenly over the drive, whose revisits are judged again at each size

Row = dict[str, Any]


class Watched(gtsam.ISAM2):
    """iSAM2 whose update can be timed from outside; untimed updates cost what they do without."""

    @contextmanager
    def timed(self) -> Iterator[list[float]]:
        """Processor times, s, of the updates meanwhile."""
        update, took = self.update, []

        def timed(*arguments: Any, **options: Any) -> gtsam.ISAM2Result:
            started = time.process_time()
            result = update(*arguments, **options)
            took.append(time.process_time() - started)
            return result

        self.update = timed
        try:
            yield took
        finally:
            del self.update


def run(largest: int, seed: int, tell: Callable[[str], None]) -> list[Row]:
    """Drive up to a number of keyframes; a row for each of `SIZES` on the way.

    Parameters
    ----------
    largest : int
        Keyframes that are driven.
    seed : int
    tell : callable
        Called with a line of progress.
    """
    # both smoothers
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    bare, watched = gtsam.ISAM2(parameters), Watched(parameters)
    gated = pgti.GatedISAM2(watched, radii=RADIUS_M)
    rows: list[Row] = []
    names = ("bare", "gated", "bare closing", "gated closing", "decision")
    times: dict[str, list[float]] = {name: [] for name in names}
    accepted: list[bool] = []
    needed = {name: _needed(name == "gated", largest, seed) for name in ("bare", "gated")}
    gc.disable()
    for k, (factors, values, closures) in enumerate(drive(largest, seed)):
        # both smoothers, each first in turn: the second finds much of what it needs in the processor's cache
        together = joined(factors, graph_of(closures))
        update, kind = None, " closing" if closures else ""

        def alone() -> None:
            bare.update(together, values)  # noqa: B023

        def behind_the_gate() -> None:
            nonlocal update
            update = gated.update(factors, values, closures)  # noqa: B023

        turns = [("bare", alone), ("gated", behind_the_gate)]
        with watched.timed() if closures else nullcontext() as took:
            for name, task in turns if k // 2 % 2 else reversed(turns):
                times[name + kind].append(_seconds(task))
        if closures:
            times["decision"].append(times["gated closing"][-1] - sum(took))
        accepted += [decision.accepted for decision in update.decisions]

        # a row
        if k + 1 in SIZES:
            row = _row(k + 1, times, accepted) | {f"{name}_mb": needed[name][len(rows)] for name in needed}
            rows.append(row | _reviewed(gated, len(accepted)))
            tell(line(rows[-1]))
    gc.enable()
    return rows


def _needed(is_gated: bool, largest: int, seed: int) -> list[float]:
    """Megabytes of a smoother in a process of its own, at each of `SIZES`."""
    with multiprocessing.get_context("spawn").Pool(1) as alone:
        return alone.apply(_driven, (is_gated, largest, seed))


def _driven(is_gated: bool, largest: int, seed: int) -> list[float]:
    # drive, with either smoother
    parameters, found = gtsam.ISAM2Params(), []
    parameters.setFactorization("QR")
    smoother = pgti.GatedISAM2(parameters, radii=RADIUS_M) if is_gated else gtsam.ISAM2(parameters)
    for k, (factors, values, closures) in enumerate(drive(largest, seed)):
        if is_gated:
            smoother.update(factors, values, closures)
        else:
            smoother.update(joined(factors, graph_of(closures)), values)

        # resident memory without free pages
        if k + 1 in SIZES:
            gc.collect()
            ctypes.CDLL(None).malloc_trim(0)
            found.append(_megabytes())
    return found


def _row(n_keyframes: int, times: dict[str, list[float]], accepted: list[bool]) -> Row:
    plain = [np.array(times[name][-WINDOW:]) for name in ("bare", "gated")]
    closing = [np.array(times[name][-WINDOW // EVERY :]) for name in ("bare closing", "gated closing")]
    return {
        "n_keyframes": n_keyframes,
        "bare_s": float(np.median(plain[0])),
        "gated_s": float(np.median(plain[1])),
        "ratio": float(np.median(plain[1]) / np.median(plain[0])),
        "ratio_so_far": float(np.median(times["gated"]) / np.median(times["bare"])),
        "bare_closing_s": float(np.median(closing[0])) if len(closing[0]) else None,
        "gated_closing_s": float(np.median(closing[1])) if len(closing[1]) else None,
        "gated_closing_p99_s": float(np.quantile(closing[1], 0.99)) if len(closing[1]) else None,
        "decision_s": float(np.median(times["decision"][-WINDOW // EVERY :])) if times["decision"] else None,
        "offered": len(accepted),
        "accepted": int(sum(accepted)),
    }


def _reviewed(gated: pgti.GatedISAM2, n_offered: int) -> Row:
    """How long it takes to judge revisits again, each by itself, and how many admitted closures that condemns."""
    times, leaving = [], set[int]()
    for number in np.unique(np.linspace(0, n_offered - 1, REVIEWS).round().astype(int)).tolist():
        started = time.process_time()
        leaving.update(gated.review([number]).leaving)
        times.append(time.process_time() - started)
    return {
        "reviews": len(times),
        "review_s": float(np.median(times)),
        "review_slowest_s": max(times),
        "leaving": len(leaving),
    }


def draw(rows: list[Row], path: Path) -> None:
    """Milliseconds of an update by the size of the map.

    Parameters
    ----------
    rows : list of Row
    path : Path
    """
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    sizes = [row["n_keyframes"] for row in rows]
    for name, label, style in (
        ("bare_s", "iSAM2 alone", "C0--"),
        ("gated_s", "gated", "C0-"),
        ("bare_closing_s", "iSAM2 alone, with a closure", "C1--"),
        ("gated_closing_s", "gated, with a closure", "C1-"),
        ("decision_s", "of which the decision", "C2-"),
    ):
        axes.loglog(sizes, [1e3 * row[name] for row in rows], style, marker="o", label=label)
    axes.set(xlabel="keyframes", ylabel="processor time of an update, ms (median)")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def line(row: Row) -> str:
    """A row in words."""
    closing = (
        ""
        if row["gated_closing_s"] is None
        else (
            f", with a closure {row['bare_closing_s'] * 1e3:.2f} and {row['gated_closing_s'] * 1e3:.1f} ms "
            f"(p99 {row['gated_closing_p99_s'] * 1e3:.0f} ms), of which the decision {row['decision_s'] * 1e3:.1f} ms"
        )
    )
    return (
        f"{row['n_keyframes']:6d} keyframes: {row['bare_s'] * 1e3:.3f} ms bare, {row['gated_s'] * 1e3:.3f} ms gated, "
        f"ratio {row['ratio']:.2f} (of all so far {row['ratio_so_far']:.2f}){closing}; {row['accepted']} of "
        f"{row['offered']} closures; a review of a revisit {row['review_s'] * 1e3:.0f} ms (slowest "
        f"{row['review_slowest_s'] * 1e3:.0f} ms), {row['leaving']} leaving; {row['bare_mb']:.0f} MB bare, "
        f"{row['gated_mb']:.0f} MB gated"
    )


def drive(
    n_keyframes: int, seed: int, every: int = EVERY, laps: int = 1
) -> Iterator[tuple[gtsam.NonlinearFactorGraph, gtsam.Values, list[Any]]]:
    """The input of each keyframe: odometry and first value, and regularly closures to the laps before.

    Parameters
    ----------
    n_keyframes : int
    seed : int
    every : int
        Keyframes from closures to closures.
    laps : int
        Closures of a keyframe, one to each of so many laps before.
    """
    # noise, motion and poses
    random = np.random.default_rng(seed)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.05, 0.01]))
    step, turn = gtsam.Pose2(1.0, 0.0, 0.0), gtsam.Pose2(1.0, 0.0, np.pi / 2)
    truth, guess = gtsam.Pose2(), gtsam.Pose2()
    poses = [truth]
    for k in range(n_keyframes):
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()

        # odometry
        if k == 0:
            factors.push_back(gtsam.PriorFactorPose2(0, truth, noise))
        else:
            motion = turn if k % (LAP // 4) == 0 else step
            measured = motion.compose(gtsam.Pose2(*random.normal(0, [0.02, 0.02, 0.002])))
            truth, guess = truth.compose(motion), guess.compose(measured)
            poses.append(truth)
            factors.push_back(between(k - 1, k, measured, noise))
        values.insert(k, guess)

        # closures
        closures = []
        for earlier in range(k - LAP, max(k - laps * LAP, 0) - 1, -LAP) if k % every == 0 else ():
            seen = poses[earlier].between(truth).compose(gtsam.Pose2(*random.normal(0, [0.05, 0.05, 0.01])))
            closures.append(between(earlier, k, seen, noise))
        yield factors, values, closures


def _seconds(task: Callable[[], object]) -> float:
    started = time.process_time()
    task()
    return time.process_time() - started


def _megabytes() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20
