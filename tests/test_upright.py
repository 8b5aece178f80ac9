"""The body's vertical: found whatever the axes are called, and not taken for held where nothing holds the tilt."""

from itertools import pairwise

import gtsam
import numpy as np
import pytest

from pgti_gtsam.drift.upright import LEAST_TILT, chained, upright

OPTICAL = gtsam.Rot3(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]).T)  # x right, y down, z ahead
LOOKING_DOWN = gtsam.Rot3.Pitch(np.radians(30))


def steps(n, tilt, drift, mount, seed=0):
    """Steps of a body that yaws about and tilts by so much from level, with tilt that drifts, seen from its mount."""
    random = np.random.default_rng(seed)
    yaw = np.cumsum(random.normal(0, 0.1, n))
    tilted = random.normal(0, tilt, (n, 2))
    world = [gtsam.Rot3.Yaw(y) * gtsam.Rot3.Rodrigues(*each, 0.0) * mount for y, each in zip(yaw, tilted, strict=True)]
    noise = [gtsam.Rot3.Rodrigues(*each, 0.0) for each in random.normal(0, drift, (n, 2))]
    turns = [a.between(b) * (mount.inverse() * e * mount) for a, b, e in zip(world, world[1:], noise, strict=False)]
    return [gtsam.Pose3(turn, np.array([1.0, 0, 0])) for turn in turns]


def body_of(found, variance=0.03**2):
    n = len(found)
    return upright(*chained(n + 1, np.stack([np.arange(n), np.arange(n) + 1], 1), found, np.full(n, variance)))


@pytest.mark.parametrize("mount", [gtsam.Rot3(), OPTICAL, LOOKING_DOWN], ids=["upright", "optical", "looking down"])
def test_the_vertical_is_found_in_any_axes(mount):
    body = body_of(steps(400, 0.01, 1e-4, mount))
    vertical = body.levelling.matrix() @ [0, 0, 1]
    expected = mount.inverse().matrix() @ [0, 0, 1]
    assert abs(vertical @ expected) > np.cos(np.radians(2))
    assert LEAST_TILT <= body.tilt < 0.2


def test_a_hand_held_camera_that_comes_back_to_level_is_held_less():
    level, swaying = (body_of(steps(400, tilt, 1e-4, OPTICAL)).tilt for tilt in (0.01, 0.15))
    assert level < swaying < 1.0


def test_tilt_that_drifts_as_heading_does_is_not_held():
    assert body_of(steps(400, 0.0, 0.03, gtsam.Rot3())).tilt > 0.3


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("mount", [gtsam.Rot3(), LOOKING_DOWN, gtsam.Rot3.Roll(np.pi)], ids=["upright", "down", "over"])
def test_a_body_is_turned_as_little_as_its_vertical_asks(mount, seed):
    turned = body_of(steps(400, 0.01, 1e-4, mount, seed)).levelling
    assert np.linalg.norm(gtsam.Rot3.Logmap(turned)) < np.radians(35)


def test_a_body_that_is_not_held_at_all_keeps_its_own_axes():
    body = body_of(steps(400, 0.0, 0.1, OPTICAL))
    assert body.tilt == 1.0
    assert body.levelling.equals(gtsam.Rot3(), 1e-12)


def test_ramps_do_not_move_the_bound():
    n = 400
    pitch = np.where(np.arange(n) % 100 < 15, 0.15, 0.0)
    world = [gtsam.Rot3.Pitch(p) for p in pitch]
    found = [gtsam.Pose3(a.between(b), np.array([1.0, 0, 0])) for a, b in pairwise(world)]
    assert body_of(found).tilt == LEAST_TILT


def test_one_keyframe_and_no_steps_have_no_vertical():
    assert upright(*chained(1, np.empty((0, 2), dtype=int), [], np.empty(0))).tilt == 1.0
    assert upright(*chained(30, np.empty((0, 2), dtype=int), [], np.empty(0))).tilt == 1.0


def test_two_robots_with_different_worlds_share_the_body():
    found = steps(200, 0.01, 1e-4, OPTICAL)
    pairs = np.stack([np.arange(200), np.arange(200) + 1], 1)[: len(found)]
    both = np.concatenate([pairs, pairs + 201])
    body = upright(*chained(402, both, [*found, *found], np.full(len(both), 9e-4)))
    assert body.tilt < 0.2
