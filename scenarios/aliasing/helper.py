"""A process of its own for methods that may not come to an end: run as `python -m scenarios.aliasing.helper FD`."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from scenarios.problem import Problem

ROOT = Path(__file__).parents[2]


class Helper:
    """Solves problems, one after another, and is replaced when one takes too long."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._ours: Any = None

    def solve(self, problem: Problem, method: str, limit_s: float) -> Any:
        """The method's `Outcome`.

        Raises
        ------
        TimeoutError
            There was none after `limit_s` seconds.
        RuntimeError
            GTSAM gave up, or the process ended.
        """
        if self._process is None:
            self._start()
        self._ours.send((problem, method))
        if not self._ours.poll(limit_s):
            self.close()
            raise TimeoutError(f"no answer after {limit_s:g} s")
        try:
            answer = self._ours.recv()
        except EOFError as error:
            self.close()
            raise RuntimeError("the process that ran the method ended") from error
        if isinstance(answer, RuntimeError):
            raise answer
        return answer

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._ours.close()
            self._process = None

    def _start(self) -> None:
        self._ours, theirs = multiprocessing.Pipe()
        with theirs:
            command = [sys.executable, "-m", __name__, str(theirs.fileno())]
            self._process = subprocess.Popen(command, cwd=ROOT, pass_fds=[theirs.fileno()])


def _serve(connection: Connection[Any, Any]) -> None:
    from scenarios.aliasing import methods

    while True:
        try:
            problem, method = connection.recv()
        except EOFError:  # nobody asks any more
            return
        try:
            answer: Any = methods.solve(problem, method)
        except RuntimeError as error:  # what GTSAM raises where its solver gives up
            answer = RuntimeError(str(error).strip().splitlines()[0][:120])
        try:
            connection.send(answer)
        except BrokenPipeError:  # the one who asked is gone
            return


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
