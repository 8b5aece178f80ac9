"""What a run says while it works: lines, records with --verbose, nothing with --quiet; and completion by the shell."""

import logging
import os
import subprocess
import sys

import pytest

from pgti_gtsam import datasets
from pgti_gtsam.cli import progress

SQUARE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 5 0 1.57
VERTEX_SE2 2 5 5 3.14
VERTEX_SE2 3 0 5 -1.57
EDGE_SE2 0 1 5 0 1.57 1 0 0 1 0 1
EDGE_SE2 1 2 5 0 1.57 1 0 0 1 0 1
EDGE_SE2 2 3 5 0 1.57 1 0 0 1 0 1
"""
STEPS = ["reading", "adapting", "checking the estimate", "weighing closures", "places"]
PROGRAM = "import sys; sys.argv[0] = 'pgti-gtsam'; from pgti_gtsam.cli import main; main()"


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


@pytest.fixture
def slow(run, monkeypatch):
    """Every step counts as long enough for a line."""
    monkeypatch.setattr(progress, "EVERY_S", 0.0)


def test_a_quick_run_says_nothing(run, square):
    code, _, err = run("audit", square, "--radius", 1)
    assert (code, err) == (0, "")


def test_a_long_run_says_its_steps_in_lines(run, square, slow):
    _, out, err = run("audit", square, "--radius", 1)
    lines = err.splitlines()
    assert [step for step in STEPS if f"pgti-gtsam: {step}" not in lines] == []
    assert "reading" not in out


def test_a_long_run_counts(run, square, slow):
    _, _, err = run("replay", square, "--radius", 1)
    assert "pgti-gtsam: measuring 4 of 4" in err.splitlines()


def test_quiet_is_quiet(run, square, slow):
    code, out, err = run("audit", square, "--radius", 1, "--quiet")
    assert (code, err) == (0, "")
    assert "square" in out


def test_quiet_still_says_what_stops_it(run, tmp_path):
    code, _, err = run("audit", tmp_path / "none.g2o", "-q")
    assert code == 2
    assert err.count("\n") == 1


def test_verbose_says_every_step_with_its_time(run, square):
    _, _, err = run("audit", square, "--radius", 1, "--verbose")
    assert "pgti_gtsam.datasets.reader: " in err
    assert "read as g2o: 4 variables, 3 factors" in err
    assert [step for step in STEPS if f"pgti_gtsam.cli.progress: {step}" not in err] == []


def test_a_verbose_run_leaves_the_next_as_it_is(run, square):
    run("audit", square, "--radius", 1, "--verbose")
    assert run("audit", square, "--radius", 1)[2] == ""


def test_the_library_logs_and_prints_nothing(square, capsys):
    class Kept(logging.Handler):
        def emit(self, record):
            kept.append(record)

    kept, log, handler = [], logging.getLogger("pgti_gtsam"), Kept()
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        datasets.read(square)
    finally:
        log.removeHandler(handler)
    assert [record.name for record in kept] == ["pgti_gtsam.datasets.reader"]
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_commands(shell):
    asked = {"_TYPER_COMPLETE_ARGS": "pgti-gtsam aud", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    asked |= {"COMP_WORDS": "pgti-gtsam aud", "COMP_CWORD": "1", "_PGTI_GTSAM_COMPLETE": f"complete_{shell}"}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env={**os.environ, **asked}, capture_output=True, text=True)
    assert "audit" in done.stdout
    assert "mend" not in done.stdout
