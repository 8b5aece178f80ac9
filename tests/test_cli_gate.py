"""`pgti-gtsam gate` and `closures`: what they print, write and refuse."""

import json
import re
from html import escape
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from streets import RADIUS, block, driven

from pgti_gtsam import datasets

LAP = 4 * 22  # steps around a block of 40 m
TRUE = [(20 + k, 20 + k + LAP) for k in range(0, 9, 3)]
FALSE = [(5, 60), (12, 130)]
NOWHERE = gtsam.Pose2()
KITTI = Path(__file__).parents[2] / "shared" / "data" / "kitti_robustslam" / "07" / "kitti_07_alpha_0.25.g2o"


@pytest.fixture(scope="module")
def world():
    """Two laps around a block, three true closures and two false ones."""
    world = driven(block(40, times=2), bias=0.002, noise=0.005)
    for ends in TRUE:
        world.graph.push_back(world.closure(*ends))
    for ends in FALSE:
        world.graph.push_back(world.closure(*ends, NOWHERE))
    return world


@pytest.fixture
def streets(world, tmp_path):
    """The world as a g2o file, with labels beside it."""
    path = tmp_path / "streets.g2o"
    datasets.write_g2o(world.graph, world.values, path)
    (tmp_path / "streets_GT_LC.txt").write_text("".join(f"{i} {j}\n" for i, j in TRUE))
    return path


@pytest.fixture
def archives(world, tmp_path):
    """The world as archives with symbols for keys, a prior and a robust closure: graph, values, closures by slot."""
    graph, values, slots = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
    for k in range(world.values.size()):
        values.insert(X(k), world.values.atPose2(k))
    graph.push_back(gtsam.PriorFactorPose2(X(0), world.truth[0], gtsam.noiseModel.Unit.Create(3)))
    for slot in range(world.graph.size()):
        factor = world.graph.at(slot)
        i, j = factor.keys()
        model = factor.noiseModel()
        if j > i + 1:
            slots[graph.size()] = (i, j)
            model = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.3), model)
        graph.push_back(gtsam.BetweenFactorPose2(X(i), X(j), factor.measured(), model))
    (tmp_path / "graph.txt").write_text(graph.serialize())
    (tmp_path / "values.txt").write_text(values.serialize())
    return graph, values, slots


def ends_in(graph):
    keys = [tuple(graph.at(slot).keys()) for slot in range(graph.size())]
    return [pair for pair in keys if abs(pair[1] - pair[0]) > 1]


def test_the_gate_says_what_it_accepts_and_why(run, streets):
    code, out, err = run("gate", streets, "--radius", RADIUS)
    assert (code, err) == (0, "")
    lines = [line for line in out.splitlines() if line.startswith(("accepted", "rejected"))]
    assert len(lines) == len(TRUE) + len(FALSE)
    said = {line.split("  ")[1].strip(): line for line in lines}
    assert next(iter(said)) == "5 – 60"  # in the order of time
    for i, j in TRUE:
        assert said[f"{i} – {j}"].startswith("accepted")
        assert "known true: " in said[f"{i} – {j}"]
        assert "2 others of its revisit" in said[f"{i} – {j}"]
    for i, j in FALSE:
        assert said[f"{i} – {j}"].startswith("rejected")
        assert "put its later keyframe" in said[f"{i} – {j}"]
        assert "<1 %" in said[f"{i} – {j}"]
    assert "3 accepted, 0 undecided, 2 rejected" in out
    assert "known to be true: 3, of which 3 accepted" in out
    assert "known to be false: 2, of which 2 not accepted" in out


def test_decisions_are_written_a_line_each(run, streets, tmp_path):
    found = tmp_path / "decisions.jsonl"
    assert run("gate", streets, "--radius", RADIUS, "--decisions", found, "--scores")[0] == 0
    records = [json.loads(line) for line in found.read_text().splitlines()]
    assert [tuple(record["keys"]) for record in records] == sorted(TRUE + FALSE, key=lambda ends: ends[1])
    for record in records:
        assert record["accepted"] is record["is_true"] is (tuple(record["keys"]) in TRUE)
        terms = record["terms"]
        assert record["log_odds"] == pytest.approx(sum(term["log_odds"] for term in terms.values()), rel=1e-5)
        assert record["probability"] == pytest.approx(1 / (1 + np.exp(-record["log_odds"])), rel=1e-6)
        assert (record["probability"] >= 0.95) is record["accepted"]
        assert sorted(record["reasons"]) == sorted(term["sentence"] for term in terms.values())
        assert record["judged_with"] == (3 if record["accepted"] else 1)
        for name in ("score", "global_score"):
            difference = record[name]["after"] - record[name]["before"]
            assert record[name]["rise"] == pytest.approx(difference, abs=1e-5 * record[name]["after"])
    graph = datasets.read(streets).graph
    assert all(list(graph.at(record["slot"]).keys()) == record["keys"] for record in records)


