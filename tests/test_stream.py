"""The gate in a pipeline: lines in, verdicts out, the same as those of `GatedISAM2`."""

import json

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import RADIUS, block, driven, straight

from pgti_gtsam.gate import GatedISAM2, LoopClosureGate
from pgti_gtsam.stream import Journal, Session

LAP = 4 * 12  # steps around a block of 20 m
GATE = LoopClosureGate()
NOWHERE = gtsam.Pose2()


@pytest.fixture(scope="module")
def world():
    return driven(block(20, times=2) + straight(10), bias=0.002, noise=0.005)


def edge(i, j, measured):
    """An edge as g2o text."""
    if isinstance(measured, gtsam.Pose2):
        return f"EDGE_SE2 {i} {j} {measured.x()!r} {measured.y()!r} {measured.theta()!r} 400 0 0 400 0 10000"
    x, y, z, w = (measured.rotation().toQuaternion().coeffs()).tolist()
    information = "400 0 0 0 0 0 400 0 0 0 0 400 0 0 0 10000 0 0 10000 0 10000"
    return f"EDGE_SE3:QUAT {i} {j} {' '.join(map(repr, [*measured.translation().tolist(), x, y, z, w]))} {information}"


def steps(world, first, last):
    """Lines of the odometry that leads to some keyframes."""
    return [edge(k - 1, k, world.graph.at(k - 1).measured()) for k in range(first, last)]


def closing(world, i, j, measured=None):
    return edge(i, j, world.truth[i].between(world.truth[j]) if measured is None else measured)


def told(session, lines):
    return [answer for line in lines for answer in session.answers(line)]


def begun(world, last, radius_m=RADIUS):
    session = Session.started(GATE, radius_m)
    assert told(session, steps(world, 1, last)) == []
    return session


def test_a_step_is_odometry_and_an_edge_between_two_known_vertices_a_closure(world):
    session = begun(world, LAP + 6)
    true, false = told(session, [closing(world, LAP + 5, 5), closing(world, 30, LAP + 5, NOWHERE)])
    assert (true["line"], true["id"], true["keys"], true["verdict"]) == (LAP + 6, 0, [LAP + 5, 5], "accepted")
    assert (false["line"], false["id"], false["accepted"]) == (LAP + 7, 1, False)
    assert true["probability"] > 0.95 > 0.05 > false["probability"]
    assert true["changed"] is false["changed"] is False
    assert true["reasons"] != false["reasons"] != []
    assert true["global_score"]["rise"] == true["global_score"]["after"] - true["global_score"]["before"]
    json.dumps([true, false], allow_nan=False)
    pose = session.isam.calculateEstimatePose2(LAP + 5)
    assert pose.equals(world.truth[LAP + 5], 0.3)


def test_the_verdicts_in_space_and_in_the_plane_are_those_of_the_smoother(world):
    spatial = driven([gtsam.Pose3(step) for step in block(20, times=2)], bias=0.002, noise=0.003)
    for drive in (world, spatial):
        is_planar = drive is world
        session, isam = begun(drive, 1), GatedISAM2(radii=RADIUS)
        kind = "Pose2" if is_planar else "Pose3"
        model = gtsam.noiseModel.Isotropic.Sigma(3 if is_planar else 6, 1e-3)
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factors.push_back(getattr(gtsam, f"PriorFactor{kind}")(0, drive.truth[0], model))
        values.insert(0, drive.truth[0])
        isam.update(factors, values)
        for k in range(1, LAP + 12):
            measured = drive.graph.at(k - 1).measured()
            factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            factors.push_back(drive.graph.at(k - 1))
            values.insert(k, getattr(isam, f"calculateEstimate{kind}")(k - 1).compose(measured))
            isam.update(factors, values)
            lines, closures = steps(drive, k, k + 1), []
            if k in (LAP + 3, LAP + 6, LAP + 9):
                nowhere = type(measured)() if k % 2 else None
                closures, lines = [drive.closure(k - LAP, k, nowhere)], [*lines, closing(drive, k - LAP, k, nowhere)]
            answers, update = told(session, lines), isam.update(closures=closures) if closures else None
            assert [answer["verdict"] for answer in answers] == (
                [] if update is None else [update.decisions[0].verdict]
            )
            if update is not None:
                assert np.isclose(answers[0]["log_odds"], update.decisions[0].log_odds, rtol=1e-3)


