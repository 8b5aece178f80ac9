"""A map has no unit and no place: verdicts in micrometres, megametres and at UTM offsets are those in metres.

And no run differs from another: not by the seed of Python's hashes, nor by the number of threads.
"""

import os
import subprocess
import sys

import gtsam
import numpy as np
import pytest
from test_datasets_rtabmap import truth

import pgti_gtsam as pgti
from pgti_gtsam.datasets import write_g2o
from pgti_gtsam.factor_graphs import keys_of, without
from pgti_gtsam.report.digits import packable, stable

UTM = np.array([5e5, 5e6, 100.0])  # m
FRAMES = {"µm": (1e6, 0.0), "Mm": (1e-6, 0.0), "UTM": (1.0, UTM), "UTM in µm": (1e6, 1e6 * UTM)}
CLOSURES = [(2, 22), (10, 30), (25, 45), (33, 53), (15, 56)]
FALSE = [(5, 48), (0, 37)]
RADIUS, WIDE = 3.0, 30.0  # m


def laps(spatial, scale=1.0, offset=0.0, n=60):
    """Three laps, or more, whose odometry drifts, with five true closures and two false ones; lengths times a scale."""
    rng = np.random.default_rng(5)
    sigmas = np.array([1e-3, 1e-3, 4e-3, 0.05, 0.05, 0.01] if spatial else [0.05, 0.05, 4e-3])
    length = np.array([1, 1, 1, scale, scale, scale] if spatial else [scale, scale, 1.0])
    drawn = [truth(5 * i) for i in range(n)]
    poses = drawn if spatial else [gtsam.Pose2(*pose.translation()[:2], pose.rotation().yaw()) for pose in drawn]
    tie, group = (gtsam.BetweenFactorPose3, gtsam.Pose3) if spatial else (gtsam.BetweenFactorPose2, gtsam.Pose2)
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas * length)
    graph, values, here = gtsam.NonlinearFactorGraph(), gtsam.Values(), poses[0]

    def in_unit(pose, shift=0.0):
        place = pose.translation()
        return group(pose.rotation(), scale * place + np.resize(shift, len(place)))

    values.insert(0, in_unit(here, offset))
    for i in range(n - 1):
        step = poses[i].between(poses[i + 1]).compose(group.Expmap(rng.normal(size=len(sigmas)) * sigmas))
        graph.push_back(tie(i, i + 1, in_unit(step), noise))
        here = here.compose(step)
        values.insert(i + 1, in_unit(here, offset))
    for i, j in CLOSURES:
        seen = poses[i].between(poses[j]).compose(group.Expmap(rng.normal(size=len(sigmas)) * sigmas))
        graph.push_back(tie(i, j, in_unit(seen), noise))
    for i, j in FALSE:
        graph.push_back(tie(i, j, group(), noise))
    return graph, values


@pytest.mark.parametrize("spatial", [False, True])
def test_units_and_offsets_change_nothing(spatial):
    expected = judged(*laps(spatial), RADIUS)
    assert {slot for slot, verdict in expected[1].items() if verdict == "accepted"} == {59, 60, 61, 62, 63}
    for scale, offset in FRAMES.values():
        found = judged(*laps(spatial, scale, offset), scale * RADIUS)
        assert found[:3] == expected[:3]
        np.testing.assert_allclose(found[3], expected[3], rtol=0, atol=1e-6)
        np.testing.assert_allclose(found[4], expected[4], rtol=1e-6)


def judged(graph, values, radius):
    """Verdict of the map, of its closures, kinds and stretches of its places, probabilities, Λ."""
    diagnosis, gated = pgti.diagnose(graph, values, radii=radius), pgti.gate_graph(graph, values, radius)
    own = {closure.slot: closure.probability for closure in diagnosis.closures}
    slots = sorted(gated.decisions)
    return (
        diagnosis.verdict,
        {slot: gated.decisions[slot].verdict for slot in slots},
        [(place.kind, str(place.keyframes)) for place in diagnosis.places],
        [*(own[slot] for slot in slots), *(gated.decisions[slot].probability for slot in slots)],
        diagnosis.integrity.score,
    )


@pytest.mark.parametrize("spatial", [False, True])
def test_units_change_no_decision_of_a_gated_smoother(spatial):
    expected = smoothed(spatial, 1.0)
    assert {told[0] for told in expected} == {"accepted", "rejected"}
    for scale in (1e3, 1e-3):
        found = smoothed(spatial, scale)
        assert [told[:2] for told in found] == [told[:2] for told in expected]
        np.testing.assert_allclose([told[2] for told in found], [told[2] for told in expected], rtol=0, atol=1e-6)


