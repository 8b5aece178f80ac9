"""The prediction of each tie by all other ties of a map, from a single factorisation.

With the residual r at the optimum, the tolerance R, the covariance C of the relative pose and S = R − C, a tie differs
from the prediction of the others by e = R S⁻¹ r, with the covariance R S⁻¹ R − R (leave-one-out residuals of
linear least squares: Cook and Weisberg, Residuals and Influence in Regression, 1982, chapter 2).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.drift.settled import Settled
from pgti_gtsam.spectral.laplacian import connected_components

LEAST_REST = 1e-6
"""Least eigenvalue of S in units of R: the rounding of the covariances. What the others predict is uncertain by 1000
tolerances there, and how uncertain exactly does not matter."""

Array = NDArray[np.float64]


def left_out(settled: Settled, ties: NDArray[np.int64]) -> tuple[Array, Array]:
    """Differences of ties from the prediction by all others, (k, d), and their covariances, (k, d, d).

    The difference of a tie that pulls at nothing is its residual. Without a path by other ties, the covariance is NaN.

    Parameters
    ----------
    settled : Settled
    ties : (k,) int
        Indices of ties.
    """
    model, active = settled.model, settled.active[ties]
    spread, residuals = settled.covariances(model.ties.pairs[ties]), settled.residuals[ties]
    missed, others = _predicted(residuals, np.sqrt(model.ties.variances[ties]), np.nan_to_num(spread, nan=0.0))
    others[np.isin(ties, _alone(settled))] = np.nan
    return np.where(active[:, None], missed, residuals), np.where(active[:, None, None], others, spread)


def left_out_together(settled: Settled, groups: Sequence[NDArray[np.int64]]) -> list[tuple[Array, Array]]:
    """Differences of each group's ties from the prediction by all others, (g, d), and the covariance, (g d, g d).

    Parameters
    ----------
    settled : Settled
    groups : sequence of (k,) int
        Indices of ties.
    """
    ties, found = settled.model.ties, []
    spreads = settled.joint_covariances([ties.pairs[group] for group in groups])
    for group, spread in zip(groups, spreads, strict=True):
        missed, others = _predicted(
            settled.residuals[group].reshape(1, -1), np.sqrt(ties.variances[group]).reshape(1, -1), spread[None]
        )
        found.append((missed.reshape(len(group), -1), others[0]))
    return found


def given_others(missed: Array, spread: Array, variances: Array) -> tuple[Array, Array]:
    """What some ties miss of a prediction by all the others of them as well, (g, d), and its covariance, (g, d, d).

    Parameters
    ----------
    missed : (g, d) float
        Differences of the ties from a prediction without any of them.
    spread : (g d, g d) float
        Joint covariance of that prediction.
    variances : (g, d) float
        Of the ties.
    """
    g, d = missed.shape
    own, others = np.empty((g, d)), np.empty((g, d, d))
    known, flat = spread + np.diag(variances.ravel()), missed.ravel()
    for k, inner in enumerate(np.arange(g * d).reshape(g, d)):
        rest = np.delete(np.arange(g * d), inner)
        gain = np.linalg.solve(known[np.ix_(rest, rest)], spread[np.ix_(rest, inner)]).T
        own[k] = missed[k] - gain @ flat[rest]
        others[k] = spread[np.ix_(inner, inner)] - gain @ spread[np.ix_(rest, inner)]
    return own, others


def _alone(settled: Settled) -> NDArray[np.int64]:
    """Active closures without which the map would fall apart."""
    ties, active, n = settled.model.ties, settled.active, len(settled.poses)
    parts, part = connected_components(n, ties.pairs[active & (ties.slots < 0)])
    between = np.flatnonzero(active & (ties.slots >= 0) & (part[ties.pairs[:, 0]] != part[ties.pairs[:, 1]]))
    ends = part[ties.pairs[between]].astype(np.int64)
    n_parts = connected_components(parts, ends)[0]
    _, first, count = np.unique(np.sort(ends, axis=1), axis=0, return_index=True, return_counts=True)
    single = first[count == 1]
    needed = [k for k in single.tolist() if connected_components(parts, np.delete(ends, k, axis=0))[0] > n_parts]
    return between[needed]


def _predicted(residuals: Array, roots: Array, spread: Array) -> tuple[Array, Array]:
    """R S⁻¹ r and R S⁻¹ R − R with S = R − C, of (k, d) residuals r, roots of R and (k, d, d) covariances C."""
    rest, axes = np.linalg.eigh(np.eye(roots.shape[1]) - spread / (roots[:, :, None] * roots[:, None, :]))
    gain = 1 / np.clip(rest, LEAST_REST, 1.0)  # S⁻¹ in units of R, along the axes
    along = axes.swapaxes(1, 2) @ (residuals / roots)[:, :, None]
    missed = roots * (axes @ (gain[:, :, None] * along))[:, :, 0]
    return missed, roots[:, :, None] * (axes * (gain - 1)[:, None, :] @ axes.swapaxes(1, 2)) * roots[:, None, :]
