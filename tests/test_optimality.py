"""Optimality criteria: Kirchhoff's theorem on graphs whose trees can be counted, and laws of information."""

import closed_forms
import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam.optimality import compare_optimality, information_criteria, optimality
from pgti_gtsam.support_graph import support_graph

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


@pytest.mark.parametrize("method", ["dense", "poles"])
def test_what_the_heat_kernels_know_need_not_be_found_again(method):
    graph = pgti.PoseGraph(keys=range(4), positions=LINE, edges=[(0, 1), (1, 2), (2, 3)], radii=1.0)
    found, afresh = pgti.assess(graph, method=method).optimality, compare_optimality(graph, support_graph(graph))
    for name in ("d", "t", "e", "e_tilde"):
        for which in ("pose_graph", "merged_graph"):
            known, expected = (getattr(getattr(part, which), name) for part in (found, afresh))
            assert known == pytest.approx(expected, rel=1e-9)


def test_edges_of_different_information_are_weighted_one_by_one():
    information = np.stack([np.eye(3), 4 * np.eye(3)])
    graph = pgti.PoseGraph(
        keys=range(3), positions=LINE[:3], edges=[(0, 1), (1, 2)], radii=0.1, edge_information=information
    )
    found = pgti.assess(graph).optimality.weighted.pose_graph
    spectrum = np.linalg.eigvalsh([[1, -1, 0], [-1, 5, -4], [0, -4, 4]])[1:]
    assert found.d == pytest.approx(np.prod(spectrum) ** (1 / 3))
    assert (found.t, found.e, found.e_tilde) == pytest.approx((spectrum.sum() / 3, spectrum[0], spectrum[1]))


def test_inserted_edges_raise_every_criterion_and_change_is_their_difference():
    found = pgti.assess(pgti.PoseGraph(keys=range(4), positions=LINE, edges=[(0, 1), (1, 2), (2, 3)], radii=1.0))
    assert found.optimality.weighted is None
    for name in ("d", "t", "e", "e_tilde"):
        before, after = (getattr(part, name) for part in (found.optimality.pose_graph, found.optimality.merged_graph))
        assert after > before
        assert getattr(found.optimality.change, name) == pytest.approx(after - before)
