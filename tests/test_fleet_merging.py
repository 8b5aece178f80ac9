"""Maps of several robots, joined by links: true ones fuse, wrong ones and lone ones do not."""

import json

import gtsam
import numpy as np
import pytest
from json_schemas import check
from streets import RADIUS, between, block, driven

from pgti_gtsam import datasets, merge
from pgti_gtsam.errors import FileFormatError, InvalidClosureError, InvalidGraphError
from pgti_gtsam.factor_graphs import keys_of

LAP = 48
FRAMES = {"a": gtsam.Pose2(), "b": gtsam.Pose2(500, 20, 1), "c": gtsam.Pose2(-30, 5, 2.5)}


def key(name):
    return gtsam.symbol(name[0], int(name[1:]))


@pytest.fixture(scope="module")
def robots():
    """Two laps each around the same block, in three frames."""
    return {letter: lapping(seed) for seed, letter in enumerate(FRAMES)}


def lapping(seed):
    world = driven(block(20, times=2), bias=0.001, noise=0.004, seed=seed)
    for i in range(0, LAP - 1, 3):
        world.graph.push_back(world.closure(i, i + LAP))
    return world


def together(robots, frames):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for letter, frame in frames.items():
        for k in range(robots[letter].graph.size()):
            factor = robots[letter].graph.at(k)
            graph.push_back(factor.rekey([key(f"{letter}{own}") for own in factor.keys()]))  # noqa: SIM118
        for k, pose in enumerate(robots[letter].truth):
            values.insert(key(f"{letter}{k}"), frame.compose(pose))
    return graph, values


def link(robots, first, second, wrong=None):
    places = [robots[name[0]].truth[int(name[1:])] for name in (first, second)]
    return between(key(first), key(second), places[0].between(places[1]) if wrong is None else wrong)


def test_variables_that_no_keyframe_is_tied_to_are_named(robots):
    graph, values = together(robots, {letter: FRAMES[letter] for letter in "ab"})
    unit = gtsam.noiseModel.Unit.Create(2)
    graph.push_back(gtsam.PriorFactorPoint2(key("l1"), np.zeros(2), unit))
    values.insert(key("l1"), np.zeros(2))
    values.insert(key("l2"), np.ones(2))
    found = merge(graph, values, [], RADIUS)
    assert found.left_out == (key("l1"), key("l2"))
    assert found.values.size() == values.size() - 2
    assert found.graph.size() == graph.size() - 1


def offered(robots):
    return [
        link(robots, "a3", "b5"),
        link(robots, "a30", "b28"),
        link(robots, "b10", "a12"),
        link(robots, "a20", "b40", gtsam.Pose2()),
        link(robots, "a1", "c2"),
        link(robots, "b25", "c26"),
        link(robots, "c14", "a40", gtsam.Pose2(1, 1, 1)),
        link(robots, "c61", "a60"),
    ]


def test_true_links_join_the_maps_and_wrong_ones_do_not(robots):
    graph, values = together(robots, FRAMES)
    found = merge(graph, values, offered(robots), RADIUS)
    verdicts = [each.verdict for each in found.links]
    assert verdicts == [*["accepted"] * 3, "rejected", "accepted", "accepted", "rejected", "accepted"]
    assert [joining.maps for joining in found.order] == [("a", "b"), ("a + b", "c")]
    assert set(found.order[1].links) == {4, 5, 7}  # to two maps: those to either would not have joined c
    assert min(joining.probability for joining in found.order) > 0.95

    assert found.left_out == ()

    # one frame, and the links of the wrong ones are in no graph
    assert found.graph.size() == graph.size() + 6
    for first, second in (("a40", "b41"), ("b10", "c60"), ("a90", "c5")):
        apart = found.values.atPose2(key(first)).between(found.values.atPose2(key(second)))
        true = [robots[name[0]].truth[int(name[1:])] for name in (first, second)]
        assert np.linalg.norm(apart.between(true[0].between(true[1])).translation()) < 0.5

    # all gain
    assert [gain.map for gain in found.gains] == ["a", "b", "c"]
    assert [gain.n_links for gain in found.gains] == [5, 4, 3]
    assert all(gain.after_m < gain.before_m for gain in found.gains)
    assert values.atPose2(key("b0")).equals(FRAMES["b"], 0.0)


def test_frames_of_maps_mean_nothing(robots):
    links = offered(robots)
    one, other = (
        merge(*together(robots, frames), links, RADIUS)
        for frames in (FRAMES, {"a": gtsam.Pose2(7, 8, 3), "b": gtsam.Pose2(), "c": gtsam.Pose2(0, 0, -1)})
    )
    assert [each.verdict for each in one.links] == [each.verdict for each in other.links]
    np.testing.assert_allclose(
        [each.probability for each in one.links], [each.probability for each in other.links], rtol=1e-3, atol=1e-6
    )


@pytest.mark.parametrize("names", [[("a3", "b5")], [("a3", "b5"), ("a4", "b6")]])
def test_a_lone_revisit_joins_nothing(robots, names):
    frames = {letter: FRAMES[letter] for letter in "ab"}
    graph, values = together(robots, frames)
    found = merge(graph, values, [link(robots, *ends) for ends in names], RADIUS)
    assert not found.order
    assert {each.verdict for each in found.links} == {"undecided"}
    assert found.graph.size() == graph.size()
    x = [[found.values.atPose2(key(f"{letter}{k}")).x() for k in range(2 * LAP)] for letter in "ab"]
    assert min(x[1]) > max(x[0]) + 2 * RADIUS


