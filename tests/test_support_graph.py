"""Spheres that meet, found fast and compared with every pair looked at."""

import numpy as np
import pytest
from drawn import pose_graphs
from hypothesis import given, settings
from hypothesis import strategies as st

import pgti_gtsam as pgti
from pgti_gtsam.support_graph import overlapping_spheres, support_graph
from pgti_gtsam.track import track_edges

SETTINGS = settings(derandomize=True, deadline=None, max_examples=150)


@SETTINGS
@given(pose_graphs(max_size=40))
def test_overlaps_are_those_of_every_pair_looked_at(pose_graph):
    positions, radii = pose_graph.positions, pose_graph.radii
    distances = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    expected = np.argwhere(np.triu(distances <= radii[:, None] + radii[None], 1))
    np.testing.assert_array_equal(overlapping_spheres(positions, radii), expected)


@SETTINGS
@given(pose_graphs())
def test_merged_is_the_union_and_inserted_the_difference(pose_graph):
    support = support_graph(pose_graph)
    as_sets = [set(map(tuple, edges.tolist())) for edges in (pose_graph.edges, support.free_space_edges)]
    assert set(map(tuple, support.merged_edges.tolist())) == as_sets[0] | as_sets[1]
    assert set(map(tuple, support.inserted_edges.tolist())) == as_sets[1] - as_sets[0]
    assert len(support.merged_edges) == len(as_sets[0] | as_sets[1])


@pytest.mark.parametrize(
    ("gap", "radii", "meet"),
    [
        (2.0, (1.0, 1.0), True),  # touching
        (2.0, (2.0, 0.0), True),  # a bare centre on a sphere
        (2.0, (1.9, 0.0), False),
        (0.0, (0.0, 0.0), True),  # one place
        (1e-9, (0.0, 0.0), False),
        (1000.0, (1e-3, 1000.0), True),  # radii six decades apart
    ],
)
def test_touching_spheres_meet(gap, radii, meet):
    found = overlapping_spheres(np.array([[0, 0, 0], [gap, 0, 0]]), np.array(radii))
    assert len(found) == int(meet)


@SETTINGS
@given(st.integers(1, 30), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.5, 3.0, 100.0]))
def test_the_track_connects_what_its_length_cannot_part(n, seed, size):
    rng = np.random.default_rng(seed)
    steps = rng.exponential(size=n - 1)
    steps[rng.random(n - 1) < 0.2] = np.nan
    radii = rng.exponential(size=n) * size
    expected = [
        (i, j)
        for i in range(n)
        for j in range(i + 1, n)
        if steps[i:j].sum() <= radii[i] + radii[j]  # false for NaN, where no odometry joins them
    ]
    assert sorted(map(tuple, track_edges(steps, radii).tolist())) == expected


def test_the_track_repairs_the_premise_of_section_5_1():
    positions = np.stack([np.arange(50.0), np.zeros(50)], axis=1)
    chain = [(i, i + 1) for i in range(49)]
    bare = pgti.PoseGraph(keys=range(50), positions=positions, edges=chain, radii=2.2)
    tracked = pgti.PoseGraph(keys=range(50), positions=positions, edges=track_edges(np.ones(49), bare.radii), radii=2.2)
    assert pgti.assess(bare).score > 0.1
    assert pgti.assess(tracked).score == 0
