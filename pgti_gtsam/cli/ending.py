"""How a run of the command line ends: an error gives one line and exit code 2; a closed pipe ends the run quietly.

The only place that catches `PgtiError`, `OSError` and `MemoryError`.
"""

from __future__ import annotations

import codecs
import io
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from pgti_gtsam.cli.options import CLOSED_PIPE, READ_NOTES, Terminal, discard_output
from pgti_gtsam.errors import PgtiError
from pgti_gtsam.plain_text import in_ascii, visible


def run_to_its_end(app: Callable[[], object]) -> None:
    """Run a command line; an error is told in one line, followed by the notes on the map that was read."""
    READ_NOTES.set(())
    _print_what_terminals_have()
    try:
        app()
    except PgtiError as error:
        if isinstance(error.__cause__, BrokenPipeError):
            discard_output()
            sys.exit(CLOSED_PIPE)
        _fail(str(error), getattr(error, "__notes__", ()))
    except MemoryError:
        _fail("the memory does not suffice for this map; keep every second keyframe of it, or fewer")
    except OSError as error:
        discard_output()
        name = "standard output" if error.filename is None else str(error.filename)
        _fail(f"{name} cannot be used: {error.strerror or error}")


def _fail(message: str, notes: Sequence[str] = ()) -> NoReturn:
    console = Terminal(stderr=True, highlight=False)
    console.print(f"pgti-gtsam: {visible(message)}", markup=False, soft_wrap=True)
    for note in (*READ_NOTES.get(), *notes):
        console.print(f"  note: {visible(note)}", markup=False, soft_wrap=True)
    sys.exit(2)


def _print_what_terminals_have() -> None:
    """Let characters that the terminal's encoding lacks be printed in ASCII."""
    codecs.register_error("pgti-ascii", in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="pgti-ascii")
