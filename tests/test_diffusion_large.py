"""Graphs beyond what all modes of a dense matrix serve: products and resolvents tell what the modes tell."""

import gtsam
import numpy as np
import pytest
from scipy import linalg, sparse

from pgti_gtsam import diffusion
from pgti_gtsam.diffusion import block_laplacian, flow, proxy
from pgti_gtsam.errors import InvalidGraphError, InvalidValueError, UnsolvableGraphError

N = 20


@pytest.fixture
def large(monkeypatch):
    """Every graph counts as large."""
    for module in (flow, proxy):
        monkeypatch.setattr(module, "MODES_UP_TO", 3)


def ring(*, is_held=True):
    """A ring of keyframes with two chords, tied with different information; its first keyframe is held."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(N):
        values.insert(k, gtsam.Pose2(np.cos(k), np.sin(k), 0.3 * k))
    for i, j in [*((k, (k + 1) % N) for k in range(N)), (0, 9), (4, 15)]:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.2, 0.05]) * (1 + i % 3))
        graph.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(0.2, 0.3, 0.31), noise))
    if is_held:
        graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(1, 0, 0), gtsam.noiseModel.Isotropic.Sigma(3, 0.1)))
    return diffusion.normal_equations(diffusion.linearise(graph, values))


def three():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(3):
        values.insert(k, gtsam.Pose2(k, 0, 0))
    for k in range(2):
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(1, 0, 0), gtsam.noiseModel.Unit.Create(3)))
    return graph, values


def test_the_flow_of_a_large_graph_is_the_matrix_exponential_at_short_and_at_long_times(large):
    equations = ring()
    dense, found = equations.hessian.toarray(), diffusion.heat_flow(equations)
    slowest, fastest = np.linalg.eigvalsh(dense)[[0, -1]]
    times = np.geomspace(0.01 / fastest, 3 / slowest, 9)
    norm = abs(equations.hessian).sum(axis=0).max()
    assert times[0] * norm < flow.PRODUCTS < times[-1] * norm
    expected = [found.steady - linalg.expm(-t * dense) @ found.steady for t in times]
    np.testing.assert_allclose(found.at(times), expected, atol=1e-7 * np.abs(found.steady).max())
    short = times[times * norm <= flow.PRODUCTS]
    np.testing.assert_array_equal(found.at(short), found.at(times)[: len(short)])


@pytest.mark.parametrize("is_held", [True, False])
def test_the_rates_of_a_large_flow_are_the_extreme_eigenvalues(large, is_held):
    equations = ring(is_held=is_held)
    slowest, fastest = diffusion.extreme_eigenvalues(equations)
    expected = np.linalg.eigvalsh(equations.hessian.toarray())
    assert fastest == pytest.approx(expected[-1], rel=1e-5)
    assert slowest == pytest.approx(max(expected[0], 0.0), rel=1e-5, abs=1e-9 * fastest)


def test_a_matrix_of_a_zero_row_has_no_slowest_rate(large):
    """Nothing ties the last vertex: the factorisation finds a pivot of zero."""
    equations = diffusion.relative_consensus(6, [(0, 1), (1, 2), (2, 3), (3, 4)], np.ones((4, 1)), held=0)
    assert diffusion.extreme_eigenvalues(equations)[0] == 0.0
    with pytest.raises(UnsolvableGraphError, match="prior"):
        diffusion.steady_state(equations)


def test_the_heat_left_at_a_keyframe_of_a_large_graph_is_that_of_all_modes(monkeypatch):
    equations, vertices = ring(is_held=False), np.array([0, 7, 19])
    times = np.geomspace(1e-4, 1e2, 7)
    expected = diffusion.heat_left(equations.hessian, 3, vertices, times)
    monkeypatch.setattr(proxy, "MODES_UP_TO", 3)
    np.testing.assert_allclose(diffusion.heat_left(equations.hessian, 3, vertices, times), expected, atol=1e-6)
    assert len(proxy.chosen_vertices(N, 3)) == N  # few enough to ask all of them
    chosen = proxy.chosen_vertices(5000, 3)
    assert len(chosen) <= proxy.SAMPLED_COLUMNS // 3
    assert (chosen[0], chosen[-1]) == (0, 4999)


def test_a_large_graph_is_as_well_ordered_by_the_scalar_laplacian(monkeypatch):
    expected = diffusion.compare(ring(is_held=False))
    for module in (flow, proxy):
        monkeypatch.setattr(module, "MODES_UP_TO", 3)
    found = diffusion.compare(ring(is_held=False))
    for name in ("times", "matched_times", "scalar", "block", "differences"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0.01, atol=1e-4)
    assert found.rank_correlation == pytest.approx(expected.rank_correlation, abs=0.1)  # some vertices are alike


def test_other_variables_that_hang_together_beyond_what_is_eliminated_densely_are_refused(monkeypatch):
    """A pose sees a landmark, which is tied to a second, and so on."""
    graph, values = three()
    for k in range(4):
        values.insert(10 + k, np.array([float(k), 1.0]))
        graph.add(gtsam.BearingRangeFactor2D(0, 10 + k, gtsam.Rot2(1.5), 1.0, gtsam.noiseModel.Unit.Create(2)))
        if k:
            graph.add(gtsam.BetweenFactorPoint2(9 + k, 10 + k, np.array([1.0, 0.0]), gtsam.noiseModel.Unit.Create(2)))
    linearisation = diffusion.linearise(graph, values)
    assert diffusion.normal_equations(linearisation).n_vertices == 3
    monkeypatch.setattr(block_laplacian, "LARGEST_ELIMINATED", 7)
    with pytest.raises(InvalidGraphError, match="at most 7 dimensions, got 8"):
        diffusion.normal_equations(linearisation)


def test_series_that_never_change_are_in_one_order():
    assert diffusion.spearman(np.zeros(4), np.zeros(4)) == 1.0
    assert diffusion.spearman(np.zeros(4), np.arange(4.0)) == 0.0


def test_a_linearisation_in_space_stays_in_space():
    spatial = diffusion.in_space(diffusion.linearise(*three()))
    assert diffusion.in_space(spatial) is spatial


def test_a_factor_with_an_error_that_is_no_number_is_named():
    graph, values = three()
    broken = gtsam.noiseModel.Diagonal.Sigmas(np.array([1.0, 1.0, np.nan]))
    graph.add(gtsam.BetweenFactorPose2(0, 2, gtsam.Pose2(2, 0, 0), broken))
    with pytest.raises(
        InvalidValueError, match="finite error and Jacobian, got another in BetweenFactorPose2 in slot 2"
    ):
        diffusion.linearise(graph, values)


def test_a_shifted_singular_matrix_is_refused():
    with pytest.raises(UnsolvableGraphError, match="prior"):
        flow.factorised(sparse.csc_array((2, 2)))
