"""Aliasing in small: labels come from geometry, rows are repeatable and resumed, every method answers."""

import json
import os
import subprocess
import sys
from itertools import accumulate
from pathlib import Path

import gtsam
import numpy as np
import pytest
from optional import needs_open3d
from scipy import stats

from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import graph_of
from scenarios import measures, sweep, worlds
from scenarios.aliasing import field, figure, maps, methods, tables, trials
from scenarios.aliasing.helper import Helper
from scenarios.aliasing.trials import Trial
from scenarios.problem import Problem, alone, space
from scenarios.worlds import alignment, drift, layouts, sensors
from scenarios.worlds.ambiguity import ambiguity
from scenarios.worlds.solid import Solid, box

pytestmark = needs_open3d
GRAPHS = Path(__file__).parents[2] / "shared" / "data" / "pose_graphs"


def small(world="warehouse", seed=1001, told="right"):
    """A drive that is short and has true and false proposals."""
    return worlds.problem(world, seed, told, length_m={"warehouse": 250.0, "tunnel": 500.0}[world])


def test_rays_end_on_the_box_and_drawn_points_lie_on_it():
    solid = Solid(box((1, -1, -1), (3, 1, 1)))
    hit = solid.cast(np.zeros((2, 3)), np.array([[1.0, 0, 0], [0, 1.0, 0]]))
    np.testing.assert_allclose(hit.points[0], [1, 0, 0], atol=1e-6)
    assert np.isinf(hit.distances[1])
    points, normals = solid.draw(np.random.default_rng(0), 10.0)
    away = np.abs(points - [2, 0, 0]).max(axis=1)
    np.testing.assert_allclose(away, 1.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(((points - [2, 0, 0]) * normals).sum(axis=1)), 1.0, atol=1e-12)


def test_a_sensor_sees_what_is_in_view_and_not_what_is_hidden():
    solid = Solid(box((1, -1, -1), (3, 1, 1)))
    places = np.array([[1.0, 0, 0], [3.0, 0, 0], [-2.0, 0, 0], [0.0, 2.0, 0], [100.0, 0, 0]])
    assert sensors.CAMERA.sees(solid, gtsam.Pose3(), places).tolist() == [0]
    assert sensors.LIDAR_3D.sees(solid, gtsam.Pose3(), places).tolist() == [0, 2, 3]


def test_odometry_is_a_chain_of_similarities():
    truth = [gtsam.Pose3(gtsam.Rot3.Yaw(0.1 * k), np.array([2.0 * k, 0, 0])) for k in range(6)]
    found = drift.odometry(truth, np.random.default_rng(0), planar=False, scaled=True)
    assert found.scales[0] == 1.0
    assert np.ptp(found.scales) > 0
    plain = drift.odometry(truth, np.random.default_rng(0), planar=True, scaled=False)
    np.testing.assert_array_equal(plain.scales, 1.0)
    for step in plain.steps:
        assert abs(step.z()) < 1e-12
    for step, true, scale in zip(found.steps, np.diff([p.x() for p in truth]), found.scales, strict=False):
        assert np.linalg.norm(step.translation()) / scale == pytest.approx(true, abs=0.3)


@pytest.mark.parametrize("kind", drift.KINDS)
def test_odometry_errs_as_its_kind_says(kind):
    truth = [gtsam.Pose3(gtsam.Rot3(), np.array([2.0 * k, 0, 0])) for k in range(2000)]
    errors = drift.KINDS[kind]
    found = drift.odometry(truth, np.random.default_rng(3), planar=True, scaled=False, errors=errors)
    true = truth[0].between(truth[1])
    off = np.abs([gtsam.Pose3.Logmap(true.between(step)) for step in found.steps])
    yaw, ahead, sigma = off[:, 2], off[:, 3], drift.WALK[2] * np.sqrt(2.0)
    if errors.bias <= 3:
        assert np.median(yaw) == pytest.approx(0.67 * errors.walk * sigma, rel=0.4, abs=1e-9)
    assert (yaw.max() > 0.1) == (kind == "bad steps")
    assert (np.mean(ahead > 0.8) > 0.01) == (kind == "slips")