def smoothed(spatial, scale):
    """Verdict, how many were judged together, probability: of closures that come at once, and of a review afresh."""
    graph, values = laps(spatial, scale)
    offered = [graph.at(slot) for slot in range(59, graph.size())]
    steps = without(graph, range(59, graph.size()))
    pose = values.atPose3(0) if spatial else values.atPose2(0)
    prior = gtsam.PriorFactorPose3 if spatial else gtsam.PriorFactorPose2
    steps.push_back(prior(0, pose, steps.at(0).noiseModel()))
    smoother = pgti.GatedISAM2(radii=scale * RADIUS)
    decisions = [*smoother.update(steps, values, offered).decisions, *smoother.review_afresh().decisions.values()]
    return [(decision.verdict, decision.judged_with, decision.probability) for decision in decisions]


@pytest.mark.parametrize("scale", [1e3, 1e-3])
def test_units_change_no_review_of_two_robots(scale):
    """Ways along the tracks of several robots say which closures are of one revisit."""
    assert reviewed(scale) == reviewed(1.0)


def reviewed(scale):
    """Verdict and size of the revisit of every closure, where the second half of the track is another robot's."""
    graph, values = laps(False, scale)
    keys = {key: gtsam.symbol("b", key) if key >= 30 else key for key in range(60)}
    renamed = gtsam.Values()
    for key, new in keys.items():
        renamed.insert(new, values.atPose2(key))
    factors = [graph.at(slot).rekey([keys[key] for key in keys_of(graph.at(slot))]) for slot in range(64)]
    steps, noise = gtsam.NonlinearFactorGraph(), factors[0].noiseModel()
    for factor in [*factors[:59], gtsam.PriorFactorPose2(0, values.atPose2(0), noise)]:
        steps.push_back(factor)
    smoother = pgti.GatedISAM2(radii=scale * WIDE)
    smoother.update(steps, renamed, factors[59:])
    decisions = smoother.review().decisions
    assert max(each.judged_with for each in decisions.values()) > 1
    return {number: (each.verdict, each.judged_with) for number, each in decisions.items()}


def test_seeds_of_hashes_and_threads_change_no_byte(tmp_path):
    """With 400 keyframes the scores of one and of two threads differ in the 13th digit."""
    write_g2o(*laps(spatial=False, n=400), tmp_path / "laps.g2o")
    first, second = (written(tmp_path, seed, threads) for seed, threads in (("0", "1"), ("1", "2")))
    assert first.keys() == second.keys()
    assert len(first) == 7
    assert [name for name in first if first[name] != second[name]] == []


def written(folder, seed, threads):
    """Everything that an audit and a gate write about a map."""
    script = """import sys
from pgti_gtsam import cli
commands = " ".join(sys.argv[1:]).split(" + ")
for words in commands:
    sys.argv = ["pgti-gtsam", *words.split()]
    try:
        cli.main()
    except SystemExit as stop:
        assert not stop.code
"""
    out = folder / seed
    out.mkdir()
    commands = (
        "audit ../laps.g2o --radius 3 --json a.json --html a.html --proposals a.g2o + "
        "gate ../laps.g2o --radius 3 --json b.json --html b.html --decisions b.jsonl --out b.g2o"
    )
    environment = {"PYTHONHASHSEED": seed, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    subprocess.run(
        [sys.executable, "-c", script, commands], cwd=out, env=os.environ | environment, check=True, capture_output=True
    )
    return {path.name: path.read_bytes() for path in out.iterdir()}


def test_digits_of_documents():
    """Six are left, of lengths of the map all; numbers whose last digits differ are the same."""
    rng = np.random.default_rng(3)
    numbers = rng.normal(size=1000) * 10.0 ** rng.integers(-12, 12, 1000)
    found = stable({"score": numbers.tolist(), "keyframes": {"position": [1 / 3]}, "n": 1234567, "words": "1.23456789"})
    np.testing.assert_allclose(found["score"], numbers, rtol=5e-6)
    assert stable({"score": (numbers * (1 + 1e-12)).tolist()})["score"] == found["score"]
    assert (found["keyframes"], found["n"], found["words"]) == ({"position": [1 / 3]}, 1234567, "1.23456789")
    assert stable({"after": {"pose": [[500000.125, 5000000.25, 0.1]]}}) == {
        "after": {"pose": [[500000.125, 5000000.25, 0.1]]}
    }
    assert stable({"a": [0.0, -1.23456789e-7, 0.99999951]}) == {"a": [0.0, -1.23457e-7, 1.0]}
    packed = packable(numbers.reshape(10, 100))
    np.testing.assert_allclose(packed, numbers.reshape(10, 100), rtol=5e-4)
    assert (packable(packed * (1 + 1e-12)) == packed).all()
    assert packable([0.0, 1234.56]).tolist() == [0.0, 1235.0]
