"""Many maps: each has its row, whatever befalls the others; and one map against its former self."""

import copy
import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from browser import cut_on_a_phone, dom_of_page, needs_chromium, rows_of
from json_schemas import check
from streets import RADIUS, block, driven

from pgti_gtsam import datasets, fleet
from pgti_gtsam.diagnosis import diagnose
from pgti_gtsam.errors import InvalidOptionError, InvalidValueError
from pgti_gtsam.fleet.jobs import WAY_POINTS, summarised
from pgti_gtsam.report.document import audit_document
from pgti_gtsam.report.fleet import fleet_document, gravity, write_fleet_page, write_table

pytest.importorskip("dask.distributed", reason="dask.distributed is missing")
LAP = 4 * 12


def street(folder, name, closures):
    """Two laps around a block as a g2o file, tied here and there."""
    world = driven(block(20, times=2), bias=0.001, noise=0.002)
    for i, j, offset in closures:
        pose = world.truth[i].between(world.truth[j])
        world.graph.push_back(world.closure(i, j, pose.compose(type(pose)(offset, 0.0, 0.0))))
    path = folder / name
    datasets.write_g2o(world.graph, world.values, path)
    return path


TIED = [(k, k + LAP, 0.0) for k in range(0, LAP - 1, 3)]


@pytest.fixture
def maps(tmp_path):
    folder = tmp_path / "maps"
    folder.mkdir()
    street(folder, "good.g2o", TIED)
    street(folder, "untied.g2o", TIED[:4])
    street(folder, "false.g2o", [*TIED, (2, 20, 15.0)])
    (folder / "corrupt.g2o").write_text("EDGE_SE2 0 1 1 0\n")
    (folder / "notes.md").write_text("no map\n")
    return folder


def audit_many(run, *words):
    return run("audit", *words, "--radius", RADIUS, "--limit-mb", "6000")


def test_every_map_has_its_row_and_nothing_is_done_twice(run, maps, tmp_path):
    out = tmp_path / "out"
    code, said, _ = audit_many(run, maps, "--out", out)
    rows = [json.loads(line) for line in (out / "maps.jsonl").read_text().splitlines()]
    verdicts = {Path(row["map"]).name: row.get("verdict", "failed") for row in rows}
    assert code == 0
    assert verdicts["good.g2o"] == "consistent"
    assert verdicts["false.g2o"] == "inconsistent"
    assert verdicts["corrupt.g2o"] == "failed"
    assert "4 maps: " in said
    assert "notes.md" in said
    ranking = json.loads((out / "maps.json").read_text())
    check("fleet", ranking)
    ranked = [row["map"] for row in ranking["maps"]]
    assert Path(ranked[0]).name == "false.g2o"
    assert Path(ranked[-1]).name == "corrupt.g2o"
    with (out / "maps.csv").open(encoding="utf-8") as file:
        assert [row["map"] for row in csv.DictReader(file)] == ranked
    before = (out / "maps.jsonl").read_bytes()
    assert audit_many(run, maps, "--out", out, "--fail-on", "inconsistent")[0] == 1
    assert (out / "maps.jsonl").read_bytes() == before
    assert run("audit", maps, "--radius", RADIUS, "--limit-mb", "5000", "--out", out)[0] == 0
    again = (out / "maps.jsonl").read_text()[len(before.decode()) :].splitlines()
    assert [Path(json.loads(line)["map"]).name for line in again] == ["corrupt.g2o"]  # others are known by now


@pytest.mark.parametrize(("limit", "why"), [({"limit_s": 0.2}, "no verdict after 0.2 s"), ({"limit_mb": 300}, "")])
def test_a_map_that_takes_too_much_is_told_of(maps, tmp_path, limit, why):
    given = {"limit_s": 60.0, "limit_mb": 6000.0} | limit
    job = fleet.AuditJob(map=str(maps / "good.g2o"), words=("--radius", "3"), folder=str(tmp_path), **given)
    row = fleet.audited(job)
    assert why in row["failed"]
    assert "verdict" not in row


