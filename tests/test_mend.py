"""Mending: wrong closures out, ties that scans confirm in, and nothing that they do not."""

import json
from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np
import pytest
from browser import dom_of_page, needs_chromium
from optional import needs_open3d

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.errors import FileFormatError
from pgti_gtsam.mending import alignment as aligning
from pgti_gtsam.mending.common_view import View, common_view
from pgti_gtsam.mending.records import Wanted
from pgti_gtsam.mending.starts import starts
from pgti_gtsam.mending.submap import Submap
from pgti_gtsam.mending.verdicts import free_allowance_m, sensors_say, tie
from pgti_gtsam.report.mended import mended_document, write_mended_page

pytest.importorskip("small_gicp", reason='pip install "pgti-gtsam[match]"')

UNIT = 1.0
STEP = 0.8
N_LAP = 65
BEARINGS = 2 * np.pi * np.arange(240) / 240 - np.pi


def box(x, y, width, height):
    """The four sides of a box, (4, 2, 2)."""
    corners = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def ring_walls():
    """A corridor around a block, with pillars that are nowhere alike."""
    random = np.random.default_rng(3)
    pillars = [box(*random.uniform(0.3, 15.2, 2), *random.uniform(0.2, 0.5, 2)) for _ in range(60)]
    apart = [pillar for pillar in pillars if not ((pillar > 0.9) & (pillar < 15.1)).all(axis=2).any()]
    return np.concatenate([box(0, 0, 16, 16), box(3, 3, 10, 10), *apart])


def scan(walls, pose, reach=20.0):
    """Where rays from a pose end, seen from there, (n, 2)."""
    angles = BEARINGS + pose.theta()
    rays, origin = np.stack([np.cos(angles), np.sin(angles)], axis=1), np.asarray(pose.translation())
    start, side = walls[:, 0] - origin, walls[:, 1] - walls[:, 0]
    cross = rays[:, None, 0] * side[:, 1] - rays[:, None, 1] * side[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (start[:, 0] * side[:, 1] - start[:, 1] * side[:, 0]) / cross
        across = (start[:, 0] * rays[:, None, 1] - start[:, 1] * rays[:, None, 0]) / cross
    hit = (along > 1e-6) & (across >= 0) & (across <= 1)
    ranges = np.where(hit, along, np.inf).min(axis=1)
    ranges = np.where(ranges < reach, ranges, np.inf)
    return ranges


def points(ranges):
    seen = np.isfinite(ranges)
    return ranges[seen, None] * np.stack([np.cos(BEARINGS[seen]), np.sin(BEARINGS[seen])], axis=1)


def lap(n_laps):
    """Poses along the middle of the corridor."""
    poses, side = [], 13.0
    for k in range(round(n_laps * 4 * side / STEP)):
        way = (k * STEP) % (4 * side)
        edge, at = divmod(way, side)
        x, y = [(1.5 + at, 1.5), (14.5, 1.5 + at), (14.5 - at, 14.5), (1.5, 14.5 - at)][int(edge)]
        poses.append(gtsam.Pose2(x, y, edge * np.pi / 2))
    return poses


@pytest.fixture(scope="module")
def ring():
    """Two laps: true poses, ranges, drifted odometry."""
    truth, random, walls = lap(2), np.random.default_rng(1), ring_walls()
    ranges = [scan(walls, pose) + random.normal(0, 0.01, len(BEARINGS)) for pose in truth]
    steps = [
        a.between(b).compose(gtsam.Pose2.Expmap(random.normal(0, [0.01, 0.01, 0.004]) + [0, 0, 0.0015]))
        for a, b in pairwise(truth)
    ]
    return truth, ranges, steps


def as_graph(steps, start):
    graph, values, model = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Isotropic.Sigma(3, 0.02)
    values.insert(0, start)
    for k, step in enumerate(steps):
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, step, model))
        values.insert(k + 1, values.atPose2(k).compose(step))
    return graph, values


@pytest.fixture(scope="module")
def mended(ring):
    """Odometry alone but for one closure that is false."""
    truth, ranges, steps = ring
    graph, values = as_graph(steps, truth[0])
    graph.add(gtsam.BetweenFactorPose2(10, 60, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 0.05)))
    before = graph.size(), values.atPose2(100).matrix().copy()
    clouds = pgti.scans_of({key: points(own) for key, own in enumerate(ranges)})
    found = pgti.mend(graph, values, clouds, radii=UNIT)
    assert (graph.size(), True) == (before[0], np.array_equal(values.atPose2(100).matrix(), before[1]))
    return found


