"""GTSAM's optimisers step by step, and the heat flow that is linearised again, from the same start.

Steps and times correspond. Gradient descent with step h is the flow by Euler's explicit rule, k steps being
the time k h. Levenberg and Marquardt's step with damping λ, −(H + λ)⁻¹ g, is a step of Euler's implicit
rule over the time 1/λ. Gauss-Newton's is the whole flow, t = ∞. Dogleg's lies between the first and the last.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.checks import finite_array, in_a_line, instance, real, real_array, shown, whole
from pgti_gtsam.diffusion.block_laplacian import normal_equations
from pgti_gtsam.diffusion.flow import extreme_eigenvalues, heat_flow
from pgti_gtsam.diffusion.grounding import Ground, grounded, grounded_graph, grounds
from pgti_gtsam.diffusion.linearisation import Linearisation, linearise
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError, MissingValueError, UnsolvableGraphError
from pgti_gtsam.factor_graphs import check_map

OPTIMISERS: dict[str, tuple[Any, Any]] = {
    "Gauss-Newton": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
    "Levenberg-Marquardt": (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams),
    "dogleg": (gtsam.DoglegOptimizer, gtsam.DoglegParams),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """An accepted state of an optimiser.

    Attributes
    ----------
    method : str
    iteration : int
        Zero is the start.
    energy : float
        The graph's error; ½‖e‖² without robust losses.
    values : gtsam.Values
    """

    method: str
    iteration: int
    energy: float
    values: gtsam.Values


def gtsam_steps(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, method: str, n_steps: int, *, damping: float | None = None
) -> list[Step]:
    """Run an optimiser of GTSAM iteration by iteration.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Held in place: see `grounding.grounded_graph`.
    values : gtsam.Values
        The start; the caller's values do not change.
    method : str
        A key of `OPTIMISERS`.
    n_steps : int
    damping : float, optional
        First λ of Levenberg-Marquardt, divided by ten at every success; GTSAM's own 1e-5 when left out.

    Raises
    ------
    InvalidOptionError
        Another method, number of steps or damping.
    UnsolvableGraphError
        GTSAM finds the graph singular.
    InvalidGraphError
        No graph, no values, or values that are not those of its factors or not finite.
    """
    if not isinstance(method, str) or method not in OPTIMISERS:
        raise InvalidOptionError(f"expected a method among {', '.join(OPTIMISERS)}, got {shown(method)}")
    whole(n_steps, "the number of steps", least=0)
    check_map(graph, values)

    # set up
    optimiser_class, parameter_class = OPTIMISERS[method]
    parameters = parameter_class()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    if damping is not None and method == "Levenberg-Marquardt":
        parameters.setlambdaInitial(_positive(damping, "damping"))
    try:
        optimiser = optimiser_class(graph, values, parameters)
        start = optimiser.error()
    except (RuntimeError, ValueError) as error:
        raise InvalidGraphError(
            f"expected values that the graph's factors take, got others: {in_a_line(error)}"
        ) from error
    if not np.isfinite(start):
        raise InvalidGraphError(f"expected values at which the graph's error is finite, got {start}")

    # from the start on
    steps = [Step(method=method, iteration=0, energy=start, values=values)]
    for k in range(1, n_steps + 1):
        try:
            optimiser.iterate()
        except RuntimeError as error:
            raise UnsolvableGraphError(
                f"expected a graph that {method} can solve, got a singular one at step {k}; has every part a prior?"
            ) from error
        steps.append(
            Step(method=method, iteration=k, energy=optimiser.error(), values=gtsam.Values(optimiser.values()))
        )
    return steps


def gradient_descent(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, n_steps: int, *, step: float | None = None
) -> Iterator[Step]:
    """Steepest descent in GTSAM's coordinates, linearised again at every step.

    Parameters
    ----------
    graph, values
        Poses only; no prior is needed, as descent moves nothing that the graph leaves open.
    n_steps : int
    step : float, optional
        h in units of 1/H; 1/λ_max of the start when left out, half the length at which a step overshoots.

    Raises
    ------
    PgtiError
        Those of `linearise`, and where number or length of steps are none.
    """
    whole(n_steps, "the number of steps", least=0)
    length = None if step is None else _positive(step, "the step")
    return _descent(linearise(graph, values), graph, values, n_steps, length)


def _descent(
    body: Linearisation, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, n_steps: int, step: float | None
) -> Iterator[Step]:
    yield Step(method="gradient descent", iteration=0, energy=graph.error(values), values=values)
    for k in range(1, n_steps + 1):
        equations = normal_equations(body)
        step = 1 / extreme_eigenvalues(equations)[1] if step is None else step
        values = moved(body, values, -step * equations.gradient)
        yield Step(method="gradient descent", iteration=k, energy=graph.error(values), values=values)
        body = linearise(graph, values)


def relinearised_flow(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, durations: NDArray[np.float64]
) -> Iterator[Step]:
    """Flow for a while, retract, linearise again, repeat: the nonlinear heat flow, at the sums of the durations.

    An infinite duration is a Gauss-Newton step.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Poses only.
    values : gtsam.Values
        The start.
    durations : (k,) float
        Length of each linear flow.

    Raises
    ------
    InvalidOptionError
        Durations that are no list of numbers of zero or more.
    PgtiError
        Those of `linearise`.
    """
    times = real_array(durations, "durations")
    if times.ndim != 1 or not (times >= 0).all():
        raise InvalidOptionError(f"expected a list of durations of zero or more, got {shown(durations)}")
    return _flow(linearise(graph, values), graph, values, times)


def _flow(
    body: Linearisation, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, durations: NDArray[np.float64]
) -> Iterator[Step]:
    yield Step(method="flow", iteration=0, energy=graph.error(values), values=values)
    for k, duration in enumerate(durations, start=1):
        held = grounded(body, grounds(body))
        flow = heat_flow(normal_equations(held))
        delta = flow.steady if np.isinf(duration) else flow.at(np.array([duration]))[0]
        values = moved(body, values, delta)
        yield Step(method="flow", iteration=k, energy=graph.error(values), values=values)
        body = linearise(graph, values)


def gauss_newton_poses(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, added: list[Ground]) -> gtsam.Values:
    """The poses after a Gauss-Newton iteration of GTSAM, by the QR solver.

    GTSAM's Cholesky solver loses twice the digits: 2e-9 of the step on parking-garage, and refuses MIT as
    indeterminate.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Poses only.
    values : gtsam.Values
        The start.
    added : list of Ground
        Grounds.
    """
    return gtsam_steps(grounded_graph(graph, values, added), values, "Gauss-Newton", 1)[-1].values


def steady_state_error(
    body: Linearisation,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    added: list[Ground],
    steady: NDArray[np.float64],
) -> float:
    """Distance between the poses of the flow's steady state and of GTSAM's Gauss-Newton step, relative to the step.

    Poses are compared, since a step may turn a pose by more than π, beyond the range of the logarithm.

    Parameters
    ----------
    body : Linearisation
        Linearisation in the body frame.
    graph, values
    added : list of Ground
        Grounds.
    steady : (n d,) float
        Steady state of the flow.

    Raises
    ------
    PgtiError
        Those of `gtsam_steps` and `moved`.
    """
    check_map(graph, values)
    instance(body, Linearisation, "a linearisation")
    steady = finite_array(steady, "the steady state", body.n_pose_columns)
    theirs = gauss_newton_poses(graph, values, added)
    difference = updates(body, moved(body, values, steady), theirs)
    size = float(np.linalg.norm(steady))
    return float(np.linalg.norm(difference)) / size if size else float(np.linalg.norm(difference))


def moved(body: Linearisation, values: gtsam.Values, delta: NDArray[np.float64]) -> gtsam.Values:
    """Values with every pose retracted by its share of δ_body, (n d,); other variables stay.

    Parameters
    ----------
    body : Linearisation
        Linearisation in the body frame.
    values : gtsam.Values
    delta : (n d,) float
        δ_body.

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        No linearisation, no values, or another number of shares.
    MissingValueError
        A pose of the linearisation has no value of its group.
    """
    poses, found = _poses(body, values), gtsam.Values(values)
    shares = finite_array(delta, "δ", body.n_pose_columns).reshape(-1, body.dimension)
    for key, pose, share in zip(body.keys.tolist(), poses, shares, strict=True):
        found.update(key, pose.retract(share))
    return found


def updates(body: Linearisation, before: gtsam.Values, after: gtsam.Values) -> NDArray[np.float64]:
    """log(p_before⁻¹ p_after) of every pose, (n, d).

    Parameters
    ----------
    body : Linearisation
        Linearisation in the body frame.
    before, after : gtsam.Values
    """
    pairs = zip(_poses(body, before), _poses(body, after), strict=True)
    return np.array([first.localCoordinates(second) for first, second in pairs])


def _poses(body: Linearisation, values: gtsam.Values) -> list[Any]:
    """Values of the poses of a linearisation."""
    instance(body, Linearisation, "a linearisation")
    if not isinstance(values, gtsam.Values):
        raise InvalidGraphError(f"expected gtsam.Values, got {shown(values)}")
    at, found = getattr(values, f"at{body.group}"), []
    for key, label in zip(body.keys.tolist(), body.labels, strict=True):
        try:
            found.append(at(key))
        except RuntimeError as error:  # GTSAM has no other way to ask for a value's type
            raise MissingValueError(f"expected a {body.group} as value of {label}, got none") from error
    return found


def _positive(given: float, what: str) -> float:
    number = real(given, what)
    if not 0 < number < np.inf:
        raise InvalidOptionError(f"expected {what} above 0 and finite, got {number}")
    return number


def matched_time(
    times: NDArray[np.float64], states: NDArray[np.float64], update: NDArray[np.float64]
) -> tuple[float, float]:
    """The time at which a flow is nearest to an optimiser's update u, and ‖δ(t) − u‖ / ‖u‖ then.

    Parameters
    ----------
    times : (n_times,) float
        Ascending and positive; the last may be infinite.
    states : (n_times, N) float
        δ(t). Between two times the flow is taken as a straight line, and time as its logarithm.
    update : (N,) float
        Zero gives time zero and no miss.

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        Lengths that differ, numbers that are not finite, times that do not ascend.
    """
    times, update = real_array(times, "times"), finite_array(update, "an update", None)
    states = finite_array(states, "states", None, len(update))
    if times.shape != (len(states),) or len(times) < 2 or not (times[0] > 0 and (np.diff(times) > 0).all()):
        raise InvalidOptionError(
            f"expected two or more ascending times above 0, one for each of {len(states)} states, got {shown(times)}"
        )

    # nothing to match
    size = float(np.linalg.norm(update))
    if size == 0:
        return 0.0, 0.0

    # the nearest point of each stretch
    steps = np.diff(states, axis=0)
    lengths = (steps**2).sum(axis=1)
    towards = ((update - states[:-1]) * steps).sum(axis=1)
    share = np.clip(np.divide(towards, lengths, out=np.zeros_like(towards), where=lengths > 0), 0.0, 1.0)
    miss = np.linalg.norm(states[:-1] + share[:, None] * steps - update, axis=1) / size

    # the nearest of all
    best = int(np.argmin(miss))
    first, last = times[best], times[best + 1]
    if np.isinf(last):
        return (float(last) if share[best] > 0.5 else float(first)), float(miss[best])
    return float(first * (last / first) ** share[best]), float(miss[best])