def test_what_cannot_be_meant_is_refused(run, maps, tmp_path):
    code, _, error = audit_many(run, maps / "good.g2o", maps / "untied.g2o")
    assert code == 2
    assert "--out" in error
    assert "--one-map" in error
    assert audit_many(run, maps, "--out", tmp_path / "out", "--html", tmp_path / "x.html")[0] == 2
    with pytest.raises(InvalidOptionError, match="does not exist"):
        fleet.maps_in([tmp_path / "nowhere"])
    (tmp_path / "pipes").mkdir()
    os.mkfifo(tmp_path / "pipes" / "endless.g2o")
    with pytest.raises(InvalidOptionError, match="no reader"):
        fleet.maps_in([tmp_path / "pipes"])  # nobody writes into it: reading would never end
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidOptionError, match="no reader"):
        fleet.maps_in([tmp_path / "empty"])


def squared(number, exponent):
    return {"key": str(number), "power": number**exponent}


def test_rows_survive_a_kill_and_come_in_order(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_text(json.dumps({"key": "2", "power": -1}) + "\n" + '{"key": "3", "po')
    told = []
    wanted = {str(k): k for k in range(5)}
    rows = fleet.run(path, wanted, squared, workers=1, exponent=3, progress=lambda done, of: told.append((done, of)))
    assert [row["power"] for row in rows] == [0, 1, -1, 27, 64]
    assert told[0] == (1, 5)
    assert told[-1] == (5, 5)
    path.write_text("[1]\n")
    with pytest.raises(InvalidOptionError, match=r"rows\.jsonl:1"):
        fleet.run(path, wanted, squared, exponent=3)


def test_a_scheduler_that_runs_elsewhere(tmp_path):
    address, dask = tmp_path / "scheduler.json", Path(sys.executable).with_name("dask")
    words = [["scheduler", "--port", "0", "--dashboard-address", ":0"], ["worker", "--nthreads", "1", "--no-dashboard"]]
    started = [
        subprocess.Popen(
            [dask, *each, "--scheduler-file", address], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for each in words
    ]
    try:
        deadline = time.monotonic() + 60
        while not (address.is_file() and address.read_text()):
            assert started[0].poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.1)
        found, job = json.loads(address.read_text())["address"], {"key": "4", "power": 16}
        assert fleet.run(tmp_path / "rows.jsonl", {"4": job}, dict, scheduler=found) == [job]
    finally:
        for process in started:
            process.terminate()
            process.wait(timeout=20)


@pytest.mark.slow
def test_two_workers_are_nearly_twice_as_fast(tmp_path):
    load = os.getloadavg()[0]
    if load > 0.5 or os.cpu_count() < 2:
        pytest.skip(f"the machine is busy (load {load:.1f}) or has one core: nothing can be timed")
    from scenarios.fleet import speedup

    found = speedup.run(tmp_path, n_maps=12, n_pairs=3, tell=lambda line: None)
    assert found["speed_up"] >= 1.7, found


@pytest.fixture(scope="module")
def document():
    world = driven(block(20, times=2), bias=0.001, noise=0.002)
    for i, j, _ in TIED:
        world.graph.push_back(world.closure(i, j))
    found = diagnose(world.graph, world.values, radii=RADIUS)
    return json.loads(json.dumps(audit_document(found, name="street", file_format="made")))


def test_a_map_compared_with_itself_has_not_changed(document):
    same = fleet.compare(document, document)
    assert not same.is_worse
    assert (same.new_places, same.gone_places, same.closures) == ((), (), ())


def test_what_got_worse_is_told_and_the_reverse_is_what_got_better(document, run, tmp_path):
    worse = copy.deepcopy(document)
    worse["verdict"]["level"] = "inconsistent"
    worse["closures"][3]["probability"] = 0.01
    place = {
        "kind": "missed closure",
        "sentence": "Two stretches.",
        "stretches": [[0, 3], [20, 23]],
        "closest": [1, 21],
    }
    worse["places"].append(place)
    found, back = fleet.compare(document, worse), fleet.compare(worse, document)
    assert found.is_worse
    assert not back.is_worse
    assert found.new_places == back.gone_places == (place,)
    assert found.closures[0][1:] == (document["closures"][3]["probability"], 0.01)
    moved = copy.deepcopy(worse)
    moved["places"][-1]["stretches"] = [[21, 25], [2, 5]]
    assert not fleet.compare(worse, moved).new_places
    paths = [tmp_path / name for name in ("old.json", "new.json")]
    for path, each in zip(paths, (document, worse), strict=True):
        path.write_text(json.dumps(each))
    code, said, _ = run("compare", *paths, "--fail-on-worse", "--json", tmp_path / "changed.json")
    assert code == 1
    assert "missed closure: Two stretches." in said
    assert json.loads((tmp_path / "changed.json").read_text())["is_worse"] is True
    assert run("compare", *reversed(paths), "--fail-on-worse")[0] == 0
    assert run("compare", paths[0], tmp_path / "nowhere.json")[0] == 2


def test_two_maps_that_have_nothing_in_common_are_not_compared(document):
    other = copy.deepcopy(document)
    other["keyframes"]["label"] = [f"x{label}" for label in other["keyframes"]["label"]]
    with pytest.raises(InvalidValueError, match="no keyframe in common"):
        fleet.compare(document, other)


def hostile_rows():
    name = "</script><img src=x onerror=document.body.dataset.pwned=1>"
    base = {
        "verdict": "incomplete", "text": name, "score": 1.0, "collision_score": 0.0, "keyframes": 9, "collisions": 4,
        "places": {name: 1}, "false_closures": 0, "least_probable": {"keyframes": [name, name], "probability": 0.2},
        "way": [[0, 0], [1, 0], [1, 1]], "page": name, "document": "d.json", "seconds": 1.0,
    }  # fmt: skip
    rows = [{**base, "key": str(k), "map": f"{name}/{k}.g2o", "collisions": k} for k in range(12)]
    return [*rows, {"key": "z", "map": name, "failed": name}]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e5])
