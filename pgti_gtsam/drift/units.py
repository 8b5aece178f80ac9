"""What a map's errors are measured by: its free space, the body's vertical, and how far its keyframes lie apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

CURVED = 0.25
"""How far, in ρ, a correction may bend the map beyond what linear predictions hold for, before a new optimum."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Units:
    """Units of a map's errors.

    Attributes
    ----------
    unit_m : float
        ρ.
    levelling : gtsam.Pose2 or gtsam.Pose3
        Turn Q that took the caller's poses T to the model's, T Q, whose z axis is the body's vertical.
    tilt : float
        Drift of the odometry's tilt in parts of that of the heading: see `upright`.
    spread : (d, d) float
        Covariance of the relative pose of keyframes drawn at random, axis by axis.
    """

    unit_m: float
    levelling: Any
    tilt: float
    spread: Array

    @property
    def is_planar(self) -> bool:
        """Whether the poses are Pose2."""
        return len(self.spread) == 3

    @property
    def translation(self) -> slice:
        """Where the translation stands in a tangent vector."""
        return translation_of(self.is_planar)

    @property
    def extent_m(self) -> float:
        """How far keyframes lie apart along the map's longest axis."""
        return float(np.sqrt(np.diag(self.spread)[self.translation].max()))

    def variances(self, length: float, angle: float) -> Array:
        """Squares of a length in ρ and of an angle in rad, in GTSAM's order, (d,).

        Parameters
        ----------
        length : float
            In ρ.
        angle : float
            In rad.
        """
        return variances_of(length * self.unit_m, angle, is_planar=self.is_planar)

    def allowances_m(self, covariances: Array) -> Array:
        """Standard deviation, m, of relative positions along their least certain axis, (k,); infinite where unknown.

        Parameters
        ----------
        covariances : (k, d, d) float
            As from `Settled.covariances`.
        """
        own = self.translation
        blocks = covariances[:, own, own]
        unknown: Any = np.isnan(blocks).any(axis=(1, 2))
        squares = np.linalg.eigvalsh(np.where(unknown[:, None, None], 0.0, blocks))[:, -1]
        return np.where(unknown, np.inf, np.sqrt(np.maximum(squares, 0.0)))

    def moves_little(self, moved: Array) -> bool:
        """Whether corrections, (k, d), stay within linear steps, for keyframes and all that turns with them."""
        place = np.arange(moved.shape[1])[self.translation]
        turned, shifted = np.delete(moved, place, axis=1), moved[:, place]
        reach = np.linalg.norm(shifted, axis=1) + self.extent_m * np.linalg.norm(turned, axis=1)
        return bool(reach.max() <= CURVED * self.unit_m)

    def bends(self, moved: Array) -> bool:
        """Whether corrections, (k, d), turn the map so far that linear predictions fail: extent θ² / 2."""
        turned = np.delete(moved, np.arange(moved.shape[1])[self.translation], axis=1)
        return bool(self.extent_m * np.square(turned).max() / 2 > CURVED * self.unit_m)


def variances_of(length_m: float, angle: float, *, is_planar: bool) -> Array:
    """Squares of a length in m and of an angle in rad, in the order of GTSAM's tangent space, (d,).

    Parameters
    ----------
    length_m : float
    angle : float
        In rad.
    is_planar : bool
    """
    squares = np.square([length_m, length_m, angle] if is_planar else [angle] * 3 + [length_m] * 3)
    return np.asarray(squares, dtype=float)


def translation_of(is_planar: bool) -> slice:
    """Where the translation stands in a tangent vector."""
    return slice(0, 2) if is_planar else slice(3, 6)
