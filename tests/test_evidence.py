"""How evidence is fitted and how probabilities are checked: closed forms, and a graph of real near misses."""

from pathlib import Path

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from optional import needs_open3d
from scipy.special import expit

from pgti_gtsam.gate.admission import DOUBT
from scenarios import near_misses, worlds
from scenarios.evidence import calibration, radius_loss, rise_fit

DATA = Path(__file__).parents[2] / "shared" / "data"
pytestmark = needs_open3d
laws = settings(derandomize=True, deadline=None, max_examples=30)


def told(n, seed, slope=1.0):
    """Log odds, and truths that come true as often as `slope` times them say."""
    random = np.random.default_rng(seed)
    odds = random.normal(0.0, 3.0, n)
    return odds, random.random(n) < expit(slope * odds)


def test_the_fit_lets_true_revisits_pass_and_is_the_likeliest_that_does():
    random = np.random.default_rng(0)
    rise, true = random.uniform(0.0, 1.0, 300), random.random(300) < 0.5
    revisits = np.stack([random.normal(6.0 * true, 1.5) + 3.0 * rise, rise, true], axis=1)
    fit = rise_fit.fitted(revisits)
    passing = rise_fit.told(fit, revisits)[true] > rise_fit.ACCEPTED
    assert passing.mean() >= rise_fit.PASS
    assert fit[1] < 0
    stricter = fit - [0.1, 0.0]
    assert (rise_fit.told(stricter, revisits)[true] > rise_fit.ACCEPTED).mean() < rise_fit.PASS


@pytest.mark.parametrize("equal_mass", [True, False])
def test_what_comes_true_as_often_as_told_has_no_calibration_error(equal_mass):
    odds, true = told(50_000, 1)
    assert calibration.calibration_error(expit(odds), true, equal_mass=equal_mass) < 0.01


@pytest.mark.parametrize("equal_mass", [True, False])
def test_the_calibration_error_of_one_probability_is_its_distance_from_the_share(equal_mass):
    true = np.arange(100) < 70
    found = calibration.calibration_error(
        np.full(100, 0.9), np.random.default_rng(0).permutation(true), equal_mass=False
    )
    assert found == pytest.approx(0.2)
    assert calibration.calibration_error(np.ones(50), np.ones(50, dtype=bool), equal_mass=equal_mass) == 0.0


def test_the_temperature_cools_what_is_too_sure():
    assert calibration.temperature(*told(20_000, 2, slope=0.5)) == pytest.approx(2.0, rel=0.1)


@laws
@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60), st.booleans())
def test_every_probability_is_in_one_bin(probabilities, equal_mass):
    inside = calibration.bins(np.array(probabilities), equal_mass=equal_mass)
    np.testing.assert_array_equal(np.sum(inside, axis=0), 1)


def test_the_diagram_is_drawn_and_the_report_has_a_line_for_every_kind(tmp_path):
    odds, true = told(400, 3)
    judged = list(zip(odds.tolist(), true.tolist(), strict=True))
    rows = [{"world": "offices", "seed": 0, "setting": calibration.AT_ONCE, "judged": judged}]
    calibration.draw(rows, tmp_path / "diagram.png")
    assert (tmp_path / "diagram.png").read_bytes().startswith(b"\x89PNG")
    assert "| worlds, at once | 400 |" in "\n".join(calibration.report(rows, rows))


def test_the_information_that_real_loops_are_told_changes_no_verdict_and_far_ones_are_refused():
    if not (DATA / "bicocca" / near_misses.GRAPH).is_file():
        pytest.skip(f"{near_misses.GRAPH} is absent")
    loops = near_misses.loops(DATA)
    assert (loops.missed_m[loops.true] < 1.0).all()
    rows = [near_misses.gated(loops, 1.0, information) for information in (1.0, 1e-3)]
    counts = [(row["true_accepted"], row["false_accepted_missed_m"]) for row in rows]
    assert counts[0] == counts[1]
    assert counts[0][0] >= 0.99 * rows[0]["true"]
    assert max(counts[0][1]) < 6.0
    assert sum(1 for _ in near_misses.report(rows)) == 7
    assert np.median(rows[0]["true_disagreements"] + rows[0]["false_disagreements"]) == pytest.approx(1.0)


def test_a_wall_inside_a_sphere_takes_radius_and_one_beyond_takes_none():
    here = gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.array([5.0, 0.0, 0.0]))
    there = gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), np.array([5.0, 1.0, 0.0]))
    landmarks = np.array([[0.0, 3.0, 0.0], [0.5, 0.0, 0.0]])  # 1.5 m ahead of here, and farther
    assert radius_loss.lost(here, 2.0, there, landmarks) == pytest.approx(0.25)
    assert radius_loss.lost(here, 1.0, there, landmarks) == 0.0
    assert radius_loss.lost(here, 1.0, there, np.empty((0, 3))) == 0.0


def test_a_drive_becomes_revisits_in_doubt_with_rise_and_loss(monkeypatch):
    whole = worlds.drive
    monkeypatch.setattr(worlds, "drive", lambda world, seed, length_m=None: whole(world, seed, 250.0))
    revisits = np.array(radius_loss.row(radius_loss.Trial("warehouse", 1001))["revisits"], dtype=float)
    drift, _, loss, is_true = revisits.T
    assert (np.abs(drift) <= DOUBT).all()
    assert ((loss >= 0) & (loss <= 1)).all()
    assert 0 < is_true.sum() < len(is_true)
    by_rise = rise_fit.row(rise_fit.Trial("warehouse", 1001))["revisits"]
    np.testing.assert_array_equal(np.array(by_rise, dtype=float), revisits[:, [0, 1, 3]])


def test_evidence_that_says_nothing_does_not_raise_the_likelihood_of_held_out_truths():
    random = np.random.default_rng(0)
    true = random.random(600) < 0.5
    drift, noise = random.normal(3.0 * true, 2.0), random.normal(size=600)
    groups = np.arange(600) % 3
    alone, both, nothing = (
        radius_loss.likelihood(np.column_stack(columns), true, groups) for columns in ([drift], [drift, noise], [noise])
    )
    assert nothing < -0.69 < alone
    assert both < alone + 0.003
