"""A smoke run of each experiment, and the laws of what they compute."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from optional import needs_open3d

from pgti_gtsam import datasets
from scenarios import pipeline, scans, speed
from scenarios.speed import solvers

ROOT = Path(__file__).parents[1]


def scenarios(*words):
    return subprocess.run(
        [sys.executable, "-m", "scenarios", *map(str, words)], cwd=ROOT, capture_output=True, text=True
    )


def test_the_list_names_every_experiment():
    said = scenarios("list").stdout
    assert all(name in said for name in ("speed", "gate-kitti", "scans", "worlds", "field"))


def test_the_growth_of_a_power_law_is_its_exponent():
    rows = [
        {"case": f"chain-{n}", "solver": "poles", "n_vertices": n, "seconds": 3e-4 * n**1.1} for n in (1000, 3000, 9000)
    ]
    assert speed.growth(rows) == {"chain": pytest.approx(1.1)}


def test_the_dense_solver_is_timed_by_the_clock_on_more_than_a_core():
    (row,) = speed.in_fresh_process("cores", "random-300", 0, None, threads=2)
    assert row["n_vertices"] == 300
    assert 0 < row["seconds"] < 60


def test_every_solver_is_timed_and_compared_with_dense():
    rows = {row["solver"]: row for row in speed.in_fresh_process("solvers", "chain-200", 1000, None)}
    assert set(rows) == set(solvers.SOLVERS)
    assert rows["dense"]["zeta_error"] is None
    for solver, row in rows.items():
        assert row["n_vertices"] == 200
        assert row["seconds"] > 0
        if solver != "dense":
            assert row["zeta_error"] < {"lanczos": 0.1, "chebyshev": 1e-3}.get(solver, 1e-6)


def test_the_audit_is_timed_part_by_part():
    rows = {row["part"]: row for row in speed.in_fresh_process("audits", "landmarks-300", 1000, None)}
    assert {"adaptation", "support graph", "spectra", "optimality"} < set(rows)
    assert all(row["seconds"] >= 0 and row["n_keyframes"] == 300 for row in rows.values())


def test_updates_are_timed_on_a_cached_map():
    rows = speed.in_fresh_process("updates", "chain-500-2", 1000, None)
    assert {row.get("n_inserted") for row in rows} == {None, 1, 10}
    assert all(row["seconds"] > 0 for row in rows)


def test_the_figure_is_drawn_from_the_results(tmp_path):
    row = {"solver": "poles", "peak_megabytes": 3.0, "zeta_error": None}
    rows = [{**row, "case": f"chain-{n}", "n_vertices": n, "seconds": n * 1e-4} for n in (3000, 10_000)]
    speed.write({"solvers": rows, "growth": speed.growth(rows)}, tmp_path / "speed.json")
    assert (tmp_path / "speed.png").read_bytes().startswith(b"\x89PNG")


DATA = ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is absent")


@needs_data
def test_decisions_are_timed_whole_and_in_parts():
    rows = {row["what"]: row for row in speed.in_fresh_process("decisions", "kitti_00", 1000, DATA)}
    whole, kept = "a decision on a {} closure", "the same against a kept reference map, {}"
    slowest = rows[whole.format("true")]["slowest"]
    for what in (whole, kept):
        true, false = (rows.pop(what.format(kind)) for kind in ("true", "false"))
        assert (true["accepted"], false["accepted"]) == (true["offered"], 0)
        assert 0 < true["seconds"] <= true["slowest"]
    assert {"adapting", "weighing", "contacts with and without"} < set(rows)
    assert sum(row["seconds"] for row in rows.values()) < 3 * slowest


@needs_data
@needs_open3d
def test_scans_that_look_alike_are_no_closures():
    path = DATA / "scan_pose_graphs" / "mit-cscail.log"
    alike = scans.look_alikes(path)
    published = datasets.read(path).values
    for first, second, measured in alike:
        there = published.atPose2(first).between(published.atPose2(second))
        assert np.hypot(*there.translation()) >= scans.APART_M
        assert np.hypot(*measured.translation()) < scans.APART_M / 2
    row = scans.gated(path, 1000)
    assert row["look_alikes"] == len(alike) > 10
    assert row["true_accepted"] > 0.98 * row["true"]
    assert row["false_accepted"] < 0.02 * row["false"]


@needs_data
@needs_open3d
def test_outliers_in_a_standard_graph_from_the_command_line(tmp_path):
    words = ("--graphs", "MIT", "--seeds", "1000", "--methods", "no gate,DCS", "--out", tmp_path / "rows.jsonl")
    done = scenarios("field", "--data", DATA, *words)
    assert done.returncode == 0, done.stderr
    assert "0 of 12 trials" in done.stdout
    assert len((tmp_path / "rows.jsonl").read_text().splitlines()) == 12
    assert "0 of 12 trials" not in scenarios("field", "--data", DATA, *words).stdout


@needs_open3d
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("worlds", "--worlds", "moon"), "expected worlds from offices"),
        (("worlds", "--seeds", "one"), "expected whole numbers"),
        (("field", "--data", ".", "--methods", "magic"), "expected methods from gate"),
    ],
)
def test_what_there_is_not_is_named(words, expected):
    done = scenarios(*words)
    assert done.returncode == 2
    assert expected in done.stderr


def test_a_folder_that_is_not_there_is_named():
    done = scenarios("speed", "--data", "nowhere")
    assert done.returncode == 2
    assert "nowhere" in done.stderr


def test_a_pipeline_is_timed_beside_isam2_alone(tmp_path):
    rows = pipeline.run(500, 1000, tell=lambda line: None)
    assert [row["n_keyframes"] for row in rows] == [250, 500]
    assert rows[-1]["accepted"] == rows[-1]["offered"] == 30
    assert all(row["bare_s"] > 0 and row["gated_s"] > 0 for row in rows)
    assert all(0 < row["decision_s"] < row["gated_closing_s"] for row in rows)
    pipeline.draw(rows, tmp_path / "pipeline.png")
    assert (tmp_path / "pipeline.png").read_bytes().startswith(b"\x89PNG")
