"""The JSON document keeps to its schema whatever the map, and the terminal summary says what it holds."""

import base64
import io
import json
from pathlib import Path

import numpy as np
from drawn import pose_graphs
from hand_made import as_gtsam
from hypothesis import given, settings
from jsonschema import Draft202012Validator
from rich.console import Console

import pgti_gtsam as pgti
from pgti_gtsam import report
from pgti_gtsam.report.document import audit_document
from pgti_gtsam.report.terminal import print_summary

SCHEMA = json.loads((Path(report.__file__).parent / "schemas" / "audit.schema.json").read_text(encoding="utf-8"))
HOSTILE = "[bold]<script>alert(1)</script>[/nothing]"


def document_of(pose_graph, **texts):
    graph, values = as_gtsam(pose_graph.positions, pose_graph.edges.tolist())
    radii = dict(enumerate(np.maximum(pose_graph.radii, 1e-2).tolist()))
    found = pgti.diagnose(graph, values, radii=radii)
    return audit_document(found, **{"name": "map", "file_format": "test", **texts}), found


def printed(document):
    out = io.StringIO()
    print_summary(document, Console(file=out, width=140))
    return out.getvalue()


@settings(derandomize=True, deadline=None, max_examples=40)
@given(pose_graphs())
def test_every_document_is_strict_json_of_its_schema_and_can_be_printed(pose_graph):
    document, found = document_of(pose_graph)
    text = json.dumps(document, allow_nan=False)
    Draft202012Validator(SCHEMA).validate(json.loads(text))
    assert document["verdict"]["text"] in " ".join(printed(document).split())
    wrong = {"likely false closure", "undecided contact", "missed closure", "tracking gap"}
    assert not (found.verdict == "consistent" and {place.kind for place in found.places} & wrong)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(pose_graphs())
def test_places_part_the_collisions(pose_graph):
    _, found = document_of(pose_graph)
    own = [place for place in found.places if place.kind not in ("untied second pass", "incomplete fusion")]
    resolved = [pair for place in own for pair in map(tuple, place.edges.tolist())]
    assert len(set(resolved)) == len(resolved)
    assert set(resolved) == set(map(tuple, found.integrity.collision_edges.tolist()))
    for place in own:
        assert place.worst in place.edges
        (a, b), (c, d) = place.keyframes
        assert all(a <= i <= b and c <= j <= d for i, j in place.revisit.edges.tolist())


def test_signatures_come_back_as_they_were():
    document, found = document_of(square())
    packed = document["signatures"]["merged_graph"]
    values = np.frombuffer(base64.b64decode(packed["base64"]), dtype="<f4").reshape(packed["shape"])
    np.testing.assert_allclose(values, found.integrity.signatures_merged_graph, rtol=1e-6)


def square():
    corners = [[0, 0], [5, 0], [5, 5], [0, 5], [0, 0.5]]
    return pgti.PoseGraph(keys=range(5), positions=corners, edges=[(i, i + 1) for i in range(4)], radii=0.3)


def test_hostile_text_is_printed_as_it_is():
    document, _ = document_of(square(), name=HOSTILE, notes=[HOSTILE])
    assert printed(document).count(HOSTILE) == 2
