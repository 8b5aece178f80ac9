"""A session on disk: the whole state from time to time, and every line since, so that nothing is lost between.

The state stands in a file and the lines in a second file, ``NAME.lines``. A line is written when taken and
before the answer: a process killed in between answers the line when resumed, and a line that kills is not read again.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from pgti_gtsam.errors import FileFormatError, InvalidOptionError, OutputError, PgtiError
from pgti_gtsam.gate import LoopClosureGate
from pgti_gtsam.gate.smoothers.saved import read_state, write_state
from pgti_gtsam.stream.session import Answer, Session

EVERY = 2000
"""Lines after which the state is written again. What is killed reads them again when it is resumed: some seconds."""

SCHEMA, VERSION = "pgti-gtsam/stream-state", 1


class Journal:
    """Where a session is kept.

    Parameters
    ----------
    path : Path
        Of the state.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.lines_path = path, path.with_name(path.name + ".lines")
        self._lock: Any = None  # the file of the lines, held as long as the session lasts
        self._lines: Any = None
        self._count = 0

    def opened(self, gate: LoopClosureGate, radius_m: float | None = None) -> tuple[Session, list[Answer]]:
        """The session that was kept, or a new session, and its first answers.

        The first answer says where the session continues; then come the answers to the lines since the state was last
        written, possibly lost: these hold ``"again": true``.

        Parameters
        ----------
        gate : LoopClosureGate
        radius_m : float, optional
            Metres around every keyframe of a new session.

        Raises
        ------
        InvalidOptionError
            Another process keeps a session there.
        FileFormatError
            The file holds something else.
        PgtiError
            As of `Session.resumed`.
        """
        self._lock = _locked(self.lines_path)
        try:
            return self._read(gate, radius_m)
        except PgtiError:
            if not self.lines_path.stat().st_size:
                self.lines_path.unlink()
            self._lock.close()
            raise

    def _read(self, gate: LoopClosureGate, radius_m: float | None) -> tuple[Session, list[Answer]]:
        if not self.path.exists():
            session = Session.started(gate, radius_m)
            self.save(session)
            return session, []

        # the state, and the lines since
        state = read_state(self.path, SCHEMA, VERSION)
        session, again = Session.resumed(state["session"], gate), list[Answer]()
        if radius_m is not None and session.isam.radii != radius_m:
            raise FileFormatError(self.path, f"expected the radii that the map was begun with, got {radius_m:g} m")
        for line in self._kept_lines(session.n_lines):
            again += [{**answer, "again": True} for answer in session.answers(line)]
        self.save(session)
        where = {"line": session.n_lines, "variables": session.n_variables, "undecided": session.undecided}
        return session, [{"resumed": where}, *again]

    def note(self, session: Session, line: bytes) -> None:
        """Keep a line that a session took.

        Parameters
        ----------
        session : Session
        line : bytes
        """
        self._lines.write(b"%d %b" % (session.n_lines, line))
        self._lines.flush()
        self._count += 1
        if self._count >= EVERY:
            self.save(session)

    def save(self, session: Session) -> None:
        """Write the whole state; the lines so far are part of the state."""
        if self._lines is not None:
            self._lines.close()
        write_state(self.path, {"schema": SCHEMA, "schema_version": VERSION, "session": session.state()})
        self._lines, self._count = self.lines_path.open("wb"), 0

    def end(self, session: Session) -> None:
        """Write the state a last time; no line is left beside the state."""
        self.save(session)
        self._lines.close()
        self.lines_path.unlink()
        self._lock.close()

    def _kept_lines(self, after: int) -> list[str]:
        """Lines behind the state, whole lines only."""
        raw = self.lines_path.read_bytes().split(b"\n")[:-1]
        numbered = [line.decode("utf-8", "replace").partition(" ") for line in raw]
        return [text for number, _, text in numbered if number.isdecimal() and int(number) > after]


def _locked(path: Path) -> Any:
    """A file that no other process holds, made where there is none; the lock ends with the process at the latest."""
    while True:
        try:
            file = path.open("ab")
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror or error}; nothing was written") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            name = path.with_suffix("")
            raise InvalidOptionError(
                f"expected a state of this process alone, got {name}, which another process keeps; name another state"
            ) from None

        # another process may have ended, and removed the file, in between
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        file.close()
