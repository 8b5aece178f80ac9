"""Mending where something lacks: no common points, thin scans, dense clouds, answers that the others contradict."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
import test_mend
from optional import needs_open3d
from test_mend import N_LAP, UNIT, aligned, as_graph, lap, points, ring_walls, wanted

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.errors import FileFormatError, InvalidOptionError
from pgti_gtsam.mending import alignment as aligning
from pgti_gtsam.mending.common_view import CommonView
from pgti_gtsam.mending.exchange import open_ties, ties_in
from pgti_gtsam.mending.starts import MOST, SPACING, starts
from pgti_gtsam.mending.submap import ENOUGH, Submap, Submaps, moved
from pgti_gtsam.mending.verdicts import sensors_say
from pgti_gtsam.track import track_of

ring = test_mend.ring  # two laps: true poses, ranges, drifted odometry
SIGMAS = [0.3, 0.3, 0.05]
SMALL = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)


def room(pose):
    """Points on the walls, the floor and two pillars of a room, seen from a pose in space."""
    random = np.random.default_rng(4)
    a, b = random.uniform(0, 1, (2, 3000))
    walls = [np.c_[8 * a, y + 0 * a, 3 * b] for y in (0, 5)]
    walls += [np.c_[0 * a, 5 * a, 3 * b], np.c_[8 * a, 5 * b, 0 * a]]
    pillars = [np.c_[x + 0.3 * np.cos(7 * a), y + 0.3 * np.sin(7 * a), 3 * b] for x, y in ((2.0, 3.0), (6.0, 1.5))]
    return np.array([pose.transformTo(point) for point in np.concatenate([*walls, *pillars])[::3]])


def test_clouds_in_space_are_aligned_in_space():
    poses = [gtsam.Pose3(gtsam.Rot3.Yaw(yaw), [x, 2.0, 1.0]) for x, yaw in ((3.0, 0.0), (4.0, 0.3))]
    first, second = (aligning.Cloud.of(Submap(view=own, points=own), UNIT) for own in map(room, poses))
    true, sigmas = poses[0].between(poses[1]), [0.02, 0.02, 0.1, 0.3, 0.3, 0.05]
    predicted = true.retract(np.array([0.01, 0.01, 0.05, 0.2, -0.1, 0.05]))
    found = aligning.align(first, second, predicted, np.diag(np.square(sigmas)))
    assert np.linalg.norm(true.localCoordinates(found.pose)) < 0.03
    asked = replace(wanted(gtsam.Pose2(), SIGMAS), pose=predicted, covariance=np.diag(np.square(sigmas)))
    assert sensors_say(asked, found, UNIT)[0] == "confirmed"


def test_clouds_without_a_point_near_each_other_are_not_matched():
    found = aligned(ring_walls(), lap(1)[3], lap(1)[5], gtsam.Pose2(500.0, 0, 0), SIGMAS)
    assert found is None
    assert sensors_say(wanted(gtsam.Pose2(500.0, 0, 0), SIGMAS), found, UNIT) == (
        "undecided",
        "Nothing in the two clouds lies near enough to match.",
    )


@pytest.mark.parametrize(
    ("view", "off", "outcome", "said"),
    [
        ({"agreement": 0.5, "seen": 0.9}, 0.0, "refused", "puts 50 % of the points where the other keyframe saw free"),
        ({"agreement": 1.0, "seen": 0.05}, 0.0, "undecided", "little in view in common: 5 % of the points"),
        ({"agreement": 0.85, "seen": 0.9}, 0.0, "undecided", "puts 15 % of the points where"),
        ({"agreement": 1.0, "seen": 0.9}, 3.0, "refused", "lies 3 m from where the drift model predicts it, give or"),
    ],
)
def test_the_sensors_say_why_a_fit_is_not_confirmed(view, off, outcome, said):
    predicted = gtsam.Pose2(1.6, 0.0, 0.0)
    found = aligned(ring_walls(), lap(1)[10], lap(1)[12], predicted, SIGMAS)
    assert sensors_say(wanted(predicted, SIGMAS), found, UNIT)[0] == "confirmed"
    found = replace(found, view=CommonView(**view), pose=found.pose.compose(gtsam.Pose2(0, off, 0)))
    told = sensors_say(wanted(predicted, SIGMAS), found, UNIT)
    assert told[0] == outcome
    assert said in told[1]


def test_a_view_that_nothing_confirms_weighs_nothing():
    assert CommonView(agreement=0.0, seen=0.0).weight == -np.inf


def test_starts_in_a_vast_region_are_as_many_as_are_tried():
    found = starts(gtsam.Pose2(), np.diag(np.square([100.0, 50.0, 1.0])), UNIT)
    assert MOST / 2 < len(found) <= MOST
    assert found[0].equals(gtsam.Pose2(), 1e-9)
    apart = np.abs([start.translation() for start in found]).max(axis=0)
    assert (apart > 4 * SPACING).all()


def test_a_dense_cloud_needs_no_neighbours_and_a_thin_one_has_theirs():
    clouds = {0: np.ones((ENOUGH, 3)), 1: np.ones((5, 3)), 2: np.zeros((5, 3))}
    graph, values = as_graph([gtsam.Pose2(1.0, 0, 0)] * 2, gtsam.Pose2())
    track = pgti.from_gtsam(graph, values, radii=UNIT)
    poses = [values.atPose2(k) for k in range(3)]
    submaps = Submaps(clouds=pgti.scans_of(clouds), keys=[0, 1, 2], poses=poses, track=track_of(track), unit_m=UNIT)
    assert len(submaps.at(0).points) == ENOUGH
    assert len(submaps.at(1).points) == ENOUGH + 10
    np.testing.assert_allclose(submaps.at(1).points[5:10], np.tile([1.0, 0, 0], (5, 1)))  # keyframe 2 is a metre ahead


def test_points_move_with_poses_of_the_plane_and_of_space():
    ahead = np.array([[1.0, 0.0, 0.5]])
    np.testing.assert_allclose(moved(ahead, gtsam.Pose2(2, 3, np.pi / 2)), [[2.0, 4.0, 0.5]], atol=1e-12)
    space = gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), [2, 3, 7])
    np.testing.assert_allclose(moved(ahead, space), [[2.0, 4.0, 7.5]], atol=1e-12)
    np.testing.assert_allclose(moved(ahead[:, :2], space), [[2.0, 4.0]], atol=1e-12)


def test_scans_of_a_few_points_leave_ties_undecided(ring):
    truth, ranges, steps = ring
    graph, values = as_graph(steps, truth[0])
    few = pgti.scans_of({key: points(own)[:3] for key, own in enumerate(ranges)})
    found = pgti.mend(graph, values, few, radii=UNIT)
    assert {attempt.outcome for attempt in found.attempts} == {"undecided"}
    assert all("near enough to match" in attempt.reason for attempt in found.attempts)


def test_an_answer_that_all_the_other_ties_contradict_is_out_again(ring):
    """The gate lets a tie pass that drift allows; a tie that nobody asked for may not miss by so much."""
    truth, _, steps = ring
    graph, values = as_graph(steps, truth[0])
    off = {30: gtsam.Pose2(0.0, 1.6, 0.0)}
    ties = {k: truth[k].between(truth[k + N_LAP]).compose(off.get(k, gtsam.Pose2())) for k in (2, 14, 30, 46, 58)}
    matched = [gtsam.BetweenFactorPose2(k, k + N_LAP, pose, SMALL) for k, pose in ties.items()]
    found = pgti.mend(graph, values, radii=UNIT, matched=matched)
    answers = {attempt.keys[0]: attempt for attempt in found.attempts if attempt.wanted is None}
    assert {k for k, attempt in answers.items() if attempt.outcome != "confirmed"} == {30}
    assert "Out again: all other ties put its later keyframe 1.6 m away, give or take" in answers[30].reason
    assert found.graph.nrFactors() == graph.size() + len(matched) - 1


def test_answers_that_the_gate_refuses_tie_nothing(ring):
    truth, _, steps = ring
    graph, values = as_graph(steps, truth[0])
    found = pgti.mend(graph, values, radii=UNIT, matched=[gtsam.BetweenFactorPose2(3, 40, gtsam.Pose2(), SMALL)])
    (answer,) = (attempt for attempt in found.attempts if attempt.wanted is None)
    assert answer.outcome == "refused"
    assert found.graph.size() == graph.size()


def test_proposals_are_the_wanted_ties_that_nothing_confirmed(ring):
    truth, _, steps = ring
    graph, values = as_graph(steps, truth[0])
    true = truth[3].between(truth[3 + N_LAP])
    found = pgti.mend(graph, values, radii=UNIT, matched=[gtsam.BetweenFactorPose2(3, 3 + N_LAP, true, SMALL)])
    proposed, poses = open_ties(found)
    asked = [attempt for attempt in found.attempts if attempt.wanted is not None]
    assert found.of("confirmed")
    assert [tuple(proposed.at(k).keys()) for k in range(proposed.size())] == [attempt.keys for attempt in asked]
    assert set(poses.keys()) == {key for attempt in asked for key in attempt.keys}


def test_a_file_of_ties_may_have_other_factors_and_no_other_keyframes(tmp_path):
    graph, values = as_graph([gtsam.Pose2(1.0, 0, 0)] * 3, gtsam.Pose2())
    datasets.write_g2o(graph, values, tmp_path / "map.g2o")
    vertices = "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(4))
    edge = "EDGE_SE2 0 {} 3 0 0 100 0 0 100 0 400\n"
    (tmp_path / "ties.g2o").write_text(f"{vertices}VERTEX_XY 9 1 1\nEDGE_SE2_XY 0 9 1 1 10 0 20\n{edge.format(3)}")
    dataset = datasets.read(tmp_path / "map.g2o")
    (tie,) = ties_in(tmp_path / "ties.g2o", dataset)
    assert tuple(tie.keys()) == (0, 3)
    (tmp_path / "ties.g2o").write_text(f"{vertices}VERTEX_SE2 7 3 0 0\n{edge.format(7)}")
    with pytest.raises(InvalidOptionError, match=r"expected ties between keyframes of the map, got 7 in .*ties\.g2o"):
        ties_in(tmp_path / "ties.g2o", dataset)


def test_a_cloud_without_a_number_in_its_name_is_left_out(tmp_path):
    for name in ("map.pcd", "3.pcd"):
        (tmp_path / name).touch()
    assert {key: path.name for key, path in pgti.clouds_in(tmp_path, [3, 4]).files.items()} == {3: "3.pcd"}
    with pytest.raises(FileFormatError, match="found no folder"):
        pgti.clouds_in(tmp_path / "nowhere", [3])


@needs_open3d
def test_a_cloud_of_no_finite_point_is_refused(tmp_path):
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    (tmp_path / "5.pcd").write_text(header + "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA ascii\nnan 0 0\n")
    with pytest.raises(FileFormatError, match="found no finite point"):
        pgti.clouds_in(tmp_path, [5]).points(5)
