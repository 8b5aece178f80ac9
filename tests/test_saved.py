"""A gate that is saved and resumed goes on as if nothing had happened."""

import json

import gtsam
import numpy as np
import pytest
from streets import RADIUS, block, driven, straight

from pgti_gtsam.errors import FileFormatError, InvalidGraphError
from pgti_gtsam.gate.smoothers.fixed_lag import GatedFixedLagSmoother
from pgti_gtsam.gate.smoothers.isam2 import GatedISAM2

LAP = 4 * 12  # steps around a block of 20 m
NOWHERE = gtsam.Pose2()
ORIGIN = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)
TRUE, FALSE = {2: 1, 8: 7, 24: 23}, {4: 30, 20: 60}  # first keyframe by the second, a lap later
CLOSING = {LAP + k: (i, None) for k, i in TRUE.items()} | {LAP + k: (i, NOWHERE) for k, i in FALSE.items()}


@pytest.fixture(scope="module")
def world():
    return driven(block(20, times=2) + straight(10), bias=0.002, noise=0.005)


def drive(world, isam, first, last):
    """The verdicts, and the changed minds, of closures that come with some keyframes."""
    is_lagged = isinstance(isam, GatedFixedLagSmoother)
    told = []
    for k in range(first, last):
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factors.push_back(gtsam.PriorFactorPose2(0, world.truth[0], ORIGIN) if k == 0 else world.graph.at(k - 1))
        values.insert(k, world.values.atPose2(k))
        i, pose = CLOSING.get(k, (None, None))
        closures, more = (
            [] if i is None else [world.closure(i, k, pose)],
            {"timestamps": {k: float(k)}} if is_lagged else {},
        )
        update = isam.update(factors, values, closures=closures, radii={k: RADIUS}, **more)
        told += [(k, decision.verdict, decision.log_odds) for decision in update.decisions]
        told += [(k, number, decision.verdict) for number, decision in update.changed.items()]
    return told


@pytest.fixture(scope="module")
def whole(world):
    """A run without a break, and its verdicts."""
    isam = GatedISAM2()
    return isam, drive(world, isam, 0, LAP + 30)


@pytest.mark.parametrize("broken_at", [0, LAP + 21])
def test_resumed_anywhere_the_verdicts_are_those_of_one_run(world, whole, tmp_path, broken_at):
    (whole, expected), isam, last = whole, GatedISAM2(), LAP + 30
    told = drive(world, isam, 0, broken_at)
    isam.save(tmp_path / "gate.json")
    resumed = GatedISAM2.load(tmp_path / "gate.json")
    told += drive(world, resumed, broken_at, last)

    assert [row[:2] for row in told] == [row[:2] for row in expected]
    assert np.allclose([row[2] for row in told], [row[2] for row in expected], rtol=1e-6)
    assert resumed.admitted == whole.admitted
    assert resumed.radii == whole.radii
    one, other = resumed.estimate(), whole.estimate()
    assert all(one.atPose2(k).equals(other.atPose2(k), 1e-2) for k in range(last))
    assert [path.name for path in tmp_path.iterdir()] == ["gate.json"]


def test_closures_can_be_taken_out_after_a_break_and_slots_stay_empty(world):
    isam = GatedISAM2()
    drive(world, isam, 0, LAP + 10)
    isam.retract(0)
    resumed = GatedISAM2.resumed(json.loads(json.dumps(isam.state())))
    assert resumed.admitted == isam.admitted != {}
    resumed.retract(*resumed.admitted)
    assert resumed.admitted == {}
    for slot in range(isam.getFactorsUnsafe().size()):
        assert (isam.getFactorsUnsafe().at(slot) is None) <= (resumed.getFactorsUnsafe().at(slot) is None)
    assert resumed.review_afresh().decisions.keys() == isam.review_afresh().decisions.keys()


@pytest.mark.parametrize("kind", [gtsam.IncrementalFixedLagSmoother, gtsam.BatchFixedLagSmoother])
@pytest.mark.parametrize("broken_at", [0, 5, LAP + 21])
def test_a_fixed_lag_smoother_goes_on_with_its_window_and_all_that_left_it(world, tmp_path, kind, broken_at):
    whole, isam, last = GatedFixedLagSmoother(kind(LAP + 5.0)), GatedFixedLagSmoother(kind(LAP + 5.0)), LAP + 30
    expected, told = drive(world, whole, 0, last), drive(world, isam, 0, broken_at)
    isam.save(tmp_path / "gate.json")
    resumed = GatedFixedLagSmoother.load(tmp_path / "gate.json")
    told += drive(world, resumed, broken_at, last)

    assert [row[:2] for row in told] == [row[:2] for row in expected]
    # iSAM2 counts the updates to the next relinearisation anew
    assert np.allclose([row[2] for row in told], [row[2] for row in expected], rtol=1e-3)
    assert (type(resumed.smoother), resumed.smootherLag()) == (kind, LAP + 5.0)
    assert dict(resumed.timestamps()) == dict(whole.timestamps())
    assert (resumed.absorbed, resumed.admitted) == (whole.absorbed, whole.admitted)
    assert resumed.absorbed
    one, other = resumed.estimate(), whole.estimate()
    assert all(one.atPose2(k).equals(other.atPose2(k), 1e-2) for k in range(last))
    with pytest.raises(InvalidGraphError, match="expected the state of ISAM2, got that of"):
        GatedISAM2.load(tmp_path / "gate.json")


def _nothing(_, __, jacobians):
    """A factor that pulls at nothing."""
    if jacobians is not None:
        jacobians[0] = np.eye(3)
    return np.zeros(3)


def test_what_has_no_archive_is_not_saved_and_what_is_no_state_is_not_read(world, tmp_path):
    isam = GatedISAM2()
    drive(world, isam, 0, 3)
    (tmp_path / "gate.json").write_text("as it was")
    factors = gtsam.NonlinearFactorGraph()
    factors.push_back(gtsam.CustomFactor(ORIGIN, [1], _nothing))
    isam.smoother.update(factors, gtsam.Values())
    with pytest.raises(InvalidGraphError, match="archives"):
        isam.save(tmp_path / "gate.json")
    with pytest.raises(FileFormatError, match="no JSON"):
        GatedISAM2.load(tmp_path / "gate.json")
    assert (tmp_path / "gate.json").read_text() == "as it was"
    with pytest.raises(InvalidGraphError, match="expected a state"):
        GatedISAM2.resumed({"schema": "pgti-gtsam/audit"})


def test_a_state_that_was_changed_since_is_refused(whole, tmp_path):
    isam, path = whole[0], tmp_path / "gate.json"
    isam.save(path)
    text = path.read_text()
    GatedISAM2.load(path)
    packed = text.index('"map": "') + 2000
    for changed in (
        text[:packed] + ("A" if text[packed] != "A" else "B") + text[packed + 1 :],
        text.replace("[0, 3.0]", "[0, 3.5]"),
        text[: text.rindex(', "sha256"')] + "}",
        text[:-1] + ', "more": 1}',
    ):
        assert changed != text
        path.write_text(changed)
        with pytest.raises(FileFormatError, match="changed since; start anew"):
            GatedISAM2.load(path)
        assert path.read_text() == changed
    path.write_text(text[: len(text) // 2])
    with pytest.raises(FileFormatError, match="no JSON"):
        GatedISAM2.load(path)
