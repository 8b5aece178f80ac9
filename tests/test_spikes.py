"""The experiment of the spikes: who is a candidate, what rises, what the tables say."""

import numpy as np
import pytest
from optional import needs_open3d
from streets import RADIUS, block, driven

pytestmark = needs_open3d  # the worlds import it

LAP = 4 * 22


@pytest.fixture(scope="module")
def spikes():
    from scenarios import spikes

    return spikes


@pytest.fixture(scope="module")
def found(spikes):
    """Rises where a lap meets its first pass, and where a false closure folds the lap."""
    import pgti_gtsam as pgti

    world = driven(block(40, times=2), noise=0.002)
    reference = pgti.LoopClosureGate().reference_map(world.graph, world.values, RADIUS)
    fold = world.truth[30].between(world.truth[30 + LAP])
    return [spikes.spikes(reference, closure) for closure in (world.closure(20, 20 + LAP), world.closure(10, 75, fold))]


def test_every_score_of_a_keyframe_rises_at_a_false_closure_more_than_at_a_true_one(spikes, found):
    true, false = found
    assert set(true) == set(false) == {*spikes.SPIKES, "allowed"}
    for name in ("keyframe", "keyframe_global", "stable", "contact"):
        assert false[name] > 1.5 * max(true[name], 0.0)


def test_a_keyframes_rise_is_never_below_that_of_the_largest(found):
    """max(a) − max(b) ≤ max(a − b): what Λ hides, ζ shows."""
    assert all(each["score"] <= each["keyframe"] + 1e-9 for each in found)


def test_candidates_are_first_matches_and_false_ones(spikes):
    ends = [(0, 100), (3, 104), (50, 150), (2, 190), (60, 200)]
    true = np.array([True, True, False, True, False])
    assert spikes._sample(ends, true, np.random.default_rng(0)) == {0, 2, 3, 4}


def test_tables_follow_from_the_rises(spikes):
    """Ten true and ten false closures whose rises interleave at one score, and are apart at all others."""

    def candidate(is_true, k):
        apart = {name: float(k if is_true else 100 + k) for name in spikes.SPIKES}
        return {"true": is_true, "overlapping": True, "allowed": 0.5} | apart | {"score": float(2 * k + is_true)}

    candidates = [candidate(is_true, k) for is_true in (True, False) for k in range(10)]
    rows = [{"map": "fr079", "seed": seed, "candidates": candidates} for seed in (0, spikes.TRAINING)]
    assert spikes.limits_of(rows[1:])["keyframe"] == 9.0
    areas, caught, by_limits = [line for line in spikes.report(rows) if line.startswith("| fr079 | 10 | 10 |")]
    assert areas.split("|")[4:6] == [" 0.45 ", " 1.00 "]
    assert caught.split("|")[4:6] == [" 0% ", " 100% "]
    assert by_limits.split("|")[4:6] == [" 0%, 0% ", " 100%, 0% "]
