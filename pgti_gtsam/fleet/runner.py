"""Jobs at scale: each is a row of a file of JSON lines, appended as soon as known."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pgti_gtsam import encode
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.fleet.cluster import connected

Row = dict[str, Any]

_LOG = logging.getLogger(__name__)


def run(
    path: Path,
    wanted: Mapping[str, Any],
    row: Callable[..., Row],
    *,
    key_of: Callable[[Row], str] = lambda found: str(found["key"]),
    scheduler: str | None = None,
    workers: int = 2,
    progress: Callable[[int, int], None] = lambda done, of: None,
    **options: Any,
) -> list[Row]:
    """Run the jobs that the file lacks; all rows, in the order of the jobs.

    A job with a row is not run again. A killed worker's jobs are given to another.

    Parameters
    ----------
    path : Path
        Of the JSON lines.
    wanted : mapping from key to job
    row : callable
        From a job, and the options, to its row; pickled.
    key_of : callable
        From a row to the key of its job.
    scheduler : str, optional
        Address of a Dask scheduler; a cluster of processes on this machine without.
    workers : int
        Of that cluster.
    progress : callable
        Told how many jobs are done, and of how many.

    Raises
    ------
    MissingDependencyError
        Dask is not installed.
    InvalidOptionError
        Nobody answers at the scheduler's address, or the file holds other lines.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    done = {key_of(found): found for found in rows(path)}
    missing = [key for key in wanted if key not in done]
    progress(len(wanted) - len(missing), len(wanted))
    if missing:
        with path.open("a", encoding="utf-8") as file:
            for count, (key, found) in enumerate(_computed(wanted, missing, row, scheduler, workers, options), start=1):
                done[key] = found
                _LOG.info("%s %s", key, f"failed: {found['failed']}" if "failed" in found else "done")
                file.write(encode.line(found))
                file.flush()
                progress(len(wanted) - len(missing) + count, len(wanted))
    return [done[key] for key in wanted]


def rows(path: Path) -> Iterator[Row]:
    """Whole rows of a file; a last line that was cut off when the run was killed is removed.

    Raises
    ------
    InvalidOptionError
        A line is no row.
    """
    if not path.is_file():
        return
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole != len(data):
        os.truncate(path, whole)
    for number, line in enumerate(data[:whole].splitlines(), start=1):
        try:
            found = json.loads(line)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise InvalidOptionError(
                f"expected rows of an earlier run, got another line at {path}:{number}; name another folder"
            )
        yield found


def _computed(
    wanted: Mapping[str, Any],
    missing: list[str],
    row: Callable[..., Row],
    scheduler: str | None,
    workers: int,
    options: Mapping[str, Any],
) -> Iterator[tuple[str, Row]]:
    """Rows in order of completion."""
    with connected(scheduler, workers) as client:
        from dask.distributed import as_completed

        # nobody keeps a future that is done, else a killed worker's would be computed again
        futures = client.map(row, [wanted[key] for key in missing], pure=False, **options)
        keys = {future.key: key for future, key in zip(futures, missing, strict=True)}
        finished = as_completed(futures, with_results=True)
        del futures
        for future, found in finished:
            yield keys[future.key], found
