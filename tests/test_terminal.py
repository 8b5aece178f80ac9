"""What the terminal says of maps that lack something, of many links and closures, and of findings without a number."""

import io
import json
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from rich.console import Console
from streets import RADIUS, between

from pgti_gtsam import datasets, diffusion
from pgti_gtsam.diagnosis import diagnose
from pgti_gtsam.errors import InvalidOptionError, MissingDependencyError
from pgti_gtsam.report import fleet as fleet_report
from pgti_gtsam.report.closure_text import print_closures
from pgti_gtsam.report.document import audit_document, estimate_record
from pgti_gtsam.report.heat import heat_document
from pgti_gtsam.report.terminal import print_merging, print_summary


def printed(printer, *given):
    out = io.StringIO()
    printer(*given, Console(file=out, width=200))
    return " ".join(out.getvalue().split())


@pytest.fixture(scope="module")
def document():
    """Two robots that nothing ties, an empty slot, a factor of an unknown kind, and a keyframe without a radius."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(12):
        values.insert(k, gtsam.Pose2(k % 6, 20.0 * (k // 6), 0.0))
        if k % 6:
            graph.push_back(between(k - 1, k, gtsam.Pose2(1, 0, 0)))
    graph.push_back(between(0, 1, gtsam.Pose2(1, 0, 0)))
    graph.remove(graph.size() - 1)
    error = gtsam.noiseModel.Unit.Create(1)
    graph.push_back(gtsam.CustomFactor(error, [2, 3, 4], lambda *_: np.zeros(1)))
    found = diagnose(graph, values, radii=dict.fromkeys(range(11), RADIUS))
    return json.loads(json.dumps(audit_document(found, name="two robots", file_format="made")))


def test_what_a_map_lacks_is_noted(document):
    said = printed(print_summary, document)
    assert "empty slots 1" in said
    assert "factors unknown 1 CustomFactor" in said
    assert "1 keyframes without radius: nothing is guaranteed free around them" in said
    assert "the pose graph falls into 2 parts, which free space joins into 2" in said


def test_landmarks_that_serve_for_nothing_are_noted(document):
    adaptation = {"landmarks_without_position": 3, "max_shared_landmarks": 4, "min_shared_landmarks": 15}
    changed = document | {"adaptation": document["adaptation"] | adaptation, "estimate": estimate_record(None, 1.0)}
    said = printed(print_summary, changed)
    assert "3 landmarks could not be placed and give no radius" in said
    assert "no two keyframes share 15 landmarks, so covisibility connects none; the most that two share is 4" in said
    assert "whether the estimate is an optimum could not be tried" in said


def test_a_pose_graph_that_was_not_read_from_factors_has_no_counts_of_them(document):
    said = printed(print_summary, document | {"adaptation": None})
    assert f"edges {document['summary']['n_pose_graph_edges']}" in said
    assert "factors used" not in said


def test_of_many_links_and_closures_the_rest_is_counted():
    link = {"keyframes": ["a1", "b2"], "verdict": "accepted", "probability": 0.99, "sentence": "It fits."}
    said = printed(print_merging, {"links": [link] * 23, "order": [], "gains": [], "left_out": []})
    assert said.count("a1 – b2") == 20
    assert "and 3 more" in said
    assert "left out" not in said
    said = printed(print_merging, {"links": [], "order": [], "gains": [], "left_out": [f"l{k}" for k in range(21)]})
    assert "variables that no factor ties to a keyframe: 21 (l0, l1," in said
    assert "l19, …)" in said
    assert "more" not in printed(print_merging, {"links": [link] * 20, "order": [], "gains": [], "left_out": []})
    record = {
        "verdict": "accepted", "keys": [1, 2], "keyframes": ["1", "2"], "probability": 0.9, "log_odds": 2.2,
        "is_true": None, "terms": {"drift": {"log_odds": 2.2}},
    }  # fmt: skip
    assert "and 2 more, in the JSON (--json)" in printed(print_closures, [record] * 22)


def test_an_optimiser_that_finds_the_graph_singular_is_told_of():
    dataset = datasets.read(gtsam.findExampleDataFile("pose3example.txt"))
    found = diffusion.study(dataset.graph, dataset.values)
    optimisers = [replace(each, energies=np.zeros(0)) for each in found.optimisers]
    document = heat_document(replace(found, optimisers=tuple(optimisers)), name="five", file_format=dataset.format)
    for run in document["optimisers"]:
        assert [run["method"], "none", "the optimiser found the graph singular"] in [*map(list, document["findings"])]


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("maps.xlsx", InvalidOptionError, "ends with .csv or .parquet"),
        ("maps.parquet", MissingDependencyError, r"pip install 'pgti-gtsam\[parquet\]'"),
    ],
)
def test_a_table_of_maps_that_cannot_be_written_is_refused(tmp_path, monkeypatch, name, error, said):
    monkeypatch.setattr(fleet_report, "find_spec", lambda _: None)
    with pytest.raises(error, match=said):
        fleet_report.check_table(tmp_path / name)
    fleet_report.check_table(tmp_path / "maps.csv")
