"""The progress of a command on standard error: a bar on a terminal, lines elsewhere, every step with --verbose."""

from __future__ import annotations

import functools
import inspect
import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any, get_type_hints

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

EVERY_S = 5.0
"""Seconds between two lines of progress where standard error is no terminal: quick commands print none."""

_PACKAGE = logging.getLogger("pgti_gtsam")
_LOG = logging.getLogger(__name__)
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no warnings on standard error.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Every step with its time on standard error.")]
Tell = Callable[[str, int, int], None]


def with_verbosity(command: Callable[..., None]) -> Callable[..., None]:
    """A command with the options --quiet and --verbose, which set the level of the package's log."""

    @functools.wraps(command)
    def run(*, quiet: bool, verbose: bool, **options: Any) -> None:
        _log_to_standard_error(quiet=quiet, verbose=verbose)
        command(**options)

    hints = get_type_hints(command, include_extras=True) | {"quiet": Quiet, "verbose": Verbose}
    given = [each.replace(annotation=hints[name]) for name, each in inspect.signature(command).parameters.items()]
    own = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=hints[name])
        for name in ("quiet", "verbose")
    ]
    run.__signature__ = inspect.Signature([*given, *own])  # type: ignore[attr-defined]
    run.__annotations__ = hints
    del run.__wrapped__  # or its own annotations would be read
    return run


def _log_to_standard_error(*, quiet: bool, verbose: bool) -> None:
    """Warnings by default, errors alone if quiet, all records with their times if verbose."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        logging.Formatter("%(asctime)s.%(msecs)03d %(name)s: %(message)s", "%H:%M:%S")
        if verbose
        else logging.Formatter("pgti-gtsam: %(message)s")
    )
    _PACKAGE.handlers = [handler]
    _PACKAGE.propagate = False
    _PACKAGE.setLevel(logging.DEBUG if verbose else logging.ERROR if quiet else logging.WARNING)


@contextmanager
def stages() -> Iterator[Callable[[str], None]]:
    """Progress by the names of steps."""
    with counted() as tell:
        yield lambda step: tell(step, 0, 1)


@contextmanager
def counted() -> Iterator[Tell]:
    """Progress by a description, the number of things done, and the number of all."""
    if _LOG.isEnabledFor(logging.DEBUG):
        yield _log
        return
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines() if _LOG.isEnabledFor(logging.WARNING) else _nothing
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    hidden = not _LOG.isEnabledFor(logging.WARNING)
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        task = progress.add_task("starting", total=None)

        def tell(description: str, done: int, of: int) -> None:
            progress.update(
                task, description=_told(description, done, of), completed=done, total=of if of > 1 else None
            )

        yield tell


def _log(description: str, done: int, of: int) -> None:
    _LOG.debug("%s", _told(description, done, of))


def _nothing(description: str, done: int, of: int) -> None:
    del description, done, of


def _lines() -> Tell:
    """Lines on standard error, not more often than `EVERY_S`."""
    last = time.monotonic()

    def tell(description: str, done: int, of: int) -> None:
        nonlocal last
        if time.monotonic() - last >= EVERY_S:
            last = time.monotonic()
            print(f"pgti-gtsam: {_told(description, done, of)}", file=sys.stderr, flush=True)  # noqa: T201

    return tell


def _told(description: str, done: int, of: int) -> str:
    return f"{description} {done} of {of}" if of > 1 else description
