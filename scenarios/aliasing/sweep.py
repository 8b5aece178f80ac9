"""Trials at scale: each is one row of a file of JSON lines, appended as soon as it is known.

A trial whose row is there is not run again: a killed run goes on where it stopped, and a killed worker's trials are
given to another.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from dask.distributed import Client, LocalCluster, as_completed

from scenarios.aliasing import trials
from scenarios.aliasing.trials import Trial


def run(
    path: Path, wanted: Sequence[Trial], scheduler: str | None, limit_s: float, tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Run what the file does not hold yet; all rows, in the order of the trials."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = {_key(row): row for row in _rows(path)}
    missing = [trial for trial in wanted if trial.key() not in done]
    tell(f"{len(wanted)} trials, {len(wanted) - len(missing)} of them known")
    if missing:
        cluster = None if scheduler else LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0")
        with Client(scheduler or cluster) as client, path.open("a", encoding="utf-8") as file:
            # nobody keeps a future that is done, else a killed worker's would be computed again
            futures = client.map(trials.row, missing, limit_s=limit_s, pure=False)
            finished = as_completed(futures, with_results=True)
            del futures
            for count, (_, row) in enumerate(finished, start=1):
                file.write(json.dumps(row, ensure_ascii=False) + "\n")
                file.flush()
                done[_key(row)] = row
                if count % 50 == 0 or count == len(missing):
                    tell(f"{count} of {len(missing)}")
        if cluster is not None:
            cluster.close()
    return [done[trial.key()] for trial in wanted]


def _key(row: dict[str, Any]) -> Trial:
    return Trial(row["world"], row["seed"], row["setting"], row["share"], row["method"])


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    """Whole rows of the file; a last line that was cut off when the run was killed is cut from it."""
    if not path.is_file():
        return
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    yield from map(json.loads, whole.splitlines())
