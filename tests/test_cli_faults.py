"""The command line under faults: full devices, closed pipes, names that no terminal should get as they are."""

import io
import json
import os
import sys

import pytest
from test_cli import SQUARE

from pgti_gtsam import cli, datasets
from pgti_gtsam.plain_text import visible

HOSTILE = os.fsdecode(b"map \xff\x1b[31m\xe2\x80\xae<b>.g2o")
SHOWN = "map \\xff\\x1b[31m\\u202e<b>"


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


@pytest.fixture
def hostile(tmp_path):
    path = tmp_path / HOSTILE
    path.write_text(SQUARE)
    return path


def test_hidden_characters_are_escaped_and_others_stay():
    assert visible("Ärger, 京都, Λ") == "Ärger, 京都, Λ"
    assert visible("\x1b]0;\a\n\x9b\u2066\u200b\U000e0041\udcff") == (
        "\\x1b]0;\\x07\\x0a\\x9b\\u2066\\u200b\\U000e0041\\xff"
    )


@pytest.mark.parametrize("command", ["audit", "gate"])
def test_names_are_escaped_in_terminal_document_and_page(run, hostile, command, tmp_path):
    hostile.write_text(SQUARE + "EDGE_SE2 0 4 0 0.5 -1.57 1 0 0 1 0 1\n")
    found, page = tmp_path / "found.json", tmp_path / "page.html"
    code, out, err = run(command, hostile, "--radius", 0.3, "--json", found, "--html", page)
    assert (code, err) == (0, "")
    assert SHOWN in out
    assert not {"\x1b", "\u202e"} & set(out)
    assert json.loads(found.read_text(encoding="utf-8"))["input"]["name"] == SHOWN
    text = page.read_text(encoding="utf-8")
    assert "\u202e" not in text
    assert f"<title>{SHOWN.replace('<', '&lt;').replace('>', '&gt;')}" in text


def test_names_are_escaped_in_errors_and_notes(run, hostile, tmp_path):
    code, _, err = run("audit", hostile.with_name(HOSTILE + "\nnone"))
    assert code == 2
    assert err.count("\n") == 1
    assert f"{SHOWN}.g2o\\x0anone: no such file" in err
    other = tmp_path / "other.g2o"
    other.write_text(SQUARE)
    assert all("\x1b" not in note for note in datasets.read_one_map([hostile, other]).notes)


def test_outputs_and_inputs_that_fail_are_one_line(run, square, tmp_path):
    for words in (
        ["--json", "/dev/full"],
        ["--json", tmp_path / ("n" * 300)],
        ["--json", tmp_path / "none" / "map.json"],
        ["--json", tmp_path],
        ["--cloud", tmp_path],
    ):
        code, out, err = run("audit", square, *(["--radius", 0.3] if words[0] == "--json" else []), *words)
        assert (code, out) == (2, "")
        assert err.startswith("pgti-gtsam: ")
        assert "Traceback" not in err


def test_memory_that_does_not_suffice_is_one_line(run, square, monkeypatch):
    def starved(path, limit=None):
        raise MemoryError

    monkeypatch.setattr("pgti_gtsam.datasets.source.read_bytes", starved)
    code, _, err = run("audit", square, "--radius", 0.3)
    assert code == 2
    assert err.startswith("pgti-gtsam: the memory does not suffice for this map")


def test_a_closed_pipe_ends_quietly(square, monkeypatch, capsys):
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w") as pipe:
        assert code_with_output(pipe, monkeypatch, "audit", square, "--radius", "0.3") == 141
    assert capsys.readouterr().err == ""


def test_a_full_device_as_output_is_one_line(square, monkeypatch, capsys):
    with open("/dev/full", "w") as full:
        assert code_with_output(full, monkeypatch, "audit", square, "--radius", "0.3") == 2
    assert capsys.readouterr().err == "pgti-gtsam: standard output cannot be used: No space left on device\n"


def test_an_ascii_terminal_gets_letters_spelled(square, monkeypatch):
    bytes_ = io.BytesIO()
    with io.TextIOWrapper(bytes_, encoding="ascii") as output:
        assert code_with_output(output, monkeypatch, "audit", square, "--radius", "0.3") == 0
        text = bytes_.getvalue().decode("ascii")
    assert "Lambda" in text
    assert "Zbar" in text


def code_with_output(output, monkeypatch, *words):
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setattr(sys, "argv", ["pgti-gtsam", *map(str, words)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    return stop.value.code or 0
