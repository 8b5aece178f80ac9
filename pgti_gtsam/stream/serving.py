"""A session between two streams of bytes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from pgti_gtsam import encode
from pgti_gtsam.stream.journal import Journal
from pgti_gtsam.stream.session import Answer, Session


class Sink(Protocol):
    """Where answers go."""

    def write(self, data: bytes, /) -> object:
        """Take bytes."""

    def flush(self) -> object:
        """Pass the written bytes on."""


def serve(session: Session, lines: Iterable[bytes], sink: Sink, journal: Journal | None = None) -> None:
    """Answer lines until the end, each at once.

    Parameters
    ----------
    session : Session
    lines : iterable of bytes
        With line breaks. A line without is the last, cut off.
    sink : Sink
        Takes a JSON object a line.
    journal : Journal, optional
        Where the session is kept.
    """
    rest = b""
    for line in lines:
        if not line.endswith(b"\n"):
            rest = line
            break
        answers = session.answers(line.decode("utf-8", "replace"))
        if journal is not None:
            journal.note(session, line)
        tell(answers, sink)
    answers = session.end(rest.decode("utf-8", "replace"))
    if journal is not None:
        journal.end(session)
    tell(answers, sink)


def tell(answers: Iterable[Answer], sink: Sink) -> None:
    """Write answers as strict JSON, an answer a line, and flush.

    Parameters
    ----------
    answers : iterable of Answer
    sink : Sink
    """
    text = "".join(encode.line(answer) for answer in answers)
    if text:
        sink.write(text.encode())
        sink.flush()
