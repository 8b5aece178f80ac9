"""Which closures of a revisit agree: by the places to which they move the map, in units of free space."""

import gtsam
import numpy as np
import pytest

from pgti_gtsam.gate.candidates import AGREEMENT, AGREEMENT_RAD, STRETCHED, agreement

UNIT = 4.0  # m


def planar(x, angle=0.0):
    return gtsam.Pose2(x, 0.0, angle)


def spatial(x, angle=0.0):
    return gtsam.Pose3(gtsam.Rot3.Ry(angle), np.array([0.0, x, 0.0]))


def agree(first, second, *, ways=(0.0, 0.0), unit=UNIT):
    """Whether two motions agree, seen from either; the later keyframes stand at the origin."""
    place = np.zeros(2 if isinstance(first, gtsam.Pose2) else 3)
    found = agreement([first, second], [place, place], np.array(ways), unit)
    assert found.diagonal().all()
    assert (found == found.T).all()
    return bool(found[0, 1])


@pytest.mark.parametrize("motion", [planar, spatial])
@pytest.mark.parametrize("way", [0.0, 7.0])
@pytest.mark.parametrize("unit", [0.02, UNIT])
def test_places_may_lie_apart_by_a_share_of_free_space_that_grows_with_the_way(motion, way, unit):
    limit = AGREEMENT * (1 + STRETCHED * way) * unit
    for ways in ((way, 0.0), (0.0, way)):
        assert agree(motion(1.0), motion(1.0 + 0.999 * limit), ways=ways, unit=unit)
        assert not agree(motion(1.0), motion(1.0 + 1.001 * limit), ways=ways, unit=unit)


@pytest.mark.parametrize("motion", [planar, spatial])
@pytest.mark.parametrize("sign", [1, -1])
def test_headings_may_differ_by_a_fixed_angle(motion, sign):
    assert agree(motion(1.0, 0.1), motion(1.0, 0.1 + 0.999 * sign * AGREEMENT_RAD))
    assert not agree(motion(1.0, 0.1), motion(1.0, 0.1 + 1.001 * sign * AGREEMENT_RAD))


def test_the_places_of_both_must_agree():
    """Motions that agree at one place and turn about that place move the other place apart."""
    near, far = np.zeros(2), np.array([1.2 * AGREEMENT * UNIT / 0.3, 0.0])
    motions = [planar(0.0), planar(0.0, 0.3)]
    assert agreement(motions, [near, near], np.zeros(2), UNIT)[0, 1]
    for places in ([near, far], [far, near]):
        assert not agreement(motions, places, np.zeros(2), UNIT)[0, 1]