def test_the_false_closure_is_out_and_true_ties_are_in(ring, mended):
    truth, _, steps = ring
    assert set(mended.out) == {len(steps)}
    assert len(mended.of("confirmed")) >= 5
    for attempt in mended.of("confirmed"):
        i, j = attempt.keys
        off = truth[i].between(truth[j]).between(attempt.pose)
        assert np.linalg.norm(off.translation()) < 0.15
        assert abs(off.theta()) < 0.05


def test_the_mended_map_lies_nearer_to_the_truth(ring, mended):
    truth, _, steps = ring
    _, drifted = as_graph(steps, truth[0])

    def worst(values):
        return max(np.linalg.norm(values.atPose2(k).translation() - pose.translation()) for k, pose in enumerate(truth))

    assert worst(mended.values) < 0.35 * worst(drifted)
    assert mended.after.verdict == "consistent"


def test_a_consistent_map_stays_as_it_is(ring, mended):
    truth, ranges, _ = ring
    clouds = pgti.scans_of({key: points(own) for key, own in enumerate(ranges)})
    again = pgti.mend(mended.graph, mended.values, clouds, radii=UNIT)
    assert again.before.verdict == "consistent"
    assert (again.attempts, dict(again.out)) == ((), {})
    assert all(again.values.atPose2(k).equals(mended.values.atPose2(k), 1e-3) for k in range(len(truth)))


def test_every_attempt_says_why(mended):
    assert all(attempt.reason.endswith(".") for attempt in mended.attempts)


def test_without_scans_ties_are_proposed_and_answers_are_judged(ring):
    truth, _, steps = ring
    graph, values = as_graph(steps, truth[0])
    proposed = pgti.mend(graph, values, radii=UNIT)
    assert proposed.attempts
    assert {attempt.outcome for attempt in proposed.attempts} == {"undecided"}
    assert all("no scan or cloud" in attempt.reason for attempt in proposed.attempts)

    # a matcher that is right, and one answer that is wrong
    model = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    answers = [gtsam.BetweenFactorPose2(k, k + N_LAP, truth[k].between(truth[k + N_LAP]), model) for k in (3, 20, 40)]
    wrong = gtsam.BetweenFactorPose2(30, 30 + N_LAP, gtsam.Pose2(6, 6, 1), model)
    judged = pgti.mend(graph, values, radii=UNIT, matched=[*answers, wrong])
    outcome = {attempt.keys: attempt.outcome for attempt in judged.attempts if attempt.wanted is None}
    assert outcome == {**{(k, k + N_LAP): "confirmed" for k in (3, 20, 40)}, (30, 30 + N_LAP): "refused"}


def wanted(pose, sigmas):
    return Wanted(
        keyframes=(0, 1),
        keys=(0, 1),
        place=None,
        pose=pose,
        covariance=np.diag(np.square(sigmas)),
        allowance_m=max(sigmas[:2]),
    )


def aligned(walls, first, second, predicted, sigmas):
    seen = [points(scan(walls, pose)) for pose in (first, second)]
    clouds = [aligning.Cloud.of(Submap(view=own, points=own), UNIT) for own in seen]
    return aligning.align(*clouds, predicted, np.diag(np.square(sigmas)))


def test_a_blank_corridor_gives_no_information_along_it():
    walls = np.array([[[-60.0, -1], [60, -1]], [[-60, 1], [60, 1]]])
    predicted, sigmas = gtsam.Pose2(0.5, 0.1, 0.02), [0.1, 0.1, 0.03]
    found = aligned(walls, gtsam.Pose2(), gtsam.Pose2(0.4, 0.0, 0.0), predicted, sigmas)
    assert found.pose.x() == pytest.approx(predicted.x(), abs=0.01)  # nothing but the prediction says
    assert found.pose.y() == pytest.approx(0.0, abs=0.02)
    information = tie(wanted(predicted, sigmas), found, UNIT, 1.0).noiseModel().information()
    assert information[0, 0] < 1e-3 * information[1, 1]
    assert free_allowance_m(wanted(predicted, sigmas), found, UNIT) == pytest.approx(0.1, rel=0.05)
    assert sensors_say(replace(wanted(predicted, sigmas), place="missed closure"), found, UNIT)[0] == "confirmed"
    assert sensors_say(wanted(predicted, sigmas), found, UNIT)[0] == "undecided"
    loose = replace(wanted(predicted, [1.0, 0.1, 0.03]), place="missed closure")
    assert sensors_say(loose, found, UNIT)[0] == "undecided"