def test_the_page_and_the_terminal_are_drawn_from_the_document(run, streets, tmp_path):
    document, page = tmp_path / "gated.json", tmp_path / "gated.html"
    code, out, _ = run("gate", streets, "--radius", RADIUS, "--json", document, "--html", page)
    assert code == 0
    found = json.loads(document.read_text(encoding="utf-8"))
    assert [tuple(record["keys"]) for record in found["closures"][:2]] in (FALSE, FALSE[::-1])
    assert found["options"] | {"rule": "log_odds", "min_probability": 0.95, "radius": RADIUS} == found["options"]
    shown = page.read_text(encoding="utf-8")
    block = re.search(r'<script type="application/json" id="document">(.*?)</script>', shown, re.DOTALL).group(1)
    assert json.loads(block) == found
    for record in found["closures"]:
        rise = record["global_score"]
        line = next(line for line in out.splitlines() if f" {record['keys'][0]} – {record['keys'][1]} " in line)
        assert f"Λ_glob {rise['before']:.2f} → {rise['after']:.2f}" in line


def test_scores_left_out_are_told(run, streets):
    out = run("gate", streets, "--radius", RADIUS, "--no-scores")[1]
    assert "→" not in out
    assert "--scores computes both" in out


def test_scores_are_those_of_the_decision(run, streets, tmp_path):
    from pgti_gtsam import GateOptions, LoopClosureGate, gate_graph

    run("gate", streets, "--radius", RADIUS, "--decisions", tmp_path / "found", "--scores")
    record = json.loads((tmp_path / "found").read_text().splitlines()[-1])
    dataset = datasets.read(streets)
    gate = LoopClosureGate(options=GateOptions(scores=True))
    decision = gate_graph(dataset.graph, dataset.values, RADIUS, gate=gate).decisions[record["slot"]]
    for name in ("score", "global_score"):
        change = getattr(decision, name)
        assert record[name]["before"] == pytest.approx(change.before, rel=1e-5)
        assert record[name]["after"] == pytest.approx(change.after, rel=1e-5)


@pytest.mark.parametrize("rule", ["global_rise", "keyframe_rise", "keyframe_global_rise"])
def test_the_papers_rule_on_its_own_can_be_chosen(run, streets, tmp_path, rule):
    assert run("gate", streets, "--radius", RADIUS, "--rule", rule, "--decisions", tmp_path / "found")[0] == 0
    records = [json.loads(line) for line in (tmp_path / "found").read_text().splitlines()]
    assert all(set(record["terms"]) == {rule} for record in records)
    assert all(record["accepted"] is (record["terms"][rule]["value"] <= 0.2) for record in records)


def test_the_gated_graph_is_g2o_again(run, streets, tmp_path):
    out = tmp_path / "gated.g2o"
    assert run("gate", streets, "--radius", RADIUS, "--out", out)[0] == 0
    before, after = datasets.read(streets), datasets.read(out)
    assert ends_in(after.graph) == TRUE
    assert after.graph.size() == before.graph.size() - len(FALSE)
    theirs, values = gtsam.readG2o(str(out), False)
    assert theirs.size() == after.graph.size()
    assert theirs.error(values) == pytest.approx(after.graph.error(after.values))
    assert after.graph.error(after.values) < 1e-2 * before.graph.error(after.values)  # it is at its optimum


def test_an_archived_graph_is_gated_and_everything_else_stays_as_it_was(run, archives, tmp_path):
    graph, values, slots = archives
    before = (tmp_path / "graph.txt").read_bytes(), (tmp_path / "values.txt").read_bytes()
    command = ["gate", tmp_path / "graph.txt", "--values", tmp_path / "values.txt", "--radius", RADIUS]
    code, out, _ = run(*command, "--out", tmp_path / "gated.txt", "--out-values", tmp_path / "best.txt")
    assert code == 0
    assert "x5 – x60" in out
    gated, best = gtsam.NonlinearFactorGraph(), gtsam.Values()
    gated.deserialize((tmp_path / "gated.txt").read_text())
    best.deserialize((tmp_path / "best.txt").read_text())
    assert gated.size() == graph.size()
    for slot in range(graph.size()):
        if slots.get(slot) in FALSE:
            assert gated.at(slot) is None
        else:
            assert gated.at(slot).serialize() == graph.at(slot).serialize()
    assert set(best.keys()) == set(values.keys())
    optimum = gtsam.LevenbergMarquardtOptimizer(gated, best).optimize()
    assert gated.error(best) <= 1.01 * gated.error(optimum) + 1e-9
    assert ((tmp_path / "graph.txt").read_bytes(), (tmp_path / "values.txt").read_bytes()) == before


