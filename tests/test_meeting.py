"""Stretches in contact: the share of the drift's possible positions in which they meet, and passes over each other."""

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2, norm

import pgti_gtsam as pgti
from pgti_gtsam.diagnosis.meeting import meeting_share, same_space
from pgti_gtsam.track import track_of

RADIUS = 1.0


def share(earlier, later, covariance, *, turned=0.0):
    """Of two stretches of positions in the plane, all of one heading; the later one moves about its middle."""
    places = np.concatenate([earlier, later]).astype(float)
    poses = tuple(gtsam.Pose2(x, y, turned) for x, y in places)
    n, m = len(places), len(earlier)
    graph = pgti.PoseGraph(
        keys=range(n),
        positions=np.c_[places, np.zeros(n)],
        edges=[(i, i + 1) for i in range(n - 1)],
        radii=RADIUS,
        edge_sources=[pgti.EdgeSource.BETWEEN | pgti.EdgeSource.ODOMETRY] * (n - 1),
    )
    stretches = ((0, m - 1), (m, n - 1))
    return meeting_share(poses, places, graph.radii, track_of(graph), stretches, (m + n) // 2, covariance)


def along(axis, n):
    """Positions 0.5 apart along an axis, around the origin."""
    return np.eye(2)[axis] * 0.5 * (np.arange(n)[:, None] - n // 2)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 3.0, 10.0])
def test_two_points_meet_as_often_as_the_drift_leaves_them_in_reach(sigma):
    found = share(np.zeros((1, 2)), np.full((1, 2), 0.0), np.diag([sigma**2, sigma**2, 0.0]))
    assert found == pytest.approx(chi2.cdf((2 * RADIUS / sigma) ** 2, 2), abs=0.08)


def test_drift_that_is_nothing_leaves_a_contact_as_it_is():
    assert share(along(0, 9), along(0, 9), np.zeros((3, 3))) > 0.99
    assert share(along(0, 9), along(0, 9) + [0.0, 5.0], np.zeros((3, 3))) < 0.01


def test_a_parallel_pass_is_lost_by_a_shift_to_the_side_and_a_crossing_is_not():
    sideways = np.diag([0.0, 4.0**2, 0.0])
    assert share(along(0, 61), along(0, 61), sideways) == pytest.approx(1 - 2 * norm.sf(2 * RADIUS / 4.0), abs=0.08)
    assert share(along(0, 61), along(1, 61), sideways) > 0.98


def test_the_share_does_not_depend_on_where_the_map_lies():
    covariance = np.diag([2.0, 1.0, 0.01])
    here, there = along(0, 31), along(1, 31)
    turn = gtsam.Rot2(0.7).matrix()
    moved = share(here @ turn.T + [70.0, -3.0], there @ turn.T + [70.0, -3.0], covariance, turned=0.7)
    assert moved == pytest.approx(share(here, there, covariance), abs=0.01)


def test_probabilities_rise_with_the_share_and_are_never_certain():
    found = [same_space(q) for q in (0.002, 0.1, 0.5, 0.9, 0.998)]
    assert found == sorted(found)
    assert 0 < found[0] < 0.1
    assert 0.99 < found[-1] < 1
