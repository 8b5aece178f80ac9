"""The replay of a growing map: every value is what `assess` finds on the graph of the first keyframes."""

import json
import re
import sys
import time

import gtsam
import numpy as np
import pytest
from browser import dom_of_page, needs_chromium
from streets import block, driven, straight
from test_isam2 import started, step

import pgti_gtsam as pgti
from pgti_gtsam import datasets, replaying
from pgti_gtsam.errors import FileFormatError, MissingDependencyError, PgtiError
from pgti_gtsam.pose_graph import EdgeSource
from pgti_gtsam.replaying import METRICS, Measure, lag, moment, replay_graph
from pgti_gtsam.replaying.growth import grown
from pgti_gtsam.report import curves
from pgti_gtsam.support_graph import support_graph

NOISE = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)


def eights(n=90, neighbours=3, drift=0.03, radius=0.5):
    """Two rounds of a figure of eight that drift apart, each keyframe tied to the next few, one closure."""
    s = np.linspace(0, 4 * np.pi, n)
    positions = np.c_[8 * np.sin(s) * (1 - drift * s), 5 * np.sin(2 * s), np.zeros(n)]
    i, j = np.triu_indices(n, 1)
    near = (j - i <= neighbours) | ((i == 4) & (j == n // 2 + 4))
    sources = np.where(j - i == 1, EdgeSource.BETWEEN | EdgeSource.ODOMETRY, EdgeSource.BETWEEN)[near]
    edges = np.c_[i, j][near]
    return pgti.PoseGraph(keys=np.arange(n), positions=positions, edges=edges, radii=radius, edge_sources=sources)


def drawn(seed):
    """A random walk with gaps in its odometry, random ties and radii."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(20, 60))
    i, j = np.triu_indices(n, 1)
    kept = ((j - i == 1) & (rng.random(len(i)) > 0.05)) | (rng.random(len(i)) < 0.02)
    sources = np.where((j - i == 1)[kept], EdgeSource.BETWEEN | EdgeSource.ODOMETRY, EdgeSource.BETWEEN)
    return pgti.PoseGraph(
        keys=np.arange(n),
        positions=np.cumsum(rng.normal(size=(n, 2)), axis=0),
        edges=np.c_[i, j][kept],
        radii=rng.uniform(0.2, 0.9, n),
        edge_sources=sources,
    )


def first(pose_graph, size):
    """The graph of the first keyframes."""
    kept = (pose_graph.edges < size).all(axis=1)
    return pgti.PoseGraph(
        keys=pose_graph.keys[:size],
        positions=pose_graph.positions[:size],
        edges=pose_graph.edges[kept],
        radii=pose_graph.radii[:size],
        edge_sources=pose_graph.edge_sources[kept],
    )


def metrics(integrity):
    """All metrics of a moment, by `assess`."""
    split, change = integrity.split(), integrity.optimality.change
    return {
        "score": integrity.score,
        "local": split.local,
        "global_": split.global_,
        "mean_score": integrity.mean_score,
        "stable_score": integrity.stable_score,
        "d": change.d,
        "t": change.t,
        "e": change.e,
        "e_tilde": change.e_tilde,
    }


def test_every_value_is_that_of_a_fresh_assessment():
    pose_graph = eights()
    replay = replay_graph(pose_graph)
    assert [each.n_keyframes for each in replay.moments] == list(range(1, 91))
    assert replay.curve("n_collisions").max() > 0
    for k in np.random.default_rng(0).choice(len(pose_graph), 20, replace=False):
        found, fresh = replay.moments[k], pgti.assess(first(pose_graph, k + 1))
        assert {name: getattr(found, name) for name in METRICS} == pytest.approx(metrics(fresh), abs=1e-9)
        assert (found.n_inserted, found.n_collisions) == (len(fresh.inserted_edges), len(fresh.collision_edges))
        assert found.keyframe_scores == pytest.approx(fresh.keyframe_scores, rel=1e-6, abs=1e-9)


@pytest.mark.slow
def test_a_thousand_keyframes_with_15_000_edges_take_less_than_three_minutes_of_two_cores():
    pose_graph = eights(1000, neighbours=15, drift=0.004, radius=0.1)
    assert len(pose_graph.edges) == pytest.approx(15_000, rel=0.02)
    started = time.process_time()
    replay = replay_graph(pose_graph)
    assert time.process_time() - started < 2 * 180
    assert (replay.curve("n_collisions") > 0).mean() > 0.3
    for k in np.random.default_rng(0).choice(len(pose_graph), 20, replace=False):
        found, fresh = replay.moments[k], pgti.assess(first(pose_graph, k + 1))
        assert {name: getattr(found, name) for name in METRICS} == pytest.approx(metrics(fresh), abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("every", [1, 7])
def test_what_is_explained_grows_with_the_graph_as_it_is_explained_afresh(seed, every):
    pose_graph = drawn(seed)
    n, seen = len(pose_graph), set()
    for stage in grown(pose_graph, sorted({*range(every, n, every), n})):
        fresh = support_graph(first(pose_graph, stage.n_keyframes))
        assert stage.inserted_edges.tolist() == fresh.inserted_edges.tolist()
        assert stage.n_collisions == len(fresh.collision_edges)
        pairs = set(map(tuple, fresh.inserted_edges.tolist()))
        assert stage.n_new == len(pairs - seen)
        seen = pairs


def test_the_options_are_those_of_assess():
    pose_graph = eights()
    measure = Measure(beta=0.3, n_times=40, norm=1)
    (found,) = replay_graph(pose_graph, every=500, measure=measure).moments
    fresh = pgti.assess(pose_graph, beta=0.3, n_times=40, norm=1)
    assert (found.score, found.local) == pytest.approx((fresh.score, fresh.split().local), abs=1e-9)


def as_gtsam(pose_graph):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, (x, y, _) in zip(pose_graph.keys.tolist(), pose_graph.positions, strict=True):
        values.insert(key, gtsam.Pose2(x, y, 0))
    for i, j in pose_graph.edges.tolist():
        graph.add(gtsam.BetweenFactorPose2(i, j, values.atPose2(i).between(values.atPose2(j)), NOISE))
    return graph, values


def test_a_run_that_was_stopped_goes_on_and_measures_nothing_twice(tmp_path, monkeypatch):
    graph, values = as_gtsam(eights())
    path, told = tmp_path / "replay.jsonl", []
    whole = pgti.replay(graph, values, radii=0.5, every=9, path=path, progress=lambda *done: told.append(done))
    assert told == [(k, 10) for k in range(1, 11)]
    lines = path.read_text().splitlines(keepends=True)
    assert len(lines) == 11

    # the last three are lost, one of them in the middle of its line
    path.write_text("".join(lines[:8]) + lines[8][:50])
    sizes = []

    def counted(stage, how):
        sizes.append(stage.n_keyframes)
        return moment.measured(stage, how)

    monkeypatch.setattr(replaying, "measured", counted)
    again = pgti.replay(graph, values, radii=0.5, every=9, path=path)
    assert sizes == [72, 81, 90]
    assert path.read_text() == "".join(lines)
    for name in METRICS:
        assert again.curve(name).tolist() == whole.curve(name).tolist()
    assert all(
        (a.keyframe_scores == b.keyframe_scores).all() for a, b in zip(again.moments, whole.moments, strict=True)
    )


def test_the_file_of_another_map_is_refused(tmp_path):
    graph, values = as_gtsam(eights())
    path = tmp_path / "replay.jsonl"
    pgti.replay(graph, values, radii=0.5, every=30, path=path)
    for options in ({"radii": 0.4, "every": 30}, {"radii": 0.5, "every": 45}):
        with pytest.raises(FileFormatError, match="another file"):
            pgti.replay(graph, values, **options, path=path)
    path.write_text("no JSON\n")
    with pytest.raises(FileFormatError, match="another file"):
        pgti.replay(graph, values, radii=0.5, every=30, path=path)


def test_a_record_is_replayed_with_the_estimate_of_each_moment():
    """A hairpin whose way back lay apart at first, then in contact, then, once tied, apart again."""
    out, record = [(x, 0.0) for x in range(8)], []
    for offset, keyframes, tie in ((3.0, 12, False), (0.5, 14, False), (3.0, 16, True)):
        back = [(7.0 - k, offset) for k in range(keyframes - 8)]
        values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
        for key, (x, y) in enumerate(out + back):
            values.insert(key, gtsam.Pose2(x, y, 0))
        for i, j in [*((k, k + 1) for k in range(keyframes - 1)), *([(0, 15)] if tie else [])]:
            graph.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(1, 0, 0), NOISE))
        record.append((graph, values))
    replay = pgti.replay(record, radii=0.5)
    assert replay.insertion_signal.tolist() == [False, True, False]
    for found, (graph, values) in zip(replay.moments, record, strict=True):
        fresh = pgti.assess(pgti.from_gtsam(graph, values, radii=0.5))
        assert found.score == pytest.approx(fresh.score, abs=1e-9)
        assert found.n_collisions == len(fresh.collision_edges)


def test_what_is_no_record_is_refused():
    graph, values = as_gtsam(eights(20))
    for wrong in ([], [graph], [values], [(graph, values), (values, graph)], ["ab"]):
        with pytest.raises(PgtiError, match="expected "):
            pgti.replay(wrong, radii=0.5)
    with pytest.raises(PgtiError, match="beside a record"):
        pgti.replay([(graph, values)], values, radii=0.5)
    with pytest.raises(PgtiError, match="moment 1 of the record"):
        pgti.replay([(graph, values), (graph, gtsam.Values())], radii=0.5)
    with pytest.raises(PgtiError, match="a gated smoother"):
        pgti.Record().note(graph)


def test_a_fixed_lag_smoother_is_replayed_with_all_its_track():
    """Of the moments of a short window, and of plain iSAM2, the graphs are of all keyframes so far."""
    world, record, plain = driven(straight(60), noise=0.005), pgti.Record(), pgti.Record()
    gated, isam = pgti.GatedFixedLagSmoother(gtsam.IncrementalFixedLagSmoother(5.0), radii=0.5), gtsam.ISAM2()
    for k in range(20):
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factors.push_back(world.graph.at(k - 1) if k else gtsam.PriorFactorPose2(0, world.truth[0], NOISE))
        values.insert(k, world.values.atPose2(k))
        gated.update(factors, values, {k: float(k)})
        isam.update(factors, values)
        record.note(gated)
        plain.note(isam)
    assert gated.calculateEstimate().size() < 10
    for replay in (pgti.replay(record), pgti.replay(plain, radii=0.5)):
        assert replay.curve("n_keyframes").tolist() == list(range(1, 21))


def test_a_gated_smoother_is_replayed_as_it_was(tmp_path):
    """A lap and a bit: a false closure is kept out, a true one moves the map, and leaves again."""
    world = driven(block(20, times=2) + straight(10), bias=0.002, noise=0.005)
    lap, closures = 4 * 12, {53: (4, 30, gtsam.Pose2()), 55: (7, 55)}
    isam, record, fresh = started(world, radii={0: 1.0}), pgti.Record(), []

    def note():
        record.note(isam)
        fresh.append(pgti.assess(pgti.from_gtsam(isam.getFactorsUnsafe(), isam.estimate(), radii=isam.radii)))

    for k in range(1, lap + 10):
        offered = [world.closure(*closures[k])] if k in closures else []
        update = isam.update(*step(world, k), offered, radii={k: 1.0})
        assert [decision.accepted for decision in update.decisions] == [k == 55] * len(offered)
        if k >= lap:
            note()
    isam.retract(1)
    note()

    replay = pgti.replay(record, path=tmp_path / "record.jsonl")
    assert replay.curve("score") == pytest.approx([each.score for each in fresh], abs=1e-9)
    collisions = replay.curve("n_collisions").tolist()
    assert collisions == [len(each.collision_edges) for each in fresh]
    assert collisions[54 - lap] > 0  # nothing tied, the false closure kept out
    assert collisions[55 - lap] == 0
    assert collisions[-1] > 0  # taken out again
    moved = replay.moments[55 - lap].positions[:54] - replay.moments[54 - lap].positions[:54]
    assert np.abs(moved).max() > 1e-3
    again = pgti.replay(record, path=tmp_path / "record.jsonl")
    assert again.curve("score").tolist() == replay.curve("score").tolist()


@pytest.mark.parametrize("late", [-4, 0, 3])
def test_a_metric_that_steps_after_the_signal_has_that_lag(late):
    signal = np.zeros(60, dtype=bool)
    signal[[15, 22, 41]] = True
    found = lag(np.cumsum(np.roll(signal, late)).astype(float), signal)
    assert found.lag == late
    assert found.correlation == pytest.approx(1, abs=0.02)
    assert (found.at_zero == found.correlation) == (late == 0)


def test_a_metric_that_never_changes_answers_to_nothing():
    assert np.isnan(lag(np.ones(9), np.arange(9) == 3).correlation)


@pytest.fixture
def map_file(tmp_path):
    graph, values = as_gtsam(eights())
    datasets.write_g2o(graph, values, tmp_path / "eights.g2o")
    return tmp_path / "eights.g2o"


def test_the_command_shows_the_curves_and_writes_them(run, map_file, tmp_path):
    lines, picture = tmp_path / "r.jsonl", tmp_path / "r.png"
    code, out, err = run("replay", map_file, "--radius", 0.5, "--every", 30, "--json", lines, "--png", picture)
    assert (code, err) == (0, "")
    assert "90 keyframes" in out
    assert [json.loads(line).get("n_keyframes") for line in lines.read_text().splitlines()] == [None, 30, 60, 90]
    assert picture.read_bytes().startswith(b"\x89PNG")
    code, _, err = run("replay", map_file, "--radius", 0.5, "--every", 0)
    assert (code, err.splitlines()[0]) == (2, "pgti-gtsam: expected every of at least 1, got 0")


def test_a_picture_that_cannot_be_drawn_is_refused_first(run, tmp_path, monkeypatch):
    assert run("replay", "--png", tmp_path / "map.pdf")[0] == 2
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependencyError, match="figures"):
        curves.require_png(tmp_path / "map.png")


@needs_chromium
def test_the_page_shows_the_map_as_it_was(run, map_file, tmp_path):
    page = tmp_path / "r.html"
    assert run("replay", map_file, "--radius", 0.5, "--every", 30, "--html", page)[0] == 0
    dom = dom_of_page(page, "#keyframes=60")
    body = re.search(r"<body[^>]*>", dom).group()
    assert 'data-ready="true"' in body
    assert "data-errors" not in body
    assert re.search(r'id="plan"[^>]*aria-label="Map of 60 keyframes', dom)
