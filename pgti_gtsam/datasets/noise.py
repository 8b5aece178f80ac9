"""Information matrices of text files as GTSAM noise models, robust where a comment says so."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.losses import losses
from pgti_gtsam.datasets.text import LARGEST, Table, TextFile


def _upper_triangle(size: int) -> NDArray[np.int64]:
    """Index of entry (i, j) of a symmetric matrix in the upper triangle written row by row, (d, d)."""
    places = np.zeros((size, size), np.int64)
    places[np.triu_indices(size)] = np.arange(size * (size + 1) // 2)
    return np.maximum(places, places.T)


def _layout(size: int, order: NDArray[np.int64]) -> dict[int, NDArray[np.int64]]:
    """Indices of a matrix's entries in the upper triangle and in the full matrix, by the count of numbers."""
    upper, full = _upper_triangle(size), np.arange(size * size).reshape(size, size)
    return {size * (size + 1) // 2: upper[np.ix_(order, order)], size * size: full[np.ix_(order, order)]}


# `numbers[:, UPPER_3]` turns (n, 6) numbers into (n, 3, 3) symmetric matrices
UPPER_2, UPPER_3 = _upper_triangle(2), _upper_triangle(3)
TORO_3 = np.array([[0, 1, 4], [1, 2, 5], [4, 5, 3]])  # I11 I12 I22 I33 I13 I23, as TORO writes it
ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
# files write translation, then rotation; the tangent space of gtsam.Pose3 is rotation, then translation
PLANE, SPACE = _layout(3, np.arange(3)), _layout(6, ROTATION_FIRST)
POINT_2, POINT_3, CAMERA = _layout(2, np.arange(2)), _layout(3, np.arange(3)), _layout(6, np.arange(6))
SCALED_CAMERA = {28: _upper_triangle(7)[:6, :6], 49: np.arange(49).reshape(7, 7)[:6, :6]}  # the scale comes last

# Files write about six digits, so rounding alone can move a zero eigenvalue to either side by 1e-6 of the
# largest; below 1e-12 GTSAM's Cholesky factor loses its last digits to rounding in float64.
ROUNDING, SINGULAR = 1e-6, 1e-12


def is_semidefinite(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each of (n, d, d) symmetric matrices has no eigenvalue below zero, up to the file's rounding."""
    eigenvalues = np.linalg.eigvalsh(matrices)
    return np.asarray(eigenvalues[:, 0] >= -ROUNDING * eigenvalues[:, -1])


def information(
    file: TextFile, table: Table, numbers: NDArray[np.float64], layout: Mapping[int, NDArray[np.int64]], tag: str
) -> NDArray[np.float64]:
    """Information matrices of the rows of a table, (n, d, d).

    Parameters
    ----------
    file, table : TextFile, Table
        Named in errors.
    numbers : (n, k) float
        The numbers behind the measurement; empty, with a note, where unit matrices are assumed.
    layout : mapping of int to (d, d) int
        Where each entry of a matrix stands, by the count of numbers.
    tag : str
        Named in the note.

    Raises
    ------
    FileFormatError
        A full matrix is not symmetric.
    """
    size = len(next(iter(layout.values())))
    if not numbers.shape[1]:
        if len(numbers):
            file.notes.append(f"unit information assumed: {len(numbers)} {tag} lines hold none")
        return np.tile(np.eye(size), (len(numbers), 1, 1))
    matrices = numbers[:, layout[numbers.shape[1]]]
    if numbers.shape[1] < size * size:
        return np.asarray(matrices)
    uneven = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    bad = np.flatnonzero(uneven > ROUNDING * np.abs(matrices).max(axis=(1, 2), initial=0.0))
    if bad.size:
        message = (
            f"got a full matrix that is not symmetric; expected the upper triangle, {size * (size + 1) // 2} numbers"
        )
        raise file.error(message, table.lines[bad[0]])
    return np.asarray(matrices)


def information_models(file: TextFile, table: Table, matrices: NDArray[np.float64]) -> list[gtsam.noiseModel.Base]:
    """A noise model per row of a table: Gaussian, and robust where a comment before the line names a loss.

    A singular matrix says nothing in some direction, as files do on purpose for unmeasured directions.
    GTSAM's ``Gaussian.Information`` would turn such a matrix into NaN, so the model takes the square root R with
    RᵀR = Λ, whose rows in the unmeasured directions are zero. A matrix with a negative eigenvalue, which
    no measurement has, becomes the nearest matrix without (Higham, doi:10.1016/0024-3795(88)90223-6), with a note.

    Parameters
    ----------
    file, table : TextFile, Table
        Named in errors and notes.
    matrices : (n, d, d) float
        Information, in the order of GTSAM's tangent space.

    Raises
    ------
    FileFormatError
        A comment holds half a loss.
    """
    places: dict[bytes, int] = {}  # most files repeat a few matrices; np.unique would copy all of them three times
    inverse = np.array([places.setdefault(matrix.tobytes(), len(places)) for matrix in matrices], np.int64)
    first = np.unique(inverse, return_index=True)[1]
    unique = matrices[first]
    indefinite = ~is_semidefinite(unique)
    if indefinite.any():
        count, line = int(indefinite[inverse].sum()), table.lines[first[indefinite].min()]
        file.notes.append(
            f"{count} information matrices have a negative eigenvalue (first on line {line}): "
            "the nearest semidefinite ones are used"
        )
    models = [_information_model(matrix) for matrix in unique]
    robust = losses(file)
    return [
        gtsam.noiseModel.Robust.Create(robust[line], models[i]) if line in robust else models[i]
        for line, i in zip(table.lines.tolist(), inverse.tolist(), strict=True)
    ]


def _information_model(matrix: NDArray[np.float64]) -> gtsam.noiseModel.Base:
    eigenvalues, vectors = np.linalg.eigh(matrix)
    if eigenvalues[0] > SINGULAR * eigenvalues[-1]:
        return gtsam.noiseModel.Gaussian.Information(matrix)
    root = np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * vectors.T
    return gtsam.noiseModel.Gaussian.SqrtInformation(root, False)  # no shortcut to sigmas: one would be inf


def inverse_covariances(file: TextFile, table: Table, covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Information (n, d, d) of covariances (n, d, d).

    Parameters
    ----------
    file : TextFile
        Named in errors.
    table : Table
        Rows of the matrices.
    covariances : (n, d, d) float

    Raises
    ------
    FileFormatError
        A covariance is not positive definite.
    """
    eigenvalues = np.linalg.eigvalsh(covariances)
    bad = np.flatnonzero(eigenvalues[:, 0] <= np.maximum(SINGULAR * eigenvalues[:, -1], 1 / LARGEST))
    if bad.size:
        lowest = eigenvalues[bad[0], 0]
        message = f"expected a positive definite covariance matrix, got one with eigenvalue {lowest:.6g}"
        raise file.error(message, table.lines[bad[0]])
    return np.asarray(np.linalg.inv(covariances), np.float64)