def test_an_xml_archive_comes_back_as_a_text_archive_and_that_is_said(run, archives, tmp_path):
    graph, _, slots = archives
    tokens = (tmp_path / "graph.txt").read_text().split()
    items = "".join(f"<item>{escape(token)}</item>" for token in tokens[3:])
    head = f'<boost_serialization signature="serialization::archive" version="{tokens[2]}">'
    xml = tmp_path / "graph.xml"
    xml.write_text(
        f'<?xml version="1.0"?><!DOCTYPE boost_serialization>{head}<data>{items}</data></boost_serialization>'
    )
    out, values = tmp_path / "gated.xml", tmp_path / "values.txt"
    code, said, _ = run("gate", xml, "--values", values, "--radius", RADIUS, "--out", out)
    assert code == 0
    assert "as a text archive" in said
    gated = gtsam.NonlinearFactorGraph()
    gated.deserialize(out.read_text())
    assert gated.size() == graph.size()
    assert [slot for slot in range(gated.size()) if gated.at(slot) is None] == [
        slot for slot, ends in slots.items() if ends in FALSE
    ]


def test_a_finished_map_has_its_closures_judged_least_probable_first(run, world, tmp_path):
    graph = gtsam.NonlinearFactorGraph(world.graph)
    graph.remove(graph.size() - 1)  # one false closure is left
    datasets.write_g2o(graph, world.values, tmp_path / "map.g2o")
    code, out, err = run("closures", tmp_path / "map.g2o", "--radius", RADIUS, "--json", tmp_path / "found.json")
    assert (code, err) == (0, "")
    document = json.loads((tmp_path / "found.json").read_text())
    found = document["closures"]
    assert tuple(found[0]["keys"]) == FALSE[0]
    odds = [record["log_odds"] for record in found]
    assert odds == sorted(odds)
    assert document["unjudged"] == []
    rows = [line.split() for line in out.splitlines() if line.startswith(("rejected", "undecided", "accepted"))]
    assert len(rows) == 4
    assert rows[0][:4] == ["rejected", "5", "–", "60"]
    assert float(rows[0][6]) == pytest.approx(odds[0], abs=0.01)


def test_each_closure_is_judged_against_all_others(world, streets, run, tmp_path):
    from pgti_gtsam import LoopClosureGate

    run("closures", streets, "--radius", RADIUS, "--json", tmp_path / "found.json")
    for record in json.loads((tmp_path / "found.json").read_text())["closures"]:
        rest, closure = gtsam.NonlinearFactorGraph(world.graph), gtsam.NonlinearFactorGraph()
        closure.push_back(world.graph.at(record["slot"]))
        rest.remove(record["slot"])
        alone = LoopClosureGate().evaluate(rest, world.values, closure, RADIUS)
        assert record["verdict"] == alone.verdict


def test_a_closure_on_which_a_keyframe_hangs_is_told_apart(run, world, tmp_path):
    graph, values = gtsam.NonlinearFactorGraph(world.graph), gtsam.Values(world.values)
    values.insert(999, world.values.atPose2(4))
    graph.push_back(world.closure(4, 30).at(0).rekey([4, 999]))
    datasets.write_g2o(graph, values, tmp_path / "spur.g2o")
    code, out, _ = run("closures", tmp_path / "spur.g2o", "--radius", RADIUS, "--json", tmp_path / "found.json")
    assert code == 0
    assert "left out of the judgement: 1 closures" in out
    assert json.loads((tmp_path / "found.json").read_text())["unjudged"] == [["4", "999"]]
    code, _, err = run("gate", tmp_path / "spur.g2o", "--radius", RADIUS)
    assert code == 2
    assert "999" in err


def test_a_map_without_closures_has_nothing_to_judge(run, tmp_path):
    world = driven(block(40))
    datasets.write_g2o(world.graph, world.values, tmp_path / "lap.g2o")
    for command in ("gate", "closures"):
        code, out, _ = run(command, tmp_path / "lap.g2o", "--radius", RADIUS)
        assert code == 0
        assert "0 closures" in out


