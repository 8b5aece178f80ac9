"""Files that are written whole or not at all, and the files of a command together.

A file is written beside its name, brought to the disk and renamed: a reader of the name finds the old file or the
new file, also when the disk is full or the process is killed meanwhile. A process that is killed while it writes may
leave a file ``.pgti-….part`` behind.
"""

from __future__ import annotations

import os
import secrets
import signal
import stat
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from pgti_gtsam.errors import OutputError


class _Output(NamedTuple):
    path: Path
    data: bytes


_WAITING: ContextVar[list[_Output] | None] = ContextVar("outputs that wait for each other", default=None)


def write_text(path: Path | str, text: str) -> None:
    """Write text as UTF-8; raises as `write_bytes` does.

    Parameters
    ----------
    path : Path or str
    text : str
    """
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a file whole, or leave the old file.

    Symbolic links are followed and stay; an old file's permissions are kept. Devices and pipes are written directly.

    Parameters
    ----------
    path : Path or str
        In a folder that exists.
    data : bytes

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    output, waiting = _Output(Path(path), data), _WAITING.get()
    if waiting is None:
        _put([output])
    else:
        waiting.append(output)


@contextmanager
def together() -> Iterator[None]:
    """All that is written inside appears at the end: every file, or none where the inside or a write fails.

    Raises
    ------
    OutputError
        A file cannot be written; the message says which other files exist.
    """
    waiting: list[_Output] = []
    token = _WAITING.set(waiting)
    try:
        yield
    finally:
        _WAITING.reset(token)
    _put(waiting)


@contextmanager
def drawn(path: Path | str) -> Iterator[Path]:
    """A scratch file with the same ending, for writers that need a path; the content goes to ``path`` whole."""
    with TemporaryDirectory() as folder:
        part = Path(folder) / f"drawn{Path(path).suffix}"
        yield part
        data = part.read_bytes()
    write_bytes(path, data)


def _put(outputs: Sequence[_Output]) -> None:
    """Write streams first, since bytes in a stream cannot be taken back; then all files."""
    written: list[Path] = []
    files: list[_Output] = []
    for output in outputs:
        with _named(output.path, written):
            if _is_stream(output.path):
                _send(output)
                written.append(output.path)
            else:
                files.append(output)
    with _undisturbed():
        _replace(files, written)


def _replace(files: Sequence[_Output], written: list[Path]) -> None:
    staged: list[tuple[Path, Path, Path]] = []
    try:
        # beside their names
        for path, data in files:
            with _named(path, written):
                target = Path(os.path.realpath(path))
                part = target.with_name(f".pgti-{secrets.token_hex(6)}.part")
                staged.append((path, target, part))
                _stage(target, part, data)

        # under their names
        for path, target, part in staged:
            with _named(path, written):
                os.replace(part, target)
                written.append(path)
    finally:
        for _, _, part in staged:
            with suppress(OSError):
                part.unlink()


def _stage(target: Path, part: Path, data: bytes) -> None:
    """Write and bring to the disk, with the permissions of the file that is replaced."""
    with part.open("xb") as file:
        if target.exists():
            target.open("ab").close()  # a file that may not be written may not be replaced either
            part.chmod(stat.S_IMODE(target.stat().st_mode))
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _is_stream(path: Path) -> bool:
    """Whether a path is a device, a pipe, or the file that standard output or error goes to."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return False
    return not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)) or _descriptor(found) is not None


def _descriptor(found: os.stat_result) -> int | None:
    """Standard output or error, where that is the file."""
    for descriptor in (1, 2):
        with suppress(OSError):  # a closed one
            if os.path.samestat(found, os.fstat(descriptor)):
                return descriptor
    return None


def _send(output: _Output) -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    descriptor = _descriptor(output.path.stat())
    target = output.path if descriptor is None else descriptor
    with open(target, "wb", closefd=descriptor is None) as file:
        file.write(output.data)


@contextmanager
def _named(path: Path, written: Sequence[Path]) -> Iterator[None]:
    """OSErrors become a line that says which file failed and which exist."""
    try:
        yield
    except OSError as error:
        others = f"written are {', '.join(map(str, written))} alone" if written else "nothing was written"
        raise OutputError(f"{path} cannot be written: {error.strerror or error}; {others}") from error


@contextmanager
def _undisturbed() -> Iterator[None]:
    """SIGINT and SIGTERM wait until the block has ended; in other threads than the main thread nothing is done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def wait(number: int, _: Any) -> None:
        came.append(number)

    before = {number: signal.signal(number, wait) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for caught in came:
            signal.raise_signal(caught)
