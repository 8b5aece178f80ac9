"""What a caller may pass by mistake is refused before any work, in one line that says what was expected."""

import gtsam
import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam import diffusion
from pgti_gtsam.errors import PgtiError
from pgti_gtsam.replaying import Measure, replay

NOISE = gtsam.noiseModel.Unit.Create(3)
POSES = [gtsam.Pose2(10 * np.cos(a), 10 * np.sin(a), a + np.pi / 2) for a in np.arange(16) * np.pi / 4]
CLOSURE = gtsam.BetweenFactorPose2(1, 9, gtsam.Pose2(), NOISE)
NAN_CLOSURE = gtsam.BetweenFactorPose2(1, 9, gtsam.Pose2(0, 0, np.nan), NOISE)


def laps(nan_heading=False):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, pose in enumerate(POSES):
        values.insert(key, gtsam.Pose2(pose.x(), pose.y(), np.nan) if nan_heading and key == 3 else pose)
    graph.add(gtsam.PriorFactorPose2(0, POSES[0], NOISE))
    for i, j in [*((i, i + 1) for i in range(15)), (0, 8), (3, 11)]:
        graph.add(gtsam.BetweenFactorPose2(i, j, POSES[i].between(POSES[j]), NOISE))
    return graph, values


MAP = laps()
CALLS = {
    "from_gtsam": lambda graph, values, **options: pgti.from_gtsam(graph, values, **options),
    "diagnose": lambda graph, values, **options: pgti.diagnose(graph, values, **options),
    "gate_graph": lambda graph, values, **options: pgti.gate_graph(graph, values, **options),
    "replay": lambda graph, values, **options: replay(graph, values, **options),
}
RADII_CALLS = CALLS | {
    "evaluate": lambda graph, values, radii: pgti.LoopClosureGate().evaluate(graph, values, CLOSURE, radii),
    "GatedISAM2": lambda graph, values, radii: pgti.GatedISAM2(radii=radii),
}
MAP_CALLS = RADII_CALLS | {
    "study": lambda graph, values, radii: diffusion.study(graph, values),
    "linearise": lambda graph, values, radii: diffusion.linearise(graph, values),
    "equation_11": lambda graph, values, radii: diffusion.equation_11(graph, values),
    "reference_map": lambda graph, values, radii: pgti.LoopClosureGate().reference_map(graph, values, radii),
}
del MAP_CALLS["GatedISAM2"]
RADII = {
    "list": [1.0] * 16,
    "array": np.ones(16),
    "scalar array": np.array(1.0),
    "set": {1.0},
    "text": "1",
    "truth": True,
    "negative": -1,
    "NaN": np.nan,
    "infinite": np.inf,
    "huge": 1e300,
    "tiny": 1e-200,
    "complex": 1j,
    "function": lambda key: 1.0,
    "text as key": {"x": 1.0},
    "fraction as key": {0.5: 1.0},
    "negative key": {-1: 1.0},
    "huge key": {1 << 70: 1.0},
    "text as value": {0: "a"},
    "list as value": {0: [1.0, 2.0]},
    "None as value": {0: None},
}


def refused(call, *arguments, **options):
    with pytest.raises(PgtiError) as error:
        call(*arguments, **options)
    message = str(error.value)
    assert message.startswith("expected ")
    assert ", got " in message
    assert "\n" not in message


@pytest.mark.parametrize("name", RADII_CALLS)
def test_radii(name):
    for radii in RADII.values():
        if name == "GatedISAM2" and radii is RADII["huge key"]:  # which may come later
            continue
        refused(RADII_CALLS[name], *MAP, radii=radii)


@pytest.mark.parametrize("name", MAP_CALLS)
def test_maps(name):
    graph, values = MAP
    wrong = [(values, graph), (None, None), ([CLOSURE], values), (graph, {0: POSES[0]}), ("a", "b"), laps(True)]
    for pair in wrong:
        if name != "equation_11" or pair is not wrong[-1]:
            refused(MAP_CALLS[name], *pair, radii=1.0)