@pytest.mark.parametrize(("bias", "off", "verdict"), [(0.01, 0.0, "accepted"), (0.002, 5.0, "rejected")])
def test_a_changed_mind_is_told_by_the_line_of_the_closure(bias, off, verdict):
    world = driven(block(20, times=2) + straight(10), bias=bias, noise=0.005)
    session = begun(world, LAP + 11)
    measured = world.truth[3].between(world.truth[LAP + 3]).compose(gtsam.Pose2(off, off, 0.0))
    (first,) = told(session, [json.dumps({"g2o": edge(3, LAP + 3, measured), "id": "first"})])
    assert first["verdict"] == "undecided"
    session = Session.resumed(json.loads(json.dumps(session.state())), GATE)
    later = told(session, [closing(world, k, LAP + k) for k in (4, 5, 6, 7, 9)])
    changed = [(answer["id"], answer["line"], answer["verdict"]) for answer in later if answer["changed"]]
    assert ("first", LAP + 11, verdict) in changed
    assert session.undecided == 0


def test_an_edge_to_a_vertex_that_is_not_there_waits_for_it(world):
    session = begun(world, LAP + 4)
    lines = [closing(world, 5, LAP + 5), closing(world, 6, LAP + 6)]
    assert told(session, lines) == []
    session = Session.resumed(json.loads(json.dumps(session.state())), GATE)
    answers = told(session, steps(world, LAP + 4, LAP + 6))
    assert [(answer["line"], answer["verdict"]) for answer in answers] == [(LAP + 4, "accepted")]
    (left,) = session.end()
    assert left["line"] == LAP + 5
    assert f"leads to {LAP + 6}" in left["error"]


def test_vertices_first_and_edges_in_any_order_are_one_map(world):
    session = Session.started(GATE, RADIUS)
    vertices = [f"VERTEX_SE2 {k} 0 0 0" for k in range(LAP + 6)]
    answers = told(session, [*vertices, closing(world, 5, LAP + 5), *reversed(steps(world, 1, LAP + 6))])
    assert [answer["verdict"] for answer in answers] == ["accepted"]
    assert session.n_variables == LAP + 6
    assert session.end() == []


def test_robots_are_told_by_their_letters(world):
    a, b = (lambda k: gtsam.symbol("a", k)), (lambda k: gtsam.symbol("b", k))
    measured = [world.graph.at(k).measured() for k in range(LAP)]
    session = Session.started(GATE, RADIUS)
    lines = [edge(a(k), a(k + 1), measured[k]) for k in range(LAP)]
    lines += [edge(b(k), b(k + 1), measured[k]) for k in range(10)]
    assert told(session, [*lines, edge(a(4), b(5), world.truth[4].between(world.truth[5]))]) == []
    assert session.n_variables == LAP + 1 + 11
    (answer,) = told(session, [edge(a(9), b(9), NOWHERE)])
    assert answer["verdict"] == "accepted"


def test_a_json_line_says_what_it_holds(world):
    session = begun(world, LAP + 6)
    skip = world.truth[LAP + 3].between(world.truth[LAP + 5])
    assert told(session, [json.dumps({"g2o": edge(LAP + 3, LAP + 5, skip), "kind": "odometry"})]) == []
    lost = edge(3, 200, world.truth[3].between(world.truth[LAP + 6]))
    assert told(session, [json.dumps({"g2o": [lost, edge(200, 201, NOWHERE)], "kind": "odometry"})]) == []
    assert session.isam.valueExists(201)
    two = [closing(world, k, LAP + k) for k in (4, 5)]
    (answer,) = told(session, [json.dumps({"g2o": two, "kind": "closure", "id": 17})])
    assert (answer["id"], answer["keys"], answer["accepted"]) == (17, [4, LAP + 4, 5, LAP + 5], True)


