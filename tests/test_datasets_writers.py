"""A gated graph goes back into the format that it came in, where that holds one."""

import math

import gtsam
import numpy as np
import pytest
from small_files import TEXTS, read_text

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import closure_slots, poses_of
from pgti_gtsam.datasets.pyfg_writer import write_pyfg
from pgti_gtsam.datasets.toro_writer import write_toro

TURN = np.pi / 4
TRUE, FALSE = (0, 8), (2, 7)


def ring(letter=""):
    """Nine poses around an octagon of 2 m steps, a true and a false closure: names, poses, edges (i, j, pose)."""
    poses = [gtsam.Pose2()]
    for _ in range(8):
        poses.append(poses[-1].compose(gtsam.Pose2(2, 0, TURN)))
    edges = [(i, i + 1, gtsam.Pose2(2, 0, TURN)) for i in range(8)]
    edges += [(*TRUE, poses[0].between(poses[8])), (*FALSE, gtsam.Pose2())]
    return [f"{letter}{i}" for i in range(9)], poses, edges


def numbers(pose):
    return f"{pose.x()!r} {pose.y()!r} {pose.theta()!r}"


def toro():
    names, poses, edges = ring()
    lines = [f"VERTEX2 {name} {numbers(pose)}" for name, pose in zip(names, poses, strict=True)]
    lines += [f"EDGE2 {i} {j} {numbers(pose)} 100 0 100 400 0 0" for i, j, pose in edges]
    return "\n".join(lines) + "\n"


def pyfg():
    names, poses, edges = ring("A")
    rows = enumerate(zip(names, poses, strict=True))
    lines = [f"VERTEX_SE2 {k}.5 {name} {numbers(pose)}" for k, (name, pose) in rows]
    lines += [f"EDGE_SE2 1.5 A{i} A{j} {numbers(pose)} 0.01 0 0 0.01 0 0.0025" for i, j, pose in edges]
    return "\n".join(lines) + "\n"


def trajectory():
    _, poses, _ = ring()
    lines = []
    for k, pose in enumerate(poses):
        half = pose.theta() / 2
        lines.append(f"{k}.0 {pose.x()!r} {pose.y()!r} 0 0 0 {math.sin(half)!r} {math.cos(half)!r}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("name", "write"),
    [("TORO", write_toro), ("TORO in space", write_toro), ("PyFG", write_pyfg)],
    ids=["TORO", "TORO in space", "PyFG"],
)
def test_what_is_written_is_read_again(tmp_path, name, write):
    dataset = read_text(tmp_path, TEXTS[name])
    write(dataset.graph, dataset.values, tmp_path / "written")
    again = datasets.read(tmp_path / "written")
    assert again.format == dataset.format
    assert again.graph.equals(dataset.graph, 1e-9)
    assert again.values.equals(dataset.values, 1e-9)


@pytest.mark.parametrize(("text", "format"), [(toro(), "TORO graph"), (pyfg(), "PyFG graph")], ids=["TORO", "PyFG"])
@pytest.mark.parametrize("ending", ["txt", "g2o"])
def test_a_gated_graph_keeps_its_format_unless_the_name_says_g2o(run, tmp_path, text, format, ending):
    (tmp_path / "map.txt").write_text(text)
    before = datasets.read(tmp_path / "map.txt")
    assert len(closure_slots(before)) == 2
    out = tmp_path / f"gated.{ending}"
    code, said, _ = run("gate", tmp_path / "map.txt", "--radius", 0.5, "--out", out)
    assert code == 0
    assert "1 accepted, 0 undecided, 1 rejected" in said
    after = datasets.read(out)
    assert after.format == ("g2o" if ending == "g2o" else format)
    assert " written" not in said
    factors = [after.graph.at(slot) for slot in range(after.graph.size())]
    kept = [before.graph.at(slot) for slot in range(before.graph.size() - 1)]
    assert all(factor.measured().equals(old.measured(), 1e-9) for factor, old in zip(factors, kept, strict=True))
    assert ending == "g2o" or list(poses_of(after.values)) == list(poses_of(before.values))


def test_what_holds_no_graph_is_written_as_g2o_and_says_so(run, tmp_path):
    (tmp_path / "poses.tum").write_text(trajectory())
    (tmp_path / "loops.txt").write_text("0 8 0 0 0\n2 7 0 0 0\n")
    words = ("gate", tmp_path / "poses.tum", "--loops", tmp_path / "loops.txt", "--radius", 0.5)
    code, said, _ = run(*words, "--out", tmp_path / "gated.txt")
    assert code == 0
    assert "gated graph, as g2o: no TUM trajectory is written" in said
    assert datasets.read(tmp_path / "gated.txt").format == "g2o"


def test_noise_that_toro_and_pyfg_have_no_words_for_is_counted(tmp_path):
    graph, values, key = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.symbol("A", 0)
    values.insert(key, gtsam.Pose2())
    values.insert(key + 1, gtsam.Pose2(1, 0, 0))
    values.insert(key + 2, np.array([0.0, 1.0]))
    half = gtsam.noiseModel.Gaussian.SqrtInformation(np.diag([1.0, 1.0, 0.0]), False)
    graph.push_back(gtsam.BetweenFactorPose2(key, key + 1, gtsam.Pose2(1, 0, 0), half))
    slanted = gtsam.noiseModel.Gaussian.Information(np.array([[2.0, 1.0], [1.0, 2.0]]))
    graph.push_back(gtsam.BearingRangeFactor2D(key, key + 2, gtsam.Rot2(1.0), 1.0, slanted))
    unknown = "with a noise model or a measurement that the format has no word for"
    assert write_pyfg(graph, values, tmp_path / "p")[f"BetweenFactorPose2 {unknown}"] == 1
    assert write_toro(graph, values, tmp_path / "t") == {f"BearingRangeFactor2D {unknown}": 1}