@pytest.mark.parametrize("name", CALLS)
def test_slots_of_closures(name):
    for closures in ("ab", 3, [15.5], [15.0], [-1], [1 << 70], [99], [None], [CLOSURE], np.array([15.5])):
        refused(CALLS[name], *MAP, radii=1.0, closures=closures)
    CALLS[name](*MAP, radii=1.0, closures=np.array([17, 16]))


@pytest.mark.parametrize("closure", [None, "x", 3, [], [1], [None], [[CLOSURE]], MAP[1], NAN_CLOSURE])
def test_closures(closure):
    refused(pgti.LoopClosureGate().evaluate, *MAP, closure, 1.0)
    smoother = pgti.GatedISAM2(radii=1.0)
    smoother.update(*MAP)
    refused(smoother.update, gtsam.NonlinearFactorGraph(), gtsam.Values(), [closure])


@pytest.mark.parametrize("name", ["from_gtsam", "diagnose", "replay"])
def test_options_of_maps(name):
    for options in (
        {"edges": 3},
        {"edges": [1]},
        {"edges": []},
        {"min_shared_landmarks": 1.5},
        {"min_shared_landmarks": "a"},
        {"min_shared_landmarks": np.nan},
    ):
        refused(CALLS[name], *MAP, radii=1.0, **options)


@pytest.mark.parametrize(
    "arrays",
    [
        {"positions": 1j * np.ones((3, 3))},
        {"positions": [["a", "b", "c"]] * 3},
        {"positions": [[0, 0, 0], [1, 0], [2, 0, 0]]},
        {"positions": None},
        {"keys": [0.5, 1, 2]},
        {"keys": [-1, 1, 2]},
        {"keys": [1 << 70, 1, 2]},
        {"keys": None},
        {"edges": [(0.5, 1)]},
        {"edges": [(np.nan, 1)]},
        {"edges": [(1j, 1)]},
        {"edges": np.ones((2, 2), dtype=bool)},
        {"edges": [("a", "b")]},
        {"edges": None},
        {"radii": 1j},
        {"radii": "a"},
        {"radii": None},
    ],
)
def test_arrays_of_a_pose_graph(arrays):
    valid = {"keys": [0, 1, 2], "positions": np.zeros((3, 3)), "radii": 1.0, "edges": [(0, 1), (1, 2)]}
    pgti.PoseGraph(**valid)
    refused(pgti.PoseGraph, **valid | arrays)


@pytest.mark.parametrize("beta", ["a", None, np.nan, 1j, 2, -0.1, True])
def test_beta(beta):
    refused(pgti.assess, pgti.from_gtsam(*MAP, radii=1.0), beta=beta)
    refused(pgti.GateOptions, beta=beta)
    refused(Measure, beta=beta)


def test_other_options():
    pose_graph = pgti.from_gtsam(*MAP, radii=1.0)
    for options in (
        {"n_times": 2.5},
        {"n_times": "a"},
        {"n_times": 10**12},
        {"n_times": True},
        {"norm": "a"},
        {"norm": np.nan},
    ):
        refused(pgti.assess, pose_graph, **options)
        refused(Measure, **options)
    for wrong in (None, MAP[0]):
        refused(pgti.assess, wrong)
    for options in (
        {"min_probability": "a"},
        {"min_probability": 1j},
        {"max_rise": np.nan},
        {"max_rise": -1},
        {"scores": "yes"},
        {"edges": ("x",)},
        {"min_shared_landmarks": 0},
        {"rule": []},
    ):
        refused(pgti.GateOptions, **options)
    for gate in (3, pgti.GateOptions()):
        refused(pgti.gate_graph, *MAP, 1.0, gate=gate)
    for options in ({"every": 1.5}, {"every": "a"}, {"measure": 3}, {"path": 3}):
        refused(replay, *MAP, radii=1.0, **options)
    for review in (None, "x"):
        refused(pgti.GatedISAM2(radii=1.0).revise, review)


def test_times_of_the_heat_flow():
    body = diffusion.linearise(*MAP)
    flow = diffusion.heat_flow(diffusion.normal_equations(diffusion.grounded(body, diffusion.grounds(body))))
    for times in ("a", -1.0, np.nan, [[1.0]], None, 1j, []):
        with pytest.raises(PgtiError, match="expected "):
            flow.at(times)
