"""Chosen blocks of an inverse, compared with the whole dense inverse."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgti_gtsam.spectral.block_inverse import HalfProducts, factorise, own_products, products, solve
from pgti_gtsam.spectral.elimination_tree import analyse


@settings(derandomize=True, deadline=None, max_examples=80)
@given(st.integers(1, 60), st.integers(0, 120), st.sampled_from([1, 3, 6]), st.integers(0, 2**32 - 1))
def test_blocks_and_solutions_are_those_of_the_dense_inverse(n, m, d, seed):
    rng = np.random.default_rng(seed)
    pairs = rng.integers(0, n, (m, 2))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]  # some occur twice, and in both directions
    blocks = rng.normal(size=(len(pairs), d, d))
    dense = np.zeros((n, n, d, d))
    np.add.at(dense, (pairs[:, 0], pairs[:, 1]), blocks)
    np.add.at(dense, (pairs[:, 1], pairs[:, 0]), blocks.swapaxes(1, 2))
    matrix = dense.transpose(0, 2, 1, 3).reshape(n * d, n * d)
    heavy = np.abs(matrix).sum(axis=1).max() + 1
    diagonal = np.tile(heavy * np.eye(d), (n, 1, 1))
    matrix += heavy * np.eye(n * d)
    inverse = np.linalg.inv(matrix)
    factor = factorise(analyse(n, np.unique(np.sort(pairs, axis=1), axis=0)), diagonal, pairs, blocks)
    ends = rng.integers(0, n, (rng.integers(0, 80), 2))  # of any vertices, the same one twice among them
    jacobians = rng.normal(size=(len(ends), 2, d, d))
    rows = np.zeros((len(ends), d, n, d))
    for k, (i, j) in enumerate(ends):
        rows[k, :, i] += jacobians[k, 0]
        rows[k, :, j] += jacobians[k, 1]
    rows = rows.reshape(-1, n * d)
    whole = products(factor, ends, jacobians)
    np.testing.assert_allclose(whole, rows @ inverse @ rows.T, atol=1e-12)
    own = whole.reshape(len(ends), d, len(ends), d)[np.arange(len(ends)), :, np.arange(len(ends))]
    np.testing.assert_allclose(own_products(factor, ends, jacobians), own, atol=1e-12)

    # the same in parts, one after the other
    halves, cuts = HalfProducts.none(factor), [0, *np.sort(rng.integers(0, len(ends) + 1, 2)).tolist(), len(ends)]
    for first, last in pairwise(cuts):
        halves, across, own = halves.extended(ends[first:last], jacobians[first:last])
        np.testing.assert_allclose(across, whole[: first * d, first * d : last * d], atol=1e-12)
        np.testing.assert_allclose(own, whole[first * d : last * d, first * d : last * d], atol=1e-12)
    assert halves.n_pairs == len(ends)
    b = rng.normal(size=(n, d))
    np.testing.assert_allclose(solve(factor, b).ravel(), inverse @ b.ravel(), atol=1e-12)


def test_a_singular_matrix_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        factorise(analyse(2, np.array([[0, 1]])), np.zeros((2, 3, 3)), np.array([[0, 1]]), np.zeros((1, 3, 3)))
