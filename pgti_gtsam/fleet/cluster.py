"""A Dask cluster: one that runs, or processes of this machine for as long as they are needed."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from pgti_gtsam.errors import InvalidOptionError, MissingDependencyError

AHEAD = 2
"""Tasks for each worker that are made before they are asked for."""

Each = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]


@contextmanager
def connected(scheduler: str | None, workers: int) -> Iterator[Any]:
    """A Dask client.

    Parameters
    ----------
    scheduler : str or None
        Address of a Dask scheduler; without, a cluster of processes on this machine.
    workers : int
        Of that cluster.

    Raises
    ------
    MissingDependencyError
        Dask is not installed.
    InvalidOptionError
        Nobody answers at the scheduler's address.
    """
    try:
        import dask
        from dask.distributed import Client, LocalCluster
    except ImportError as error:
        raise MissingDependencyError(
            f"dask.distributed cannot be loaded ({error}): install it with  pip install 'pgti-gtsam[fleet]'"
        ) from error
    cluster = None
    if scheduler is None:
        dask.config.set({"logging.distributed": "critical"})  # a worker that is told to end complains of it
        cluster = LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.CRITICAL
        )
    try:
        client = Client(scheduler or cluster, timeout=10)
    except OSError as error:
        raise InvalidOptionError(f"expected a Dask scheduler at {scheduler}, got no answer: {error}") from error
    with client:
        yield client
    if cluster is not None:
        cluster.close()


@contextmanager
def spread(scheduler: str | None = None, workers: int = 2) -> Iterator[Each]:
    """A function like `map` that works on a cluster: results in the order of the tasks, which are made as workers free.

    Parameters
    ----------
    scheduler, workers
        As in `connected`.

    Raises
    ------
    MissingDependencyError, InvalidOptionError
        Those of `connected`.
    """
    with connected(scheduler, workers) as client:

        def each(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Any]:
            waiting: deque[Any] = deque()
            for task in tasks:
                waiting.append(client.submit(function, task, pure=False))
                if len(waiting) > AHEAD * max(len(client.nthreads()), 1):
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

        yield each
