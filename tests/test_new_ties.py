"""The best new tie is what trying every tie by a fresh assessment finds."""

import numpy as np
import pytest
from test_replay import drawn

import pgti_gtsam as pgti
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.places import WINDOW
from pgti_gtsam.spectral import one_edge


def winding(seed, n=60):
    """A way that winds about its start and crosses itself, each keyframe tied to the next three."""
    rng = np.random.default_rng(seed)
    position, heading, positions = np.zeros(2), 0.0, []
    for _ in range(n):
        positions.append(position.copy())
        heading += rng.normal(0, 0.3) + 0.2 * np.sin(np.arctan2(-position[1], -position[0]) - heading)
        position += np.cos(heading), np.sin(heading)
    i, j = np.triu_indices(n, 1)
    return pgti.PoseGraph(keys=np.arange(n) + 100, positions=positions, edges=np.c_[i, j][j - i <= 3], radii=1.0)


def with_tie(pose_graph, tie):
    return pgti.PoseGraph(
        keys=pose_graph.keys,
        positions=pose_graph.positions,
        edges=np.concatenate([pose_graph.edges, [tie]]),
        radii=pose_graph.radii,
    )


def by_trying(pose_graph, ties):
    return {tuple(tie): pgti.assess(with_tie(pose_graph, tie)).score for tie in ties.tolist()}


@pytest.mark.parametrize("seed", range(4))
def test_the_ranking_is_that_of_trying_every_tie(seed):
    pose_graph = winding(seed)
    fresh = pgti.assess(pose_graph)
    tried = by_trying(pose_graph, fresh.inserted_edges)
    found = pgti.best_revisits(pose_graph, 5)
    assert found[0].score == pytest.approx(min(tried.values()), abs=1e-6)
    assert [tie.score for tie in found] == pytest.approx([tried[tie.keyframes] for tie in found], abs=1e-6)
    assert all(tie.score_before == pytest.approx(fresh.score, abs=1e-8) for tie in found)
    assert found[0].keys == tuple(k + 100 for k in found[0].keyframes)

    # what is not listed is worse, or beside what is
    for pair, score in tried.items():
        near = any(np.abs(np.subtract(pair, tie.keyframes)).max() <= WINDOW for tie in found)
        assert near or score >= (found[-1].score if len(found) == 5 else fresh.score) - 1e-6


def test_ties_that_lower_nothing_are_not_named():
    """Two crossings: a tie at one of them leaves Λ to the other, or raises it."""
    pose_graph = winding(6)
    named = {tie.keyframes for tie in pgti.best_revisits(pose_graph, 1000)}
    tried = by_trying(pose_graph, pgti.assess(pose_graph).inserted_edges)
    before = pgti.assess(pose_graph).score
    assert any(score > before for score in tried.values())
    assert all(tried[pair] < before for pair in named)


def test_edges_in_several_chunks_are_as_in_one(monkeypatch):
    pose_graph = winding(1)
    whole = pgti.best_revisits(pose_graph, 3)
    monkeypatch.setattr(one_edge, "CHUNK_ENTRIES", 1)
    assert pgti.best_revisits(pose_graph, 3) == whole


def test_where_the_graph_falls_into_parts_a_tie_that_joins_parts_comes_first():
    for seed in range(50):
        pose_graph = drawn(seed)
        fresh = pgti.assess(pose_graph)
        if fresh.n_components_pose_graph > fresh.n_components_merged_graph and np.isfinite(fresh.score):
            break
    joining = [
        tie
        for tie in fresh.inserted_edges
        if pgti.assess(with_tie(pose_graph, tie)).n_components_pose_graph < fresh.n_components_pose_graph
    ]
    tried = by_trying(pose_graph, np.array(joining))
    assert pgti.best_revisits(pose_graph, 1)[0].score == pytest.approx(min(tried.values()), abs=1e-6)


def test_a_graph_that_lacks_no_edge_needs_no_revisit():
    straight = pgti.PoseGraph(keys=range(3), positions=np.eye(3) * 9, edges=[(0, 1), (1, 2)], radii=1.0)
    assert pgti.best_revisits(straight) == []
    with pytest.raises(InvalidOptionError, match="count"):
        pgti.best_revisits(straight, 0)
