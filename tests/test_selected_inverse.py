"""Elimination and selected inversion: dense inverses as oracle, on the graphs that the tree may meet."""

import closed_forms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgti_gtsam.spectral import selected_inverse
from pgti_gtsam.spectral.elimination_tree import analyse
from pgti_gtsam.spectral.laplacian import laplacian
from pgti_gtsam.spectral.selected_inverse import (
    FrontEntries,
    factorise,
    inverse_diagonal,
    inverse_diagonals,
    inverted,
    solve,
)

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60)
SHIFTS = np.geomspace(1e-3, 10, 5) * np.exp(0.55j * np.pi)


@st.composite
def nested_graphs(draw, max_size=60):
    """A graph and another on some of its edges; empty, disconnected, complete and repeated edges occur."""
    n = draw(st.integers(1, max_size))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    edges = np.argwhere(np.triu(rng.random((n, n)) < draw(st.sampled_from([0.0, 0.03, 0.2, 1.0])), 1))
    if draw(st.booleans()):
        edges = np.concatenate([edges, np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)])
    return n, edges[rng.random(len(edges)) < draw(st.sampled_from([0.0, 0.7, 1.0]))], edges


@SETTINGS
@given(nested_graphs())
def test_diagonals_and_solutions_agree_with_dense_inverses(graphs):
    n, some, edges = graphs
    tree = analyse(n, edges)
    for chosen in (some, edges):
        matrix = laplacian(n, chosen)
        exact = np.stack([np.linalg.inv(matrix.toarray() + z * np.eye(n)) for z in SHIFTS])
        factor = factorise(FrontEntries.of(tree, matrix), SHIFTS)
        np.testing.assert_allclose(inverse_diagonal(factor), np.einsum("pii->pi", exact), rtol=1e-9)
        columns = np.eye(n)[:, : min(n, 3)]
        found = solve(factor, columns[tree.order])[:, tree.positions]
        np.testing.assert_allclose(found, exact @ columns, atol=1e-9 * np.abs(exact).max())


@SETTINGS
@given(nested_graphs(max_size=20))
def test_grounded_vertices_add_to_the_diagonal(graphs):
    n, _, edges = graphs
    tree, matrix = analyse(n, edges), laplacian(n, edges)
    grounds = np.arange(n) % 3.0
    factor = factorise(FrontEntries.of(tree, matrix, grounds), SHIFTS)
    exact = [np.diag(np.linalg.inv(matrix.toarray() + np.diag(grounds + z))) for z in SHIFTS]
    np.testing.assert_allclose(inverse_diagonal(factor), exact, rtol=1e-9)


@SETTINGS
@given(nested_graphs())
def test_the_tree_holds_every_edge_and_every_parent_its_childrens_rows(graphs):
    n, _, edges = graphs
    tree = analyse(n, edges)
    assert sorted(tree.order) == list(range(n))
    np.testing.assert_array_equal(tree.order[tree.positions], np.arange(n))
    owners = np.repeat(np.arange(tree.n_supernodes), tree.widths)
    rows = np.split(tree.rows, tree.row_starts[1:-1])
    fronts = [np.concatenate([np.flatnonzero(owners == k), rows[k]]) for k in range(tree.n_supernodes)]
    for i, j in np.sort(tree.positions[edges], axis=1):
        assert j in fronts[owners[i]]
    for k, (_, _, parent, into) in enumerate(tree.visits()):
        assert (parent < 0) == (len(rows[k]) == 0)
        if parent >= 0:
            assert parent > k
            np.testing.assert_array_equal(fronts[parent][into], rows[k])


@pytest.mark.parametrize("family", [closed_forms.cycle(3000), closed_forms.path(3000)], ids=["cycle", "path"])
def test_long_paths_do_not_lose_their_fill(family):
    """An entry that fades along the elimination is still an entry."""
    n, edges, _ = family
    tree = analyse(n, edges)
    assert np.count_nonzero(tree.parents < 0) == 1
    factor = factorise(FrontEntries.of(tree, laplacian(n, edges)), SHIFTS)
    whole = n / SHIFTS  # columns of (L + zI)⁻¹ sum to 1/z
    np.testing.assert_allclose(solve(factor, np.ones((n, 1))).sum(axis=(1, 2)), whole, rtol=1e-9)


def test_chunks_and_cache_blocks_change_nothing(monkeypatch):
    n, edges, _ = closed_forms.grid(12, 13)
    tree = analyse(n, edges)
    entries = FrontEntries.of(tree, laplacian(n, edges))
    (_, whole), *_ = inverse_diagonals(entries, SHIFTS)
    monkeypatch.setattr(selected_inverse, "MAX_CHUNK", 2)
    monkeypatch.setattr(selected_inverse, "CACHE_BYTES", 1.0)
    monkeypatch.setattr(selected_inverse, "ONE_CALL", 0)
    parts = list(inverse_diagonals(entries, SHIFTS))
    assert [chunk.stop - chunk.start for chunk, _ in parts] == [2, 2, 1]
    np.testing.assert_allclose(np.concatenate([part for _, part in parts]), whole, rtol=1e-12)


@pytest.mark.parametrize("shift", [1e-6, 1e-10, 1e-13])
def test_row_sums_keep_the_null_vector(shift):
    """The diagonal's mean is the mean of 1/(λ + z): at small z all but 1/(nz) is far below the diagonal's rounding."""
    n, edges, _ = closed_forms.path(500)
    z = shift * np.exp(0.55j * np.pi)
    factor = factorise(FrontEntries.of(analyse(n, edges), laplacian(n, edges)), np.array([z]))
    positive = 4 * np.sin(np.pi * np.arange(1, n) / (2 * n)) ** 2
    expected = 1 / (n * z) + np.mean(1 / (positive + z)) * (n - 1) / n
    assert abs(inverse_diagonal(factor).mean() / expected - 1) < 1e-9


@pytest.mark.parametrize("size", [1, 2, 17, 50])
def test_inverses_by_halves(size):
    rng = np.random.default_rng(size)
    a = rng.normal(size=(3, size, size)) + 1j * rng.normal(size=(3, size, size))
    a = a + a.swapaxes(1, 2) + 8 * np.eye(size)
    np.testing.assert_allclose(inverted(a) @ a, np.broadcast_to(np.eye(size), a.shape), atol=1e-9)


def test_columns_of_one_pattern_are_eliminated_together():
    pairs = np.argwhere(np.triu(np.ones((6, 6)), 1))
    assert len(analyse(6, pairs).starts) - 1 <= 2
    two = np.concatenate([pairs, pairs + 6])
    assert len(analyse(12, two).starts) - 1 <= 4
