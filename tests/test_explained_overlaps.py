"""Explained overlaps: no new loops in the complex, a fixpoint that no order changes, what remains is a collision."""

import gudhi
import numpy as np
import pytest
from drawn import pose_graphs
from hypothesis import given, settings
from hypothesis import strategies as st

import pgti_gtsam as pgti
from pgti_gtsam.support_graph import explained_overlaps, support_graph

SETTINGS = settings(derandomize=True, deadline=None, max_examples=150)
ODOMETRY = pgti.EdgeSource.BETWEEN | pgti.EdgeSource.ODOMETRY


def tracked(positions, radii, closures=()):
    """A chain of odometry through positions, with closures."""
    n = len(positions)
    edges = [(i, i + 1) for i in range(n - 1)] + list(closures)
    sources = [ODOMETRY] * (n - 1) + [pgti.EdgeSource.BETWEEN] * len(closures)
    return pgti.PoseGraph(keys=range(n), positions=positions, edges=edges, radii=radii, edge_sources=sources)


def betti(n, edges, squares=()):
    """Components and independent loops of the clique complex, with some squares as two triangles more."""
    complex_ = gudhi.SimplexTree()
    for i in range(n):
        complex_.insert([i])
    for i, j in edges:
        complex_.insert([int(i), int(j)])
    complex_.expansion(2)
    for i, k, m, j in squares:  # split by the diagonal from i to m
        complex_.insert([i, k, m])
        complex_.insert([i, m, j])
    complex_.compute_persistence(persistence_dim_max=True)
    return (complex_.betti_numbers() + [0, 0])[:2]


@SETTINGS
@given(pose_graphs(max_size=14))
def test_what_triangles_explain_adds_no_loop_and_joins_no_parts(pose_graph):
    support = support_graph(pose_graph)  # drawn graphs have no odometry, so no rungs
    before, after = (betti(len(pose_graph), edges) for edges in (pose_graph.edges, support.explained_edges))
    assert after[0] == before[0]
    assert after[1] <= before[1]


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.integers(4, 12), st.sampled_from([0.3, 0.6, 1.1]))
def test_what_rungs_explain_adds_no_loop_once_its_square_is_a_cell(seed, n, radius):
    rng = np.random.default_rng(seed)
    out = np.c_[np.arange(n), np.zeros(n), np.zeros(n)]
    positions = np.concatenate([out, out[::-1] + [0.0, 0.5, 0.0]]) + rng.normal(0, 0.05, (2 * n, 3))
    ties = [(i, 2 * n - 1 - i) for i in range(n - 1) if rng.random() < 0.2]
    graph = tracked(positions, radius, ties)
    support = support_graph(graph)
    rails = {frozenset(pair) for pair in graph.edges[graph.edge_sources == ODOMETRY].tolist()}
    known = set(map(tuple, support.explained_edges.tolist()))
    squares = [
        (i, k, m, j)
        for i, j in known
        for k in (i - 1, i + 1)
        for m in (j - 1, j + 1)
        if {frozenset((i, k)), frozenset((j, m))} <= rails and len({i, j, k, m}) == 4 and tuple(sorted((k, m))) in known
    ]
    assert betti(2 * n, known, squares)[1] <= betti(2 * n, graph.edges.tolist(), squares_of(graph, rails))[1]


def squares_of(graph, rails):
    """Squares of two odometry steps beside each other that the pose graph has itself."""
    own = set(map(tuple, graph.edges.tolist()))
    return [
        (i, k, m, j)
        for i, j in own
        for k in (i - 1, i + 1)
        for m in (j - 1, j + 1)
        if {frozenset((i, k)), frozenset((j, m))} <= rails and len({i, j, k, m}) == 4 and tuple(sorted((k, m))) in own
    ]


@SETTINGS
@given(pose_graphs(max_size=30), st.integers(0, 2**32 - 1))
def test_neither_order_of_keyframes_nor_growth_changes_the_fixpoint(pose_graph, seed):
    n, rng = len(pose_graph), np.random.default_rng(seed)
    support = support_graph(pose_graph)
    odometry = pose_graph.edges[rng.random(len(pose_graph.edges)) < 0.5]
    found = explained_overlaps(n, pose_graph.edges, support.inserted_edges, odometry)

    # other names for the keyframes
    rank = rng.permutation(n)
    renamed = [np.sort(rank[pairs], axis=1) for pairs in (pose_graph.edges, support.inserted_edges, odometry)]
    np.testing.assert_array_equal(explained_overlaps(n, *renamed), found)

    # overlaps that come later, from a graph that has settled
    late = rng.random(len(found)) < 0.5
    early = explained_overlaps(n, pose_graph.edges, support.inserted_edges[~late], odometry)
    known = np.concatenate([pose_graph.edges, support.inserted_edges[~late][early]])
    rest = np.concatenate([support.inserted_edges[late], support.inserted_edges[~late][~early]])
    again = explained_overlaps(n, known, rest, odometry)
    assert early.sum() + again.sum() == found.sum()


