"""Which of several closures are tied: the evidence on each, and how often the free space is asked."""

import gtsam
import numpy as np
import pytest
from scipy.optimize import brentq
from streets import RADIUS, block, driven, ramp, straight, turn

from pgti_gtsam.drift.left_out import left_out
from pgti_gtsam.drift.log_odds import AGREES, log_odds, log_odds_together
from pgti_gtsam.drift.settled import settle
from pgti_gtsam.gate.admission import DOUBT, Admission, Weight
from pgti_gtsam.gate.candidate_map import CandidateMaps
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.terms.contact_rise import local_rise

NEEDED = 2.0
LAP, LAP_OF_20 = 4 * 32, 4 * 12  # steps around a block of 60 m and of 20 m


@pytest.fixture(scope="module")
def two_blocks():
    """A lap around a block, a street, a lap around another, and a true closure in each."""
    once = [*block(60), *straight(20)]
    world = driven([*once, *turn(-np.pi / 2), *straight(100), *once], bias=0.003, noise=0.005)
    second = len(world.truth) - len(once)
    return world, [world.closure(4, 4 + LAP), world.closure(second + 4, second + 4 + LAP)]


def test_the_free_space_of_all_in_doubt_is_asked_once_where_none_fails(two_blocks):
    """The law: where both pass, their evidence is the rise from the map without to the map with both."""
    world, closures = two_blocks
    reference = LoopClosureGate().reference_map(world.graph, world.values, RADIUS)
    offered, rows = reference.offered(closures)
    maps, asked = CandidateMaps(reference=reference, offered=offered), []

    def contacts_of(settled):
        asked.append(settled.active.sum() - offered.active.sum())
        return maps.contacts(settled)

    weights = [Weight(ties=np.array(own)) for own in rows]
    admission = Admission(
        model=offered.model,
        needed=NEEDED,
        contacts_of=contacts_of,
        active=offered.active,
        weights=weights,
        nearest=offered,
    )
    admission.run()
    assert all(NEEDED < weight.drift < DOUBT for weight in weights)
    assert admission.active.all()
    assert asked == [0, 2]
    both = settle(offered.model, admission.active, offered)
    expected, _ = local_rise(maps.contacts(offered), maps.contacts(both))
    assert [weight.rise.rise for weight in weights] == pytest.approx([expected.rise] * 2)


@pytest.mark.parametrize("steps", [block(20), ramp(20, 0.0, 1)], ids=["planar", "in space"])
def test_each_further_member_that_agrees_adds_its_bonus_and_a_lone_closure_has_none(steps):
    world = driven([*steps, *steps[:10]], noise=0.005)
    reference = LoopClosureGate().reference_map(world.graph, world.values, RADIUS)
    offered, rows = reference.offered([world.closure(k, k + len(steps)) for k in (2, 4, 6)])
    ties = np.concatenate(rows)
    pairs, d = offered.model.ties.pairs[ties], len(offered.model.units.spread)
    missed, spread = offered.residuals[ties], offered.joint_covariances([pairs])[0]
    later = [offered.poses[j] for j in pairs[:, 1].tolist()]
    weight = Weight(ties=ties)
    for n in (1, 2, 3):
        own = missed[:n], spread[: n * d, : n * d]
        weight.weigh(offered.model.units, later[:n], *own)
        together = log_odds_together(offered.model.units, later[:n], range(n), *own)
        assert weight.drift == pytest.approx(together + (n - 1) * AGREES)
        if n == 1:
            assert weight.drift == pytest.approx(log_odds(offered.model.units, missed[:1], spread[None, :d, :d])[0])


def with_a_member_off_by(off_m):
    """An admission in which all of a revisit is tied, one member of which lies off, and that member's tie."""
    world = driven([*block(20), *block(20)[:20]], noise=0.005)
    shifted = world.truth[3].between(world.truth[LAP_OF_20 + 3]).compose(gtsam.Pose2(off_m, 0, 0))
    closures = [world.closure(k, k + LAP_OF_20) for k in (2, 5, 8, 12)]
    reference = LoopClosureGate().reference_map(world.graph, world.values, RADIUS)
    offered, rows = reference.offered([*closures, world.closure(3, LAP_OF_20 + 3, shifted)])
    tied = np.ones(len(offered.active), dtype=bool)
    admission = Admission(
        model=offered.model,
        needed=NEEDED,
        contacts_of=CandidateMaps(reference=reference, offered=offered).contacts,
        active=tied,
        weights=[Weight(ties=np.concatenate(rows))],
        nearest=settle(offered.model, tied, offered),
    )
    return admission, rows[-1][0]


@pytest.mark.parametrize("off_m", [0.0, 8.0])
def test_a_tied_member_that_all_the_others_contradict_is_out_again(off_m):
    admission, false = with_a_member_off_by(off_m)
    n_tied = len(admission.active)
    admission.run()
    assert admission.active.sum() == n_tied - (off_m > 0)
    assert admission.active[false] == (off_m == 0)
    assert list(admission.member_odds) == ([false] if off_m else [])
    assert all(odds < 0 for odds in admission.member_odds.values())


@pytest.mark.parametrize("wanted", [0.5, -0.5])
def test_a_tied_member_stays_while_the_others_say_more_for_it_than_against(wanted):
    def odds_beyond(off_m):
        admission, member = with_a_member_off_by(off_m)
        missed, others = left_out(admission.settled, np.array([member]))
        return float(log_odds(admission.model.units, missed, others)[0]) - wanted

    admission, member = with_a_member_off_by(brentq(odds_beyond, 1.0, 6.0, xtol=1e-4))
    admission._compare_members()
    assert admission.active[member] == (wanted > 0)
