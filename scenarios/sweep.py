"""Trials at scale: each is one row of a file of JSON lines, appended as soon as it is known.

A trial whose row is there is not run again: a killed run goes on where it stopped, and a killed worker's trials are
given to another.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from dask.distributed import Client, LocalCluster, as_completed


def run(
    path: Path,
    wanted: Sequence[NamedTuple],
    row: Callable[..., dict[str, Any]],
    scheduler: str | None,
    tell: Callable[[str], None],
    **options: Any,
) -> list[dict[str, Any]]:
    """Run what the file does not hold yet; all rows, in the order of the trials.

    Parameters
    ----------
    path : Path
    wanted : sequence of named tuples
        Trials, whose fields their rows repeat; a trial with a method `key` is named in its row as that says.
    row : callable
        From a trial and the options to its row.
    scheduler : str or None
        Address of a Dask scheduler; a local cluster of two workers without.
    tell : callable
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    fields = wanted[0]._fields if wanted else ()
    keys = [tuple(trial.key() if hasattr(trial, "key") else trial) for trial in wanted]
    done = {_key(found, fields): found for found in rows(path)}
    missing = [trial for trial, key in zip(wanted, keys, strict=True) if key not in done]
    tell(f"{len(wanted)} trials, {len(wanted) - len(missing)} of them known")
    if missing:
        cluster = None if scheduler else LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0")
        with Client(scheduler or cluster) as client, path.open("a", encoding="utf-8") as file:
            # nobody keeps a future that is done, else a killed worker's would be computed again
            futures = client.map(row, missing, pure=False, **options)
            finished = as_completed(futures, with_results=True)
            del futures
            for count, (_, found) in enumerate(finished, start=1):
                file.write(json.dumps(found, ensure_ascii=False) + "\n")
                file.flush()
                done[_key(found, fields)] = found
                if count % 50 == 0 or count == len(missing):
                    tell(f"{count} of {len(missing)}")
        if cluster is not None:
            cluster.close()
    return [done[key] for key in keys]


def rows(path: Path) -> Iterator[dict[str, Any]]:
    """Whole rows of the file; a last line that was cut off when the run was killed is cut from it."""
    if not path.is_file():
        return
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole != len(data):
        os.truncate(path, whole)
    yield from map(json.loads, data[:whole].splitlines())


def _key(row: dict[str, Any], fields: Sequence[str]) -> tuple[Any, ...]:
    return tuple(row[field] for field in fields)
