"""The JSON document keeps to its schema whatever the map, and the terminal summary says what it holds."""

import base64
import io
import json
from pathlib import Path

import numpy as np
import pytest
from drawn import pose_graphs
from hypothesis import given, settings
from jsonschema import Draft202012Validator
from rich.console import Console

import pgti_gtsam as pgti
from pgti_gtsam import report
from pgti_gtsam.report.document import audit_document
from pgti_gtsam.report.places import find_places
from pgti_gtsam.report.terminal import print_summary
from pgti_gtsam.report.verdict import BROKEN_ABOVE, HARMLESS_BELOW

SCHEMA = json.loads((Path(report.__file__).parent / "audit.schema.json").read_text(encoding="utf-8"))
HOSTILE = "[bold]<script>alert(1)</script>[/nothing]"


def document_of(pose_graph, **texts):
    integrity = pgti.assess(pose_graph, n_times=20)
    named = {"name": "map", "file_format": "test", **texts}
    return audit_document(pose_graph, integrity, **named), integrity


def printed(document):
    out = io.StringIO()
    print_summary(document, Console(file=out, width=140))
    return out.getvalue()


@settings(derandomize=True, deadline=None, max_examples=40)
@given(pose_graphs())
def test_every_document_is_strict_json_of_its_schema_and_can_be_printed(pose_graph):
    document, integrity = document_of(pose_graph)
    text = json.dumps(document, allow_nan=False)
    Draft202012Validator(SCHEMA).validate(json.loads(text))
    assert document["summary"]["verdict"]["text"] in " ".join(printed(document).split())
    assert (document["summary"]["verdict"]["level"] == "consistent") == (len(integrity.inserted_edges) == 0)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(pose_graphs())
def test_places_part_the_inserted_edges(pose_graph):
    integrity = pgti.assess(pose_graph, n_times=5)
    places = find_places(pose_graph, integrity)
    assert sum(place.n_inserted_edges for place in places) == len(integrity.inserted_edges)
    members = np.concatenate([place.keyframes for place in places]) if places else np.empty(0)
    np.testing.assert_array_equal(np.sort(members), np.unique(integrity.inserted_edges))
    worst = [integrity.stable_scores[place.worst] for place in places]
    assert worst == sorted(worst, reverse=True)
    for place in places:
        assert place.worst in place.keyframes


def test_two_contacts_far_apart_are_two_places():
    out = np.stack([np.arange(30.0), np.where(np.arange(30) % 28 < 2, 0.4, 5.0)], axis=1)
    both = np.concatenate([out, (out * [1, -1])[::-1]])
    graph = pgti.PoseGraph(keys=range(60), positions=both, edges=[(i, i + 1) for i in range(59)], radii=0.45)
    places = find_places(graph, pgti.assess(graph))
    assert len(places) == 2
    found = {tuple(place.keyframes.tolist()) for place in places}
    assert found == {(0, 1, 58, 59), (28, 31)}  # the turn from 29 to 30 is an edge of the pose graph


def test_signatures_come_back_as_they_were():
    document, integrity = document_of(square())
    packed = document["signatures"]["merged_graph"]
    values = np.frombuffer(base64.b64decode(packed["base64"]), dtype="<f4").reshape(packed["shape"])
    np.testing.assert_allclose(values, integrity.signatures_merged_graph, rtol=1e-6)


def square():
    corners = [[0, 0], [5, 0], [5, 5], [0, 5], [0, 0.5]]
    return pgti.PoseGraph(keys=range(5), positions=corners, edges=[(i, i + 1) for i in range(4)], radii=0.3)


def test_hostile_text_is_printed_as_it_is():
    document, _ = document_of(square(), name=HOSTILE, notes=[HOSTILE])
    assert printed(document).count(HOSTILE) == 2


@pytest.mark.parametrize(
    ("table_4_row", "score", "severe"),
    [("KITTI-00", 1.3702, True), ("Campus-4", 1.0533, True), ("KITTI-18", 0.1708, False), ("Campus-7", 0.0365, False)],
)
def test_the_levels_part_the_papers_severe_maps_from_its_harmless_ones(table_4_row, score, severe):
    assert (score > BROKEN_ABOVE) == severe
    assert (score < HARMLESS_BELOW) != severe
