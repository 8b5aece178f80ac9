"""A process of its own for methods that may not come to an end: run as `python -m scenarios.aliasing.helper FD`.

Limits are of processor time, so that the load of a machine does not decide which method has an answer. Workers of
pebble have limits of wall time, and cannot be started in the workers of Dask, which run the trials.
"""

from __future__ import annotations

import multiprocessing
import signal
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from scenarios.problem import Problem

ROOT = Path(__file__).parents[2]


class Helper:
    """Solves problems in turn, in a process that is replaced when a problem takes too long."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._ours: Any = None

    def solve(self, problem: Problem, method: str, limit_s: float) -> Any:
        """The method's `Outcome`.

        Parameters
        ----------
        problem : Problem
        method : str
            Name in `METHODS`.
        limit_s : float
            Limit of processor time, s.

        Raises
        ------
        TimeoutError
            There was none within `limit_s` seconds of processor time.
        RuntimeError
            GTSAM gave up, or the process ended.
        """
        if self._process is None:
            self._start()
        self._ours.send((problem, method, limit_s))
        try:
            answer = self._ours.recv()
        except EOFError as error:
            if self._ended() == -signal.SIGPROF:
                raise TimeoutError(f"no answer within {limit_s:g} s") from error
            raise RuntimeError("the process that ran the method ended") from error
        if isinstance(answer, RuntimeError):
            raise answer
        return answer

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._ended()

    def _ended(self) -> int:
        """Wait for the process to end; its exit code."""
        process, self._process = self._process, None
        self._ours.close()
        return 0 if process is None else process.wait()

    def _start(self) -> None:
        self._ours, theirs = multiprocessing.Pipe()
        with theirs:
            command = [sys.executable, "-m", __name__, str(theirs.fileno())]
            self._process = subprocess.Popen(command, cwd=ROOT, pass_fds=[theirs.fileno()])


def _serve(connection: Connection[Any, Any]) -> None:
    from scenarios.aliasing import methods

    while True:
        try:
            problem, method, limit_s = connection.recv()
        except EOFError:  # nobody asks any more
            return
        signal.setitimer(signal.ITIMER_PROF, limit_s)
        try:
            answer: Any = methods.solve(problem, method)
        except RuntimeError as error:  # what GTSAM raises where its solver gives up
            answer = RuntimeError(str(error).strip().splitlines()[0][:120])
        signal.setitimer(signal.ITIMER_PROF, 0)
        try:
            connection.send(answer)
        except BrokenPipeError:  # the one who asked is gone
            return


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
