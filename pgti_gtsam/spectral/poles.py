"""The exponential of a Laplacian as one sum of resolvents for all times.

On the positive spectrum, λ in [λ₂, λ_max],

    exp(−tλ) ≈ Re( c(t) + Σ_j w_j(t) / (λ + z_j) ),

with poles −z_j that do not depend on t. So the diagonal of exp(−tL) at every time is a matrix product with the
diagonals of the resolvents (L + z_j I)⁻¹, computed once. The z_j lie on a ray (the mirror image is
counted by taking the real part), with moduli in geometric progression from below λ₂ to above λ_max, as the
function varies on the scale of λ itself at all times between 1/λ_max and 1/λ₂. The weights of all times are one
linear least squares fit on a logarithmic grid of λ. Poles in geometric progression converge geometrically at a
rate that depends on log(λ_max/λ₂) only (compare Trefethen, Weideman and Schmelzer, Talbot quadratures and
rational approximations, BIT 46, 2006, doi:10.1007/s10543-006-0077-9, for one t at a time).

The fit is to exp(−t(λ − λ₂)), which does not underflow, and residuals count more where a graph has more eigenvalues:
a chain has about (λ/λ₂)^(1/2) of them below λ, a surface λ/λ₂.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.errors import InvalidOptionError

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

ANGLE_RAD = 0.55 * np.pi  # of the z_j; from 0.5π to 0.6π the residual changes little, outside it grows
BELOW, ABOVE = 0.25, 1.5  # moduli from BELOW λ₂ to ABOVE λ_max
WEIGHT_EXPONENT = 0.75  # between the 1/2 of chains and the 1 of surfaces
RELATIVE_CUTOFF = 1e-15  # of singular values in the fit; keeps the weights small where poles are redundant
SAMPLES_PER_DECADE = 60
REFERENCE_TIMES = 25
EARLIEST, LATEST = 4 * np.log(10), 12.0  # reference times: EARLIEST/λ_max (the paper's) to LATEST/λ₂
MAX_POLES = 120  # past a condition number of 1e16 in double precision
TOLERANCES = (1e-11, 1e-2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """Weights of a sum of resolvents for some times.

    Attributes
    ----------
    constants : (n_times,) float
        c(t).
    weights : (n_poles, n_times) complex
        w_j(t).
    residual : float
        Largest weighted residual, relative to the largest weighted value at the same time: an estimate of the
        error relative to the largest signature. Observed errors stay within thirty times the residual; no bound.
    largest_error : float
        Largest residual of the exponential itself, between zero and one.
    """

    constants: FloatArray
    weights: ComplexArray
    residual: float
    largest_error: float


def shifts_for(smallest: float, largest: float, tolerance: float) -> ComplexArray:
    """Fewest shifts z_j whose fit of the reference times has a residual within the tolerance.

    Parameters
    ----------
    smallest, largest : float
        λ₂ and λ_max; for several graphs that share the shifts, the smallest and the largest among them.
    tolerance : float
        From 1e-11 to 1e-2; below about 1e-10 rounding of the fit decides.

    Returns
    -------
    (n_poles,) complex

    Raises
    ------
    InvalidOptionError
        If the tolerance is outside its range.
    """
    if not TOLERANCES[0] <= tolerance <= TOLERANCES[1]:
        raise InvalidOptionError(f"tolerance: expected {TOLERANCES[0]:g} to {TOLERANCES[1]:g}, got {tolerance!r}")
    decades, digits = np.log10(largest / smallest), -np.log10(tolerance)
    count = max(4, int(0.4 * digits + decades * (1.3 + 0.5 * digits)) - 3)  # two or three below what it takes
    shifts, best = _on_ray(smallest, largest, count), np.inf
    while count < MAX_POLES:
        candidate = _on_ray(smallest, largest, count)
        residual = reference_residual(candidate, smallest, largest)
        if residual < best:
            best, shifts = residual, candidate
        if residual <= tolerance:
            break
        # residuals fall by a constant factor a pole: step by what is missing, at least one pole
        count += max(1, int(np.log10(residual / tolerance)))
    return shifts


def reference_times(smallest: float, largest: float) -> FloatArray:
    """Times at which the spectrum [smallest, largest] matters, from the paper's first on: (n,).

    Parameters
    ----------
    smallest, largest : float
        λ₂ and λ_max.
    """
    return np.geomspace(EARLIEST / largest, max(LATEST / smallest, EARLIEST / largest), REFERENCE_TIMES)


def reference_residual(shifts: ComplexArray, smallest: float, largest: float) -> float:
    """Residual of the fit at the reference times.

    Parameters
    ----------
    shifts : (n_shifts,) complex
    smallest, largest : float
        λ₂ and λ_max.
    """
    return fit(shifts, reference_times(smallest, largest), smallest, largest).residual


def fit(shifts: ComplexArray, times: FloatArray, smallest: float, largest: float) -> Fit:
    """Weights of exp(−t(λ − smallest)) on [smallest, largest].

    Parameters
    ----------
    shifts : (n_poles,) complex
        As `shifts_for` gives them, for this interval or a larger interval.
    times : (n_times,) float
        Not negative.
    smallest, largest : float
        The interval, positive.
    """
    samples = _samples(smallest, largest)
    row_weights = (samples / smallest) ** WEIGHT_EXPONENT
    values = np.exp(-np.outer(samples - smallest, times))
    return _least_squares(shifts, _near(shifts, smallest, largest), samples, row_weights, values)


def fit_from_zero(shifts: ComplexArray, times: FloatArray, largest: float) -> Fit:
    """Weights of exp(−tλ) on [0, largest], zero mode and all, for times that end where the shifts were placed for.

    Parameters
    ----------
    shifts : (n_poles,) complex
        As `shifts_for` gives them for an interval from about 1/max(times) on.
    times : (n_times,) float
        Not negative.
    largest : float
        Positive.
    """
    slowest = float(np.abs(shifts).min()) / BELOW
    samples = np.concatenate([[0.0], _samples(0.01 * slowest, largest)])
    row_weights = np.maximum(samples / slowest, 1.0) ** WEIGHT_EXPONENT
    values = np.exp(-np.outer(samples, times))
    return _least_squares(shifts, np.ones(len(shifts), dtype=bool), samples, row_weights, values)


def _samples(smallest: float, largest: float) -> FloatArray:
    decades = np.log10(largest / smallest)
    return np.geomspace(smallest, largest, 50 + int(SAMPLES_PER_DECADE * decades))


def _least_squares(
    shifts: ComplexArray,
    used: NDArray[np.bool_],
    samples: FloatArray,
    row_weights: FloatArray,
    values: FloatArray,
) -> Fit:
    resolvents = 1 / (samples[:, None] + shifts[used])
    basis = np.hstack([np.ones((len(samples), 1)), resolvents.real, -resolvents.imag]) * row_weights[:, None]
    scales = np.linalg.norm(basis, axis=0)
    basis, values = basis / scales, values * row_weights[:, None]
    solution = np.linalg.lstsq(basis, values, rcond=RELATIVE_CUTOFF)[0]
    errors = np.abs(basis @ solution - values)
    residuals = errors.max(axis=0) / np.abs(values).max(axis=0)
    constants, real, imaginary = np.split(solution / scales[:, None], [1, 1 + np.count_nonzero(used)])
    weights = np.zeros((len(shifts), values.shape[1]), dtype=complex)
    weights[used] = real + 1j * imaginary
    return Fit(
        constants=constants[0],
        weights=weights,
        residual=float(residuals.max(initial=0.0)),
        largest_error=float((errors / row_weights[:, None]).max(initial=0.0)),
    )


def _near(shifts: ComplexArray, smallest: float, largest: float) -> NDArray[np.bool_]:
    """The shifts that serve an interval: others would take large weights of opposite signs and cancel."""
    moduli = np.abs(shifts)
    inside = (moduli >= BELOW * smallest * (1 - 1e-9)) & (moduli <= ABOVE * largest * (1 + 1e-9))
    near = inside.copy()
    near[:-1] |= inside[1:]
    near[1:] |= inside[:-1]
    return near


def _on_ray(smallest: float, largest: float, count: int) -> ComplexArray:
    moduli = np.geomspace(BELOW * smallest, ABOVE * largest, count)
    return np.asarray(moduli * np.exp(1j * ANGLE_RAD))
