"""Poles and weights: the sum of resolvents is the exponential on the whole interval."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.spectral import poles

SETTINGS = settings(derandomize=True, deadline=None, max_examples=40)


def at(fit, shifts, eigenvalues):
    """The fitted function at given eigenvalues: (n_times, k)."""
    return (fit.weights.T @ (1 / (eigenvalues + shifts[:, None]))).real + fit.constants[:, None]


@SETTINGS
@given(st.floats(1e-9, 1e3), st.floats(0.0, 10.0), st.sampled_from([1e-6, 1e-8, 1e-10]))
def test_the_sum_is_the_exponential_between_the_samples_too(smallest, decades, tolerance):
    largest = smallest * 10**decades
    shifts = poles.shifts_for(smallest, largest, tolerance)
    times = np.geomspace(poles.EARLIEST / largest, max(4 * np.log(10) / smallest, poles.EARLIEST / largest), 30)
    fit = poles.fit(shifts, times, smallest, largest)
    eigenvalues = np.geomspace(smallest, largest, 1234)
    weight = (eigenvalues / smallest) ** poles.WEIGHT_EXPONENT
    exact = np.exp(-np.outer(times, eigenvalues - smallest)) * weight
    errors = np.abs(at(fit, shifts, eigenvalues) * weight - exact).max(axis=1) / exact.max(axis=1)
    assert errors.max() <= 4 * tolerance
    assert fit.residual <= 4 * tolerance


@SETTINGS
@given(st.floats(0.0, 10.0))
def test_times_before_the_first_reference_time_are_no_worse(decades):
    shifts = poles.shifts_for(1.0, 10**decades, 1e-8)
    times = np.concatenate([[0.0], np.geomspace(1e-6, 1, 20) * poles.EARLIEST / 10**decades])
    fit = poles.fit(shifts, times, 1.0, 10**decades)
    assert fit.residual <= 2e-8


def test_poles_of_a_wider_interval_serve_a_narrower_one():
    shifts = poles.shifts_for(1e-7, 1e2, 1e-8)
    assert poles.reference_residual(shifts, 1e-4, 1e1) <= 3e-8


def test_a_lower_tolerance_takes_more_poles_and_more_poles_for_a_wider_spectrum():
    counts = [[len(poles.shifts_for(1.0, top, tolerance)) for tolerance in (1e-6, 1e-8, 1e-10)] for top in (1e2, 1e6)]
    assert np.all(np.diff(counts, axis=1) > 0)
    assert np.all(np.diff(counts, axis=0) > 0)


def test_poles_lie_off_the_spectrum():
    shifts = poles.shifts_for(1.0, 1e6, 1e-8)
    assert np.all(shifts.imag > 0)


def test_the_fit_from_zero_keeps_the_zero_mode():
    times = np.geomspace(0.5, 2000, 40)
    shifts = poles.shifts_for(0.1 / times.max(), 40.0, 1e-9)
    fit = poles.fit_from_zero(shifts, times, 40.0)
    eigenvalues = np.concatenate([[0.0], np.geomspace(1e-9, 40, 555)])
    errors = np.abs(at(fit, shifts, eigenvalues) - np.exp(-np.outer(times, eigenvalues)))
    assert errors.max() <= 1.1 * fit.largest_error
    assert fit.largest_error <= 1e-7


@pytest.mark.parametrize("tolerance", [0.0, 1e-13, 0.1, np.nan])
def test_a_tolerance_out_of_range_is_refused(tolerance):
    with pytest.raises(InvalidOptionError, match="tolerance"):
        poles.shifts_for(1.0, 10.0, tolerance)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_the_spectrum_is_nothing_to_the_fit(unit):
    shifts, times = poles.shifts_for(1e-7, 1e2, 1e-8), np.geomspace(0.05, 1e3, 20)
    used = [np.abs(poles.fit(shifts * u, times / u, 1e-3 * u, u).weights).any(axis=1) for u in (1.0, unit)]
    assert (used[0] == used[1]).all()
    assert 0 < used[0].sum() < len(shifts)
