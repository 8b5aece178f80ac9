"""Inserted edges on a cached factorisation, over the whole graph and near them: the same as from scratch."""

import closed_forms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from pgti_gtsam.spectral import low_rank
from pgti_gtsam.spectral.dense_kernel import dense_heat_kernel
from pgti_gtsam.spectral.laplacian import laplacian
from pgti_gtsam.spectral.locality import kernel_within, local_change
from pgti_gtsam.spectral.low_rank import SpectralState

SETTINGS = settings(derandomize=True, deadline=None, max_examples=50)
STABLE_TIMES = np.geomspace(0.5, 2000, 40)


@st.composite
def closures(draw, max_size=60):
    """A graph, connected or not, and edges to insert: none, repeated, between components, many at one vertex."""
    n = draw(st.integers(2, max_size))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    chain = chain[rng.random(n - 1) < draw(st.sampled_from([0.0, 0.95, 1.0]))]
    k = draw(st.integers(0, 6))
    inserted = rng.integers(0, n, (k, 2))
    if draw(st.booleans()):
        inserted[:, 0] = 0
    return n, chain.astype(np.int64), inserted[inserted[:, 0] != inserted[:, 1]]


@SETTINGS
@given(closures())
def test_updates_agree_with_the_graph_computed_from_scratch(case):
    n, edges, inserted = case
    state = SpectralState.of(n, edges)
    exact = dense_heat_kernel(n, np.concatenate([edges, inserted]))
    updated = state.kernel_with(inserted)
    times = np.geomspace(4 * np.log(10) / exact.largest, 4 * np.log(10) / exact.smallest_positive, 30)
    oracle = exact.signatures(times)
    assert updated.n_components == exact.n_components
    assert updated.smallest_positive == pytest.approx(exact.smallest_positive, rel=1e-8)
    assert updated.largest == pytest.approx(exact.largest, rel=1e-8)
    np.testing.assert_allclose(updated.signatures(times), oracle, atol=1e-7 * oracle.max())
    oracle = exact.diagonals(STABLE_TIMES)
    np.testing.assert_allclose(updated.diagonals(STABLE_TIMES), oracle, atol=1e-8)
    np.testing.assert_allclose(state.bounded_kernel_with(inserted).diagonals(STABLE_TIMES), oracle, atol=1e-7)


