"""The page: it draws any audit without the network, and no text of the document becomes markup."""

from __future__ import annotations

import functools
import json
import re

import numpy as np
import pytest
from browser import References, dom_of_page, needs_chromium, rows_of, run_after_script
from hand_made import as_gtsam

from pgti_gtsam.diagnosis import diagnose
from pgti_gtsam.errors import InvalidValueError
from pgti_gtsam.report.document import audit_document
from pgti_gtsam.report.html import page, write_page

HOSTILE = (
    "</script><script>document.body.dataset.pwned = 1</script><img src=x onerror=document.body.dataset.pwned=1>\u2028"
)


def audit(positions, edges, radius, name="map"):
    """The document of a map; its lists are copied, so that a test may change them."""
    graph, values = as_gtsam(positions, edges)
    radii = dict(enumerate(np.broadcast_to(np.asarray(radius, dtype=float), len(positions)).tolist()))
    document = audit_document(diagnose(graph, values, radii=radii), name=name, file_format="fabricated")
    return json.loads(json.dumps(document))


def two_laps(n=41):
    """Two laps of a figure of eight, tied where they start: elsewhere the second is seen beside the first."""
    s = np.linspace(0, 4 * np.pi, n)
    positions = np.c_[20 * np.sin(s), 10 * np.sin(2 * s), 0.02 * s]
    return audit(positions, [*((i, i + 1) for i in range(n - 1)), (0, n // 2)], 1.0)


def planar():
    return audit([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0]], [(0, 1), (1, 2), (2, 3), (3, 4)], 0.51)


def isolated():
    """Keyframe 2 has no edge, but its sphere touches two others: an infinite score."""
    return audit([[0, 0, 0], [1, 0, 0], [2, 0, 1], [3, 0, 0]], [(0, 1), (1, 3)], 1.0)


def hostile():
    """Every text that a file can bring in is an attack."""
    document = two_laps()
    document["input"] = {"name": HOSTILE, "format": HOSTILE, "notes": [HOSTILE]}
    document["keyframes"]["label"] = [HOSTILE] * len(document["keyframes"]["label"])
    document["verdict"] = {"level": HOSTILE, "text": HOSTILE}
    document["options"] = {HOSTILE: HOSTILE}
    counts = {HOSTILE: 1}
    document["adaptation"] = {
        "used": counts, "ignored": counts, "unknown": counts, "edges": counts, "empty_slots": 1, "n_landmarks": 1,
        "n_observations": 1, "keyframes_without_radius": 1, "max_shared_landmarks": None,
    }  # fmt: skip
    for place in document["places"]:
        place |= {"label": HOSTILE, "kind": HOSTILE, "sentence": HOSTILE, "remedy": HOSTILE, "scale": HOSTILE}
    for closure in document["closures"]:
        closure["sentence"] = HOSTILE
    return document


def unknown():
    """What the document says where nothing is known: nothing judges the closures, nothing bounds the drift."""
    document = two_laps()
    for place in document["places"]:
        place |= {"allowance_m": "infinite", "gain": "infinite", "proposal": None}
    for closure in document["closures"]:
        closure |= {"probability": None, "log_odds": None, "allowed_m": "infinite"}
    document["adaptation"] = None
    return document


MAPS = {
    "two laps": two_laps,
    "planar": planar,
    "isolated keyframe": isolated,
    "one keyframe": lambda: audit([[0, 0, 0]], [], 1.0),
    "no edge": lambda: audit([[0, 0, 0], [9, 9, 9]], [], [0.0, 0.5]),
    "coincident keyframes": lambda: audit([[1, 2, 3]] * 3, [(0, 1), (1, 2)], 0.5),
    "nothing known": unknown,
    "hostile texts": hostile,
}


@pytest.fixture(scope="module")
def dom_of(tmp_path_factory):
    """From a map's name to its DOM, opened once."""
    return functools.cache(lambda name: opened(MAPS[name](), tmp_path_factory.mktemp("page")))


def opened(document, folder, fragment=""):
    """The page's DOM after its scripts have run in a browser that reaches nothing."""
    write_page(document, folder / "page.html")
    return dom_of_page(folder / "page.html", fragment)


def run_after(monkeypatch, script):
    """Let every page run a script once it is ready."""
    run_after_script(monkeypatch, "main.js", script)


def marked(dom):
    """What the map marks, in the words of its canvas."""
    return re.search(r'<canvas id="marks"[^>]*aria-label="([^"]*)"', dom).group(1)


@needs_chromium
@pytest.mark.parametrize("name", MAPS)
def test_every_map_is_drawn_offline_without_an_error(name, dom_of):
    body = re.search(r"<body[^>]*>", dom_of(name)).group()
    assert 'data-ready="true"' in body
    assert "data-errors" not in body  # uncaught errors, missing WebGL, and whatever the policy had to block
    assert "data-pwned" not in body


@needs_chromium
def test_hostile_text_stays_text(dom_of):
    dom = dom_of("hostile texts")
    shown = "&lt;/script&gt;&lt;script&gt;document.body.dataset.pwned = 1&lt;/script&gt;"
    assert f'<h1 id="name">{shown}' in dom
    assert "<img" not in dom
    assert len(References(dom).scripts) == 3


@needs_chromium
def test_page_opens_at_the_first_place(dom_of):
    document, dom = two_laps(), dom_of("two laps")
    classes, text = rows_of(dom, "places-table")[0]
    assert classes == "chosen"
    assert document["places"][0]["sentence"] in text
    assert document["places"][0]["remedy"] in text
    assert int(re.match(r"Marked: keyframe (\d+), place 1, ", marked(dom)).group(1)) in document["places"][0]["closest"]


@needs_chromium
def test_page_without_a_place_opens_at_the_worst_keyframe(dom_of):
    document = planar()
    assert not document["places"]
    assert marked(dom_of("planar")).startswith(f"Marked: keyframe {document['summary']['worst']},")


@needs_chromium
def test_address_chooses_the_keyframe(tmp_path):
    document = two_laps()
    assert document["summary"]["worst"] != 17
    dom = opened(document, tmp_path, "#keyframe=17")
    assert re.search(r'<h2 id="keyframe-title"[^>]*>Keyframe 17<', dom)
    assert marked(dom).startswith("Marked: keyframe 17, ")


@needs_chromium
def test_address_chooses_the_place(tmp_path):
    dom = opened(two_laps(), tmp_path, "#place=2")
    assert [classes for classes, _ in rows_of(dom, "places-table")][:3] == ["", "chosen", ""]
    assert ", place 2, " in marked(dom)


@needs_chromium
def test_closures_are_listed_and_a_click_draws_one(tmp_path, monkeypatch):
    document = two_laps()
    (closure,) = document["closures"]
    i, j = closure["keyframes"]
    click = 'byId("closures-table").querySelector("tbody tr").click();'
    run_after(monkeypatch, f"{click} await new Promise((resume) => setTimeout(resume, 1000));")
    dom = opened(document, tmp_path)
    assert [(classes, text.startswith(f"{i} – {j} ")) for classes, text in rows_of(dom, "closures-table")] == [
        ("chosen", True)
    ]
    assert closure["sentence"] in dom
    assert marked(dom).startswith(f"Marked: keyframe {j}, closure {i} – {j}, ")


@needs_chromium
def test_map_is_coloured_by_scores_and_by_place(tmp_path, monkeypatch):
    """By place, the keyframes of a place's stretches share a colour that no keyframe outside has."""
    document = two_laps()
    script = """
      const colours = {};
      for (const { value } of [...byId("colour-by").options]) {
        byId("colour-by").value = value;
        byId("colour-by").dispatchEvent(new Event("change"));
        await new Promise((resume) => setTimeout(resume, 1000));
        colours[value] = Array.from(byId("map").data[3].marker.color);
      }
      document.body.dataset.colours = JSON.stringify(colours).replaceAll('"', "'");
    """
    run_after(monkeypatch, script)
    colours = json.loads(re.search(r'data-colours="([^"]*)"', opened(document, tmp_path)).group(1).replace("'", '"'))
    keyframes = document["keyframes"]
    np.testing.assert_allclose(colours["score"], keyframes["score"])
    np.testing.assert_allclose(colours["collisions"], keyframes["collision_score"])
    inside = {k for place in document["places"] for first, last in place["stretches"] for k in range(first, last + 1)}
    grey = {colour for k, colour in enumerate(colours["place"]) if k not in inside}
    assert len(grey) <= 1
    assert grey.isdisjoint(colours["place"][k] for k in inside)
    [(first, last), _] = document["places"][0]["stretches"]
    assert len(set(colours["place"][first : last + 1])) == 1


@needs_chromium
def test_a_choice_draws_no_trace_of_the_map_anew(tmp_path, monkeypatch):
    """plotly would upload the whole map again, which takes seconds where keyframes are many."""
    script = """
      let drawn = 0;
      byId("map").on("plotly_afterplot", () => { drawn += 1; });
      for (const keyframe of [3, 4, 5]) await choose(atKeyframe(keyframe));
      document.body.dataset.drawn = drawn;
    """
    run_after(monkeypatch, script)
    assert 'data-drawn="0"' in opened(two_laps(), tmp_path)


@needs_chromium
def test_estimate_that_is_no_optimum_is_noticed(tmp_path, dom_of):
    document = two_laps()
    document["estimate"] |= {"is_optimum": False, "keyframe": 7, "step_m": 1.5}
    assert "no optimum of its graph: one step moves keyframe 7 by 1.5 m" in opened(document, tmp_path)
    assert "no optimum of its graph: one" not in re.search(r'<div id="warnings">.*?</div>', dom_of("two laps")).group()


@needs_chromium
def test_click_chooses_the_keyframe_that_was_hit(tmp_path, monkeypatch):
    """On an edge its end that was hit. plotly repeats a click while it draws: that must end."""
    document = two_laps()
    (i, j), (k, _), (m, _) = (document["edges"][name][5] for name in ("pose_graph", "fusion", "collisions"))
    hits = [(0, 15, i), (0, 16, j), (1, 15, k), (2, 15, m), (3, 7, 7)]
    clicks = """
      byId("map").on("plotly_afterplot", () => byId("map").emit("plotly_click", { points: [hit] }));
      let hit;
      const chosen = [];
      for (const [curveNumber, pointNumber] of HITS) {
        hit = { curveNumber, pointNumber };
        byId("map").emit("plotly_click", { points: [hit] });
        await new Promise((resume) => setTimeout(resume, 1000));
        chosen.push(byId("keyframe-title").textContent);
      }
      document.body.dataset.chosen = chosen;
    """
    run_after(monkeypatch, clicks.replace("HITS", json.dumps(hits)))
    expected = ",".join(f"Keyframe {hit[2]}" for hit in hits)
    assert f'data-chosen="{expected}"' in opened(document, tmp_path)


@needs_chromium
def test_infinite_scores_are_said_in_words(dom_of):
    assert isolated()["summary"]["score"] == "infinite"
    assert '<p class="value">infinite</p>' in dom_of("isolated keyframe")


@pytest.mark.parametrize("make", [two_laps, hostile])
def test_page_refers_to_nothing_outside(make):
    references = References(page(make()))
    assert references.found == []
    assert references.scripts == ["application/json", None, "module"]


def test_page_carries_the_document_unchanged():
    document = hostile()
    script = r'<script type="application/json" id="document">(.*?)</script>'
    block = re.search(script, page(document), re.DOTALL).group(1)
    assert json.loads(block) == document
    assert not set("<>&\u2028\u2029") & set(block)


def test_policy_forbids_all_but_the_two_scripts():
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page(planar())).group(1)
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert policy.count("'sha256-") == 2
    assert "http" not in policy
    assert "unsafe-eval" not in policy


@pytest.mark.parametrize(
    "change", [{"schema": "other"}, {"schema_version": 1}, {"times": [float("nan")]}, {"times": [float("inf")]}]
)
def test_other_documents_are_refused(change):
    with pytest.raises(InvalidValueError, match="expected"):
        page(planar() | change)
