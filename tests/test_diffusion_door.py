"""Every public function of the heat view refuses what is no input of it, in one line that says what was expected."""

import gtsam
import numpy as np
import pytest
from scipy import sparse
from test_door import MAP, laps

from pgti_gtsam import diffusion
from pgti_gtsam.errors import PgtiError
from pgti_gtsam.factor_graphs import factors_of, graph_of

GRAPH, VALUES = MAP
BODY = diffusion.linearise(GRAPH, VALUES)
EQUATIONS = diffusion.normal_equations(BODY)
N = len(EQUATIONS.gradient)
OPEN = diffusion.linearise(graph_of(factors_of(GRAPH)[1:]), VALUES)
GROUNDS = diffusion.grounds(OPEN)
EDGES = [(0, 1), (1, 2)]

NOTHING = [None, "a", 3, [1], MAP]
NO_GRAPH, NO_VALUES = [*NOTHING, VALUES], [*NOTHING, GRAPH, {0: 1}]
NO_MATRIX = [*NOTHING, np.eye(N), sparse.csr_array((3, 6)), sparse.csr_array((0, 0)), np.nan * EQUATIONS.hessian]
NO_COUNT = [None, "a", 0, -1, 1.5, True, np.nan]
NO_NUMBER = [None, "a", 0, -1.0, np.nan, np.inf, 1j, True]
NO_VECTOR = ["a", 3, [1, 2], np.full(N, np.nan), np.zeros((N, 2)), np.zeros(N, dtype=complex), np.inf * np.ones(N)]
NO_EDGES = [None, "a", 3, [(0, 3)], [(-1, 0)], [(1, 1)], [(0.5, 1)], [(0, 1, 2)], [(np.nan, 1)]]
NO_TIMES = [None, "a", [], -1.0, [-1.0, 1.0], [np.nan], [1j], [[1.0]]]
BROKEN = laps(nan_heading=True)[1]
LANDMARKS = gtsam.Values()
for key in range(16):
    LANDMARKS.insert(key, gtsam.Point2(0, 0))

# by name: arguments that are accepted, and for each place in them what is not
CALLS = {
    "block_edges": ([EQUATIONS.hessian, 3], [NO_MATRIX, [*NO_COUNT, 5]]),
    "compare": ([EQUATIONS, None], [NOTHING, ["a", 3, [1.0], np.full(17, np.nan), -np.ones(17)]]),
    "components": ([EQUATIONS.hessian, 3], [NO_MATRIX, [*NO_COUNT, 5]]),
    "equation_11": ([GRAPH, VALUES], [NO_GRAPH, [*NO_VALUES, gtsam.Values(), BROKEN, LANDMARKS]]),
    "extreme_eigenvalues": ([EQUATIONS], [NOTHING]),
    "gauss_newton_poses": ([GRAPH, VALUES, []], [NO_GRAPH, [*NO_VALUES, gtsam.Values(), LANDMARKS], NOTHING]),
    "gradient_descent": ([GRAPH, VALUES, 1], [NO_GRAPH, [*NO_VALUES, gtsam.Values(), BROKEN], [None, "a", -1, 1.5]]),
    "grounded": ([OPEN, GROUNDS], [NOTHING, [*NOTHING, [diffusion.Ground(key=99, matrix=np.eye(3))]]]),
    "grounded_graph": ([GRAPH, VALUES, GROUNDS], [NO_GRAPH, NO_VALUES, NOTHING]),
    "grounds": ([BODY], [NOTHING]),
    "gtsam_steps": (
        [GRAPH, VALUES, "dogleg", 1],
        [NO_GRAPH, [*NO_VALUES, gtsam.Values(), BROKEN, LANDMARKS], [None, "a", []], [None, "a", -1, 1.5]],
    ),
    "heat_flow": ([EQUATIONS, None, None], [NOTHING, NO_VECTOR, NO_VECTOR]),
    "heat_left": (
        [EQUATIONS.hessian, 3, [0, 1], [1.0]],
        [NO_MATRIX, NO_COUNT, ["a", 3, [16], [-1]], [*NO_TIMES, [0.0]]],
    ),
    "hops_from": ([0, 3, EDGES], [[None, -1, 3, 0.5], NO_COUNT, NO_EDGES]),
    "in_space": ([BODY], [NOTHING]),
    "information_weights": ([EQUATIONS], [NOTHING]),
    "inverse_right_jacobian": ([gtsam.Pose2, np.zeros(3)], [[None, "Pose2", gtsam.Rot2, []], NO_VECTOR]),
    "laplacian_defect": ([EQUATIONS], [NOTHING]),
    "linearise": ([GRAPH, VALUES], [NO_GRAPH, [*NO_VALUES, gtsam.Values(), BROKEN, LANDMARKS]]),
    "matched_time": (
        [[1.0, 2.0], np.ones((2, 4)), np.ones(4)],
        [NO_TIMES, ["a", np.ones((2, 3)), np.ones(2)], ["a", 3, [np.nan]]],
    ),
    "moved": ([BODY, VALUES, np.zeros(N)], [NOTHING, [*NO_VALUES, gtsam.Values(), LANDMARKS], [None, *NO_VECTOR]]),
    "normal_equations": ([BODY], [NOTHING]),
    "relative_consensus": (
        [3, EDGES, np.ones((2, 1)), np.ones(2), 0],
        [
            NO_COUNT,
            NO_EDGES,
            [None, "a", np.ones(2), np.ones((3, 1))],
            ["a", 3, [1.0], [1.0, np.nan]],
            [-1, 3, 0.5, "a"],
        ],
    ),
    "relinearised_flow": (
        [GRAPH, VALUES, [1.0]],
        [NO_GRAPH, [*NO_VALUES, gtsam.Values()], ["a", None, [-1.0], [np.nan], 1.0]],
    ),
    "robust_weights": ([GRAPH, VALUES], [NO_GRAPH, NO_VALUES]),
    "row_defects": ([EQUATIONS], [NOTHING]),
    "scalar_equations": ([3, EDGES], [NO_COUNT, NO_EDGES]),
    "spearman": ([[1.0, 2.0], [2.0, 1.0]], [[None, "a", 3, [np.nan], []], [None, "a", [1.0]]]),
    "spread": ([EQUATIONS, 0, [0.1, 1.0]], [NOTHING, [None, -1, 16, 0.5], NO_TIMES]),
    "steady_state": ([EQUATIONS], [NOTHING]),
    "steady_state_error": (
        [BODY, GRAPH, VALUES, [], np.zeros(N)],
        [NOTHING, NO_GRAPH, [*NO_VALUES, gtsam.Values()], NOTHING, [None, *NO_VECTOR]],
    ),
    "study": ([GRAPH, VALUES], [NO_GRAPH, [*NO_VALUES, gtsam.Values(), BROKEN, LANDMARKS]]),
    "time_grid": ([0.1, 1.0], [[*NO_NUMBER, 2.0], [*NO_NUMBER, 0.05]]),
    "to_body": ([BODY], [NOTHING]),
    "unforced": ([EQUATIONS], [NOTHING]),
    "updates": ([BODY, VALUES, VALUES], [NOTHING, [*NO_VALUES, gtsam.Values()], [*NO_VALUES, LANDMARKS]]),
    "weight_asymmetry": ([EQUATIONS], [NOTHING]),
}


