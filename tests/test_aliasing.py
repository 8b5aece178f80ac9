"""Aliasing in small: labels come from geometry, rows are repeatable and resumed, every method answers."""

import json
from pathlib import Path

import numpy as np
import pytest

from scenarios import aliasing, measures
from scenarios.aliasing import field, methods, streets


def test_a_closure_is_true_where_its_measurement_agrees_with_the_poses():
    problem = streets.problem(1001)
    assert problem.true.any()
    assert (~problem.true).any()
    for closure, true in zip(problem.closures, problem.true, strict=True):
        i, j = closure.at(0).keys()
        actual = problem.truth.atPose2(i).between(problem.truth.atPose2(j))
        off = np.linalg.norm(actual.translation() - closure.at(0).measured().translation())
        assert (off < 1.0) if true else (off > 0.9 * streets.BLOCK_M - 5)


def test_the_same_seed_gives_the_same_problem_whatever_methods_are_told():
    one, other = streets.problem(1002, "right"), streets.problem(1002, "identity")
    pairs = zip(one.closures, other.closures, strict=True)
    assert all(a.at(0).measured().equals(b.at(0).measured(), 1e-12) for a, b in pairs)
    np.testing.assert_array_equal(one.true, other.true)
    assert one.graph.at(1).noiseModel().sigmas()[2] == streets.ODOMETRY[2]
    assert other.graph.at(1).noiseModel().sigmas()[2] == 1.0


@pytest.mark.parametrize("method", methods.METHODS)
def test_every_method_answers_for_every_closure(method):
    problem = streets.problem(1003, n_streets=10)
    outcome = methods.solve(problem, method)
    assert outcome.accepted.shape == problem.true.shape
    assert outcome.values.size() == problem.truth.size()
    assert np.isfinite(measures.ate_m(problem.truth, outcome.values))


def test_the_gate_parts_true_from_false_on_a_training_seed():
    problem = streets.problem(1000, "identity")
    assert measures.f1(problem.true, methods.solve(problem, "gate").accepted) > 0.95


def test_known_rows_are_kept_and_a_torn_one_is_run_again(tmp_path):
    wanted = [("streets", 1003, "right", 1.0, name) for name in ("no gate", "Cauchy")]
    path = tmp_path / "rows.jsonl"
    first = aliasing.run(path, wanted, None, lambda _: None)
    lines = path.read_text().splitlines()
    assert len(lines) == 2
    path.write_text(lines[0] + "\n" + lines[1][: len(lines[1]) // 2])
    again = aliasing.run(path, wanted, None, lambda _: None)
    assert path.read_text().splitlines()[0] == lines[0]
    assert len(path.read_text().splitlines()) == 2
    timeless = [[{k: v for k, v in row.items() if "seconds" not in k} for row in rows] for rows in (first, again)]
    assert timeless[0] == timeless[1]
    assert all(json.loads(line)["f1"] >= 0 for line in lines)


def test_intervals_hold_their_mean_and_collapse_without_spread():
    assert aliasing.mean_and_interval([0.5, 0.5]) == (0.5, 0.5, 0.5)
    mean, low, high = aliasing.mean_and_interval([0.0, 1.0, 1.0])
    assert low <= mean <= high


def test_outliers_of_standard_graphs_are_far_from_true_and_the_rest_is_the_file():
    path = Path(__file__).parents[2] / "shared" / "data" / "pose_graphs" / "MIT.g2o"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    problem = field.problem(path, 1000, 0.5)
    assert (problem.true.sum(), (~problem.true).sum()) == (20, 10)
    for closure, true in zip(problem.closures, problem.true, strict=True):
        i, j = closure.at(0).keys()
        off = problem.truth.atPose2(i).between(problem.truth.atPose2(j)).translation()
        assert true or np.linalg.norm(off) > field.APART_M