def test_wrong_links_alone_join_nothing(robots):
    graph, values = together(robots, {letter: FRAMES[letter] for letter in "ab"})
    for seed in range(4):
        random = np.random.default_rng(seed)
        wrong = [
            link(robots, f"a{i}", f"b{j}", gtsam.Pose2(*random.normal(size=2), random.uniform(-3, 3)))
            for i, j in random.integers(LAP, size=(8, 2))
        ]
        assert not merge(graph, values, wrong, RADIUS).order


def test_a_link_is_one_between_factor(robots):
    graph, values = together(robots, {"a": FRAMES["a"]})
    prior = gtsam.PriorFactorPose2(key("a0"), gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3))
    with pytest.raises(InvalidClosureError, match="expected a link of one between factor"):
        merge(graph, values, [prior], RADIUS)


def test_landmarks_move_with_their_map_and_stay_where_no_factor_sees_them(robots):
    """A corner that robot b sees, and a point that nothing ties to any map and that belongs to none."""
    graph, values = together(robots, {letter: FRAMES[letter] for letter in "ab"})
    slots = [slot for slot in range(graph.size()) if np.diff(keys_of(graph.at(slot)))[0] > 1]
    corner, lone, pose = gtsam.symbol("l", 0), gtsam.symbol("l", 1), values.atPose2(key("b7"))
    values.insert(corner, pose.transformFrom(np.array([2.0, 1.0])))
    values.insert(lone, np.array([9.0, 9.0]))
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 0.1)
    graph.push_back(gtsam.BearingRangeFactor2D(key("b7"), corner, gtsam.Rot2.atan2(1, 2), np.hypot(1, 2), noise))
    links = [link(robots, *ends) for ends in (("a3", "b5"), ("a30", "b28"), ("b10", "a12"))]
    found = merge(graph, values, links, RADIUS, closures=slots)
    assert [joining.maps for joining in found.order] == [("a", "b")]
    seen = found.values.atPose2(key("b7")).transformTo(found.values.atPoint2(corner))
    np.testing.assert_allclose(seen, [2.0, 1.0], atol=0.05)
    assert not found.values.exists(lone)
    assert len(found.closures) == len(slots) + len(links)


def test_a_variable_that_is_no_pose_and_no_point_is_refused(robots):
    graph, values = together(robots, {letter: FRAMES[letter] for letter in "ab"})
    scale = gtsam.symbol("s", 0)
    values.insert(scale, np.ones(5))
    graph.push_back(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [key("b3"), scale], lambda *_: np.zeros(1)))
    with pytest.raises(InvalidGraphError, match="expected maps of poses and points to merge, got another variable, s0"):
        merge(graph, values, [link(robots, "a3", "b5")], RADIUS)


@pytest.fixture
def files(robots, tmp_path):
    for letter, frame in FRAMES.items():
        values = gtsam.Values()
        for k, pose in enumerate(robots[letter].truth):
            values.insert(k, frame.compose(pose))
        datasets.write_g2o(robots[letter].graph, values, tmp_path / f"{letter}.g2o")
    lines = []
    for each in offered(robots):
        ends = " ".join(gtsam.DefaultKeyFormatter(own) for own in each.keys())  # noqa: SIM118
        pose = each.measured()
        lines.append(f"EDGE_SE2 {ends} {pose.x()} {pose.y()} {pose.theta()} 400 0 0 400 0 10000")
    (tmp_path / "links.g2o").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_the_command_line_joins_maps(run, files):
    maps, links, out = [files / f"{letter}.g2o" for letter in FRAMES], files / "links.g2o", files / "map.json"
    code, said, _ = run("audit", *maps, "--one-map", "--links", links, "--radius", RADIUS, "--json", out)
    assert code == 0
    check("audit", json.loads(out.read_text()))
    assert "a20 – b40" in said
    assert "a + b + c" in said
    assert "consistent" in said
    code, _, error = run("audit", maps[0], "--links", links, "--radius", RADIUS)
    assert code == 2
    assert "--one-map" in error
    code, _, error = run("audit", *maps, "--one-map", "--links", links, "--radius", "auto")
    assert code == 2
    assert "--radius METRES" in error


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("EDGE_SE2 a3 b999 1 0 0 1 0 0 1 0 1", "line 1: expected a keyframe of the maps, got b999"),
        ("EDGE_SE2 3 4 1 0 0 1 0 0 1 0 1", "a0 is keyframe 0 of the first file"),
        ("VERTEX_SE2 0 0 0 0", "line 1: expected edges between poses of two maps"),
        ("EDGE_SE2 a3 b5 1 0", "line 1: expected"),
        ("# nothing", "expected"),
    ],
)
def test_links_that_cannot_be_meant_are_refused(files, line, why):
    dataset = datasets.read_one_map([files / "a.g2o", files / "b.g2o"])
    (files / "bad.g2o").write_text(line + "\n")
    with pytest.raises(FileFormatError, match=why):
        datasets.read_links(files / "bad.g2o", dataset)
