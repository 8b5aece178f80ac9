"""What a session on disk refuses, when its state is written anew, and what no line of a pipeline may say."""

import json

import gtsam
import numpy as np
import pytest
from streets import RADIUS, block, driven
from test_stream import GATE, NOWHERE, begun, closing, edge, steps, told

from pgti_gtsam.errors import FileFormatError
from pgti_gtsam.stream import Journal, Session, journal


@pytest.fixture(scope="module")
def world():
    return driven(block(20), bias=0.002, noise=0.005)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"schema": "pgti-gtsam/audit", "schema_version": 1}', "expected a state of pgti-gtsam/stream-state 1"),
        ('{"schema": "pgti-gtsam/stream-state", "schema_version": 7}', "got another; name another file"),
        ("[]", "got another JSON document"),
    ],
)
def test_a_file_that_is_no_state_is_refused_and_stays_as_it_was(tmp_path, text, said):
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=said):
        Journal(path).opened(GATE)
    assert path.read_text() == text
    assert [each.name for each in tmp_path.iterdir()] == ["state.json"]  # no lock is left beside


def test_a_session_goes_on_with_its_own_radius_only_and_keeps_its_lines(world, tmp_path):
    kept = Journal(tmp_path / "state.json")
    session, _ = kept.opened(GATE, RADIUS)
    for line in steps(world, 1, 4):
        session.answers(line)
        kept.note(session, line.encode() + b"\n")
    kept._lock.close()
    with pytest.raises(FileFormatError, match="expected the radii that the map was begun with, got 7 m"):
        Journal(tmp_path / "state.json").opened(GATE, 7.0)
    session, first = Journal(tmp_path / "state.json").opened(GATE, RADIUS)
    assert first == [{"resumed": {"line": 3, "variables": 4, "undecided": 0}}]


def test_the_state_is_written_anew_after_some_lines(world, tmp_path, monkeypatch):
    monkeypatch.setattr(journal, "EVERY", 3)
    kept = Journal(tmp_path / "state.json")
    session, _ = kept.opened(GATE, RADIUS)
    left = []
    for line in steps(world, 1, 6):
        session.answers(line)
        kept.note(session, line.encode() + b"\n")
        left.append(kept.lines_path.read_bytes().count(b"\n"))
    assert left == [1, 2, 0, 1, 2]


def test_radii_are_of_all_keyframes_or_of_each_and_above_zero(world):
    (answer,) = told(begun(world, 4), ["RADIUS 1 2.0"])
    assert f"all have {RADIUS:g} m; leave one of the two out" in answer["error"]
    session = begun(world, 4, radius_m=None)
    for radius in (0, -1.5):
        (answer,) = told(session, [f"RADIUS 1 {radius}"])
        assert f"expected a radius above 0 m, got {radius:g} for 1" in answer["error"]
    (answer,) = told(session, [json.dumps({"radii": [1, 2]})])
    assert "expected radii as identifiers with metres" in answer["error"]
    (answer,) = told(session, [json.dumps({"radii": {"x1": 2}})])
    assert "expected an identifier" in answer["error"]


def test_a_closure_makes_no_keyframe_and_waits_with_what_follows_from_it(world):
    session = begun(world, 4)
    waiting = json.dumps({"g2o": edge(3, 9, NOWHERE), "kind": "closure"})
    assert told(session, [waiting, "EDGE_BEARING_SE2_XY 3 0 0.5 400"]) == []
    assert session.n_variables == 4
    (left,) = session.end()
    assert "expected odometry that leads to 9" in left["error"]
    assert "so do 1 later lines" in left["error"]


def test_a_position_from_a_satellite_does_not_start_a_keyframe():
    session, position = Session.started(GATE, RADIUS), "EDGE_SE3_PRIORXYZ {} 1 0 0 66 0 0 66 0 33"
    assert told(session, [edge(0, 1, gtsam.Pose3()), position.format(1), position.format(7)]) == []
    assert session.n_variables == 2
    (left,) = session.end()
    assert left["line"] == 3


def test_a_resumed_session_answers_as_one_that_never_broke(world, tmp_path):
    lines = [*steps(world, 1, 48), closing(world, 0, 47)]
    whole = told(Session.started(GATE, RADIUS), lines)
    kept = Journal(tmp_path / "state.json")
    session, _ = kept.opened(GATE, RADIUS)
    answers = told(session, lines[:20])
    kept.end(session)
    session, _ = Journal(tmp_path / "state.json").opened(GATE)
    answers += told(session, lines[20:])
    assert [answer["verdict"] for answer in answers] == [answer["verdict"] for answer in whole] != []
    np.testing.assert_allclose([a["log_odds"] for a in answers], [a["log_odds"] for a in whole], rtol=1e-6)
