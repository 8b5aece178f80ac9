"""The experiments with many maps and with a large one: maps have the damage that is counted, and tables say so."""

from collections import Counter

import pytest

from pgti_gtsam.diagnosis import diagnose
from scenarios.fleet import growth, night
from scenarios.fleet.drives import RADIUS, Damage, damage_of, drive
from scenarios.fleet.streets import DISTRICT, city


@pytest.mark.parametrize(("seed", "verdict"), [(1008, "consistent"), (1007, "inconsistent"), (1013, "incomplete")])
def test_a_drive_has_the_damage_that_is_counted(seed, verdict):
    made, damage = drive(seed), damage_of(seed)
    found = diagnose(made.graph, made.values, radii=RADIUS)
    assert made.damage == damage
    assert found.verdict == verdict
    assert sum(closure.is_false for closure in found.closures) == damage.false
    if not damage.false:
        assert Counter(place.kind for place in found.places)["missed closure"] == damage.untied


def test_damage_is_ranked_by_false_closures_first():
    sizes = [Damage(untied, false).size for false in range(6) for untied in range(5)]
    assert sizes == sorted(set(sizes))
    kinds = Counter((damage.untied > 0, damage.false > 0) for damage in map(damage_of, range(200)))
    assert set(kinds.values()) == {50}


def test_the_ranking_is_compared_with_the_damage():
    def row(place, size, verdict="inconsistent"):
        return {"place": place, "size": size, "untied": 0, "false": size // 5, "verdict": verdict, "false_closures": 1}

    maps = [row(0, 10), row(1, 5), row(2, 0, "consistent")]
    found = {"maps": maps, "rows": 5, "n_maps": 5, "seconds": 1.0, "killed_after_rows": 1}
    found |= {"rows_added_when_started_again": 0, "seconds_when_started_again": 0.1}
    found["failed"] = [{"map": "endless.g2o", "said": "no verdict after 3 s"}]
    lines = night.report(found)
    assert night.spearman(maps) == pytest.approx(1.0)
    assert night.spearman([maps[1] | {"place": 2}, maps[2] | {"place": 1}]) == pytest.approx(-1.0)
    assert "| intact | 1 | 1 | 0 | 0 | 0 |" in lines
    assert "endless.g2o: no verdict after 3 s" in lines


def test_a_city_grows_and_is_tied_where_told():
    tied, untied = city(DISTRICT + 500, seed=2), city(DISTRICT + 500, untied=1.0, false=3, seed=2)
    assert tied.values.size() == DISTRICT + 500
    assert tied.n_closures > (DISTRICT + 500) / 20
    assert untied.n_closures == len(untied.false) == 3


def test_the_table_says_whether_both_ways_agree():
    names = ("cpu_s", "worker_cpu_s", "peak_mb", "worker_peak_mb", "collisions", "parts", "closures")
    same = {"verdict": "incomplete", "reason": "", "digest_of_places": "a", "digest_of_overlaps": "b", "places": {}}
    parts = dict.fromkeys(names, 1) | same | {"keyframes": 10, "way": "parts"}
    whole = parts | {"way": "whole"}
    assert growth.report([parts, whole])[-1].endswith("| yes |")
    assert growth.report([parts, whole | {"digest_of_places": "c"}])[-1].endswith("| no |")
    assert growth.report([parts])[-1].endswith("|  |")
