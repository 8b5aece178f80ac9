"""The command line in cases that are rare: folders in folders, maps in parts that fail a limit, closed pipes, bars."""

import json
import os
import subprocess
import sys

import pytest
from streets import RADIUS, block, driven
from test_cli import SQUARE

from pgti_gtsam import datasets, fleet
from pgti_gtsam.fleet import jobs

MAIN = [sys.executable, "-c", "from pgti_gtsam.cli import main; main()"]


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


def test_maps_lie_in_folders_within_folders_and_hidden_files_are_left_out(tmp_path):
    for name in ("a/b/deep.g2o", "a/top.g2o", "a/.hidden.g2o", ".git/x.g2o"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(SQUARE)
    (tmp_path / "a/notes.md").write_text("no map\n")
    maps, others = fleet.maps_in([tmp_path])
    assert [path.relative_to(tmp_path).as_posix() for path in maps] == ["a/b/deep.g2o", "a/top.g2o"]
    assert [path.name for path in others] == ["notes.md"]


def test_a_folder_that_is_a_map_is_one_map_whose_name_changes_with_its_bytes(tmp_path):
    model = tmp_path / "model"
    (model / "images").mkdir(parents=True)
    (model / "cameras.txt").write_text("1 SIMPLE_PINHOLE 640 480 500 320 240\n")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 1 0 0 1 b.png\n\n")
    (model / "points3D.txt").write_text("")
    assert fleet.maps_in([tmp_path]) == ([model], [])
    job = fleet.AuditJob(map=str(model), words=(), folder=str(tmp_path), limit_s=1.0, limit_mb=1.0)
    before = job.key
    (model / "points3D.txt").write_text("# none\n")
    assert before.startswith("model-")
    assert job.key != before


@pytest.mark.parametrize(
    ("code", "said", "why"),
    [
        (-9, "", "its process was ended by signal 9"),
        (1, "Traceback\nMemoryError\n", "it takes more memory than 300 MB"),
        (3, "first\nlast line\n", "last line"),
        (3, "", "its process ended with code 3"),
        (2, "noise\npgti-gtsam: expected a map\n", "expected a map"),
    ],
)
def test_why_a_map_of_many_has_no_verdict(tmp_path, square, monkeypatch, code, said, why):
    ended = subprocess.CompletedProcess([], code, stdout="", stderr=said)
    monkeypatch.setattr(jobs.subprocess, "run", lambda *_, **__: ended)
    row = fleet.audited(fleet.AuditJob(map=str(square), words=(), folder=str(tmp_path), limit_s=9.0, limit_mb=300.0))
    assert row["failed"] == why


def test_a_ranking_of_maps_without_a_verdict_is_a_table_all_the_same(run, tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "corrupt.g2o").write_text("EDGE_SE2 0 1 1 0\n")
    out, table = tmp_path / "out", tmp_path / "ranking.csv"
    code, said, _ = run("audit", tmp_path / "maps", "--out", out, "--table", table, "--workers", 1)
    assert code == 0
    assert table.read_text() == (out / "maps.csv").read_text()
    assert "corrupt.g2o: " in said
    assert "what to look at first" not in said
    code, _, error = run("audit", tmp_path / "maps", "--out", out, "--limit-s", 0)
    assert (code, error.count("\n")) == (2, 1)
    assert "expected limits above zero, got 0.0 s" in error


def test_of_many_closures_that_moved_the_rest_is_counted(run, tmp_path, square):
    assert run("audit", square, "--radius", 1, "--json", tmp_path / "old.json")[0] == 0
    old = json.loads((tmp_path / "old.json").read_text())
    closure = {"keyframes": [0, 4], "slot": 0, "is_false": False, "log_odds": 2.0}
    for name, probability in (("old", 0.9), ("new", 0.1)):
        changed = old | {"closures": [closure | {"slot": k, "probability": probability} for k in range(23)]}
        for k, each in enumerate(changed["closures"]):
            each["keyframes"] = [k % 5, k // 5]
        (tmp_path / f"{name}.json").write_text(json.dumps(changed))
    code, said, _ = run("compare", tmp_path / "old.json", tmp_path / "new.json")
    assert code == 0
    assert said.count(": 0.9 → 0.1") == 20
    assert "and 3 more" in said


def test_an_audit_in_parts_tells_of_links_and_fails_as_asked(run, tmp_path):
    """Two robots around the same block twice, untied; one link joins nothing."""
    for seed, name in enumerate("ab"):
        world = driven(block(60, times=2), bias=1e-4, noise=0.002, seed=seed)
        datasets.write_g2o(world.graph, world.values, tmp_path / f"{name}.g2o")
    (tmp_path / "links.g2o").write_text("EDGE_SE2 a4 b4 0 0 0 400 0 0 400 0 10000\n")
    words = ["--one-map", "--links", tmp_path / "links.g2o", "--radius", RADIUS, "--parts", 2, "--workers", 1]
    code, said, _ = run("audit", tmp_path / "a.g2o", tmp_path / "b.g2o", *words, "--fail-on", "incomplete")
    assert code == 1
    assert "Links between maps" in said
    assert "a4 – b4" in said
    assert "incomplete" in said
    assert run("audit", tmp_path / "a.g2o", tmp_path / "b.g2o", *words)[0] == 0


def test_several_files_are_one_map_only_where_that_is_said(run, square):
    code, _, error = run("diffusion", square, square)
    assert (code, error.count("\n")) == (2, 1)
    assert "expected one map, got 2 files; if they are one map say --one-map" in error


def test_a_file_that_may_not_be_written_is_refused_before_the_work(run, square, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda _, mode: mode != os.W_OK)  # a superuser may write everywhere
    code, _, error = run("audit", square, "--radius", 1, "--json", tmp_path / "map.json")
    assert code == 2
    assert "permission denied" in error


@pytest.mark.parametrize("command", ["diffusion", "gate"])
@pytest.mark.parametrize("kind", ["json", "html"])
def test_either_document_may_be_asked_for_alone(run, square, tmp_path, command, kind):
    words = [] if command == "diffusion" else ["--radius", 1]
    assert run(command, square, *words, f"--{kind}", tmp_path / f"found.{kind}")[0] == 0
    assert [path.name for path in tmp_path.iterdir() if path != square] == [f"found.{kind}"]


def test_a_reader_that_leaves_while_a_document_is_written_ends_the_run_quietly(square):
    words = ["audit", str(square), "--radius", "1", "--json", "/dev/stdout"]
    with subprocess.Popen([*MAIN, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(timeout=60) == 141


def test_a_terminal_shows_a_bar_and_none_with_quiet(run, square, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    code, _, shown = run("replay", square, "--radius", 1)
    assert code == 0
    assert "measuring 5 of 5" in shown
    assert run("replay", square, "--radius", 1, "--quiet")[2].strip("\x1b[?25hl\r\n") == ""
