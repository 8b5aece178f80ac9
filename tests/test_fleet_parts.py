"""A map in parts: the overlaps, places and verdict of the whole, and scores within their bounds."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from json_schemas import check
from scipy.linalg import expm

from pgti_gtsam import datasets, parts
from pgti_gtsam.diagnosis import diagnose
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.integrity import stable_scores
from pgti_gtsam.parts.cut import EdgeList, Neighbours, cores, part_of
from pgti_gtsam.parts.overlaps import overlaps_of
from pgti_gtsam.parts.scores import TIMES
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from pgti_gtsam.spectral.laplacian import laplacian
from pgti_gtsam.spectral.locality import kernel_within
from pgti_gtsam.support_graph import support_graph
from scenarios.fleet.streets import RADIUS, city


def cut(pose_graph, n_parts):
    core_of = cores(pose_graph.positions, n_parts)
    edges, neighbours = EdgeList.of(len(pose_graph), pose_graph.edges), Neighbours.of(pose_graph)
    return [part_of(pose_graph, edges, neighbours, np.flatnonzero(core_of == k)) for k in range(n_parts)]


def wandering(seed, n, spread):
    """A track that crosses itself, with spheres of many sizes and some ties across the map."""
    random = np.random.default_rng(seed)
    ties = random.integers(n, size=(n // 12, 2))
    ties = ties[ties[:, 0] != ties[:, 1]]
    steps = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    odometry = np.full(len(steps), EdgeSource.BETWEEN | EdgeSource.ODOMETRY, np.uint8)
    return PoseGraph(
        keys=np.arange(n, dtype=np.uint64),
        positions=np.cumsum(random.normal(size=(n, 3)) * [1, 1, 0.1], axis=0),
        radii=np.exp(spread * random.normal(size=n)),
        edges=np.concatenate([steps, ties]),
        edge_sources=np.concatenate([odometry, np.full(len(ties), EdgeSource.BETWEEN, np.uint8)]),
    )


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6), n=st.integers(20, 150), n_parts=st.integers(1, 9), spread=st.sampled_from([0.0, 0.3, 1])
)
def test_parts_explain_the_overlaps_that_the_whole_explains(seed, n, n_parts, spread):
    pose_graph = wandering(seed, n, spread)
    whole, found = support_graph(pose_graph), overlaps_of(n, cut(pose_graph, n_parts), map)
    np.testing.assert_array_equal(found.fusion_edges, whole.fusion_edges)
    np.testing.assert_array_equal(found.collision_edges, whole.collision_edges)


def test_an_explanation_travels_through_many_parts():
    """Two lanes beside each other, tied at one end: each overlap explains the next, from part to part."""
    n = 40
    lanes = np.array([[2.0 * (k % n), 0.5 * (k // n), 0.0] for k in range(2 * n)])
    steps = np.array([[k, k + 1] for k in range(2 * n - 1) if k != n - 1])
    pose_graph = PoseGraph(
        keys=np.arange(2 * n, dtype=np.uint64),
        positions=lanes,
        radii=np.full(2 * n, 0.9),
        edges=np.concatenate([steps, [[0, n]]]),
        edge_sources=np.concatenate([np.full(len(steps), 9, np.uint8), [1]]),
    )
    found = overlaps_of(2 * n, cut(pose_graph, 8), map)
    assert len(found.collision_edges) == 0
    assert len(found.fusion_edges) == n - 1
    assert found.n_rounds > 5


@pytest.mark.parametrize("n_parts", [0, 41])
def test_parts_are_as_many_as_can_be(n_parts):
    with pytest.raises(InvalidOptionError):
        cores(np.zeros((40, 3)), n_parts)


def told(found):
    """Of two diagnoses of a map the same; without incomplete fusion, which ζ decides."""
    places = [
        (each.kind, each.keyframes, each.edges.tolist(), each.revisit.closest, each.probability, round(each.gain, 9))
        for each in found.places
        if each.kind != "incomplete fusion"
    ]
    return found.verdict, found.reason, places, [(each.slot, each.log_odds) for each in found.closures]


@pytest.mark.parametrize(("seed", "false"), [(0, 0), (1, 2)])
def test_the_verdict_in_parts_is_that_of_the_whole(seed, false):
    built, n_parts = city(2000, false=false, seed=seed), 6
    whole = diagnose(built.graph, built.values, radii=RADIUS)
    found = parts.diagnose_parts(built.graph, built.values, parts=n_parts, radii=RADIUS)
    assert told(found) == told(whole)
    np.testing.assert_array_equal(found.compared.fusion_edges, whole.integrity.fusion_edges)
    np.testing.assert_array_equal(found.compared.collision_edges, whole.integrity.collision_edges)

    # scores on the same times, and their bounds
    n, explained = len(whole.pose_graph), np.concatenate([whole.pose_graph.edges, whole.integrity.fusion_edges])
    kernels = heat_kernels(n, whole.pose_graph.edges, explained, whole.integrity.merged_edges)
    compared = found.compared
    for own, (a, b) in ((compared.scores, (0, 2)), (compared.fusion, (0, 1)), (compared.collisions, (1, 2))):
        missed = np.abs(stable_scores(kernels[a], kernels[b], TIMES) - own.stable_scores)
        assert (missed <= own.bounds + 1e-6).all()
    assert np.median(compared.scores.bounds) < 0.1
    assert sum(part.n_core for part in found.parts) == n


def test_damage_at_the_borders_of_parts_is_found():
    built = city(2000, seed=3)
    found = parts.diagnose_parts(built.graph, built.values, parts=16, radii=RADIUS)
    collisions, core_of = found.compared.collision_edges, cores(found.pose_graph.positions, 16)
    assert (core_of[collisions[:, 0]] != core_of[collisions[:, 1]]).any()
    assert told(found) == told(diagnose(built.graph, built.values, radii=RADIUS))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(5, 40))
def test_heat_that_leaves_bounds_what_comes_back(seed, n):
    random = np.random.default_rng(seed)
    edges = np.unique(np.sort(random.integers(n, size=(3 * n, 2)), axis=1), axis=0)
    matrix = laplacian(n, edges[edges[:, 0] != edges[:, 1]])
    own = np.flatnonzero(random.random(n) < 0.6)
    if not len(own):
        own = np.array([0])
    found, times = kernel_within(matrix[own][:, own].tocsc(), TIMES), TIMES
    whole = np.array([np.diag(expm(-t * matrix.toarray()))[own] for t in times]).T
    assert (found.diagonal <= whole + 1e-7).all()
    assert (whole <= found.most + 1e-7).all()


def test_the_command_line_audits_in_parts(run, tmp_path):
    pytest.importorskip("dask.distributed", reason="dask.distributed is missing")
    built = city(1200, seed=1, false=1)
    path, out = tmp_path / "city.g2o", tmp_path / "city.json"
    datasets.write_g2o(built.graph, built.values, path)
    words = ["audit", path, "--radius", RADIUS, "--parts", 3]
    code, said, _ = run(*words, "--workers", 1, "--json", out, "--fail-on", "inconsistent")
    document = json.loads(out.read_text())
    assert code == 1
    assert "1200 in 3 parts" in said
    check("parts", document)
    assert document["verdict"]["level"] == "inconsistent"
    assert sum(part["n_core"] for part in document["parts"]) == 1200
    code, _, error = run(*words, "--html", tmp_path / "city.html")
    assert code == 2
    assert "--parts without --html" in error