def doors(every):
    """A corridor of 40 m with a recess in its left wall every so many metres."""
    steps = np.arange(-20.0, 20.0, every)
    walls = [[[-20.0, -1], [20, -1]], *([[x, 1], [x + every - 0.6, 1]] for x in steps)]
    walls += [wall for x in steps + every for wall in ([[x - 0.6, 1], [x - 0.6, 1.5]], [[x - 0.6, 1.5], [x, 1.5]])]
    return np.array(walls)


def test_a_corridor_that_fits_at_the_next_door_is_left_open():
    sigmas = [1.5, 0.1, 0.03]
    fit = aligned(doors(2.0), gtsam.Pose2(), gtsam.Pose2(0.3, 0, 0), gtsam.Pose2(0.5, 0, 0), sigmas)
    assert fit.rival.weight > 0.8 * fit.view.weight
    assert sensors_say(wanted(gtsam.Pose2(0.5, 0, 0), sigmas), fit, UNIT)[0] == "undecided"


def test_a_cluttered_room_is_held_in_all_directions():
    found = aligned(ring_walls(), lap(1)[10], lap(1)[12], gtsam.Pose2(1.4, 0.1, 0.05), [0.3, 0.3, 0.05])
    assert np.allclose(found.pose.translation(), [2 * STEP, 0], atol=0.03)
    assert sensors_say(wanted(gtsam.Pose2(1.4, 0.1, 0.05), [0.3, 0.3, 0.05]), found, UNIT)[0] == "confirmed"


def test_scans_of_other_places_are_not_confirmed():
    predicted, sigmas = gtsam.Pose2(0.2, 0.0, 0.0), [0.3, 0.3, 0.05]
    found = aligned(ring_walls(), lap(1)[3], lap(1)[30], predicted, sigmas)
    assert sensors_say(wanted(predicted, sigmas), found, UNIT)[0] != "confirmed"


def test_a_point_in_free_space_contradicts_and_one_behind_a_wall_does_not():
    ends = points(scan(box(-2, -2, 4, 4), gtsam.Pose2()))
    views = View.of(ends), View.of(ends)
    same = common_view(views, (ends, ends), 0.2)
    assert (same.agreement, same.seen, same.weight) == (1.0, 1.0, 1.0)
    assert common_view(views, (0.5 * ends, 0.5 * ends), 0.2).agreement == 0.0
    assert common_view(views, (2 * ends, 2 * ends), 0.2).seen == 0.0


def test_starts_begin_at_the_prediction_and_stay_in_the_region():
    covariance = np.diag(np.square([2.0, 0.1, 0.01]))
    found = starts(gtsam.Pose2(1, 2, 0.3), covariance, UNIT)
    assert found[0].equals(gtsam.Pose2(1, 2, 0.3), 1e-9)
    offs = np.array([gtsam.Pose2(1, 2, 0.3).localCoordinates(start) for start in found])
    assert np.ptp(offs[:, 0]) >= 4.0
    assert np.allclose(offs[:, 1:], 0, atol=1e-9)


@pytest.mark.parametrize(
    ("names", "keys", "expected"),
    [
        (["key_point_frame/3.pcd", "key_point_frame/7.pcd"], [3, 7, 9], {3: "3.pcd", 7: "7.pcd"}),
        (["000000/cloud.pcd", "000001/cloud.pcd"], [0, 1], {0: "cloud.pcd", 1: "cloud.pcd"}),
        (["1.ply", "2.ply"], [10, 20], {10: "1.ply", 20: "2.ply"}),
    ],
)
def test_clouds_are_found_by_number_or_by_order(tmp_path, names, keys, expected):
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert {key: path.name for key, path in pgti.clouds_in(tmp_path, keys).files.items()} == expected


@pytest.mark.parametrize(
    ("names", "said"),
    [([], "found none"), (["1.pcd"], "numbers such as 1"), (["1.pcd", "a/1.ply"], "number 1")],
)
def test_clouds_that_fit_no_keyframe_are_refused(tmp_path, names, said):
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(FileFormatError, match=said):
        pgti.clouds_in(tmp_path, [10, 20])


@needs_open3d
def test_a_cloud_is_read_from_a_file(tmp_path):
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\n"
    header += "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n"
    (tmp_path / "5.pcd").write_text(header + "1 2 3\nnan 0 0\n")
    assert pgti.clouds_in(tmp_path, [5]).points(5).tolist() == [[1, 2, 3]]


