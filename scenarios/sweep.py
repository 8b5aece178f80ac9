"""Trials at scale, by the runner that audits many maps: a killed run goes on from its last row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pgti_gtsam import fleet


def run(
    path: Path,
    wanted: Sequence[NamedTuple],
    row: Callable[..., dict[str, Any]],
    scheduler: str | None,
    tell: Callable[[str], None],
    **options: Any,
) -> list[dict[str, Any]]:
    """Run the trials that the file lacks; all rows, in the order of the trials.

    Parameters
    ----------
    path : Path
    wanted : sequence of named tuples
        Trials, whose fields the rows repeat; a trial with a method `key` is named in its row by `key()`.
    row : callable
        From a trial and the options to its row.
    scheduler : str or None
        Address of a Dask scheduler; a local cluster of two workers without.
    tell : callable
    """
    fields = wanted[0]._fields if wanted else ()
    keys = [repr(tuple(trial.key() if hasattr(trial, "key") else trial)) for trial in wanted]

    def progress(done: int, of: int) -> None:
        if done % 50 == 0 or done == of:
            tell(f"{done} of {of} trials")

    return fleet.run(
        path,
        dict(zip(keys, wanted, strict=True)),
        row,
        key_of=lambda found: repr(tuple(found.get(field) for field in fields)),
        scheduler=scheduler,
        progress=progress,
        **options,
    )
