"""Eq. 11 checked factor by factor: A_ij = −B_ij, B_ij = J_r⁻¹(e_ij) Ad(p_j⁻¹), in the spatial frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pgti_gtsam.checks import finite_array, shown
from pgti_gtsam.diffusion.linearisation import GROUPS, dimensions, linearised
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import check_map, slots_of

BETWEEN = {getattr(gtsam, f"BetweenFactor{name}"): group for name, group in GROUPS.items()}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equation11:
    """How far GTSAM's Jacobians of every between factor are from Eq. 11, each relative to the largest entry of B.

    Attributes
    ----------
    slots : (m,) int
        Between factors of the graph; other factors are no part of Eq. 11.
    antisymmetry : (m,) float
        |A + B|: zero for a block Laplacian.
    gtsam_jacobian : (m,) float
        |B − J Ad(p_j⁻¹)| with the J that GTSAM's own formulas give for J_r⁻¹(e).
    right_jacobian : (m,) float
        |B − J_r⁻¹(e) Ad(p_j⁻¹)| with the exact J_r⁻¹. Where this number is large and the other is not, GTSAM's J is
        not J_r⁻¹: Similarity3 factors leave J_r⁻¹ out, exact where e = 0 only;
        `Pose2.LogmapDerivative` cancels to few digits at small angles, worst just above 1e-5 rad; Pose3's
        logarithm loses half its digits some 1e-3 rad before π. H is a block Laplacian in all three cases,
        and not quite the Gauss-Newton matrix of the error.
    rotation_rad : (m,) float
        Angle of the residual's rotation; J_r is singular at 2π, the logarithm jumps at π.
    """

    slots: NDArray[np.int64]
    antisymmetry: NDArray[np.float64]
    gtsam_jacobian: NDArray[np.float64]
    right_jacobian: NDArray[np.float64]
    rotation_rad: NDArray[np.float64]


def equation_11(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Equation11:
    """Check Eq. 11 on every between factor of Pose2, Pose3 and Similarity3, without its noise model.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        An estimate of all variables.

    Raises
    ------
    PgtiError
        Those of `linearise`.
    """
    check_map(graph, values)
    dims = dimensions(values)
    found = [
        (slot, *_deviations(slot, factor, group, values, dims))
        for slot, factor in slots_of(graph)
        if (group := BETWEEN.get(type(factor))) is not None
    ]
    table = np.array(found, dtype=float).reshape(-1, 5)
    return Equation11(
        slots=table[:, 0].astype(np.int64),
        antisymmetry=table[:, 1],
        gtsam_jacobian=table[:, 2],
        right_jacobian=table[:, 3],
        rotation_rad=table[:, 4],
    )


def inverse_right_jacobian(group: Any, tangent: NDArray[np.float64]) -> NDArray[np.float64]:
    """J_r⁻¹(ξ) of any matrix Lie group, (d, d).

    J_r(ξ) = φ₁(−ad_ξ) with φ₁(X) = (eˣ − 1)/X, taken from the exponential of [[X, 1], [0, 0]], whose upper
    right block is J_r. Exact whatever the angle, where a closed form by angles loses digits near 0 and π.

    Parameters
    ----------
    group : type
        gtsam.Pose2, gtsam.Pose3 or gtsam.Similarity3.
    tangent : (d,) float
        ξ.
    """
    if group not in GROUPS.values():
        raise InvalidOptionError(f"expected {', '.join(GROUPS)} of gtsam as the group, got {shown(group)}")
    d = len(group.Logmap(group()))
    tangent = finite_array(tangent, "a tangent vector", d)
    augmented = np.zeros((2 * d, 2 * d))
    augmented[:d, :d], augmented[:d, d:] = -group.adjointMap(tangent), np.eye(d)
    return np.asarray(np.linalg.inv(linalg.expm(augmented)[:d, d:]), dtype=np.float64)


def _deviations(
    slot: int, factor: Any, group: Any, values: gtsam.Values, dims: dict[int, int]
) -> tuple[float, float, float, float]:
    i, j = factor.keys()
    at = getattr(values, f"at{group.__name__}")
    d = factor.dim()
    plain = factor.cloneWithNewNoiseModel(gtsam.noiseModel.Unit.Create(d))
    _, matrix, _ = linearised(slot, plain, values, dims)
    error, adjoint = factor.unwhitenedError(values), at(j).inverse().AdjointMap()
    a, b = matrix[:, :d] @ at(i).inverse().AdjointMap(), matrix[:, d:] @ adjoint
    size = np.abs(b).max()
    residual = factor.measured().inverse() * at(i).between(at(j))
    own = group.LogmapDerivative(residual) if hasattr(group, "LogmapDerivative") else np.eye(d)
    differences = (a + b, b - own @ adjoint, b - inverse_right_jacobian(group, error) @ adjoint)
    angle = abs(error[2]) if d == 3 else float(np.linalg.norm(error[:3]))
    first, second, third = (float(np.abs(difference).max() / size) for difference in differences)
    return first, second, third, float(angle)