@pytest.fixture(scope="module")
def log(ring, tmp_path_factory):
    """The ring as a FLIRTLib scan graph without loops."""
    truth, ranges, steps = ring
    _, values = as_graph(steps, truth[0])
    lines = []
    for key, own in enumerate(ranges):
        pose = values.atPose2(key)
        place = f"{pose.x()} {pose.y()} {pose.theta()}"
        told = " ".join(f"{r:.3f}" for r in np.where(np.isfinite(own), own, 81.91))
        header = f"0 {-np.pi} {2 * np.pi} {2 * np.pi / len(own)} 50 0.1 0 {len(own)}"
        lines.append(f"VERTEX2 {key} {place}")
        lines.append(f"ROBOTLASER1 {header} {told} 0 {place} {place} 0 0 0 0 0 {key} x {key}")
    for k, step in enumerate(steps):
        lines.append(f"EDGE2 {k} {k + 1} {step.x()} {step.y()} {step.theta()} 2500 0 2500 2500 0 0")
    path = tmp_path_factory.mktemp("ring") / "ring.log"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_command_mends_a_file_that_stays_as_it_was(run, log, tmp_path):
    text = log.read_bytes()
    out, told, page = tmp_path / "fixed.g2o", tmp_path / "told.json", tmp_path / "told.html"
    code, said, _ = run("mend", log, "--out", out, "--json", told, "--html", page)
    assert code == 0
    assert log.read_bytes() == text
    document = json.loads(told.read_text())
    confirmed = [attempt for attempt in document["attempts"] if attempt["outcome"] == "confirmed"]
    assert f"{len(confirmed)} ties in" in said
    assert len(confirmed) >= 5
    assert len(datasets.read(out).closures or ()) in (0, len(confirmed))
    assert datasets.read(out).graph.size() == len(confirmed) + datasets.read(log).graph.size()

    # a human's choice goes back in, without a scan
    ties = tmp_path / "ties.g2o"
    ties.write_text("\n".join([*document["g2o_vertices"], *(attempt["g2o"] for attempt in confirmed[:4])]) + "\n")
    bare = tmp_path / "bare.g2o"
    dataset = datasets.read(log)
    datasets.write_g2o(dataset.graph, dataset.values, bare)
    code, said, _ = run("mend", bare, "--radius", 1, "--loops", ties, "--dry-run")
    assert code == 0
    assert "4 ties in" in said


def test_a_dry_run_writes_no_map_and_proposals_are_a_file_for_a_matcher(run, log, tmp_path):
    bare, out, proposals = (tmp_path / name for name in ("bare.g2o", "fixed.g2o", "proposals.g2o"))
    dataset = datasets.read(log)
    datasets.write_g2o(dataset.graph, dataset.values, bare)
    code, _, _ = run("mend", bare, "--radius", 1, "--dry-run", "--out", out, "--proposals", proposals)
    assert code == 0
    assert not out.exists()
    assert datasets.read(proposals).graph.size() > 0
    assert run("mend", bare, "--radius", 1)[0] == 2


def document_of(mended):
    """Everything on the page, with a name that must stay text."""
    graph, false = gtsam.NonlinearFactorGraph(mended.graph), next(iter(mended.out))
    graph.replace(false, gtsam.BetweenFactorPose2(10, 60, gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3)))
    return mended_document(mended, graph, name="</script><b>ring", file_format="fabricated")


def test_a_page_far_from_the_origin_draws_walls_beside_their_keyframes(mended):
    far, moved = gtsam.Pose2(5e5, 5e6, 0.0), gtsam.Values()
    for key in mended.values.keys():  # noqa: SIM118
        moved.insert(key, far.compose(mended.values.atPose2(key)))
    after = document_of(replace(mended, values=moved))["after"]
    expected = [[*moved.atPose2(int(key)).translation()] for key in mended.after.pose_graph.keys]
    np.testing.assert_allclose(np.array(after["pose"])[:, :2], expected, atol=1e-5, rtol=0)


@needs_chromium
def test_the_page_draws_itself(mended, tmp_path):
    write_mended_page(document_of(mended), tmp_path / "page.html")
    dom = dom_of_page(tmp_path / "page.html")
    assert "data-errors" not in dom
    assert dom.count(">confirmed</strong>") == len(mended.of("confirmed"))
