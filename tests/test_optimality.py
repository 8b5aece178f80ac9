"""Optimality criteria: Kirchhoff's theorem on graphs whose trees can be counted, and laws of information."""

import closed_forms
import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam.optimality import information_criteria, optimality

LINE = np.stack([np.arange(4.0), np.zeros(4), np.zeros(4)], axis=1)


@pytest.mark.parametrize("family", closed_forms.FAMILIES.values(), ids=closed_forms.FAMILIES.keys())
def test_criteria_are_means_and_ends_of_the_spectrum(family):
    n, edges, spectrum = family
    found, positive = optimality(n, edges), np.sort(spectrum)[1:]
    assert found.d == pytest.approx(np.prod(positive) ** (1 / n), rel=1e-9)
    assert found.t == pytest.approx(positive.sum() / n, rel=1e-9)
    assert found.e == pytest.approx(positive[0], rel=1e-9)
    assert found.e_tilde == pytest.approx(positive[-1], rel=1e-9)


def test_d_counts_spanning_trees():
    n, edges, _ = closed_forms.complete(6)
    assert optimality(n, edges).d ** n / n == pytest.approx(6**4, rel=1e-9)  # Cayley's formula


def test_a_disconnected_graph_has_no_spanning_tree_and_no_connectivity():
    found = optimality(4, np.array([(0, 1), (2, 3)]))
    assert (found.d, found.e) == (0.0, 0.0)
    assert found.t == 1.0
    assert found.e_tilde == pytest.approx(2.0)


@pytest.mark.parametrize(("n", "edges"), [(1, np.empty((0, 2), int)), (3, np.empty((0, 2), int))])
def test_without_edges_every_criterion_is_zero(n, edges):
    found = optimality(n, edges)
    assert (found.d, found.t, found.e, found.e_tilde) == (0, 0, 0, 0)


def test_criteria_of_information_take_the_leading_block():
    information = np.full((3, 3, 3), np.nan)
    information[0] = np.diag([1.0, 4.0, 16.0])
    information[1, :2, :2] = np.diag([2.0, 8.0])
    np.testing.assert_allclose(information_criteria(information)[:2], [[4, 7, 1, 16], [4, 5, 2, 8]])
    assert np.isnan(information_criteria(information)[2]).all()


def test_equal_information_scales_every_weighted_criterion():
    edges = [(0, 1), (1, 2), (2, 3)]
    graph = pgti.PoseGraph(
        keys=range(4), positions=LINE, edges=edges, radii=1.0, edge_information=np.stack([5 * np.eye(3)] * 3)
    )
    found = pgti.assess(graph).optimality
    for name in ("d", "t", "e", "e_tilde"):
        scale = 5 ** (3 / 4) if name == "d" else 5  # three positive eigenvalues under a fourth root
        for which in ("pose_graph", "merged_graph"):
            plain, weighted = (getattr(getattr(part, which), name) for part in (found.unweighted, found.weighted))
            assert weighted == pytest.approx(scale * plain, rel=1e-9)


def test_inserted_edges_raise_every_criterion_and_change_is_their_difference():
    found = pgti.assess(pgti.PoseGraph(keys=range(4), positions=LINE, edges=[(0, 1), (1, 2), (2, 3)], radii=1.0))
    assert found.optimality.weighted is None
    for name in ("d", "t", "e", "e_tilde"):
        before, after = (getattr(part, name) for part in (found.optimality.pose_graph, found.optimality.merged_graph))
        assert after > before
        assert getattr(found.optimality.change, name) == pytest.approx(after - before)