def test_landmarks_give_radii_and_their_sightings_can_be_a_closure(world):
    session, seen = begun(world, 2, radius_m=None), []
    for k in range(2, LAP + 6):
        told(session, steps(world, k, k + 1))
        for n in range(3):
            place = world.truth[k].transformFrom(np.array([1.0 + n, 2.0 - n]))
            seen.append(place)
            if k <= LAP:
                x, y = world.truth[k].transformTo(place)
                assert told(session, [f"EDGE_SE2_XY {k} {3 * k + n} {x} {y} 400 0 400"]) == []
    again = [world.truth[LAP + 5].transformTo(place) for place in seen[9:12]]
    lines = [f"EDGE_SE2_XY {LAP + 5} {3 * 5 + n} {x} {y} 400 0 400" for n, (x, y) in enumerate(again)]
    (answer,) = told(session, [json.dumps({"g2o": lines, "kind": "closure"})])
    assert answer["verdict"] == "accepted"
    assert "drift" in answer["terms"]


def test_what_comes_before_its_vertex_or_its_landmark_waits_for_it(world):
    session = Session.started(GATE, RADIUS)
    early = ["EDGE_SE2_XY 0 1 1 2 400 0 400", "EDGE_BEARING_SE2_XY 1 2 0.5 400", "VERTEX_XY 2 3 1"]
    assert told(session, [*early, *steps(world, 1, 3)]) == []
    assert session.n_variables == 4
    assert [answer["line"] for answer in session.end()] == [2]
    session = Session.resumed(json.loads(json.dumps(session.state())), GATE)
    assert told(session, ["EDGE_SE2_XY 2 2 1 1 400 0 400"]) == session.end() == []
    assert session.n_variables == 5


def test_where_a_sensor_sits_can_be_said_again():
    session, seen = Session.started(GATE, RADIUS), "EDGE_SE3_TRACKXYZ 0 1 0 1 2 3 1 0 0 1 0 1"
    parameter = "PARAMS_SE3OFFSET 0 {} 0 0 0 0 0 1"
    lines = ["VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1", parameter.format(9), parameter.format(1), seen]
    assert told(session, lines) == []
    assert np.allclose(session.isam.calculateEstimatePoint3(gtsam.symbol("l", 1)), [2, 2, 3])
    (answer,) = told(session, ["PARAMS_SE3OFFSET 0 1"])
    assert "expected 9 fields" in answer["error"]


def test_radii_come_by_the_line(world):
    session = begun(world, LAP + 6, radius_m=None)
    (answer,) = told(session, [closing(world, 5, LAP + 5)])
    assert "radii" in answer["error"]
    told(session, [f"RADIUS {k} {RADIUS}" for k in range(0, LAP + 20)])
    (answer,) = told(session, [json.dumps({"g2o": closing(world, 5, LAP + 5), "radii": {"3": 2.5}})])
    assert answer["accepted"]
    assert session.isam.radii == {k: 2.5 if k == 3 else RADIUS for k in range(LAP + 6)}


