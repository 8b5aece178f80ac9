"""Laws of the covariance-free evidence."""

import numpy as np
import pytest
from drawn import pose_graphs
from hypothesis import given, settings
from hypothesis import strategies as st

import pgti_gtsam as pgti
from pgti_gtsam.drift.ties import free_space_unit
from pgti_gtsam.errors import NoRadiusError
from pgti_gtsam.gate.decision import Change
from pgti_gtsam.gate.terms.contact_rise import (
    GATE_TIMES,
    REGION,
    bridged_overlaps,
    contacts,
    local_rise,
    term,
)
from pgti_gtsam.integrity import stable_scores
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from pgti_gtsam.support_graph import overlapping_spheres

laws = settings(derandomize=True, deadline=None, max_examples=60)


def hairpin(gap, tail=0):
    """Two legs of twenty keyframes, two metres apart along the track and `gap` across; then a straight tail."""
    out = [(2.0 * k, 0.0) for k in range(20)]
    back = [(38.0 - 2.0 * k, gap) for k in range(20)]
    on = [(-2.0 * (k + 1), gap) for k in range(tail)]
    positions = np.array(out + back + on)
    edges = [(k, k + 1) for k in range(len(positions) - 1)]
    return pgti.PoseGraph(keys=np.arange(len(positions)), positions=positions, edges=edges, radii=1.5)


def with_edges(graph, pairs, positions=None, radii=None):
    return pgti.PoseGraph(
        keys=graph.keys,
        positions=graph.positions if positions is None else positions,
        edges=[*graph.edges.tolist(), *pairs],
        radii=graph.radii if radii is None else radii,
    )


def test_rise_is_after_minus_before():
    assert Change(before=2.0, after=5.0).rise == 3.0


def test_unit_of_free_space_is_the_median_of_the_positive_radii():
    graph = pgti.PoseGraph(keys=range(4), positions=np.eye(4, 3), edges=[(0, 1)], radii=[0.0, 1.0, 3.0, 8.0])
    assert free_space_unit(graph) == 3.0


def test_without_a_positive_radius_there_is_no_unit():
    graph = pgti.PoseGraph(keys=range(2), positions=np.eye(2, 3), edges=[(0, 1)], radii=0.0)
    with pytest.raises(NoRadiusError, match="positive radius"):
        free_space_unit(graph)


@laws
@given(pose_graphs())
def test_what_is_explained_does_overlap(graph):
    found = {tuple(sorted(pair)) for pair in bridged_overlaps(graph).tolist()}
    slack = graph.radii * (1 + 1e-9) + 1e-9 * graph.radii.max()
    assert found <= {tuple(pair) for pair in overlapping_spheres(graph.positions, slack).tolist()}


@laws
@given(pose_graphs())
def test_what_is_connected_is_merged(graph):
    found = contacts(graph)
    assert set(found.connected) <= set(found.merged)
    assert found.unexplained >= 0


@laws
@given(pose_graphs())
def test_what_changes_nothing_raises_nothing(graph):
    change, worst = local_rise(contacts(graph), contacts(graph))
    assert (change.before, change.after, worst) == (0.0, 0.0, None)


def test_a_closure_explains_the_overlaps_beside_it():
    # The legs are 2.5 m apart and spheres reach 1.5 m: with keyframes k and 39 - k tied, their neighbours at 2 m
    # are too far to follow from the tie alone (4.5 m of way against 3 m of spheres), at 0.2 m they are not.
    graph = hairpin(2.5)
    assert bridged_overlaps(with_edges(graph, [(10, 29)])).tolist() == [[10, 29]]
    close = with_edges(hairpin(2.5), [(10, 29)], positions=graph.positions * [0.1, 1.0, 1.0])
    assert len(bridged_overlaps(close)) > 1


@laws
@given(pose_graphs(), st.integers(0, 2**32 - 1))
def test_on_a_small_map_the_local_score_is_the_stable_score(graph, seed):
    rng = np.random.default_rng(seed)
    moved = with_edges(graph, [], positions=graph.positions + rng.normal(size=(len(graph), 3)))
    before, after = contacts(graph), contacts(moved)
    change, worst = local_rise(before, after)
    if worst is None:
        return
    n = len(graph)
    assert n <= REGION
    old, new = (
        stable_scores(
            *heat_kernels(n, *(np.stack([c // n, c % n], axis=1) for c in (s.connected, s.merged))), GATE_TIMES
        )
        for s in (before, after)
    )
    assert change.rise == pytest.approx(new[worst] - old[worst], abs=1e-9)
    assert change.before == pytest.approx(old[worst], abs=1e-9)


def folded(graph, pair):
    """The second leg laid upon the first."""
    return with_edges(graph, [pair], positions=graph.positions * [1.0, 0.02, 1.0])


def test_folding_a_map_raises_the_score_and_unfolding_it_lowers_it():
    apart, together = contacts(hairpin(20.0)), contacts(folded(hairpin(20.0), (0, 25)))
    assert local_rise(apart, together)[0].rise > 0.5
    assert local_rise(together, apart)[0].rise <= 0


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_rise_keeps_under_scale_and_rigid_motion(scale):
    rotation, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    graph, after = hairpin(20.0), folded(hairpin(20.0), (0, 25))
    expected, worst = local_rise(contacts(graph), contacts(after))
    moved = [
        contacts(with_edges(g, [], positions=scale * g.positions @ rotation.T + 7 * scale, radii=scale * g.radii))
        for g in (graph, after)
    ]
    found, where = local_rise(*moved)
    assert found.rise == pytest.approx(expected.rise, abs=1e-9)
    assert where == worst


def test_the_rise_does_not_depend_on_what_is_far_away():
    rises = [
        local_rise(contacts(hairpin(20.0, tail)), contacts(folded(hairpin(20.0, tail), (10, 25))))[0].rise
        for tail in (400, 900)
    ]
    assert rises[1] == pytest.approx(rises[0], abs=1e-3)


def test_on_a_large_map_the_local_score_is_nearly_that_of_all_keyframes():
    graph, after = hairpin(20.0, 400), folded(hairpin(20.0, 400), (10, 25))
    n, sides = len(graph), [contacts(each) for each in (graph, after)]
    assert n > REGION
    change, worst = local_rise(*sides)
    old, new = (
        stable_scores(
            *heat_kernels(n, *(np.stack([c // n, c % n], axis=1) for c in (s.connected, s.merged))), GATE_TIMES
        )
        for s in sides
    )
    assert change.rise == pytest.approx(new[worst] - old[worst], abs=1e-3)


@pytest.mark.parametrize(
    ("before", "after", "label", "said"),
    [
        (0.1, 0.5, "x7", "Free space around x7 comes to touch places that nothing connects: its score rises from 0.10"),
        (0.5, 0.1, "x7", "No keyframe's score rises: it goes from 0.50 to 0.10 around x7."),
        (0.5, 0.502, "x7", "No keyframe's score rises: it stays at 0.50 around x7."),
        (0.0, 0.0, None, "No contact of free space changes."),
    ],
)
def test_a_rise_is_told_by_its_keyframe(before, after, label, said):
    found = term(Change(before=before, after=after), label)
    assert found.sentence.startswith(said)
    assert found.value == pytest.approx(after - before)
