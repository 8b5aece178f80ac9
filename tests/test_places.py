"""Revisits of a map: tied part by part they are those that are found one after the other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pgti_gtsam as pgti
from pgti_gtsam.pair_codes import codes_of
from pgti_gtsam.places import neighbourhoods, places_on, revisits
from pgti_gtsam.pose_graph import EdgeSource
from pgti_gtsam.support_graph import explained_overlaps
from pgti_gtsam.track import track_of

ODOMETRY = EdgeSource.BETWEEN | EdgeSource.ODOMETRY


def wandering(seed, n, radius, width, n_chains=1):
    """Odometry along a random walk that meets itself again and again, in a square that it does not leave."""
    random = np.random.default_rng(seed)
    headings = np.cumsum(random.normal(0.0, 0.5, n))
    walk = np.cumsum(np.c_[np.cos(headings), np.sin(headings)], axis=0)
    folded = width - np.abs(walk % (2 * width) - width)
    broken = set(random.choice(n - 1, n_chains - 1, replace=False).tolist())
    edges = [(i, i + 1) for i in range(n - 1) if i not in broken]
    return pgti.PoseGraph(
        keys=range(n),
        positions=np.c_[folded, np.zeros(n)],
        edges=edges,
        radii=radius * random.uniform(0.5, 1.0, n),
        edge_sources=[ODOMETRY] * len(edges),
    )


def one_after_the_other(pose_graph, integrity, track):
    """The definition: the largest group is tied, all is asked again, and so on."""
    n, odometry = len(pose_graph), pose_graph.edges
    left, known = integrity.collision_edges, np.concatenate([pose_graph.edges, integrity.fusion_edges])
    groups, found = neighbourhoods(left, places_on(pose_graph, track)).group_of, []
    while len(left):
        own = groups == np.bincount(groups).argmax()
        known = np.concatenate([known, left[own]])
        follows = ~own
        follows[~own] = explained_overlaps(n, known, left[~own], odometry)  # all edges taken for new
        found.append((set(codes_of(left[own], n)), set(codes_of(left[own | follows], n))))
        known = np.concatenate([known, left[follows]])
        left, groups = left[~own & ~follows], groups[~own & ~follows]
    return sorted(found, key=lambda each: -len(each[1]))


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(20, 150), st.sampled_from([0.4, 0.8, 1.5]), st.integers(1, 3))
def test_revisits_of_all_parts_at_once_are_those_one_after_the_other(seed, n, radius, n_chains):
    pose_graph = wandering(seed, n, radius, 9.0, n_chains)
    integrity, track = pgti.assess(pose_graph), track_of(pose_graph)
    found = [
        (set(codes_of(each.edges, n)), set(codes_of(each.resolved, n)))
        for each in revisits(pose_graph, integrity, track)
    ]
    assert found == one_after_the_other(pose_graph, integrity, track)


@pytest.mark.parametrize("seed", range(3))
def test_revisits_part_the_collisions(seed):
    pose_graph = wandering(seed, 200, 0.8, 12.0)
    integrity = pgti.assess(pose_graph)
    found = revisits(pose_graph, integrity, track_of(pose_graph))
    assert len(found) > 3
    codes = np.concatenate([codes_of(each.resolved, 200) for each in found])
    np.testing.assert_array_equal(np.sort(codes), codes_of(integrity.collision_edges, 200))