@pytest.mark.parametrize("name", layouts.LAYOUTS)
def test_every_world_is_driven_through_free_space_and_sensed(name):
    driven = worlds.drive(name, 1000, 60.0)
    layout = driven.layout
    assert len(driven.truth) > 15
    nearest = min(np.min(layout.sensor.scan(layout.solid, pose).distances) for pose in driven.truth)
    assert nearest > 0.5
    least = {"camera": 500, "2D lidar": 30, "3D lidar": 150}[layout.sensor.name]
    assert np.median([len(places) for places in driven.landmarks]) >= least
    radii = np.array([driven.radii[k] for k in range(len(driven.truth))])
    assert np.median(radii) < 1.3 * nearest + 1.0
    assert (radii > 0.3).all()


@pytest.mark.parametrize("world", ["warehouse", "tunnel"])
def test_a_closure_is_true_where_its_measurement_agrees_with_the_poses(world):
    problem = small(world)
    assert problem.true.any()
    assert (~problem.true).any()
    poses = [space(pose) for pose in problem.poses(problem.truth)]
    for closure, true in zip(problem.closures, problem.true, strict=True):
        i, j = closure.at(0).keys()
        off = poses[i].between(poses[j]).between(space(closure.at(0).measured()))
        near = np.linalg.norm(off.translation()) < worlds.TRUE_M
        assert true == (near and np.linalg.norm(gtsam.Rot3.Logmap(off.rotation())) < worlds.TRUE_RAD)


def test_overlap_is_a_stretch_laid_upon_another():
    straight = [gtsam.Pose3(gtsam.Rot3(), np.array([float(k), 0, 0])) for k in range(40)]
    aside = [gtsam.Pose3(gtsam.Rot3(), np.array([float(k), 30.0, 0])) for k in range(40)]
    truth, radii = [*straight, *aside], dict.fromkeys(range(80), 0.8)
    assert worlds.overlaps(truth, radii, 25, 70, gtsam.Pose3())
    assert not worlds.overlaps(truth, radii, 25, 70, gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), np.zeros(3)))


def test_the_same_seed_gives_the_same_problem_whatever_methods_are_told():
    worlds.drive.cache_clear()
    one = small()
    worlds.drive.cache_clear()
    other = small(told="identity")
    pairs = zip(one.closures, other.closures, strict=True)
    assert all(a.at(0).measured().equals(b.at(0).measured(), 1e-9) for a, b in pairs)
    np.testing.assert_array_equal(one.true, other.true)
    assert one.radii == other.radii
    np.testing.assert_array_equal(other.graph.at(1).noiseModel().sigmas(), 1.0)