def test_every_public_function_is_tried():
    assert {name for name in diffusion.__all__ if name[0].islower()} == set(CALLS)


@pytest.mark.parametrize("name", CALLS)
def test_misuse(name):
    call, (valid, wrong) = getattr(diffusion, name), CALLS[name]
    call(*valid)
    for place, choices in enumerate(wrong):
        for given in choices:
            with pytest.raises(PgtiError) as error:
                call(*valid[:place], given, *valid[place + 1 :])
            message = str(error.value)
            assert message.startswith("expected ")
            assert ", got " in message
            assert "\n" not in message


def test_options_and_methods():
    for damping in ("a", 0, -1.0, np.nan, np.inf):
        with pytest.raises(PgtiError, match=r"expected .*damping.*, got "):
            diffusion.gtsam_steps(GRAPH, VALUES, "Levenberg-Marquardt", 1, damping=damping)
    for step in ("a", 0, -1.0, np.nan):
        with pytest.raises(PgtiError, match=r"expected .*step.*, got "):
            diffusion.gradient_descent(GRAPH, VALUES, 1, step=step)
    for n_times in (0, 1.5, "a"):
        with pytest.raises(PgtiError, match=r"expected .*times.*, got "):
            diffusion.compare(EQUATIONS, n_times=n_times)
    with pytest.raises(PgtiError, match="expected any × 48 finite numbers as states, got "):
        diffusion.heat_flow(EQUATIONS).energies(np.zeros((2, 3)))


def test_an_empty_graph_says_that_nothing_conducts():
    for name in ("linearise", "study", "gradient_descent"):
        with pytest.raises(PgtiError, match="expected a graph with factors, got none"):
            getattr(diffusion, name)(gtsam.NonlinearFactorGraph(), VALUES, *([1] if name == "gradient_descent" else []))


def test_what_marginalising_leaves_to_rounding_holds_nothing():
    """One pose and landmarks that nothing else sees: the pose is free, and rounding is no heat."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(0, gtsam.Pose2(0.3, -0.7, 0.4))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e-3, 0.1]))
    for key in range(1, 6):
        values.insert(key, gtsam.Point2(np.cos(key) * 7, np.sin(key) * 7))
        graph.add(gtsam.BearingRangeFactor2D(0, key, gtsam.Rot2(key), 7.0, noise))
    equations = diffusion.normal_equations(diffusion.linearise(graph, values))
    assert not equations.hessian.toarray().any()
    assert not equations.gradient.any()
    assert len(diffusion.study(graph, values).grounds) == 1
