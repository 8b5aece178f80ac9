"""The page of gated closures: it filters, chooses and draws offline, and no text of the document becomes markup."""

import json
import math
import re

import gtsam
import pytest
from browser import References, cut_on_a_phone, dom_of_page, needs_chromium, rows_of, run_after_script

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.errors import InvalidValueError
from pgti_gtsam.gate import Change, ClosureDecision
from pgti_gtsam.gate.decision import Term
from pgti_gtsam.report.decisions import closures_document, decision_records
from pgti_gtsam.report.gate_page import write_gate_page

HOSTILE = "</script><script>document.body.dataset.pwned = 1</script><img src=x onerror=document.body.dataset.pwned=1>"


def decided(verdict, log_odds, *, scored=True):
    change = Change(before=0.01, after=1.37) if scored else None
    term = Term(value=1.0, log_odds=log_odds, sentence=f"Drift says {verdict}. {HOSTILE}")
    return ClosureDecision(
        verdict=verdict,
        log_odds=log_odds,
        terms={} if math.isnan(log_odds) else {"drift": term},
        reasons=(term.sentence,),
        keys=(),
        score=change,
        global_score=change,
    )


def document(decisions):
    """A drive along a corridor whose closures, by slot, tie keyframe 0 to the one that the slot names."""
    values = gtsam.Values()
    for key in range(6):
        values.insert(key, gtsam.Pose2(key, 0.1 * key**2, 0))
    found = closures_document(
        decision_records(decisions, {slot: (slot, 0) for slot in decisions}, true_closures={2}),
        name=HOSTILE,
        file_format=HOSTILE,
        notes=[HOSTILE],
        options={"rule": "log_odds", "min_probability": 0.95},
        unjudged=[(4, 5)],
        keyframes=read_keyframes(values),
        odometry=[(k, k + 1) for k in range(5)],
        drawn=HOSTILE,
    )
    return json.loads(json.dumps(found))


def several():
    return document(
        {
            2: decided("accepted", 9.0),
            3: decided("undecided", 0.4, scored=False),
            4: decided("rejected", -math.inf),
            5: decided("accepted", math.nan, scored=False),
        }
    )


@needs_chromium
def test_closures_are_listed_filtered_and_chosen(tmp_path, monkeypatch):
    script = """
      const pause = () => new Promise((resume) => setTimeout(resume, 1000));
      document.body.dataset.first = byId("closure-title").textContent;
      document.body.dataset.odds = byId("evidence").textContent;
      byId("show-rejected").click();
      await pause();
      byId("gated-table").querySelectorAll("tbody tr")[1].click();
      await pause();
      document.body.dataset.layers = byId("map").data.map((trace) => `${trace.name} ${trace.visible ?? true}`);
      document.body.dataset.spikes = byId("time").data[7].y;
    """
    run_after_script(monkeypatch, "gate_main.js", script)
    write_gate_page(several(), tmp_path / "page.html")
    dom = dom_of_page(tmp_path / "page.html")
    body = re.search(r"<body[^>]*>", dom).group()
    assert 'data-ready="true"' in body
    assert "data-errors" not in body
    assert "data-pwned" not in body
    assert len(References(dom).scripts) == 3

    # it opens at the least probable; the filter takes that away everywhere, a click chooses another
    assert 'data-first="Closure 0 – 4"' in body
    assert 'data-odds="evidencelog oddsdrift−infinite"' in body
    rows = rows_of(dom, "gated-table")
    assert [text.split(" Drift")[0] for _, text in rows] == [
        "0 – 3 undecided 59.9 % – false",
        "0 – 2 accepted &gt; 99.9 % 0.01 → 1.37 true",
        "0 – 5 accepted not judged – false",
    ]
    assert [classes for classes, _ in rows] == ["", "chosen", "mistaken"]
    assert 'aria-label="Marked: closure 0 – 2"' in dom
    assert 'data-layers="odometry true,rejected false,undecided true,accepted true,keyframes true"' in body
    assert 'data-spikes="0.01,1.37,"' in body
    assert "2 of 4 accepted" in dom


@needs_chromium
def test_page_of_a_map_without_closures(tmp_path):
    write_gate_page(document({}), tmp_path / "page.html")
    body = re.search(r"<body[^>]*>", dom_of_page(tmp_path / "page.html", "#slot=2")).group()
    assert 'data-ready="true"' in body
    assert "data-errors" not in body


@needs_chromium
def test_nothing_scrolls_sideways_on_a_phone(tmp_path, monkeypatch):
    assert (
        cut_on_a_phone(
            tmp_path / "page.html", monkeypatch, lambda path: write_gate_page(several(), path), "gate_main.js"
        )
        == "[]"
    )


def test_closures_of_the_document_point_at_its_keyframes():
    found = several()
    assert [record["ends"] for record in found["closures"]] == [[0, 4], [0, 3], [0, 2], [0, 5]]
    assert found["edges"]["odometry"] == [[k, k + 1] for k in range(5)]
    assert found["keyframes"]["position"][3] == pytest.approx([3, 0.9, 0])
    assert found["unjudged"] == [["4", "5"]]


def test_page_refers_to_nothing_outside_and_refuses_other_documents(tmp_path):
    write_gate_page(several(), tmp_path / "page.html")
    assert References((tmp_path / "page.html").read_text(encoding="utf-8")).found == []
    with pytest.raises(InvalidValueError, match="expected"):
        write_gate_page(several() | {"schema_version": 2}, tmp_path / "other.html")