DIGEST = """
import hashlib, json, os
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:{cores}])
from scenarios import worlds
driven = worlds.drive("campus", 1000, 120.0)
parts = [driven.pairs, *(pose.matrix() for pose in (*driven.measured, *driven.truth, *driven.odometry.steps))]
radii = json.dumps(driven.radii)
print(len(driven.pairs), hashlib.sha256(b"".join(part.tobytes() for part in parts) + radii.encode()).hexdigest())
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to cores")
def test_two_processes_make_the_same_world_whatever_their_threads_and_hash_seeds():
    said = [
        subprocess.Popen(
            [sys.executable, "-c", DIGEST.format(cores=cores)],
            cwd=Path(__file__).parents[1],
            env=os.environ | {"PYTHONHASHSEED": str(cores), "OMP_NUM_THREADS": str(cores)},
            stdout=subprocess.PIPE,
            text=True,
        )
        for cores in (1, 2)
    ]
    one, other = (process.communicate()[0] for process in said)
    assert one == other
    assert int(one.split()[0]) > 5


def test_two_views_of_a_corner_align_to_where_they_were_taken_from():
    random = np.random.default_rng(0)
    across = random.uniform(0.5, 3.0, (3, 200, 2))
    points = np.concatenate([np.insert(plane, axis, 0.0, axis=1) for axis, plane in enumerate(across)])
    normals = np.repeat(np.eye(3), 200, axis=0)
    moved = gtsam.Pose3(gtsam.Rot3.Ypr(0.03, -0.02, 0.01), np.array([0.05, -0.03, 0.04]))
    seen = np.array([moved.transformTo(point) for point in points])
    later = alignment.Cloud.of(seen, normals @ moved.rotation().matrix())
    found = alignment.icp(alignment.Cloud.of(points, normals), later, gtsam.Pose3(), 0.3)
    assert found.fitness == 1.0
    assert found.pose.equals(moved, 1e-5)


def test_alignment_makes_no_motion_that_a_bare_plane_leaves_free():
    x, y = np.meshgrid(np.linspace(-2, 2, 9), np.linspace(-2, 2, 9))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    floor = alignment.Cloud.of(points, np.tile([0.0, 0.0, 1.0], (x.size, 1)))
    found = alignment.icp(floor, floor, gtsam.Pose3(gtsam.Rot3(), np.array([0.1, 0.0, 0.2])), 1.0)
    assert found.pose.equals(gtsam.Pose3(gtsam.Rot3(), np.array([0.1, 0.0, 0.0])), 1e-9)


def test_a_place_is_ambiguous_where_a_view_from_elsewhere_is_as_much_alike():
    places = np.array([[0.0, 0, 0], [9.0, 0, 0], [0.1, 0, 0], [9.1, 0, 0], [20.0, 0, 0]])
    unlike = np.full((5, 5), np.inf)
    unlike[2, :2], unlike[3, :2], unlike[4, :2] = (0.1, 0.2), (0.1, 0.3), (0.1, 0.1)
    assert ambiguity(unlike, places, 1.0) == 0.5
    assert np.isnan(ambiguity(np.full((5, 5), np.inf), places, 1.0))


@pytest.mark.parametrize("world", ["warehouse", "tunnel"])
@pytest.mark.parametrize("method", methods.METHODS)
def test_every_method_answers_for_every_closure(method, world):
    problem = small(world)
    outcome = methods.solve(problem, method)
    assert outcome.accepted.shape == outcome.confidence.shape == problem.true.shape
    assert outcome.values.size() == problem.n_keyframes
    truth = problem.poses(problem.truth)
    assert np.isfinite(list(measures.trajectory_errors(truth, problem.poses(outcome.values)).values())).all()


def test_the_gate_parts_true_from_false_on_a_training_seed():
    problem = small(told="identity")
    assert measures.f1(problem.true, methods.solve(problem, "gate").accepted) > 0.95


def test_a_doubtful_false_closure_is_overturned_by_the_revisits_that_it_shuts_out():
    problem = worlds.problem("streets", 1005)
    accepted = methods.solve(problem, "gate").accepted
    early = [tuple(closure.at(0).keys()) for closure in problem.closures].index((88, 190))
    assert not problem.true[early]
    assert not accepted[early]
    assert accepted[problem.true].all()


def test_the_truth_has_no_error_and_a_shift_of_all_poses_neither():
    problem = small()
    moved = gtsam.Values()
    for key, pose in enumerate(problem.poses(problem.truth)):
        moved.insert(key, gtsam.Pose2(3, 4, 0.5).compose(pose))
    assert max(measures.trajectory_errors(problem.poses(problem.truth), problem.poses(moved)).values()) < 1e-9


def test_ranks_by_hand():
    true = np.array([True, True, False, True])
    assert measures.area_under_curve(true, np.array([4.0, 3, 2, 1])) == pytest.approx(2 / 3)
    assert measures.area_under_curve(np.ones(3, dtype=bool), np.zeros(3)) is None
    assert measures.precisions(true, np.array([4.0, 3, 2, 1])) == [1.0] * 6 + [0.75] * 4
    assert measures.precisions(true, np.zeros(4)) == [0.75] * 10
    assert measures.precisions(np.zeros(0, dtype=bool), np.zeros(0)) == [0.0] * 10


def test_a_method_that_takes_too_long_is_given_up_and_the_next_one_answers():
    helper, problem = Helper(), small()
    with pytest.raises(TimeoutError, match=r"0.01 s"):
        helper.solve(problem, "gate", 0.01)
    assert helper.solve(problem, "no gate", 60.0).accepted.all()
    helper.close()


def test_known_rows_are_kept_a_torn_one_is_run_again_and_all_is_drawn(tmp_path, monkeypatch):
    wanted = [Trial("warehouse", 1001, "right", 1.0, name) for name in ("no gate", "Cauchy")]
    path = tmp_path / "rows.jsonl"
    first = sweep.run(path, wanted, trials.row, None, lambda _: None, limit_s=60.0)
    lines = path.read_text().splitlines()
    assert len(lines) == 2
    path.write_text(lines[0] + "\n" + lines[1][: len(lines[1]) // 2])
    again = sweep.run(path, wanted, trials.row, None, lambda _: None, limit_s=60.0)
    assert path.read_text().splitlines()[0] == lines[0]
    assert len(path.read_text().splitlines()) == 2
    timeless = [[{k: v for k, v in row.items() if "seconds" not in k} for row in rows] for rows in (first, again)]
    assert timeless[0] == timeless[1]
    assert all(json.loads(line)["f1"] >= 0 for line in lines)
    figure.draw(again, tmp_path / "rows.png")
    maps.draw([small()], tmp_path / "maps.png")
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in ("rows.png", "maps.png"))
    assert "| no gate |" in tables.table(again, "setting")
    assert tables.summary(again).count("\n") == 3


def test_a_trial_that_fails_is_a_row_that_says_so():
    row = trials.row(Trial("warehouse", 1001, "right", 1.0, "Λ_glob rule"), 0.01)
    assert row["f1"] == 0.0
    assert "0.01 s" in row["failed"]
    assert tables.table([row], "setting").splitlines()[-1].endswith("| 1 of 1 |")
    assert f"| warehouse | {row['ambiguity']:.2f} |" in tables.ambiguities([row])


def test_trials_name_each_pair_once():
    wanted = list(trials.world_trials(["offices"], [0, 1]))
    assert len(set(wanted)) == len(wanted)
    assert {trial.setting for trial in wanted if trial.method == trials.SLOW} == {"right", "identity"}
    assert {trial.setting for trial in wanted if trial.method == "gate"} == set(worlds.TOLD)


def test_drift_trials_try_every_kind_by_every_method():
    wanted = list(trials.drift_trials(["offices"], [0]))
    assert {(trial.setting, trial.method) for trial in wanted} == {
        (kind, method) for kind in drift.KINDS for method in trials.DRIFT_METHODS
    }
    usual, other = (trials.problem("warehouse", 1001, kind, 1.0) for kind in ("the drift", "twice the drift"))
    assert [c.at(0).keys() for c in usual.closures] == [c.at(0).keys() for c in other.closures]
    assert not usual.graph.at(1).measured().equals(other.graph.at(1).measured(), 1e-6)


def test_intervals_hold_their_mean_and_collapse_without_spread():
    assert tables.mean_and_interval([0.5, 0.5]) == (0.5, 0.5, 0.5)
    mean, low, high = tables.mean_and_interval([0.0, 1.0, 1.0])
    assert low <= mean <= high


@pytest.mark.parametrize("kind", field.KINDS)
def test_outliers_of_standard_graphs_are_far_from_true_and_the_rest_is_the_file(kind):
    path = GRAPHS / "MIT.g2o"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    problem = field.problem(path, 1000, 0.5, kind)
    assert (problem.true.sum(), (~problem.true).sum()) == (20, 10)
    poses, gaps = problem.poses(problem.truth), []
    for closure, true in zip(problem.closures, problem.true, strict=True):
        i, j = closure.at(0).keys()
        if not true:
            assert np.linalg.norm(poses[i].between(poses[j]).translation()) > field.APART_M
            gaps.append(j - i)
    if "grouped" in kind:
        assert len(set(gaps)) <= 3


def test_the_truth_of_a_graph_is_an_optimum_that_its_measurements_bear_out():
    path = GRAPHS / "MIT.g2o"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    given = field.problem(path, 1000, 0.05)
    kept = methods.joined(given, given.true)
    assert 2 * kept.error(given.truth) < stats.chi2.ppf(field.BORNE_OUT, 3 * given.true.sum())


def square(*measured):
    """Four poses on a square's corners, each a step from the next, and closures from the first to the last."""
    noise, prior = (gtsam.noiseModel.Isotropic.Sigma(3, s) for s in (0.05, 1e-3))
    corner, values = gtsam.Pose2(1, 0, np.pi / 2), gtsam.Values()
    odometry = [gtsam.PriorFactorPose2(0, gtsam.Pose2(), prior)]
    odometry += [gtsam.BetweenFactorPose2(k, k + 1, corner, noise) for k in range(3)]
    for k, pose in enumerate(accumulate([corner] * 3, gtsam.Pose2.compose, initial=gtsam.Pose2())):
        values.insert(k, pose)
    closures = [gtsam.BetweenFactorPose2(0, 3, gtsam.Pose2(*pose), noise) for pose in measured]
    return graph_of(odometry), closures, values


