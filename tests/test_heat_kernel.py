"""The heat kernel's diagonal: closed forms, the matrix exponential as oracle, and laws of diffusion."""

import closed_forms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from pgti_gtsam.spectral.dense_kernel import DenseHeatKernel, dense_heat_kernel
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from pgti_gtsam.spectral.laplacian import connected_components, laplacian
from pgti_gtsam.spectral.pole_kernel import PoleHeatKernel

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60)
TIMES = np.array([0.0, 0.1, 1.0, 7.0, 100.0])


@st.composite
def graphs(draw, max_size=16):
    n = draw(st.integers(1, max_size))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pairs = np.argwhere(np.triu(rng.random((n, n)) < draw(st.sampled_from([0.0, 0.08, 0.3, 1.0])), 1))
    return n, pairs.astype(np.int64)


@pytest.mark.parametrize("family", closed_forms.FAMILIES.values(), ids=closed_forms.FAMILIES.keys())
def test_spectra_agree_with_their_closed_forms(family):
    n, edges, spectrum = family
    kernel = dense_heat_kernel(n, edges)
    np.testing.assert_allclose(kernel.components[0].eigenvalues, np.sort(spectrum)[1:], rtol=1e-9)
    assert kernel.smallest_positive == pytest.approx(np.sort(spectrum)[1], rel=1e-9)
    assert kernel.largest == pytest.approx(spectrum.max(), rel=1e-9)


def test_the_kernel_of_a_path_agrees_with_its_closed_form():
    n, edges, _ = closed_forms.path(40)
    found = dense_heat_kernel(n, edges).diagonals(TIMES)
    np.testing.assert_allclose(found, closed_forms.path_kernel_diagonal(n, TIMES), rtol=1e-9)


@SETTINGS
@given(graphs())
def test_the_diagonal_is_that_of_the_matrix_exponential(graph):
    n, edges = graph
    matrix = laplacian(n, edges).toarray()
    expected = np.stack([np.diag(expm(-t * matrix)) for t in TIMES], axis=1)
    np.testing.assert_allclose(dense_heat_kernel(n, edges).diagonals(TIMES), expected, rtol=1e-9, atol=1e-12)


@SETTINGS
@given(graphs())
def test_heat_neither_grows_nor_falls_below_its_share_of_the_component(graph):
    n, edges = graph
    diagonal = dense_heat_kernel(n, edges).diagonals(TIMES)
    _, labels = connected_components(n, edges)
    share = 1 / np.bincount(labels)[labels]
    assert (np.diff(diagonal, axis=1) <= 1e-12).all()
    assert (diagonal >= share[:, None] - 1e-12).all()
    np.testing.assert_allclose(diagonal[:, 0], 1.0, atol=1e-12)


@SETTINGS
@given(graphs())
def test_scaled_signatures_sum_to_one_and_vanish_where_no_edge_ends(graph):
    n, edges = graph
    signatures = dense_heat_kernel(n, edges).signatures(TIMES)
    np.testing.assert_allclose(signatures.sum(axis=0), 1.0 if len(edges) else 0.0, atol=1e-12)
    isolated = np.setdiff1d(np.arange(n), edges)
    assert (signatures[isolated] == 0).all()


@SETTINGS
@given(graphs(), st.integers(0, 2**32 - 1))
def test_an_added_edge_lowers_no_eigenvalue(graph, seed):
    n, edges = graph
    if n < 2:
        return
    pair = np.sort(np.random.default_rng(seed).choice(n, 2, replace=False))
    before = np.linalg.eigvalsh(laplacian(n, edges).toarray())
    after = np.linalg.eigvalsh(laplacian(n, np.vstack([edges, pair])).toarray())
    assert (after >= before - 1e-10).all()


def test_signatures_survive_times_at_which_every_exponential_underflows():
    n, edges, eigenvalues = closed_forms.complete(5)
    for time in (1e3, 1e6):
        assert np.exp(-time * eigenvalues.max()) == 0
        signatures = dense_heat_kernel(n, edges).signatures(np.array([time]))
        rounding = (
            time * n * np.finfo(float).eps * eigenvalues.max()
        )  # of the exponent, equal eigenvalues apart by rounding
        np.testing.assert_allclose(signatures, 0.2, rtol=rounding)


def test_a_graph_without_edges_has_components_and_no_spectrum():
    kernel = dense_heat_kernel(3, np.empty((0, 2), dtype=np.int64))
    assert kernel.n_components == 3
    assert (kernel.smallest_positive, kernel.largest) == (1.0, 1.0)
    assert (kernel.diagonals(TIMES) == 1).all()


def test_the_method_is_the_faster_one_by_the_graphs_fill():
    """A grid of 625 vertices fills so much that eigenvectors are faster; a path of 600 hardly fills."""
    for (n, edges, _), kind in ((closed_forms.grid(25, 25), DenseHeatKernel), (closed_forms.path(600), PoleHeatKernel)):
        (kernel,) = heat_kernels(n, edges)
        assert isinstance(kernel, kind)
