"""The heat kernel from its poles: the dense one as oracle, closed forms where that cannot go."""

import closed_forms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgti_gtsam.spectral.dense_kernel import dense_heat_kernel
from pgti_gtsam.spectral.pole_kernel import pole_kernels

SETTINGS = settings(derandomize=True, deadline=None, max_examples=80)
STABLE_TIMES = np.geomspace(0.5, 2000, 40)


@st.composite
def nested_graphs(draw, max_size=80):
    """G_p and G_m ⊇ G_p: chains with closures, pieces, cliques on strings, isolated vertices, nothing at all."""
    n = draw(st.integers(1, max_size))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    clique = np.argwhere(np.triu(np.ones((n // 3, n // 3)), 1))
    some = np.argwhere(np.triu(rng.random((n, n)) < 2 * draw(st.sampled_from([0.0, 0.1, 1.0])) / n, 1))
    keep = rng.random(len(chain)) < draw(st.sampled_from([0.0, 0.9, 1.0]))
    chain = chain[keep]
    parts = [chain, clique, some][: draw(st.integers(1, 3))]
    pose = np.unique(np.concatenate(parts), axis=0)
    more = np.sort(rng.integers(0, n, (draw(st.integers(0, 5)), 2)), axis=1)
    merged = np.unique(np.concatenate([pose, more[more[:, 0] < more[:, 1]]]), axis=0)
    return n, pose.astype(np.int64), merged.astype(np.int64)


def grid_of_times(kernel):
    return np.geomspace(4 * np.log(10) / kernel.largest, 4 * np.log(10) / kernel.smallest_positive, 30)


def isolated(n, edges):
    return np.bincount(edges.ravel(), minlength=n) == 0


def distortions(pose, merged):
    """ζ of Eq. 17 wherever the pose graph's signature is not zero."""
    norms = np.linalg.norm(pose, axis=1)
    present = norms > 0
    return np.linalg.norm(pose - merged, axis=1)[present] / norms[present]


@SETTINGS
@given(nested_graphs())
def test_signatures_and_their_ratios_agree_with_the_dense_ones(graphs):
    n, *edge_lists = graphs
    kernels = pole_kernels(n, tuple(edge_lists))
    exact = [dense_heat_kernel(n, edges) for edges in edge_lists]
    times = grid_of_times(exact[1])
    found, expected = ([k.signatures(times) for k in family] for family in (kernels, exact))
    for edges, kernel, dense, mine, oracle in zip(edge_lists, kernels, exact, found, expected, strict=True):
        assert kernel.n_components == dense.n_components
        assert kernel.smallest_positive == pytest.approx(dense.smallest_positive, rel=1e-9)
        assert kernel.largest == pytest.approx(dense.largest, rel=1e-9)
        assert kernel.error_estimate <= 1e-7
        np.testing.assert_allclose(mine, oracle, atol=1e-7 * oracle.max(initial=0.0))
        np.testing.assert_array_equal(mine[isolated(n, edges)], 0.0)
        np.testing.assert_allclose(kernel.diagonals(STABLE_TIMES), dense.diagonals(STABLE_TIMES), atol=1e-8)
    np.testing.assert_allclose(distortions(*found), distortions(*expected), rtol=1e-6, atol=1e-7)


@SETTINGS
@given(nested_graphs(max_size=30), st.randoms(use_true_random=False))
def test_relabelled_vertices_have_relabelled_signatures(graphs, random):
    n, pose, _ = graphs
    new = np.array(random.sample(range(n), n))
    (kernel,), (other,) = pole_kernels(n, (pose,)), pole_kernels(n, (new[pose],))
    times = grid_of_times(kernel)
    np.testing.assert_allclose(other.signatures(times)[new], kernel.signatures(times), atol=1e-7)


@SETTINGS
@given(nested_graphs(max_size=30), st.floats(0.0, 1e4))
def test_heat_is_kept_at_time_zero_and_never_grows(graphs, time):
    n, pose, _ = graphs
    (kernel,) = pole_kernels(n, (pose,))
    start, later = kernel.diagonals(np.array([0.0, time])).T
    np.testing.assert_allclose(start, 1.0, atol=1e-8)
    assert np.all(later <= start + 1e-8)
    assert np.all(later >= kernel.zero_mode - 1e-8)


def test_an_edge_listed_twice_counts_twice():
    n, edges, _ = closed_forms.path(12)
    (kernel,) = pole_kernels(n, (np.concatenate([edges, edges]),))
    np.testing.assert_allclose(
        kernel.diagonals(np.array([1.5])), closed_forms.path_kernel_diagonal(12, [3.0]), rtol=1e-7
    )


def test_a_lower_tolerance_gives_a_smaller_error():
    n, edges, _ = closed_forms.grid(15, 16)
    times = np.geomspace(1, 100, 20)
    oracle = dense_heat_kernel(n, edges).signatures(times)
    errors = [
        np.abs(pole_kernels(n, (edges,), tolerance)[0].signatures(times) - oracle).max() / oracle.max()
        for tolerance in (1e-4, 1e-6, 1e-8, 1e-10)
    ]
    assert np.all(np.diff(errors) < 0)
    assert np.all(errors <= np.array([1e-4, 1e-6, 1e-8, 1e-10]))


def test_a_merged_graph_that_joins_components_survives_underflow():
    """At the last times exp(−tλ) of the pose graph is below 1e-300 in every entry and in the trace."""
    pieces, n = 60, 600
    pose = np.concatenate([closed_forms.path(10)[1] + 10 * k for k in range(pieces)])
    merged = closed_forms.path(n)[1]
    kernels = pole_kernels(n, (pose, merged))
    times = grid_of_times(kernels[1])
    assert np.exp(-kernels[0].smallest_positive * times[-1]) == 0.0
    oracle = dense_heat_kernel(n, pose).signatures(times)
    np.testing.assert_allclose(kernels[0].signatures(times), oracle, atol=1e-8 * oracle.max())


def test_a_clique_on_a_long_string_has_a_condition_number_above_a_million():
    _, clique, _ = closed_forms.complete(80)
    _, string, _ = closed_forms.path(520)
    edges = np.concatenate([clique, string + 79])
    (kernel,) = pole_kernels(599, (edges,))
    exact = dense_heat_kernel(599, edges)
    assert exact.largest / exact.smallest_positive > 1e6
    times = grid_of_times(exact)
    oracle = exact.signatures(times)
    np.testing.assert_allclose(kernel.signatures(times), oracle, atol=1e-8 * oracle.max())


@pytest.mark.parametrize("shape", ["path", "cycle", "grid"])
def test_large_graphs_agree_with_closed_forms(shape):
    n, edges, diagonals = LARGE[shape]
    (kernel,) = pole_kernels(n, (edges,))
    times = grid_of_times(kernel)
    vertices = np.linspace(0, n - 1, 23).astype(int)
    expected = diagonals(vertices, times)
    np.testing.assert_allclose(kernel.diagonals(times)[vertices], expected, rtol=1e-6)


def _path_diagonals(n, vertices, times):
    k = np.arange(1, n)
    eigenvalues = 4 * np.sin(np.pi * k / (2 * n)) ** 2
    modes = 2 / n * np.cos(np.pi * np.outer(vertices + 0.5, k) / n) ** 2
    return 1 / n + modes @ np.exp(-np.outer(eigenvalues, times))


def _cycle_diagonals(n, vertices, times):
    eigenvalues = 4 * np.sin(np.pi * np.arange(n) / n) ** 2
    return np.tile(np.exp(-np.outer(eigenvalues, times)).mean(axis=0), (len(vertices), 1))


def _grid_diagonals(rows, columns, vertices, times):
    return _path_diagonals(rows, vertices // columns, times) * _path_diagonals(columns, vertices % columns, times)


LARGE = {
    "path": (5000, closed_forms.path(5000)[1], lambda v, t: _path_diagonals(5000, v, t)),
    "cycle": (4000, closed_forms.cycle(4000)[1], lambda v, t: _cycle_diagonals(4000, v, t)),
    "grid": (3000, closed_forms.grid(50, 60)[1], lambda v, t: _grid_diagonals(50, 60, v, t)),
}