def test_a_graph_that_no_trajectory_explains_has_no_truth():
    odometry, closures, values = square((0, 1, -np.pi / 2), (30, 30, 0))
    assert field.true_poses(odometry, closures[:1], values, values).size() == 4
    with pytest.raises(InvalidOptionError, match="between 0 and 3"):
        field.true_poses(odometry, closures, values, values)


def ring(n, *wrong):
    """Poses on a ring in space, each a step from the next and the last tied to the first; vertices turned at random."""
    noise, prior = (gtsam.noiseModel.Isotropic.Sigma(6, s) for s in (0.05, 1e-3))
    random, step, values = (
        np.random.default_rng(0),
        gtsam.Pose3(gtsam.Rot3.Yaw(2 * np.pi / n), [1, 0, 0]),
        gtsam.Values(),
    )
    truth = list(accumulate([step] * (n - 1), gtsam.Pose3.compose, initial=gtsam.Pose3()))
    odometry = [gtsam.PriorFactorPose3(0, gtsam.Pose3(), prior)]
    odometry += [gtsam.BetweenFactorPose3(k, k + 1, step, noise) for k in range(n - 1)]
    for k, pose in enumerate(truth):
        values.insert(k, gtsam.Pose3(gtsam.Rot3.Expmap(random.normal(size=3, scale=2.0)), pose.translation()))
    closures = [gtsam.BetweenFactorPose3(0, n - 1, pose, noise) for pose in (truth[-1], *wrong)]
    return graph_of(odometry), closures, values


