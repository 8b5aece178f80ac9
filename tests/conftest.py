"""What tests of the command line share. Two processes test at once, with one BLAS thread each."""

import logging
import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest

from pgti_gtsam import cli
from pgti_gtsam.cli import progress


@pytest.fixture(autouse=True)
def log_as_before():
    """What a command run in this process does to the package's log ends with the test."""
    log = logging.getLogger("pgti_gtsam")
    level, handlers, propagates = log.level, [*log.handlers], log.propagate
    yield
    log.setLevel(level)
    log.handlers, log.propagate = handlers, propagates


@pytest.fixture
def run(monkeypatch, capsys):
    """Run the command line in this process: exit code, standard output, standard error without progress."""
    monkeypatch.setattr(progress, "EVERY_S", float("inf"))

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["pgti-gtsam", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        return stop.value.code or 0, *capsys.readouterr()

    return call
