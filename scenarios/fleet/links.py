"""Three robots around one block, and links between their maps, of which some are wrong: which links fuse maps?

Each robot laps the block twice, with ties between the laps, in a frame at random. A true link measures the relative
pose of two keyframes within `NEAR` of each other, with the noise of a match; a wrong link takes two places at least
30 m apart for the same place.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np

from pgti_gtsam import merge
from scenarios.fleet.drives import APART, MATCH, NOISE, RADIUS, lap
from scenarios.problem import between

ROBOTS = "abc"
NEAR = 6.0
"""Most distance between the keyframes of a true link, m: spheres of both meet."""

TRUE, WRONG = (0, 1, 2, 4, 8), (0, 4, 16)
"""Links of either kind that are tried, between any two robots."""


class Trial(NamedTuple):
    """A team by its seed, and how many links of either kind are offered."""

    seed: int
    true: int
    wrong: int


def trials(seeds: Sequence[int]) -> list[Trial]:
    """Every mixture of links that holds any."""
    return [Trial(seed, true, wrong) for seed in seeds for true in TRUE for wrong in WRONG if true or wrong]


def row(trial: Trial) -> dict[str, Any]:
    """A team with links, merged: which of them were accepted, and how many maps remain."""
    # the team
    random = np.random.default_rng(trial)
    course = lap(*np.random.default_rng([trial.seed, 0]).integers(11, 23, size=2).tolist())
    graph, values, truth = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
    for robot in ROBOTS:
        truth |= _add(graph, values, robot, course, random)

    # the links
    links = [_link(truth, random, is_true=k < trial.true) for k in range(trial.true + trial.wrong)]
    found = merge(graph, values, links, RADIUS)
    verdicts = [link.verdict for link in found.links]
    return trial._asdict() | {
        "joined": len(found.order),
        "true_accepted": verdicts[: trial.true].count("accepted"),
        "wrong_accepted": verdicts[trial.true :].count("accepted"),
        "true_rejected": verdicts[: trial.true].count("rejected"),
        "wrong_rejected": verdicts[trial.true :].count("rejected"),
    }


def run(path: Path, seeds: Sequence[int], tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Rows that the file lacks are made; all rows.

    Parameters
    ----------
    path : Path
        Of JSON lines.
    seeds : sequence of int
    tell : callable
    """
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    known = {tuple(each[name] for name in Trial._fields): each for each in map(json.loads, lines)}
    wanted = trials(seeds)
    for trial in wanted:
        if trial not in known:
            known[trial] = row(trial)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(known[trial]) + "\n")
    tell(f"{len(wanted)} teams")
    return [known[trial] for trial in wanted]


def report(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A table of all mixtures."""
    lines = [
        "| true links, wrong links | teams | joined, two a team | true accepted | wrong accepted | wrong rejected |",
        "|---|---|---|---|---|---|",
    ]
    for true, wrong in dict.fromkeys((row["true"], row["wrong"]) for row in rows):
        own = [row for row in rows if (row["true"], row["wrong"]) == (true, wrong)]
        sums = {name: sum(row[name] for row in own) for name in own[0]}
        lines.append(
            f"| {true}, {wrong} | {len(own)} | {sums['joined']} of {2 * len(own)} | {sums['true_accepted']} of "
            f"{true * len(own)} | {sums['wrong_accepted']} of {wrong * len(own)} | {sums['wrong_rejected']} |"
        )
    return lines


def _add(graph: Any, values: Any, robot: str, course: list[gtsam.Pose2], random: Any) -> dict[int, gtsam.Pose2]:
    """Two laps of a robot, in a frame at random; the true poses."""
    frame = gtsam.Pose2(*random.uniform(-500, 500, size=2), random.uniform(-np.pi, np.pi))
    pose, truth = gtsam.Pose2(), {}
    for k, step in enumerate([gtsam.Pose2(), *course, *course]):
        pose = pose.compose(step)
        truth[gtsam.symbol(robot, k)] = pose
        values.insert(gtsam.symbol(robot, k), frame.compose(pose))
    ties = [(k, k + 1, NOISE) for k in range(2 * len(course))]
    ties += [(k, k + len(course), MATCH) for k in range(0, len(course), 3)]
    for i, j, sigmas in ties:
        first, second = gtsam.symbol(robot, i), gtsam.symbol(robot, j)
        graph.push_back(_measured(first, second, truth[first].between(truth[second]), sigmas, random))
    return truth


def _link(truth: dict[int, gtsam.Pose2], random: Any, *, is_true: bool) -> Any:
    """A link between keyframes of two robots."""
    keys = list(truth)
    while True:
        i, j = (keys[k] for k in random.integers(len(keys), size=2))
        between_robots, apart = i >> 56 != j >> 56, truth[i].between(truth[j])
        distance = float(np.linalg.norm(apart.translation()))
        if between_robots and (distance <= NEAR if is_true else distance >= APART * RADIUS):
            return _measured(i, j, apart if is_true else gtsam.Pose2(), MATCH, random)


def _measured(i: int, j: int, pose: gtsam.Pose2, sigmas: Any, random: Any) -> Any:
    return between(i, j, pose.retract(sigmas * random.normal(size=3)), gtsam.noiseModel.Diagonal.Sigmas(sigmas))
