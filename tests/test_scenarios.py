"""A smoke run of each experiment, and the laws of what they compute."""

import subprocess
import sys
from pathlib import Path

import pytest

from scenarios import speed

ROOT = Path(__file__).parents[1]


def scenarios(*words):
    return subprocess.run([sys.executable, "-m", "scenarios", *words], cwd=ROOT, capture_output=True, text=True)


def test_the_list_names_every_experiment():
    assert "speed" in scenarios("list").stdout


def test_the_growth_of_a_power_law_is_its_exponent():
    rows = [
        {"case": f"chain-{n}", "solver": "poles", "n_vertices": n, "seconds": 3e-4 * n**1.1} for n in (1000, 3000, 9000)
    ]
    assert speed.growth(rows) == {"chain": pytest.approx(1.1)}


def test_every_solver_is_timed_and_compared_with_dense():
    rows = {row["solver"]: row for row in speed.measured("chain-200", None, 1000)}
    assert set(rows) == set(speed.SOLVERS)
    assert rows["dense"]["zeta_error"] is None
    for solver, row in rows.items():
        assert row["n_vertices"] == 200
        assert row["seconds"] > 0
        if solver != "dense":
            assert row["zeta_error"] < {"lanczos": 0.1, "chebyshev": 1e-3}.get(solver, 1e-6)


def test_a_folder_that_is_not_there_is_named():
    done = scenarios("speed", "--data", "nowhere")
    assert done.returncode == 2
    assert "nowhere" in done.stderr
