"""The heat view's laws: where H is a block Laplacian, what the flow ends in, and what it does on the way."""

import json
import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest
from browser import dom_of_page, needs_chromium, rows_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from pgti_gtsam import cli, datasets, diffusion
from pgti_gtsam.errors import (
    InvalidOptionError,
    InvalidValueError,
    MissingValueError,
    NoPoseError,
    UnsolvableGraphError,
)
from pgti_gtsam.report.heat import heat_document, write_heat_page

DATA = Path(__file__).parents[2] / "shared" / "data" / "pose_graphs"
SETTINGS = settings(max_examples=30, deadline=None)
RNG = np.random.default_rng


@st.composite
def factor_graphs(draw):
    """Random pose graphs of both dimensions, any information; turns near π occur, a prior may be missing."""
    rng = RNG(draw(st.integers(0, 2**32 - 1)))
    n, planar = draw(st.integers(2, 8)), draw(st.booleans())
    pose, factor, prior = (
        (gtsam.Pose2, gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2)
        if planar
        else (gtsam.Pose3, gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3)
    )
    d = 3 if planar else 6
    turns = draw(st.sampled_from([0.3, 2.0]))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    scale = np.where(np.isin(np.arange(d), [2] if planar else [0, 1, 2]), turns, 3.0)
    poses = [pose.Expmap(rng.normal(size=d) * scale) for _ in range(n)]
    for key, at in enumerate(poses):
        values.insert(key, at)
    pairs = [(i, i + 1) for i in range(n - 1)] + [tuple(rng.choice(n, 2, replace=False)) for _ in range(n // 2)]
    size = draw(st.sampled_from([0.01, 0.3]))
    for i, j in pairs:
        root = rng.normal(size=(d, d)) + 2 * np.eye(d)
        measured = poses[i].between(poses[j]).compose(pose.Expmap(rng.normal(size=d) * size))
        graph.add(factor(int(i), int(j), measured, gtsam.noiseModel.Gaussian.Information(root @ root.T)))
    if draw(st.booleans()):
        graph.add(prior(0, poses[0], gtsam.noiseModel.Isotropic.Sigma(d, 0.1)))
    return graph, values


def between_only(graph):
    kept = gtsam.NonlinearFactorGraph()
    for slot in range(graph.size()):
        if "Between" in type(graph.at(slot)).__name__:
            kept.push_back(graph.at(slot))
    return kept


def equations(graph, values):
    body = diffusion.linearise(graph, values)
    return body, diffusion.normal_equations(diffusion.grounded(body, diffusion.grounds(body)))


def square(*, prior=False, robust=False):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.2, 0.05]))
    loss = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.0), noise)
    for i in range(4):
        values.insert(i, gtsam.Pose2([0, 5, 5, 0][i], [0, 0, 5, 5][i], i * np.pi / 2))
        step = gtsam.Pose2(5.0, 0.3, np.pi / 2 + 0.1)
        graph.add(gtsam.BetweenFactorPose2(i, (i + 1) % 4, step, loss if robust and i == 3 else noise))
    if prior:
        graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), noise))
    return graph, values


@SETTINGS
@given(factor_graphs())
def test_in_space_the_normal_matrix_is_a_block_laplacian(drawn):
    graph, values = drawn
    spatial = diffusion.normal_equations(diffusion.in_space(diffusion.linearise(between_only(graph), values)))
    assert diffusion.laplacian_defect(spatial) < 1e-10
    assert diffusion.weight_asymmetry(spatial) < 1e-10


@SETTINGS
@given(factor_graphs())
def test_equation_11_holds_factor_by_factor(drawn):
    graph, values = drawn
    found = diffusion.equation_11(graph, values)
    assert len(found.slots) == between_only(graph).size()
    assert (found.antisymmetry < 1e-10).all()
    assert (found.gtsam_jacobian < 1e-10).all()


@SETTINGS
@given(factor_graphs())
def test_the_steady_state_is_the_gauss_newton_step_of_gtsam(drawn):
    graph, values = drawn
    body, normal = equations(graph, values)
    steady = diffusion.steady_state(normal)
    error = diffusion.steady_state_error(body, graph, values, diffusion.grounds(body), steady)
    assert error < 1e-8


@SETTINGS
@given(factor_graphs())
def test_energy_falls_along_the_flow_and_the_flow_solves_its_equation(drawn):
    graph, values = drawn
    _, normal = equations(graph, values)
    flow = diffusion.heat_flow(normal)
    slowest, fastest = diffusion.extreme_eigenvalues(normal)
    times = np.concatenate([[0.0], np.geomspace(0.01 / fastest, 30 / slowest, 20)])
    states = flow.at(times)
    energies = flow.energies(states)
    assert (np.diff(energies) <= 1e-9 * energies[0]).all()
    dense = normal.hessian.toarray()
    n = len(dense)
    time = times[5]
    generator = np.zeros((n + 1, n + 1))
    generator[:n, :n], generator[:n, n] = -dense, -normal.gradient
    expected = linalg.expm(time * generator)[:n, n]
    np.testing.assert_allclose(states[5], expected, atol=1e-7 * np.abs(expected).max())