@SETTINGS
@given(pose_graphs(max_size=30))
def test_fusion_and_collisions_part_the_inserted_edges(pose_graph):
    support = support_graph(pose_graph)
    parts = [set(map(tuple, each.tolist())) for each in (support.fusion_edges, support.collision_edges)]
    assert parts[0] | parts[1] == set(map(tuple, support.inserted_edges.tolist()))
    assert not parts[0] & parts[1]
    assert len(support.explained_edges) == len(pose_graph.edges) + len(parts[0])
    left = explained_overlaps(len(pose_graph), support.explained_edges, support.collision_edges, pose_graph.edges[:0])
    assert not left.any()


@SETTINGS
@given(pose_graphs(max_size=30), st.integers(0, 2**32 - 1))
def test_a_new_edge_explains_the_same_from_its_own_frontier_as_from_all_edges(pose_graph, seed):
    n, support = len(pose_graph), support_graph(pose_graph)
    if not len(support.collision_edges):
        return
    k = int(np.random.default_rng(seed).integers(len(support.collision_edges)))
    new = support.collision_edges[k : k + 1]
    rest, known = np.delete(support.collision_edges, k, axis=0), np.concatenate([support.explained_edges, new])
    none = pose_graph.edges[:0]
    np.testing.assert_array_equal(
        explained_overlaps(n, known, rest, none, new), explained_overlaps(n, known, rest, none)
    )


def two_passes(n, gap=0.4):
    """Out along the x axis, up and around, and once more along it: the second pass beside the first."""
    out = np.c_[np.arange(n), np.zeros(n)]
    back = np.c_[np.arange(n)[::-1], np.full(n, 10.0)]
    return np.concatenate([out, [[n, 5.0]], back, [[-1, 5.0]], out + [0.0, gap]])


@pytest.mark.parametrize("radius", [0.3, 1.2])
def test_one_tie_explains_a_whole_second_pass_and_none_explains_nothing(radius):
    n = 12
    positions = two_passes(n)
    bare = support_graph(tracked(positions, radius))
    late = {(i, j) for i, j in bare.collision_edges.tolist() if j > 2 * n}
    assert len(late) >= n
    tied = support_graph(tracked(positions, radius, [(5, 2 * n + 2 + 5)]))
    assert not len(tied.collision_edges)


def test_a_map_without_collisions_has_no_distortion_by_them():
    n = 12
    found = pgti.assess(tracked(two_passes(n), 1.2, [(5, 2 * n + 2 + 5)]))
    assert found.collisions.score == 0
    assert found.fusion.score == found.score > 0
    bare = pgti.assess(tracked(two_passes(n), 1.2))
    assert bare.collisions.score > 0


@SETTINGS
@given(pose_graphs())
def test_fusion_and_collisions_are_what_assess_finds_on_their_graphs(pose_graph):
    found, support = pgti.assess(pose_graph), support_graph(pose_graph)
    explained = pgti.PoseGraph(
        keys=pose_graph.keys, positions=pose_graph.positions, edges=support.explained_edges, radii=pose_graph.radii
    )
    np.testing.assert_array_equal(found.collisions.keyframe_scores, pgti.assess(explained).keyframe_scores)
    assert len(found.fusion_edges) + len(found.collision_edges) == len(found.inserted_edges)


def test_where_covisibility_is_dense_collisions_are_all_that_the_paper_counts():
    """A way that crosses itself by drift; each keyframe shares landmarks with the next seventeen, as in Table 4."""
    angle = np.linspace(0.2, 2 * np.pi - 0.2, 200)
    loop = 40 * np.c_[1 - np.cos(angle), np.sin(angle)]
    positions = np.concatenate([loop, loop[-1] + np.outer(np.arange(1, 60), [0.1, 1.2])])
    i, gap = np.meshgrid(np.arange(len(positions)), np.arange(1, 18), indexing="ij")
    edges = np.stack([i.ravel(), (i + gap).ravel()], axis=1)
    edges = edges[edges[:, 1] < len(positions)]
    found = pgti.assess(pgti.PoseGraph(keys=range(len(positions)), positions=positions, edges=edges, radii=0.8))
    assert len(found.collision_edges) == len(found.inserted_edges) > 0
    np.testing.assert_array_equal(found.collisions.keyframe_scores, found.keyframe_scores)
    assert found.fusion.score == 0
