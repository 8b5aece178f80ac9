"""Maps before and after: the truth, odometry with its candidates, all of them believed, the gate's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from pgti_gtsam import outputs
from scenarios.aliasing import methods
from scenarios.problem import Problem, space


def draw(problems: Sequence[Problem], path: Path) -> None:
    """A row for each problem.

    Parameters
    ----------
    problems : sequence of Problem
    path : Path
    """
    figure, axes = plt.subplots(
        len(problems), 4, figsize=(14, 3.2 * len(problems)), layout="constrained", squeeze=False
    )
    for row, problem in zip(axes, problems, strict=True):
        nothing = np.zeros(len(problem.closures), dtype=bool)
        everything = methods.solve(problem, "no gate")
        gated = methods.solve(problem, "gate")
        _map(row[0], problem, problem.truth, nothing, f"{problem.name}: truth")
        _map(row[1], problem, problem.values, ~nothing, f"odometry, {len(nothing)} candidates")
        _map(row[2], problem, everything.values, everything.accepted, "all believed")
        right, wrong = (int((gated.accepted & kind).sum()) for kind in (problem.true, ~problem.true))
        title = f"gate: {right} of {problem.true.sum()} true, {wrong} of {(~problem.true).sum()} false"
        _map(row[3], problem, gated.values, gated.accepted, title)
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=80)
    plt.close(figure)


def _map(axis: Axes, problem: Problem, values: gtsam.Values, shown: Any, title: str) -> None:
    places = np.array([_drawn(space(pose)) for pose in problem.poses(values)])
    for kind, colour in ((~problem.true, "tab:red"), (problem.true, "tab:green")):
        pairs = [problem.closures[k].at(0).keys() for k in np.flatnonzero(shown & kind)]
        axis.add_collection(LineCollection([places[pair] for pair in pairs], colors=colour, linewidths=0.5, alpha=0.6))
    axis.plot(*places.T, color="black", lw=0.8)
    axis.set_title(title, fontsize=9)
    axis.set_aspect("equal")
    axis.tick_params(labelsize=6)


def _drawn(pose: gtsam.Pose3) -> np.ndarray:
    """From above, and aslant, so that storeys lie apart."""
    return np.array([pose.x() + 0.35 * pose.z(), pose.y() + 1.2 * pose.z()])
