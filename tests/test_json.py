"""Every JSON document that a command writes is what its schema says, down to the last field."""

import io
import json

import gtsam
import numpy as np
import pytest
from json_schemas import SCHEMAS, check
from jsonschema import Draft202012Validator

from pgti_gtsam import encode
from pgti_gtsam.gate import LoopClosureGate
from pgti_gtsam.stream import Session, serve

LINES = ("decision", "stream")  # schemas of single lines, which carry no version


def laps(path, is_false=True):
    """Four laps of a ring with closures between them, one of them false if asked for."""
    angles = np.arange(32) * np.pi / 8
    poses = [gtsam.Pose2(10 * np.cos(a), 10 * np.sin(a), a + np.pi / 2) for a in angles]
    ties = [(i, i + 1) for i in range(31)] + [(0, 16), (3, 19), (8, 24)]
    measured = {(i, j): poses[i].between(poses[j]) for i, j in ties}
    measured |= {(2, 10): gtsam.Pose2()} if is_false else {}
    lines = [f"VERTEX_SE2 {k} {pose.x()} {pose.y()} {pose.theta()}" for k, pose in enumerate(poses)]
    lines += [f"EDGE_SE2 {i} {j} {z.x()} {z.y()} {z.theta()} 100 0 0 100 0 400" for (i, j), z in measured.items()]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("maps")


@pytest.fixture(scope="module")
def ring(folder):
    return laps(folder / "ring.g2o")


def written(run, path, *words):
    code, _, err = run(*words, path)
    assert (code, err) == (0, "")
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", SCHEMAS)
def test_schemas_are_schemas(name):
    Draft202012Validator.check_schema(SCHEMAS[name])


@pytest.mark.parametrize("name", encode.VERSIONS)
def test_schemas_have_the_version_that_is_written(name):
    text = json.dumps(SCHEMAS[name])
    assert SCHEMAS[name]["$id"] == f"pgti-gtsam/{name}/{encode.VERSIONS[name]}"
    assert f'"schema_version": {{"const": {encode.VERSIONS[name]}' in text


def test_every_document_has_a_schema():
    assert {*encode.VERSIONS, *LINES} == set(SCHEMAS)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("audit", ("audit",)),
        ("audit", ("audit", "--radius-sweep")),
        ("closures", ("gate",)),
        ("closures", ("closures",)),
        ("mend", ("mend", "--dry-run")),
    ],
)
def test_a_map_in_json(run, ring, tmp_path, name, words):
    check(name, written(run, tmp_path / "found.json", *words, ring, "--radius", 2, "--json"))


def test_heat_in_json(run, ring, tmp_path):
    check("diffusion", written(run, tmp_path / "found.json", "diffusion", ring, "--json"))


def test_a_map_without_any_overlap(run, folder, tmp_path):
    path = folder / "pair.g2o"
    path.write_text("EDGE_SE2 0 1 9 0 0 1 0 0 1 0 1\n")
    check("audit", written(run, tmp_path / "found.json", "audit", path, "--radius", 1, "--json"))


def test_decisions_line_by_line(run, ring, tmp_path):
    run("gate", ring, "--radius", 2, "--decisions", tmp_path / "lines")
    lines = (tmp_path / "lines").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 4
    for line in lines:
        check("decision", json.loads(line))


def test_a_replay_line_by_line(run, ring, tmp_path):
    run("replay", ring, "--radius", 2, "--json", tmp_path / "lines")
    lines = (tmp_path / "lines").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + 32
    for line in lines:
        check("replay", json.loads(line))


def test_one_audit_against_another(run, ring, tmp_path):
    good = laps(tmp_path / "good.g2o", is_false=False)
    old, new = tmp_path / "old.json", tmp_path / "new.json"
    run("audit", good, "--radius", 2, "--json", old)
    run("audit", ring, "--radius", 2, "--json", new)
    found = written(run, tmp_path / "found.json", "compare", old, new, "--json")
    check("comparison", found)
    assert found["is_worse"]


def test_a_stream_answer_by_answer(ring):
    edges = [line for line in ring.read_text().splitlines() if line.startswith("EDGE")]
    sink = io.BytesIO()
    serve(Session.started(LoopClosureGate(), 2.0), [*(f"{line}\n".encode() for line in edges), b"nonsense\n"], sink)
    answers = [json.loads(line) for line in sink.getvalue().splitlines()]
    assert sum("verdict" in answer for answer in answers) >= 4
    assert "error" in answers[-1]
    for answer in answers:
        check("stream", answer)


def test_numbers_that_json_lacks():
    numbers = [1.5, np.inf, -np.inf]
    assert [encode.number(each) for each in numbers] == [1.5, "infinite", "-infinite"]
    assert [encode.decoded(encode.number(each)) for each in numbers] == numbers
    assert encode.number(np.nan) is None
    assert np.isnan(encode.decoded(None))
    with pytest.raises(ValueError, match="not JSON compliant"):
        encode.line({"score": np.inf})
