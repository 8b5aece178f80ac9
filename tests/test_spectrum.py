"""Ends of Laplacian spectra: closed forms, dense eigenvalues, nearly disconnected and badly scaled graphs."""

import closed_forms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgti_gtsam.spectral.laplacian import connected_components, laplacian
from pgti_gtsam.spectral.spectrum import (
    extreme_eigenvalues,
    log_pseudo_determinant,
    lowest_eigenpairs,
    smallest_by_component,
)

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60)


@st.composite
def weighted_graphs(draw, max_size=24):
    """Graphs from empty to complete, isolated vertices and repeated edges among them."""
    n = draw(st.integers(1, max_size))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    edges = np.argwhere(np.triu(rng.random((n, n)) < draw(st.sampled_from([0.0, 0.08, 0.3, 1.0])), 1))
    if len(edges) and draw(st.booleans()):
        edges = np.concatenate([edges, edges[rng.integers(len(edges), size=3)]])
    decades = draw(st.sampled_from([0.0, 1.0, 3.0]))
    return n, edges.astype(np.int64), 10 ** rng.uniform(-decades, decades, len(edges))


def ends(n, edges, weights=None):
    return extreme_eigenvalues(laplacian(n, edges, weights), connected_components(n, edges)[1])


def test_a_graph_without_edges_has_no_positive_eigenvalue():
    assert ends(5, np.empty((0, 2), dtype=int)) == (1.0, 1.0)


@pytest.mark.parametrize("family", closed_forms.FAMILIES.values(), ids=closed_forms.FAMILIES.keys())
def test_ends_agree_with_closed_forms(family):
    n, edges, spectrum = family
    positive = np.sort(spectrum)[1:]
    assert ends(n, edges) == pytest.approx((positive[0], positive[-1]), rel=1e-9)
    assert log_pseudo_determinant(laplacian(n, edges), np.zeros(n, int)) == pytest.approx(np.log(positive).sum())


@pytest.mark.parametrize(
    ("n", "edges", "positive"),
    [
        (n, edges, (np.sort(spectrum)[1], spectrum.max()))
        for n, edges, spectrum in [closed_forms.path(20_000), closed_forms.cycle(10_001), closed_forms.grid(70, 90)]
    ],
    ids=["path", "cycle", "grid"],
)
def test_ends_of_large_graphs_agree_with_closed_forms(n, edges, positive):
    low, high = ends(n, edges)
    assert low == pytest.approx(positive[0], rel=1e-6)  # the closed form 2 − 2 cos itself cancels
    assert high == pytest.approx(positive[1], rel=1e-9)


@SETTINGS
@given(weighted_graphs())
def test_ends_agree_with_dense_eigenvalues(graph):
    n, edges, weights = graph
    count, labels = connected_components(n, edges)
    matrix = laplacian(n, edges, weights)
    positive = np.linalg.eigvalsh(matrix.toarray())[count:]
    if len(positive) == 0:
        return
    low, high = extreme_eigenvalues(matrix, labels)
    assert high == pytest.approx(positive[-1], rel=1e-9)
    assert low == pytest.approx(positive[0], rel=1e-9, abs=1e-14 * n * positive[-1])
    assert log_pseudo_determinant(matrix, labels) == pytest.approx(np.log(positive).sum(), rel=1e-6, abs=1e-6)
    assert smallest_by_component(matrix, labels).min() == pytest.approx(low, rel=1e-9, abs=1e-14 * n * high)


@SETTINGS
@given(weighted_graphs(max_size=12), st.floats(1e-6, 1e6))
def test_ends_scale_with_the_weights(graph, factor):
    n, edges, weights = graph
    if len(edges):
        low, high = ends(n, edges, weights)
        assert ends(n, edges, factor * weights) == pytest.approx((factor * low, factor * high), rel=1e-8)


@pytest.mark.parametrize("size", [5, 60, 200])
def test_a_bridge_between_cliques_is_not_skipped(size):
    _, clique, _ = closed_forms.complete(size)
    edges = np.concatenate([clique, clique + size, [[0, size]]])
    low, _ = ends(2 * size, edges)
    # by symmetry the Fiedler vector is odd: x on the clique, y at the bridge's end, (y − x)(m − 1) + 2y = λy
    roots = np.roots([1.0, -(size + 2.0), 2.0])
    assert low == pytest.approx(roots.min(), rel=1e-9)


@pytest.mark.parametrize("n", [1000, 20_000])
def test_a_weak_edge_between_strong_paths(n):
    """Twelve decades between the weights: as springs in a row, λ₂ = 4w/n up to n w / strong."""
    _, edges, _ = closed_forms.path(n)
    weights = np.full(n - 1, 1e9)
    weights[n // 2 - 1] = 1e-3
    assert ends(n, edges, weights)[0] == pytest.approx(4e-3 / n, rel=1e-12 * n)


@pytest.mark.parametrize("bound", [0.2, 2.0])  # 2 is the degree of a corner: the first pivot of L − 2I is zero
def test_lowest_eigenpairs_are_complete_and_orthonormal(bound):
    n, edges, spectrum = closed_forms.grid(21, 25)
    matrix = laplacian(n, edges)
    (vertices, values, vectors), *others = lowest_eigenpairs(matrix, np.zeros(n, int), bound)
    assert not others
    expected = np.sort(spectrum[(spectrum > 1e-9) & (spectrum <= bound)])
    np.testing.assert_allclose(values, expected, rtol=1e-8)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(len(values)), atol=1e-10)
    np.testing.assert_allclose(matrix[vertices] @ vectors, vectors * values, atol=1e-9)