def test_a_graph_in_space_whose_vertices_lead_astray_has_the_optimum_of_its_chordal_start():
    odometry, closures, values = ring(12)
    whole = graph_of([*(odometry.at(k) for k in range(odometry.size())), *closures])
    assert whole.error(gtsam.LevenbergMarquardtOptimizer(whole, values).optimize()) > 100
    assert whole.error(field.true_poses(odometry, closures, values, values)) < 1e-6


def test_a_graph_in_space_that_no_trajectory_explains_has_no_truth():
    with pytest.raises(InvalidOptionError, match="all closures"):
        field.true_poses(*ring(12, gtsam.Pose3(gtsam.Rot3(), [30, 0, 0])), gtsam.Values())


@pytest.mark.parametrize("method", ["IPC", "ROVER"])
def test_what_bends_the_square_is_refused_and_what_closes_it_is_not(method):
    odometry, closures, values = square((0, 1, -np.pi / 2), (30, 30, 0), (0.01, 1, -np.pi / 2))
    given = Problem(
        name="square",
        graph=odometry,
        values=values,
        closures=tuple(alone(closure) for closure in closures),
        true=np.array([True, False, True]),
        overlapping=np.ones(3, dtype=bool),
        radii=0.5,
        truth=values,
    )
    np.testing.assert_array_equal(methods.solve(given, method).accepted, given.true)


def test_a_standard_graph_in_space():
    path = GRAPHS / "parking-garage.g2o"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    problem = field.problem(path, 1000, 0.01)
    assert not problem.planar
    assert problem.n_keyframes == 1661
    assert (~problem.true).sum() == round(0.01 * problem.true.sum())