def test_the_body_frame_has_no_laplacian():
    body = diffusion.linearise(*square())
    assert diffusion.laplacian_defect(diffusion.normal_equations(body)) > 0.1


def test_a_prior_breaks_its_own_row_only():
    spatial = diffusion.normal_equations(diffusion.in_space(diffusion.linearise(*square(prior=True))))
    defects = diffusion.row_defects(spatial)
    assert defects[0] > 0.1
    assert (defects[1:] < 1e-10).all()


def test_a_graph_without_a_prior_is_grounded_part_by_part():
    graph, values = square()
    for i in range(4):
        values.insert(10 + i, values.atPose2(i))
        graph.add(
            gtsam.BetweenFactorPose2(10 + i, 10 + (i + 1) % 4, gtsam.Pose2(5, 0, 1.5), gtsam.noiseModel.Unit.Create(3))
        )
    body = diffusion.linearise(graph, values)
    assert [ground.key for ground in diffusion.grounds(body)] == [0, 10]
    assert not diffusion.grounds(diffusion.linearise(*square(prior=True)))
    with pytest.raises(UnsolvableGraphError, match="prior"):
        diffusion.heat_flow(diffusion.normal_equations(body)).steady.sum()


def test_marginalised_landmarks_keep_the_row_sums_and_lose_the_conductances():
    graph, values = square()
    values.insert(100, np.array([2.0, 3.0]))
    for i in range(4):
        bearing, reach = values.atPose2(i).bearing(np.array([2.0, 3.0])), values.atPose2(i).range(np.array([2.0, 3.0]))
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.02, 0.3]))
        graph.add(gtsam.BearingRangeFactor2D(i, 100, bearing, reach, noise))
    spatial = diffusion.normal_equations(diffusion.in_space(diffusion.linearise(graph, values)))
    assert spatial.n_vertices == 4
    assert diffusion.laplacian_defect(spatial) < 1e-10
    assert diffusion.weight_asymmetry(spatial) > 1e-3
    assert len(diffusion.block_edges(spatial.hessian, 3)) == 6


def test_a_robust_loss_scales_its_own_factor():
    graph, values = square(robust=True)
    weights = diffusion.robust_weights(graph, values)
    plain, robust = diffusion.linearise(*square()), diffusion.linearise(graph, values)
    assert list(weights) == [3]
    assert weights[3] < 1
    rows = robust.row_slots == 3
    root = np.sqrt(weights[3])
    np.testing.assert_allclose(robust.jacobian[rows].toarray(), root * plain.jacobian[rows].toarray(), atol=1e-12)


def test_similarities_are_a_block_laplacian_too():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i in range(4):
        values.insert(i, gtsam.Similarity3(gtsam.Rot3.Rz(i), np.array([i, i % 2, 0.5 * i]), 1 + 0.1 * i))
        measured = gtsam.Similarity3(gtsam.Rot3.Rz(1.1), np.array([1.0, 0.2, 0.1]), 1.05)
        graph.add(
            gtsam.BetweenFactorSimilarity3(i, (i + 1) % 4, measured, gtsam.noiseModel.Unit.Create(7))
        ) if i < 3 else None
    spatial = diffusion.normal_equations(diffusion.in_space(diffusion.linearise(graph, values)))
    assert spatial.dimension == 7
    assert diffusion.laplacian_defect(spatial) < 1e-10


def test_relative_consensus_ends_where_the_measurements_agree():
    places = np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 1.0], [2.0, -1.0]])
    edges = np.array([[0, 1], [1, 2], [2, 3], [0, 3]])
    normal = diffusion.relative_consensus(4, edges, places[edges[:, 0]] - places[edges[:, 1]], held=0)
    steady = diffusion.steady_state(normal).reshape(4, 2)
    np.testing.assert_allclose(steady, places, atol=1e-12)


def test_heat_spreads_as_the_square_of_the_distance_on_a_chain():
    edges = np.array([(i, i + 1) for i in range(200)])
    normal = diffusion.scalar_equations(201, edges)
    found = diffusion.spread(normal, 100, np.geomspace(1e-2, 1e5, 400))
    assert 1.7 < found.exponent() < 2.3
    assert found.hops.max() == 100