@SETTINGS
@given(closures(), st.integers(0, 2**32 - 1))
def test_edges_come_and_go(case, seed):
    n, edges, inserted = case
    rng = np.random.default_rng(seed)
    edges = np.unique(np.concatenate([edges, np.sort(rng.choice(n, (n // 2, 2)), axis=1)]), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    gone = rng.random(len(edges)) < 0.1
    exact = dense_heat_kernel(n, np.concatenate([edges[~gone], inserted]))
    updated = SpectralState.of(n, edges).kernel_with(inserted, edges[gone])
    times = np.geomspace(4 * np.log(10) / exact.largest, 4 * np.log(10) / exact.smallest_positive, 30)
    oracle = exact.signatures(times)
    assert updated.n_components == exact.n_components
    assert updated.smallest_positive == pytest.approx(exact.smallest_positive, rel=1e-8)
    assert updated.largest == pytest.approx(exact.largest, rel=1e-8)
    np.testing.assert_allclose(updated.signatures(times), oracle, atol=1e-7 * oracle.max())


def test_both_sides_of_the_break_even_agree(monkeypatch):
    n, edges, _ = closed_forms.grid(9, 11)
    inserted = np.array([[0, 98], [3, 50], [7, 8]])
    state = SpectralState.of(n, edges)
    updated = state.kernel_with(inserted).diagonals(STABLE_TIMES)
    monkeypatch.setattr(low_rank, "BREAK_EVEN", 1)
    np.testing.assert_allclose(state.kernel_with(inserted).diagonals(STABLE_TIMES), updated, atol=1e-8)
    np.testing.assert_allclose(state.bounded_kernel_with(inserted).diagonals(STABLE_TIMES), updated, atol=1e-8)


def test_a_state_answers_the_same_twice():
    n, edges, _ = closed_forms.path(50)
    state = SpectralState.of(n, edges)
    first = state.bounded_kernel_with(np.array([[3, 40]])).diagonals(STABLE_TIMES)
    state.kernel_with(np.array([[10, 20]]))
    np.testing.assert_array_equal(state.bounded_kernel_with(np.array([[3, 40]])).diagonals(STABLE_TIMES), first)


@pytest.mark.parametrize("inserted", [[[150, 450]], [[150, 450], [151, 449], [150, 155]]])
@pytest.mark.parametrize("max_vertices", [40, 100, 400])
def test_local_changes_stay_within_their_bound(inserted, max_vertices):
    n, edges, _ = closed_forms.path(600)
    inserted, times = np.array(inserted), np.geomspace(0.5, 100, 12)
    change = local_change(laplacian(n, edges), inserted, times, max_vertices=max_vertices)
    pair = (dense_heat_kernel(n, edges), dense_heat_kernel(n, np.concatenate([edges, inserted])))
    before, after = (kernel.diagonals(times) for kernel in pair)
    found = np.zeros_like(before)
    found[change.vertices] = change.after - change.before
    assert np.all(np.abs(found - (after - before)).max(axis=0) <= change.bound + 1e-7)
    assert change.bound.max() <= 1e-4 or max_vertices < 400


@pytest.mark.parametrize("inserted", [[[150, 450]], [[150, 450], [151, 449]]])
def test_the_bound_of_a_local_change_is_what_leaves_the_ball_and_what_comes_back(inserted):
    """Dense: left + left_after √R of every inserted edge, R in the ball with a sink of 1 / (2 t) at every vertex."""
    n, edges, _ = closed_forms.path(600)
    inserted, times = np.array(inserted), np.geomspace(0.5, 100, 6)
    change = local_change(laplacian(n, edges), inserted, times, max_vertices=40)
    ball, ends = change.vertices, np.searchsorted(change.vertices, inserted)
    block = laplacian(n, edges).toarray()[np.ix_(ball, ball)]
    with_edges = block + laplacian(len(ball), ends).toarray()
    left, left_after = (
        np.array([1 - expm(-t * matrix).sum(axis=1) for t in times]).T[ends].max(axis=1)
        for matrix in (block, with_edges)
    )
    signs = np.eye(len(ball))[ends[:, 0]] - np.eye(len(ball))[ends[:, 1]]
    sink = np.eye(len(ball)) / (2 * times.max())
    resistances = np.e * np.einsum("ka,ab,kb->k", signs, np.linalg.inv(block + sink), signs)
    expected = np.sqrt(times / 2) * (left + left_after * np.sqrt(resistances)[:, None]).sum(axis=0)
    np.testing.assert_allclose(change.bound, expected, rtol=1e-3, atol=1e-5)


def test_a_local_change_does_not_depend_on_the_size_of_the_map():
    inserted, times = np.array([[1000, 1300]]), np.geomspace(0.5, 100, 10)
    changes = [local_change(laplacian(n, closed_forms.path(n)[1]), inserted, times) for n in (3000, 9000)]
    np.testing.assert_array_equal(changes[0].vertices, changes[1].vertices)
    np.testing.assert_allclose(changes[0].after, changes[1].after, atol=1e-12)


def test_a_ball_that_is_the_whole_graph_loses_nothing():
    n, edges, _ = closed_forms.cycle(60)
    inserted, times = np.array([[0, 30]]), np.geomspace(0.5, 2000, 9)
    change = local_change(laplacian(n, edges), inserted, times)
    assert np.all(change.bound == 0)
    exact = dense_heat_kernel(n, np.concatenate([edges, inserted])).diagonals(times)
    np.testing.assert_allclose(change.after, exact, atol=1e-8)


def test_a_graph_without_a_change_is_not_computed_again():
    n, edges, _ = closed_forms.path(30)
    state = SpectralState.of(n, edges)
    assert state.kernel_with(np.empty((0, 2), dtype=int)) is state.kernel


@pytest.mark.parametrize("family", ["path", "complete"])
def test_heat_inside_a_part_is_exact_up_to_the_largest_eigenvalue(family):
    n, edges, _ = getattr(closed_forms, family)(16)
    matrix, times = laplacian(n, edges), np.geomspace(0.05, 20.0, 30)
    exact = dense_heat_kernel(n, edges).diagonals(times)
    np.testing.assert_allclose(kernel_within(matrix, times).diagonal, exact, atol=1e-6)
