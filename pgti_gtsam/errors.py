"""Errors of the package: a class per cause, each message saying what to do next."""

from __future__ import annotations

from pathlib import Path


class PgtiError(Exception):
    """Base of every error that this package raises on bad input."""


class FileFormatError(PgtiError):
    """A file cannot be read in the expected format.

    Parameters
    ----------
    path : Path or str
        The file.
    message : str
        The expectation and the finding.
    line : int, optional
        Line number, counted from 1.
    """

    def __init__(self, path: Path | str, message: str, *, line: int | None = None) -> None:
        self.path, self.line, self.message = Path(path), line, message
        super().__init__(f"{path}{'' if line is None else f', line {line}'}: {message}")


class MissingValueError(PgtiError):
    """A factor refers to a key that has no value."""


class UnusedValueError(PgtiError):
    """A pose has a value but no factor refers to it."""


class NoPoseError(PgtiError):
    """A factor graph or its values hold no pose."""


class NoRadiusError(PgtiError):
    """Nothing says how far the free space around any keyframe reaches."""


class InvalidValueError(PgtiError):
    """A pose, landmark or radius is not a finite number in its range."""


class InvalidGraphError(PgtiError):
    """The arrays of a pose graph do not fit together."""


class InvalidOptionError(PgtiError):
    """An option is outside its range."""


class OutputError(PgtiError):
    """A file cannot be written; an older file of the name, if any, stays."""


class MissingDependencyError(PgtiError):
    """An optional package or system library is not installed."""


class InvalidClosureError(PgtiError):
    """A closure holds no factor, or a factor that cannot be tried on the present map."""


class UnsolvableGraphError(PgtiError):
    """A factor graph without an optimum that can be found: the graph is singular, or its error is not finite."""
