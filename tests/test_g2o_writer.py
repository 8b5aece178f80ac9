"""Graphs written as g2o text: what is read again is what was written, and other readers can read it too."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, P, X
from hypothesis import given, settings
from hypothesis import strategies as st
from small_files import TEXTS, read_text

from pgti_gtsam import datasets
from pgti_gtsam.datasets import closure_slots, write_g2o
from pgti_gtsam.errors import FileFormatError, InvalidValueError, MissingValueError

M = gtsam.noiseModel.mEstimator
UNIT2, UNIT3, UNIT6 = (gtsam.noiseModel.Unit.Create(d) for d in (2, 3, 6))
EDGE = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


def factors_of(graph):
    return [factor for factor in map(graph.at, range(graph.size())) if factor is not None]


def information(factor):
    model = factor.noiseModel()
    return (model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model).information()


def loss_of(factor):
    model = factor.noiseModel()
    return model.robust().serialize() if isinstance(model, gtsam.noiseModel.Robust) else None


def moved(values, by=0.01):
    """Other values, so that no residual is zero."""
    rng = np.random.default_rng(0)
    step = gtsam.VectorValues()
    for key, dimension in values.dims().items():
        step.insert(key, by * rng.normal(size=dimension))
    return values.retract(step)


def assert_same(graph, values, other, other_values):
    assert other_values.equals(values, 1e-9)
    factors, others = factors_of(graph), factors_of(other)
    assert [type(f) for f in others] == [type(f) for f in factors]
    for factor, found in zip(factors, others, strict=True):
        assert list(found.keys()) == list(factor.keys())
        assert loss_of(found) == loss_of(factor)
        scale = np.abs(information(factor)).max()
        np.testing.assert_allclose(information(found), information(factor), rtol=1e-9, atol=1e-9 * scale)
    for at in (values, moved(values)):
        assert other.error(at) == pytest.approx(graph.error(at), rel=1e-9, abs=1e-9)


def round_trip(graph, values, folder):
    written = write_g2o(graph, values, folder / "written.g2o")
    return written, datasets.read(folder / "written.g2o")


@pytest.mark.parametrize("name", sorted(TEXTS.keys() - {"PyFG"}))  # whose names are symbols, and so renumbered
def test_what_a_text_file_holds_comes_back(tmp_path, name):
    dataset = read_text(tmp_path, TEXTS[name])
    written, found = round_trip(dataset.graph, dataset.values, tmp_path)
    assert_same(dataset.graph, dataset.values, found.graph, found.values)
    assert dataset.closures is not None or closure_slots(found) == closure_slots(dataset)
    assert (written.unwritten, written.renumbered) == ({}, ())


@pytest.mark.parametrize("name", ["city_trees_1k", "victoria_park_1k", "w100"])
def test_real_graphs_come_back(tmp_path, name):
    dataset = datasets.builtin(name)
    _, found = round_trip(dataset.graph, dataset.values, tmp_path)
    assert_same(dataset.graph, dataset.values, found.graph, found.values)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6), spatial=st.booleans(), rank=st.sampled_from([1, 2, None]), span=st.floats(-6, 6))
def test_any_gaussian_graph_comes_back(tmp_path_factory, seed, spatial, rank, span):
    """Full and singular information, small and large, planar and in space, with landmarks."""
    rng = np.random.default_rng(seed)
    pose, d = (gtsam.Pose3, 6) if spatial else (gtsam.Pose2, 3)
    between = gtsam.BetweenFactorPose3 if spatial else gtsam.BetweenFactorPose2
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    keys = sorted(rng.choice(2**40, size=4, replace=False).tolist())
    for key in keys:
        values.insert(key, pose.Expmap(rng.normal(size=d)))

    def model(d):
        root = 10**span * rng.normal(size=(d if rank is None else min(rank, d), d))
        if rank is None:
            return gtsam.noiseModel.Gaussian.Information(root.T @ root + 10 ** (2 * span) * 1e-3 * np.eye(d))
        return gtsam.noiseModel.Gaussian.SqrtInformation(np.vstack([root, np.zeros((d - len(root), d))]), False)

    for i, j in [(0, 1), (2, 1), (2, 3), (3, 0)]:
        graph.push_back(between(keys[i], keys[j], pose.Expmap(rng.normal(size=d)), model(d)))
    point = rng.normal(size=3 if spatial else 2)
    seen = values.atPose3(keys[1]).transformTo(point) if spatial else values.atPose2(keys[1]).transformTo(point)
    if spatial:
        values.insertPoint3(L(7), point)
        measured = gtsam.Unit3(seen), float(np.linalg.norm(seen)) + 0.1
        graph.push_back(gtsam.BearingRangeFactor3D(keys[1], L(7), *measured, model(3)))
        graph.push_back(gtsam.GPSFactor(keys[0], rng.normal(size=3), model(3)))
    else:
        values.insert(L(7), point)
        measured = gtsam.Rot2.atan2(seen[1], seen[0]), float(np.linalg.norm(seen)) + 0.1
        graph.push_back(gtsam.BearingRangeFactor2D(keys[1], L(7), *measured, model(2)))
    _, found = round_trip(graph, values, tmp_path_factory.getbasetemp())
    assert found.values.equals(values, 1e-9)
    for factor, other in zip(factors_of(graph), factors_of(found.graph), strict=True):
        scale = np.abs(information(factor)).max()
        np.testing.assert_allclose(information(other), information(factor), atol=1e-9 * scale)
    assert found.graph.error(values) == pytest.approx(graph.error(values), rel=1e-9)


LOSSES = [
    M.Huber.Create(1.345),
    M.Cauchy.Create(1 / 3),
    M.Tukey.Create(4.6851),
    M.Fair.Create(1.3998),
    M.DCS.Create(10.0),
    M.GemanMcClure.Create(0.1),
    M.TruncatedLeastSquares.Create(2.0),
    M.Welsch.Create(1e-7),
    M.L2WithDeadZone.Create(0.5),
    M.Null.Create(),
    M.Huber.Create(0.3, M.Base.ReweightScheme.Scalar),
]


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)
def test_robust_losses_come_back_and_other_readers_see_plain_edges(tmp_path, loss):
    dataset = read_text(tmp_path, TEXTS["g2o"])
    robust = gtsam.NonlinearFactorGraph()
    for factor in factors_of(dataset.graph):
        robust.push_back(factor.cloneWithNewNoiseModel(gtsam.noiseModel.Robust.Create(loss, factor.noiseModel())))
    written, found = round_trip(robust, dataset.values, tmp_path)
    assert written.unwritten == {}
    assert_same(robust, dataset.values, found.graph, found.values)
    assert any("ROBUST" in line for line in (tmp_path / "written.g2o").read_text().splitlines())
    plain, _ = gtsam.readG2o(str(tmp_path / "written.g2o"), False)
    betweens = [f for f in factors_of(dataset.graph) if isinstance(f, gtsam.BetweenFactorPose2)]
    theirs = [f for f in factors_of(plain) if isinstance(f, gtsam.BetweenFactorPose2)]
    assert len(theirs) == len(betweens)
    assert all(one.equals(other, 1e-9) for one, other in zip(theirs, betweens, strict=True))


@pytest.mark.parametrize(
    ("comment", "message"),
    [
        ("# 0 1 ROBUST Huber", "expected a loss"),
        ("# 0 1 ROBUST Huber much", "expected a loss"),
        ("# 0 1 ROBUST Huber -1", "expected a loss"),
        ("# 0 1 ROBUST Huber 1 2", "expected a loss"),
        ("# 0 1 ROBUST Null 1", "expected a loss"),
        ("# 0 1 ROBUST Hubert 1", "expected a loss"),
        ("# 0 1 ROBUST Huber 1\n", "expected an edge of '0 1'"),
        ("# 0 2 ROBUST Huber 1", "expected an edge of '0 2'"),
    ],
)
def test_half_a_loss_is_refused_with_its_line(tmp_path, comment, message):
    with pytest.raises(FileFormatError, match=message) as caught:
        read_text(tmp_path, f"{EDGE}{comment}\n{EDGE}")
    assert caught.value.line == 2


@pytest.mark.parametrize("comment", ["# ROBUST Huber 1", "#0 1 ROBUST Huber 1", "# 3 is x3", "# Huber 1", "#"])
def test_any_other_comment_is_a_comment(tmp_path, comment):
    assert loss_of(read_text(tmp_path, f"{comment}\n{EDGE}").graph.at(0)) is None


def test_gtsam_reads_what_is_written_in_space(tmp_path):
    dataset = datasets.read(gtsam.findExampleDataFile("pose3example-offdiagonal.txt"))
    write_g2o(dataset.graph, dataset.values, tmp_path / "written.g2o")
    graph, values = gtsam.readG2o(str(tmp_path / "written.g2o"), True)
    assert_same(dataset.graph, dataset.values, graph, values)


def test_what_the_format_cannot_hold_is_counted_by_class(tmp_path):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key in (0, 1):
        values.insert(key, gtsam.Pose2(key, 0, 0))
    values.insert(L(1), np.array([0.0, 1.0]))
    values.insert(L(2), np.array([5.0, 1.0]))
    values.insert(L(3), np.array([7.0, 7.0]))  # no factor refers to it: kept
    graph.push_back(gtsam.PriorFactorPose2(0, gtsam.Pose2(), UNIT3))
    graph.push_back(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(1, 0, 0), UNIT3))
    graph.push_back(gtsam.BearingRangeFactor2D(0, L(1), gtsam.Rot2(1.5), 0.0, UNIT2))
    graph.push_back(gtsam.BearingRangeFactor2D(0, L(1), gtsam.Rot2(1.5), 1.0, UNIT2))
    graph.push_back(gtsam.RangeFactor2D(1, L(2), 3.0, gtsam.noiseModel.Unit.Create(1)))
    graph.push_back(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(), gtsam.noiseModel.Constrained.All(3)))
    custom = M.Custom.Create(lambda e: 1.0, lambda e: e * e)
    robust = gtsam.noiseModel.Robust.Create(custom, UNIT3)
    graph.push_back(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(), robust))
    graph.remove(4)
    graph.push_back(gtsam.RangeFactor2D(1, L(2), 3.0, gtsam.noiseModel.Unit.Create(1)))
    written, found = round_trip(graph, values, tmp_path)
    assert found.graph.size() == 2
    wordless = " with a noise model or a measurement that the format has no word for"
    assert written.unwritten == {
        "PriorFactorPose2": 1,
        "RangeFactor2D": 1,
        "BearingRangeFactor2D" + wordless: 1,
        "BetweenFactorPose2" + wordless: 2,
        "variables that are no poses or sighted landmarks": 1,
    }
    assert set(found.values.keys()) == {0, 1, L(1), L(3)}


@pytest.mark.parametrize(
    ("poses", "landmarks", "expected", "comments"),
    [
        ([X(3), X(5)], [L(7)], [3, 5, 7], ["# 3 is x3", "# 5 is x5"]),
        # the format has one set of numbers: no landmark takes that of a pose …
        ([X(3), X(5)], [L(5)], [3, 5, 6], ["# 3 is x3", "# 5 is x5", "# 6 is l5"]),
        ([3, 5], [L(5)], [3, 5, 5], []),  # … but what came from a text file goes back as it was
        ([3, 5], [8], [3, 5, 8], ["# 8 is 8"]),  # will be read as l8
        ([P(1), X(1)], [L(9)], [0, 1, 9], ["# 0 is p1", "# 1 is x1"]),
        ([2**55, 2**55 + 1], [L(0)], [0, 1, 2], [f"# 0 is {2**55}", f"# 1 is {2**55 + 1}", "# 2 is l0"]),
    ],
)
def test_keys_are_numbered_one_to_one_and_the_file_names_them(tmp_path, poses, landmarks, expected, comments):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, key in enumerate(poses):
        values.insert(key, gtsam.Pose2(k, 0, 0))
    graph.push_back(gtsam.BetweenFactorPose2(*poses, gtsam.Pose2(1, 0, 0), UNIT3))
    for key in landmarks:
        values.insert(key, np.array([1.0, 1.0]))
        graph.push_back(gtsam.BearingRangeFactor2D(poses[0], key, gtsam.Rot2(1.5), 1.0, UNIT2))
    written, found = round_trip(graph, values, tmp_path)
    keys = [*poses, *landmarks]
    assert [written.numbers[key] for key in keys] == expected
    lines = (tmp_path / "written.g2o").read_text().splitlines()
    assert [line for line in lines if line.startswith("#")] == comments
    assert len(written.renumbered) == len(comments)
    assert found.graph.size() == graph.size()
    assert found.graph.error(found.values) == pytest.approx(graph.error(values))


def test_what_cannot_be_written_at_all_is_refused(tmp_path):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(), UNIT6))
    values.insert(0, gtsam.Pose3())
    with pytest.raises(MissingValueError, match="for 1;"):
        write_g2o(graph, values, tmp_path / "written.g2o")
    values.insert(1, gtsam.Pose3(gtsam.Rot3(), [np.nan, 0, 0]))
    with pytest.raises(InvalidValueError, match="at 1;"):
        write_g2o(graph, values, tmp_path / "written.g2o")
    assert not (tmp_path / "written.g2o").exists()