def test_the_picture_of_a_way_keeps_a_thousandth_of_its_size(document, scale):
    positions = scale * np.array(document["keyframes"]["position"])[:WAY_POINTS]
    scaled = copy.deepcopy(document)
    scaled["keyframes"] |= {"position": positions.tolist()}
    way = np.array(summarised(scaled)["way"])
    np.testing.assert_allclose(way, positions[:, :2], rtol=0, atol=np.ptp(positions[:, :2], axis=0).max() / 1000)


def test_the_worst_map_comes_first_and_damage_ranks_maps():
    rows = hostile_rows()[:-1]
    order = [row["collisions"] for row in sorted(rows, key=gravity)]
    assert order == sorted(order, reverse=True)
    assert np.all(np.diff(order) <= 0)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_ranking_is_a_table(tmp_path, suffix):
    pandas = pytest.importorskip("pandas", reason="pandas is missing")
    if suffix == ".parquet":
        pytest.importorskip("pyarrow", reason="PyArrow is missing: pip install 'pgti-gtsam[parquet]'")
    rows = hostile_rows()
    rows[3] |= {"score": "infinite"}
    path = tmp_path / f"maps{suffix}"
    write_table(fleet_document(rows, {}, "maps"), path)
    found = pandas.read_csv(path) if suffix == ".csv" else pandas.read_parquet(path)
    assert found["map"].tolist()[0] == rows[11]["map"]
    assert found["collisions"].dropna().tolist() == list(range(11, -1, -1))
    assert found["failed"].notna().tolist() == [False] * 12 + [True]
    if suffix == ".parquet":
        assert np.isinf(found["score"]).sum() == 1


def test_a_table_that_cannot_be_meant_is_refused(run, maps, tmp_path):
    code, _, error = audit_many(run, maps, "--out", tmp_path / "out", "--table", tmp_path / "maps.xlsx")
    assert code == 2
    assert ".parquet" in error
    code, _, error = audit_many(run, maps / "good.g2o", "--table", tmp_path / "maps.csv")
    assert code == 2
    assert "several maps" in error


@needs_chromium
def test_the_index_page_draws_any_rows_as_text(tmp_path):
    document = fleet_document(hostile_rows(), {"audit": "none"}, "maps", ["a note"])
    write_fleet_page(document, tmp_path / "index.html")
    assert (tmp_path / "index.html").stat().st_size < 100_000  # a page without plots carries no library of plots
    dom = dom_of_page(tmp_path / "index.html")
    assert 'data-ready="true"' in dom
    assert "data-pwned" not in dom
    assert "data-errors" not in dom
    assert len(rows_of(dom, "map-table")) == 12
    assert len(rows_of(dom, "failed-table")) == 1


@needs_chromium
def test_the_index_page_fits_a_phone(tmp_path, monkeypatch):
    document = fleet_document(hostile_rows(), {"audit": "none"}, "maps", ["a note"])
    cut = cut_on_a_phone(
        tmp_path / "index.html", monkeypatch, lambda path: write_fleet_page(document, path), "fleet.js"
    )
    assert cut == "[]"