def test_isotropic_information_at_one_place_is_ordered_as_the_scalar_laplacian_says():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i in range(12):
        values.insert(i, gtsam.Pose2())
    for i, j in [(i, i + 1) for i in range(11)] + [(0, 5), (3, 9)]:
        graph.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 0.1)))
    proxy = diffusion.compare(diffusion.normal_equations(diffusion.linearise(graph, values)))
    assert proxy.rank_correlation > 0.999
    assert proxy.differences.max() < 0.01


def test_gradient_descent_is_the_flow_by_small_steps():
    graph, values = square(prior=True)
    body, normal = equations(graph, values)
    fastest = diffusion.extreme_eigenvalues(normal)[1]
    *_, last = diffusion.gradient_descent(graph, values, 40, step=0.01 / fastest)
    flow = diffusion.heat_flow(normal).at(np.array([0.4 / fastest]))[0]
    moved = diffusion.updates(body, values, last.values).ravel()
    assert np.linalg.norm(moved - flow) < 0.05 * np.linalg.norm(flow)


def test_the_flow_linearised_again_ends_in_the_nonlinear_optimum():
    graph, values = square(prior=True)
    *_, last = diffusion.relinearised_flow(graph, values, np.full(8, np.inf))
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    np.testing.assert_allclose(last.energy, graph.error(optimum), rtol=1e-6)


def test_bad_graphs_are_refused_with_a_reason():
    graph, values = square()
    with pytest.raises(NoPoseError, match="expected poses"):
        diffusion.linearise(graph, gtsam.Values())
    mixed = gtsam.Values(values)
    mixed.insert(50, gtsam.Pose3())
    with pytest.raises(InvalidValueError, match="one group"):
        diffusion.linearise(graph, mixed)
    missing = gtsam.NonlinearFactorGraph(graph)
    missing.add(gtsam.BetweenFactorPose2(0, 77, gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3)))
    with pytest.raises(MissingValueError, match="77"):
        diffusion.linearise(missing, values)
    hard = gtsam.NonlinearFactorGraph(graph)
    hard.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Constrained.All(3)))
    with pytest.raises(UnsolvableGraphError, match="hard constraint"):
        diffusion.linearise(hard, values)
    with pytest.raises(InvalidOptionError, match="zero or more"):
        diffusion.heat_flow(equations(graph, values)[1]).at(np.array([-1.0]))


def test_the_command_writes_json_and_a_page(tmp_path, monkeypatch, capsys):
    path = gtsam.findExampleDataFile("pose3example.txt")
    words = ["diffusion", path, "--json", str(tmp_path / "heat.json"), "--html", str(tmp_path / "heat.html")]
    monkeypatch.setattr(sys, "argv", ["pgti-gtsam", *words])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code
    found = json.loads((tmp_path / "heat.json").read_text())
    assert found["laplacian_defect_spatial"] < 1e-10
    assert found["laplacian_defect_body"] > 0.1
    assert found["equation_11_antisymmetry"] < 1e-10
    assert found["steady_state_error"] < 1e-8
    assert -1 <= found["proxy_rank_correlation"] <= 1
    page = (tmp_path / "heat.html").read_text()
    assert "Heat left at keyframes" in page
    assert 'src="http' not in page
    assert "Gauss-Newton" in capsys.readouterr().out
    assert not any("e-1" in text for row in found["findings"] for text in row)  # rounding is no finding


@needs_chromium
def test_the_page_draws_three_plots_and_the_findings(tmp_path):
    dataset = datasets.read(gtsam.findExampleDataFile("pose3example.txt"))
    found = diffusion.study(dataset.graph, dataset.values)
    write_heat_page(heat_document(found, name="<i>five</i>", file_format=dataset.format), tmp_path / "heat.html")
    dom = dom_of_page(tmp_path / "heat.html")
    assert 'data-ready="true"' in dom
    assert "data-errors" not in dom
    assert dom.count('class="main-svg"') >= 3
    assert "<i>five</i>" not in dom
    assert any("Eq. 11" in text for _, text in rows_of(dom, "findings"))


@pytest.mark.parametrize("name", ["MIT", "intel", "parking-garage", "sphere2500"])
def test_real_graphs_hold_the_laws(name):
    path = DATA / f"{name}.g2o"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    dataset = datasets.read(path)
    body, normal = equations(dataset.graph, dataset.values)
    free = diffusion.linearise(between_only(dataset.graph), dataset.values)
    assert diffusion.laplacian_defect(diffusion.normal_equations(diffusion.in_space(free))) < 1e-10
    assert diffusion.laplacian_defect(diffusion.normal_equations(free)) > 0.1
    assert diffusion.equation_11(dataset.graph, dataset.values).antisymmetry.max() < 1e-10
    steady = diffusion.steady_state(normal)
    grounds = diffusion.grounds(body)
    assert diffusion.steady_state_error(body, dataset.graph, dataset.values, grounds, steady) < 1e-8
