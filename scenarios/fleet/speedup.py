"""How much faster two workers audit than a single worker: pairs of runs, a single thread of linear algebra each."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from pgti_gtsam import fleet
from scenarios.fleet.drives import RADIUS
from scenarios.fleet.night import LIMIT_MB, LIMIT_S, cluster, written

TRAINING = 1000
"""First seed of the drives: nothing is decided on them."""


def run(folder: Path, n_maps: int, n_pairs: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Audit the same maps by one worker and by two, in turn, on schedulers and workers by Dask's commands.

    Parameters
    ----------
    folder : Path
    n_maps, n_pairs : int
    tell : callable

    Returns
    -------
    dict
        The median speed-up, and every pair: seconds of both, load of the machine before.
    """
    maps = sorted(written(folder / "maps", range(TRAINING, TRAINING + n_maps), tell).glob("drive_*.g2o"))
    pairs = []
    for k in range(n_pairs):
        load = os.getloadavg()[0]
        counts = (1, 2) if k % 2 else (2, 1)
        seconds = {count: _audited(folder / f"out_{k}_{count}", maps, count) for count in counts}
        pairs.append({"one": round(seconds[1], 2), "two": round(seconds[2], 2), "load": round(load, 2)})
        tell(f"one worker {seconds[1]:.1f} s, two {seconds[2]:.1f} s, load {load:.1f} before")
    return {"maps": n_maps, "speed_up": round(median(pair["one"] / pair["two"] for pair in pairs), 3), "pairs": pairs}


def _audited(out: Path, maps: list[Path], n_workers: int) -> float:
    """Seconds from the first audit to the last row."""
    out.mkdir(parents=True)
    jobs = [
        fleet.AuditJob(
            map=str(path), words=("--radius", str(RADIUS)), folder=str(out), limit_s=LIMIT_S, limit_mb=LIMIT_MB
        )
        for path in maps
    ]
    with cluster(out, n_workers) as (address, _, _):
        started = time.monotonic()
        rows = fleet.run(out / "maps.jsonl", {job.key: job for job in jobs}, fleet.audited, scheduler=address)
        seconds = time.monotonic() - started
    failed = [row for row in rows if "failed" in row]
    if failed:
        raise ValueError(f"expected a verdict on every map, got {failed[0]['failed']} of {failed[0]['map']}")
    return seconds
