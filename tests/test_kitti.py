"""The gate on a real detector's loops, as a command: its verdicts, its JSON, its exit code."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data" / "kitti_robustslam"


def gate_kitti(*words):
    command = [sys.executable, "-m", "scenarios", "gate-kitti", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def write_sequence(folder, name, false_offset):
    """A drive twice around a block of 40 m, with true closures on the second lap and false ones across the block."""
    folder.mkdir()
    side = 200  # frames of 0.2 m
    headings = np.repeat(np.arange(8) * np.pi / 2, side)
    steps = [
        f"EDGE_SE2 {k} {k + 1} 0.2 0 {1.5707963 if (k + 1) % side == 0 else 0} 100 0 0 100 0 900"
        for k in range(len(headings) - 1)
    ]
    true = [(k + 4 * side, k) for k in range(0, 60, 5)]
    false = [(k + false_offset + 400, k) for k in range(100, 130, 5)]
    loops = [f"EDGE_SE2 {i} {j} 0 0 0 100 0 0 100 0 900" for i, j in true + false]
    (folder / f"kitti_{name}_alpha_0.50.g2o").write_text("\n".join(steps + loops) + "\n")
    (folder / f"kitti_{name}_alpha_0.50_GT_LC.txt").write_text("".join(f"{i} {j}\n" for i, j in true))


def test_a_sequence_without_ground_truth_is_gated(tmp_path):
    write_sequence(tmp_path / "13", "13", 0)
    done = gate_kitti("--data", tmp_path, "--sequences", "13", "--json", tmp_path / "found.json")
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert json.loads((tmp_path / "found.json").read_text()) == found
    assert {name: found["13"][name] for name in ("true", "true_accepted", "false", "false_accepted")} == {
        "true": 12,
        "true_accepted": 12,
        "false": 6,
        "false_accepted": 0,
    }
    assert found["13"]["ate_m"] is None


def test_wrong_labels_fail(tmp_path):
    write_sequence(tmp_path / "13", "13", 0)
    labels = tmp_path / "13" / "kitti_13_alpha_0.50_GT_LC.txt"
    labels.write_text("500 100\n505 105\n")  # what the gate rejects is said to be true
    assert gate_kitti("--data", tmp_path, "--sequences", "13").returncode == 1


def test_a_sequence_that_is_not_there_is_named(tmp_path):
    done = gate_kitti("--data", tmp_path, "--sequences", "02")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "kitti_02_alpha" in done.stderr


@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not here")
def test_loops_of_a_real_detector():
    done = gate_kitti("--data", DATA.parent, "--sequences", "06,07")
    assert done.returncode == 0, done.stdout + done.stderr
    for row in json.loads(done.stdout.splitlines()[-1]).values():
        assert row["true_accepted_rate"] >= 0.99
        assert row["false_accepted_rate"] <= 0.01
        assert row["ate_m"] <= 1.05 * row["ate_only_true_m"]


def test_a_sequence_is_gated_in_time_order(tmp_path):
    write_sequence(tmp_path / "13", "13", 0)
    done = gate_kitti("--data", tmp_path, "--sequences", "13", "--in-time-order")
    assert done.returncode == 0, done.stdout + done.stderr
    online, reviewed = done.stdout.splitlines()[:2]
    assert "as they come" in online
    assert "after a review  " in reviewed
    assert "true   12 of   12  false    0 of    6" in reviewed