BAD = {
    "EDGE_SE2 1 2 x 0 0 1 0 0 1 0 1": "expected a finite number",
    "EDGE_SE2 1 2 1 0": "expected 6 or",
    "EDGE_SE2 1 1 1 0 0 1 0 0 1 0 1": "from a vertex to itself",
    "EDGE_SE2 1 -2 1 0 0 1 0 0 1 0 1": "identifier from 0 on",
    "EDGE_SE3:QUAT 1 2 0 0 0 0 0 0 1": "expected a line of a planar map",
    "EDGE_SE2_XY 1 2 0 0 1 0 1": "range zero",
    "EDGE_TWO 1 2": "expected a g2o line",
    "# 1 2 ROBUST Huber": "expected a loss",
    "RADIUS 1 0": "above 0 m",
    '{"g2o": "EDGE_SE2 1 2 0 0 0"': "neither",
    '{"g2o": 3}': "line or a list",
    '{"g20": ""}': "expected the fields",
    '{"g2o": "", "kind": "loop"}': "odometry or closure",
    '{"radii": {"-1": 2}}': "expected an identifier",
    '{"radii": {"1": NaN}}': "above 0 m",
    '{"id": 1.5}': "whole number",
}


@pytest.mark.parametrize("line", BAD)
def test_a_bad_line_is_refused_by_its_number_and_changes_nothing(line, world):
    session = begun(world, 5, radius_m=None)
    before = session.state()
    answers = told(session, [line, *(["EDGE_SE2 1 2 0 0 0"] if line.startswith("#") else [])])
    assert [answer["line"] for answer in answers] == [session.n_lines]
    assert BAD[line] in answers[0]["error"]
    assert "\n" not in answers[0]["error"]
    assert session.state() | {"line": before["line"]} == before


WORDS = ["EDGE_SE2", "VERTEX_SE2", "EDGE_SE2_XY", "RADIUS", "EDGE_SE3:QUAT", "PARAMS_SE3OFFSET", "EDGE_SE3_OFFSET", "#"]
WORDS += ["0", "1", "2", "3", "-1", "0.5", "1e400", "nan", "9999999999999999999", "ROBUST", "{", '"g2o":', "}"]


NUMBERS = st.sampled_from(["0", "1", "-1", "0.3", "1e-20", "1e9", "1e29"])
EDGES = st.tuples(st.integers(0, 5), st.integers(0, 5), st.lists(NUMBERS, min_size=9, max_size=9))
LINES = st.one_of(
    st.lists(st.sampled_from(WORDS), max_size=12).map(" ".join),
    st.text(max_size=20),
    EDGES.map(lambda edge: f"EDGE_SE2 {edge[0]} {edge[1]} {' '.join(edge[2])}"),
)


@settings(max_examples=30, deadline=None)
@given(st.lists(LINES, max_size=8))
def test_no_line_ends_a_session(lines):
    session = Session.started(GATE, 1.0)
    answers = [*told(session, [line.replace("\n", " ") for line in lines]), *session.end()]
    json.dumps(answers, allow_nan=False)
    assert session.n_lines == len(lines)


def test_a_line_that_is_cut_off_is_refused_and_not_counted(world):
    session = begun(world, 5)
    (answer,) = session.end("EDGE_SE2 4 5 1 0 0")
    assert answer["line"] == 5
    assert "line break" in answer["error"]
    assert (session.n_lines, session.n_variables) == (4, 5)


def test_a_journal_loses_no_line_and_repeats_what_may_have_got_lost(world, tmp_path):
    lines = [*steps(world, 1, LAP + 6), closing(world, 30, LAP + 5, NOWHERE), closing(world, 4, LAP + 4)]
    journal = Journal(tmp_path / "state.json")
    session, first = journal.opened(GATE, RADIUS)
    assert first == []
    answers = []
    for line in lines:
        answers += session.answers(line)
        journal.note(session, line.encode() + b"\n")
    journal._lines.write(b"99 EDGE_SE2 5 3")  # killed in the middle of a line
    journal._lines.flush()
    journal._lock.close()

    session, first = Journal(tmp_path / "state.json").opened(GATE)
    where = {"line": len(lines), "variables": LAP + 6, "undecided": 0}
    assert first[0] == {"resumed": where}
    assert [answer.pop("again") for answer in first[1:]] == [True, True]
    assert first[1:] == answers
    session, first = Journal(tmp_path / "state.json").opened(GATE)
    assert first == [{"resumed": where}]
