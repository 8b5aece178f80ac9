"""A smoke run of each experiment, and the laws of what they compute."""

import json
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


@pytest.mark.parametrize("solver", ["auto", "lanczos"])
def test_every_solver_is_timed_and_compared_with_dense(solver):
    done = subprocess.run(
        [sys.executable, "-m", "scenarios.speed", "chain-1000", solver, ""], cwd=ROOT, capture_output=True, text=True
    )
    found = json.loads(done.stdout)
    assert found["n_vertices"] == 1000
    assert found["seconds"] > 0
    assert found["zeta_error"] < (1e-6 if solver == "auto" else 1e-3)


def test_a_folder_that_is_not_there_is_named():
    done = scenarios("speed", "--data", "nowhere")
    assert done.returncode == 2
    assert "nowhere" in done.stderr
