"""Λ and Λ_glob of candidates from one factorised map: the same as assessing each map from scratch."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import RADIUS, block, driven, straight

import pgti_gtsam as pgti
from pgti_gtsam.drift.settled import settle
from pgti_gtsam.gate.candidate_map import CandidateMaps
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.scored_map import ScoredMap
from pgti_gtsam.pose_graph import PoseGraph

LAP = 4 * 32  # steps around a block of 60 m
BETA = 0.5


def assessed(pose_graph):
    integrity = pgti.assess(pose_graph, beta=BETA)
    return integrity.score, integrity.split().global_


@st.composite
def two_maps(draw):
    """A random walk with edges beyond its chain; the same keyframes, somewhat moved, with other edges."""
    n = draw(st.integers(3, 60))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    places = np.cumsum(rng.normal(size=(n, 3)) * [1.0, 1.0, 0.1], axis=0)
    radii = rng.uniform(0.0, 1.5, n)
    radii[0] = 1.0
    maps = []
    for moved in (0.0, draw(st.sampled_from([0.0, 0.05, 1.0]))):
        chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
        more = rng.choice(n, (draw(st.integers(0, 3)), 2))
        edges = np.concatenate([chain, more[more[:, 0] != more[:, 1]]])
        maps.append(
            PoseGraph(keys=np.arange(n), positions=places + moved * rng.normal(size=(n, 3)), radii=radii, edges=edges)
        )
    return maps


@settings(derandomize=True, deadline=None, max_examples=40)
@given(two_maps())
def test_a_map_is_scored_from_another(maps):
    first, second = maps
    scored = ScoredMap.of(first, BETA)
    assert scored.scores == pytest.approx(assessed(first), rel=1e-3, abs=1e-4)
    expected = pgti.assess(second, beta=BETA)
    score, global_ = scored.scores_of(second)
    assert score == pytest.approx(expected.score, rel=1e-3, abs=1e-4)
    if np.sort(expected.keyframe_scores)[-2] < (1 - 1e-3) * expected.score:  # equal scores may swap the worst
        assert global_ == pytest.approx(expected.split().global_, rel=1e-2, abs=1e-3)


@pytest.fixture(scope="module")
def world():
    return driven(block(60, times=2) + straight(20), bias=0.002, noise=0.003)


def test_a_closure_toggled_to_first_order_is_nearly_at_the_optimum(world):
    reference = LoopClosureGate().reference_map(world.graph, world.values, RADIUS)
    offered, [[first], [second]] = reference.offered([world.closure(4, 4 + LAP), world.closure(20, 20 + LAP)])
    tied = settle(offered.model, np.arange(len(offered.active)) != second, offered)
    for base, tie in ((tied, second), (tied, first)):
        poses, active = base.toggled(np.array([tie]))
        best = settle(base.model, active, base)
        assert active[tie] != base.active[tie]
        missed = [one.localCoordinates(other) for one, other in zip(poses, best.poses, strict=True)]
        moved = [one.localCoordinates(other) for one, other in zip(base.poses, best.poses, strict=True)]
        assert np.abs(missed).max() < 0.05 * max(np.abs(moved).max(), RADIUS)


@pytest.mark.parametrize("count", [1, 2])
def test_candidates_have_the_scores_of_the_maps_with_and_without(world, count):
    reference = LoopClosureGate().reference_map(world.graph, world.values, RADIUS)
    closures = [world.closure(4, 4 + LAP), world.closure(9, 200)][:count]
    offered, rows = reference.offered(closures)
    active = offered.active.copy()
    active[rows[0]] = True
    maps = CandidateMaps(reference=reference, offered=offered)
    found = maps.scores(active, [np.array(row) for row in rows])
    for (score, global_), row in zip(found, rows, strict=True):
        for side, held in (("before", False), ("after", True)):
            expected = active.copy()
            expected[row] = held
            integrity = maps.integrity(settle(offered.model, expected, offered))
            assert getattr(score, side) == pytest.approx(integrity.score, rel=0.05, abs=0.01)
            assert getattr(global_, side) == pytest.approx(integrity.split().global_, rel=0.05, abs=0.01)
