"""The README's code runs as it stands."""

import re
from pathlib import Path

import gtsam
import numpy as np
import pytest

import pgti_gtsam as pgti

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
NOISE = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)


def block(word):
    """The Python block that holds a word."""
    return next(code for code in re.findall(r"```python\n(.*?)```", README, re.DOTALL) if word in code)


def graph_of(*factors):
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    return graph


def between(i, j, pose):
    return gtsam.BetweenFactorPose2(i, j, pose, NOISE)


def square_stream(side=15):
    """Once around a square in steps of a metre, with a false closure on the way and a true one at the end."""
    turn = gtsam.Pose2(1, 0, np.pi / 2)
    steps = [turn if i % side == side - 1 else gtsam.Pose2(1, 0, 0) for i in range(4 * side)]
    pose = gtsam.Pose2()
    for i, step in enumerate([None, *steps]):
        values, factors, closures = gtsam.Values(), graph_of(), []
        if step is None:
            factors = graph_of(gtsam.PriorFactorPose2(0, pose, NOISE))
        else:
            pose = pose * step * gtsam.Pose2(0, 0, 1e-3)  # an estimate that drifts
            factors = graph_of(between(i - 1, i, step * gtsam.Pose2(0, 0, 1e-3)))
        values.insert(i, pose)
        if i == 2 * side + 5:
            closures = [graph_of(between(3, i, gtsam.Pose2()))]  # looks like the other side of the square
        if i == 4 * side:
            closures = [graph_of(between(0, i, gtsam.Pose2()))]
        yield factors, values, closures


def test_the_gate_in_an_isam2_loop(capsys):
    names = {"stream": square_stream()}
    exec(block("GatedISAM2"), names)
    said = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert said == ["rejected", "accepted"]
    end = names["trajectory"].atPose2(60)
    assert np.hypot(end.x(), end.y()) < 0.1


def test_the_library_calls():
    graph, values = graph_of(), gtsam.Values()
    for factors, new, _ in square_stream():
        graph.push_back(factors)
        for key in new.keys():  # noqa: SIM118  Values is no mapping
            values.insert(key, new.atPose2(key))
    names = {"graph": graph, "values": values}
    with pytest.raises(pgti.PgtiError, match="radius"):
        exec(block("diagnose(graph, values)"), names)
    for i in range(61):
        graph.push_back(gtsam.RangeFactor2D(i, gtsam.symbol("l", i), 0.5, gtsam.noiseModel.Unit.Create(1)))
    exec(block("diagnose(graph, values)"), names)
    assert names["diagnosis"].verdict == "incomplete"
    assert [0, 60] in names["integrity"].inserted_edges.tolist()  # the square closes, and no edge says so
