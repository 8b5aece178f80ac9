"""The command line as a person uses it: output, files, exit codes, and one line for every bad input."""

import json
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

import pgti_gtsam
from pgti_gtsam import datasets
from pgti_gtsam.datasets import formats

SQUARE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 5 0 1.57
VERTEX_SE2 2 5 5 3.14
VERTEX_SE2 3 0 5 -1.57
VERTEX_SE2 4 0 0.5 -1.57
EDGE_SE2 0 1 5 0 1.57 1 0 0 1 0 1
EDGE_SE2 1 2 5 0 1.57 1 0 0 1 0 1
EDGE_SE2 2 3 5 0 1.57 1 0 0 1 0 1
EDGE_SE2 3 4 4.5 0 0 1 0 0 1 0 1
"""
DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


def test_without_a_file_kitti_00_is_audited(run, tmp_path):
    page, found = tmp_path / "map.html", tmp_path / "map.json"
    code, out, err = run("audit", "--html", page, "--json", found)
    assert (code, err) == (0, "")
    document = json.loads(found.read_text())
    assert document["summary"]["n_keyframes"] == 135
    assert document["adaptation"]["edges"] == {"between": 134, "covisibility": 1178}
    assert document["adaptation"]["n_landmarks"] == 26136
    assert document["adaptation"]["n_observations"] == 88781
    assert 5 < document["summary"]["n_inserted_edges"] < 20
    assert document["verdict"]["level"] == "consistent"
    assert document["verdict"]["text"] in " ".join(out.split())
    assert document["places"] == []
    assert page.stat().st_size > 1_000_000


def test_a_second_pass_that_nothing_ties_is_named_and_proposed(run, square, tmp_path):
    code, out, _ = run("audit", square, "--radius", 0.3, "--proposals", tmp_path / "ties.g2o")
    assert code == 0
    assert out.startswith("square: ")
    assert "4 passes through 0 again" in out
    proposed = datasets.read(tmp_path / "ties.g2o")
    assert list(proposed.graph.at(0).keys()) == [0, 4]


def test_the_optimum_is_audited_where_that_is_asked_for(run, tmp_path):
    stale = SQUARE.replace("VERTEX_SE2 2 5 5 3.14", "VERTEX_SE2 2 9 5 3.14")
    (tmp_path / "stale.g2o").write_text(stale)
    _, as_stored, _ = run("audit", tmp_path / "stale.g2o", "--radius", 0.3)
    assert 0 < as_stored.index("The estimate is no optimum") < as_stored.index("Scores")
    assert "--optimise" in as_stored
    _, best, _ = run("audit", tmp_path / "stale.g2o", "--radius", 0.3, "--optimise")
    assert best.startswith("stale: ")
    assert "the optimum is audited" in best


def test_the_radius_is_taken_from_closures_and_tried_smaller_and_larger(run, square, tmp_path):
    code, _, err = run("audit", square, "--radius", "auto")
    assert code == 2
    assert "closures" in err
    tied = tmp_path / "tied.g2o"
    tied.write_text(SQUARE + "EDGE_SE2 0 4 0 0.5 0 1 0 0 1 0 1\n")
    found = tmp_path / "found.json"
    code, out, _ = run("audit", tied, "--radius", "auto", "--radius-sweep", "--json", found)
    assert code == 0
    assert "the median distance of keyframes that closures tie" in " ".join(out.split())
    rows = json.loads(found.read_text())["radius_sweep"]["rows"]
    assert [row["factor"] for row in rows] == [0.25, 0.5, 1.0, 2.0, 4.0]


@pytest.mark.parametrize(("level", "code"), [("incomplete", 1), ("inconsistent", 0)])
def test_a_map_fails_from_the_verdict_on_that_is_asked_for(run, square, level, code):
    assert run("audit", square, "--radius", 0.3, "--fail-on", level)[0] == code


@pytest.mark.parametrize(("limit", "code"), [(100, 0), (1e-3, 1)])
def test_a_map_above_the_limit_fails(run, square, limit, code):
    assert run("audit", square, "--radius", 0.3, "--fail-above", limit)[0] == code


def test_an_archived_graph_gives_what_the_library_gives(run, tmp_path):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i in range(6):
        angle = i * np.pi / 3
        values.insert(X(i), gtsam.Pose2(np.cos(angle), np.sin(angle), angle))
    for i in range(5):
        step = values.atPose2(X(i)).between(values.atPose2(X(i + 1)))
        graph.push_back(gtsam.BetweenFactorPose2(X(i), X(i + 1), step, gtsam.noiseModel.Unit.Create(3)))
    (tmp_path / "graph.txt").write_text(graph.serialize())
    (tmp_path / "values.txt").write_text(values.serialize())
    found = tmp_path / "found.json"
    command = ("audit", tmp_path / "graph.txt", "--values", tmp_path / "values.txt", "--radius", 0.51, "--json", found)
    assert run(*command)[0] == 0
    assert json.loads(found.read_text())["edges"]["collisions"] == [[0, 5]]


def test_lines_that_are_left_out_on_request_are_in_the_headline(run, square):
    square.write_text(SQUARE + "EDGE_SE2_FANCY 0 4 1 2 3\n" * 785)
    code, out, err = run("audit", square, "--radius", 0.3)
    assert (code, out) == (2, "")
    assert "785 'EDGE_SE2_FANCY' tie two poses" in err
    code, out, _ = run("audit", square, "--radius", 0.3, "--ignore-unknown")
    assert code == 0
    assert out.startswith("square without 785 unknown edges: ")


def test_notes_on_what_was_read_come_with_a_later_error(run, square):
    square.write_text(SQUARE + "EDGE_PRIOR_FANCY 0 1 2 3\n")
    code, _, err = run("audit", square)
    assert code == 2
    assert "--radius" in err.splitlines()[0]
    assert "  note: ignored lines: 1 'EDGE_PRIOR_FANCY'" in err.splitlines()


def test_help_names_every_format_of_the_list(run):
    _, out, _ = run("audit", "--help")
    said = "".join(out.split())
    assert all("".join(format.name.split()) in said for format in formats.FORMATS)


SCRIPT = "<script>alert(1)</script>"
BAD_FILES = {
    "binary noise": (bytes(range(256)) * 40, "g2o"),
    "empty": (b"", ""),
    "truncated line": (SQUARE.replace("EDGE_SE2 1 2 5 0 1.57 1 0 0 1 0 1", "EDGE_SE2 1 2 5 0"), "line 7"),
    "pose that is no number": (SQUARE.replace("VERTEX_SE2 2 5 5 3.14", "VERTEX_SE2 2 nan 5 3.14"), "line 3"),
    "edge to a missing vertex": (SQUARE.replace("EDGE_SE2 3 4", "EDGE_SE2 3 77"), "77"),
    "graph without poses": ("VERTEX_XY 3 1 2\n", "pose"),
    "hostile label": (SQUARE.replace("VERTEX_SE2 2 5", f"VERTEX_SE2 {SCRIPT} 5"), "line 3"),
    "unknown format": ("hello world\n", "g2o"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_ends_with_one_line_and_code_2_and_stays_as_it_was(run, tmp_path, name):
    content, words = BAD_FILES[name]
    path, page = tmp_path / "bad.g2o", tmp_path / "page.html"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    before = path.read_bytes()
    code, out, err = run("audit", path, "--radius", 1, "--html", page)
    assert (code, out) == (2, "")
    assert err.startswith("pgti-gtsam: ")
    assert err.count("\n") == 1
    assert words in err
    assert not page.exists()
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["audit", "nowhere.g2o"], "nowhere.g2o"),
        (["audit", "."], "."),
        (["audit", "SQUARE"], "--radius"),
        (["audit", "SQUARE", "--radius", "-1"], "-1"),
        (["audit", "SQUARE", "--radius", "nan"], "nan"),
        (["audit", "SQUARE", "--radius", "two"], "auto"),
        (["audit", "SQUARE", "--radius", "1", "--fail-above", "nan"], "nan"),
        (["audit", "SQUARE", "--radius", "1", "--fail-on", "bad"], "inconsistent"),
        (["audit", "SQUARE", "--radius", "1", "--proposals", "SQUARE"], "input"),
        (["audit", "SQUARE", "--radius", "1", "--beta", "1"], "beta"),
        (["audit", "SQUARE", "--radius", "1", "--min-shared-landmarks", "0"], "min_shared_landmarks"),
        (["audit", "SQUARE", "--radius", "1", "--edges", "loops"], "loops"),
        (["audit", "SQUARE", "--radius", "1", "--html", "SQUARE"], "input"),
        (["audit", "SQUARE", "--radius", "1", "--json", "nowhere/found.json"], "existing folder"),
        (["audit", "SQUARE", "--radius", "1", "--cloud", "cloud.ply"], "--radius or --cloud"),
        (["audit", "SQUARE", "--values", "SQUARE"], "values"),
    ],
)
def test_bad_options_end_with_one_line_and_code_2(run, square, words, expected):
    code, out, err = run(*[str(square) if word == "SQUARE" else word for word in words])
    assert (code, out) == (2, "")
    assert err.startswith("pgti-gtsam: ")
    assert err.count("\n") == 1
    assert expected in err
    assert square.read_text() == SQUARE


@pytest.mark.parametrize(
    ("name", "options", "n_keyframes"),
    [
        ("scan_pose_graphs/mit-cscail.log", [], 1051),
        ("kitti_robustslam/06/kitti_06_alpha_0.95.g2o", ["--radius", "4"], 1101),
    ],
)
def test_real_maps_are_audited(run, tmp_path, name, options, n_keyframes):
    if not (DATA / name).exists():
        pytest.skip(f"{DATA / name} is not here")
    found = tmp_path / "found.json"
    assert run("audit", DATA / name, *options, "--json", found)[0] == 0
    assert json.loads(found.read_text())["summary"]["n_keyframes"] == n_keyframes


def test_version_and_short_help(run):
    assert run("--version")[1].strip() == f"pgti-gtsam {pgti_gtsam.__version__}"
    code, out, _ = run("audit", "-h")
    assert code == 0
    assert "--radius" in out
