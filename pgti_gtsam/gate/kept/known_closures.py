"""Closures that are known to hold, and the prediction of further closures by all of them.

Relative poses that closures c measure have the joint covariance P_cc, and the closures the tolerances R. With L the
Cholesky factor of R + P_cc and e_c the closures' errors, a closure g more is predicted with y = L⁻¹ P_cg: its error is
e_g − yᵀ L⁻¹ e_c, with covariance P_gg − yᵀ y (Gaussian conditioning). L grows by the rows (yᵀ, chol(R + P_gg − yᵀ y)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from pgti_gtsam.drift.ties import Ties, closures_of
from pgti_gtsam.drift.units import Units
from pgti_gtsam.spectral.block_inverse import BlockFactor, HalfProducts

Array = NDArray[np.float64]


class Ends(NamedTuple):
    """The keyframes that relative poses lie between, on a reference map with tails.

    Attributes
    ----------
    pairs : (k, 2) int
    roots : (k, 2) int
        Keyframe of the reference map that each hangs on.
    carry : (k, 2, d, d) float
        Jacobian of the relative pose by the pose of the root.
    """

    pairs: NDArray[np.int64]
    roots: NDArray[np.int64]
    carry: Array


class Prediction(NamedTuple):
    """Closures beside their prediction.

    Attributes
    ----------
    offered : Ties
    missed : (g, d) float
        Differences from the prediction.
    spread : (g d, g d) float
        Joint covariance of the prediction; NaN where no tie leads between the keyframes.
    ends : Ends
    halves : HalfProducts
        Of the known closures and these.
    explained : (k d, g d) float
        y.
    """

    offered: Ties
    missed: Array
    spread: Array
    ends: Ends
    halves: HalfProducts
    explained: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownClosures:
    """Closures that hold, and what a prediction needs of them.

    Attributes
    ----------
    ties : Ties
    ends : Ends
    halves : HalfProducts
    root : (k d, k d) float
        L.
    whitened : (k d,) float
        L⁻¹ e.
    """

    ties: Ties
    ends: Ends
    halves: HalfProducts
    root: Array
    whitened: Array

    @classmethod
    def none(cls, factor: BlockFactor, units: Units) -> KnownClosures:
        """No closure yet.

        Parameters
        ----------
        factor : BlockFactor
            Of the reference map.
        units : Units
        """
        d, pairs = factor.size, np.empty((0, 2), dtype=np.int64)
        return cls(
            ties=closures_of([], units),
            ends=Ends(pairs, pairs, np.empty((0, 2, d, d))),
            halves=HalfProducts.none(factor),
            root=np.empty((0, 0)),
            whitened=np.empty(0),
        )

    def prediction(
        self, offered: Ties, errors: Array, ends: Ends, halves: HalfProducts, across: Array, own: Array
    ) -> Prediction:
        """The prediction of closures.

        Parameters
        ----------
        offered : Ties
        errors : (g d,) float
            At the reference map's optimum and the steps since.
        ends : Ends
        halves : HalfProducts
            Of these closures and those.
        across : (k d, g d) float
            Covariance with those.
        own : (g d, g d) float
            Covariance without those.
        """
        explained = solve_triangular(self.root, across, lower=True, check_finite=False)
        missed = (errors - explained.T @ self.whitened).reshape(offered.variances.shape)
        return Prediction(offered, missed, own - explained.T @ explained, ends, halves, explained)

    def with_predicted(self, new: Prediction) -> KnownClosures:
        """These closures, and those of a prediction by these; numpy.linalg.LinAlgError where rounding hides R + P."""
        k = len(self.whitened)
        root = np.zeros((k + len(new.spread), k + len(new.spread)))
        root[:k, :k], root[k:, :k] = self.root, new.explained.T
        root[k:, k:] = np.linalg.cholesky(new.spread + np.diag(new.offered.variances.ravel()))
        own = solve_triangular(root[k:, k:], new.missed.ravel(), lower=True)
        return KnownClosures(
            ties=self.ties.joined(new.offered),
            ends=Ends(*(np.concatenate(both) for both in zip(self.ends, new.ends, strict=True))),
            halves=new.halves,
            root=root,
            whitened=np.append(self.whitened, own),
        )

    def pulls(self) -> Array:
        """(R + P)⁻¹ e, (k, d)."""
        found = solve_triangular(self.root, self.whitened, lower=True, trans="T")
        return np.asarray(found.reshape(self.ties.variances.shape))