def test_what_the_output_cannot_hold_is_told(run, tmp_path):
    out = tmp_path / "gated.g2o"
    for kind in ("stereo_factors", "camera_poses"):  # the first nine cameras
        lines = Path(gtsam.findExampleDataFile(f"VO_{kind}00.txt")).read_text().splitlines()
        first = [line for line in lines if line.strip() and int(line.split()[0]) < 9]
        (tmp_path / f"VO_{kind}00.txt").write_text("\n".join(first))
    calibration = Path(gtsam.findExampleDataFile("VO_calibration00.txt")).read_text()
    (tmp_path / "VO_calibration00.txt").write_text(calibration)
    code, said, err = run("gate", tmp_path / "VO_stereo_factors00.txt", "--out", out)
    assert (code, err) == (0, "")
    assert "GenericStereoFactor3D" in said
    assert "9 keys, which comments at its end name" in said


def test_thinned_out_keyframes(run, streets, tmp_path):
    out = tmp_path / "gated.g2o"
    code, said, _ = run("gate", streets, "--radius", RADIUS, "--every", 2, "--out", out)
    assert code == 0
    assert "one pose in 2 is kept" in said
    assert "2 closures went with the poses" in said  # 23 – 111 and 5 – 60
    assert datasets.closure_slots(datasets.read(out))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["gate", "nowhere.g2o"], "nowhere.g2o"),
        (["gate", "MAP"], "radius"),
        (["gate", "MAP", "--radius", "-1"], "-1"),
        (["gate", "MAP", "--radius", "3", "--every", "0"], "every=0"),
        (["gate", "MAP", "--radius", "3", "--edges", "loops"], "loops"),
        (["gate", "MAP", "--radius", "3", "--min-shared-landmarks", "0"], "min_shared_landmarks"),
        (["gate", "MAP", "--radius", "3", "--cloud", "cloud.ply"], "--radius or --cloud"),
        (["gate", "MAP", "--radius", "3", "--out", "MAP"], "input"),
        (["gate", "MAP", "--radius", "3", "--decisions", "MAP"], "input"),
        (["gate", "MAP", "--radius", "3", "--out", "nowhere/gated.g2o"], "existing folder"),
        (["gate", "MAP", "--radius", "3", "--out", "OUT", "--decisions", "OUT"], "for two"),
        (["gate", "MAP", "--radius", "3", "--out-values", "OUT"], "--out-values"),
        (["gate", "MAP", "--radius", "3", "--rule", "gut"], "keyframe_rise"),
        (["gate", "MAP", "--radius", "3", "--min-probability", "1"], "min_probability"),
        (["gate", "MAP", "--values", "MAP"], "values"),
        (["closures", "MAP", "--radius", "3", "--json", "MAP"], "input"),
        (["closures", "nowhere.g2o"], "nowhere.g2o"),
        (["closures", "MAP", "--radius", "nan"], "nan"),
    ],
)
def test_bad_options_end_with_one_line_and_the_notes_and_code_2(run, streets, tmp_path, words, expected):
    names = {"MAP": streets, "OUT": tmp_path / "out"}
    before = streets.read_bytes()
    code, out, err = run(*[names.get(word, word) for word in words])
    assert (code, out) == (2, "")
    assert err.startswith("pgti-gtsam: ")
    assert all(line.startswith("  note: ") for line in err.splitlines()[1:])
    assert expected in err
    assert streets.read_bytes() == before
    assert not (tmp_path / "out").exists()


def test_archives_are_no_output_onto_their_input(run, archives, tmp_path):
    graph, values = tmp_path / "graph.txt", tmp_path / "values.txt"
    for option in ("--out", "--out-values", "--decisions"):
        code, _, err = run("gate", graph, "--values", values, "--radius", RADIUS, option, values)
        assert code == 2
        assert "input" in err


def test_names_from_a_file_are_printed_as_they_are(run, streets, tmp_path):
    path = tmp_path / "[bold]map[red].g2o"
    path.write_bytes(streets.read_bytes())
    code, out, _ = run("gate", path, "--radius", RADIUS)
    assert code == 0
    assert "[bold]map[red]" in out


def test_real_loops(run, tmp_path):
    if not KITTI.exists():
        pytest.skip(f"{KITTI} is not here")
    out = tmp_path / "gated.g2o"
    code, said, _ = run("gate", KITTI, "--radius", 4, "--every", 5, "--out", out)
    assert code == 0
    assert "known to be true: 6, of which 6 accepted" in said
    assert "known to be false: 118, of which 118 not accepted" in said
    assert "6 accepted, 0 undecided, 0 rejected" in run("closures", out, "--radius", 4)[1]
