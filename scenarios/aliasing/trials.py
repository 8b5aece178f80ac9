"""The trials: every method on every problem; a row of numbers each."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scenarios import measures, worlds
from scenarios.aliasing import field
from scenarios.aliasing.helper import Helper
from scenarios.aliasing.methods import METHODS
from scenarios.problem import Problem
from scenarios.worlds import drift
from scenarios.worlds.layouts import LAYOUTS

SHARES = (0.1, 0.5, 1.0)
"""False closures per true one."""

SLOW = "Λ_glob rule"
"""Takes up to a minute a trial, and asks no sigma: tried at equal shares, with the right ones and with none."""

SUCCESS_M, SUCCESS_SHARE = 0.75, 0.05
"""A trajectory is a success below both: metres, and share of its extent."""


DRIFT_METHODS = ("gate", "χ²", "PCM", "GNC-TLS", "DCS")
"""Where the odometry errs in other ways: the gate and the methods that come nearest to it."""


class Trial(NamedTuple):
    """A world of `LAYOUTS` or the path of a standard graph, a seed, the sigmas told or the outliers' pattern, …"""

    world: str
    seed: int
    setting: str
    share: float
    method: str

    def key(self) -> Trial:
        """The trial under the name in its row, wherever the data lies."""
        return self._replace(world=Path(self.world).stem)


def world_trials(names: Collection[str], seeds: Sequence[int]) -> Iterator[Trial]:
    """All noise models at equal shares, and all shares with the right noise model.

    Parameters
    ----------
    names : collection of str
        Worlds.
    seeds : sequence of int
    """
    for name, seed, told in product(names, seeds, worlds.TOLD):
        for share, method in product(SHARES if told == "right" else (1.0,), METHODS):
            if method != SLOW or (share == 1.0 and told in ("right", "identity")):
                yield Trial(name, seed, told, share, method)


def drift_trials(names: Collection[str], seeds: Sequence[int]) -> Iterator[Trial]:
    """All kinds of drift at equal shares; sigmas are three times the walk's, the best value for other methods.

    Parameters
    ----------
    names : collection of str
        Worlds.
    seeds : sequence of int
    """
    for name, seed, kind, method in product(names, seeds, drift.KINDS, DRIFT_METHODS):
        yield Trial(name, seed, kind, 1.0, method)


def field_trials(paths: Sequence[Path], seeds: Sequence[int], methods: Sequence[str]) -> Iterator[Trial]:
    """All shares of random outliers, and all kinds at equal shares; the noise models are the files' own.

    Parameters
    ----------
    paths : sequence of Path
        Standard graphs.
    seeds : sequence of int
    methods : sequence of str
    """
    for path, seed, kind in product(paths, seeds, field.KINDS):
        for share, method in product(SHARES if kind == "random" else (1.0,), methods):
            yield Trial(str(path), seed, kind, share, method)


@functools.lru_cache(maxsize=2)
def problem(world: str, seed: int, setting: str, share: float) -> Problem:
    """The problem of a trial.

    Parameters
    ----------
    world : str
        World, or path of a standard graph.
    seed : int
    setting : str
        Noise model, kind of drift or kind of outliers.
    share : float
        False closures per true closure.
    """
    if setting in drift.KINDS:
        return worlds.problem(world, seed, "three times", share=share, errors=drift.KINDS[setting])
    if world in LAYOUTS:
        return worlds.problem(world, seed, setting, share=share)
    return field.problem(Path(world), seed, share, setting)


_helper = Helper()


def row(trial: Trial, limit_s: float) -> dict[str, Any]:
    """Run a trial; a method that gives up or takes too long accepts nothing.

    Parameters
    ----------
    trial : Trial
    limit_s : float
        Time of a method, s.
    """
    # the problem and the method's answer
    given = problem(*trial[:4])
    found: dict[str, Any] = trial.key()._asdict()
    if np.isfinite(given.ambiguity):
        found["ambiguity"] = given.ambiguity
    true, seen = given.true, given.overlapping
    counts = {"true": int(true.sum()), "false": int((~true).sum()), "false_without_overlap": int((~seen).sum())}
    try:
        outcome = _helper.solve(given, trial.method, limit_s)
    except (RuntimeError, TimeoutError) as error:
        return found | counts | {"failed": str(error), "f1": 0.0, "f1_with_overlap": 0.0, "success": False}

    # measures
    kept = outcome.accepted
    places = np.array([pose.translation() for pose in given.poses(given.truth)])
    extent = float(np.ptp(places, axis=0).max())
    errors = measures.trajectory_errors(given.poses(given.truth), given.poses(outcome.values))
    return (
        found
        | counts
        | {
            "true_accepted": int((true & kept).sum()),
            "false_accepted": int((~true & kept).sum()),
            "false_without_overlap_accepted": int((~seen & kept).sum()),
            "f1": measures.f1(true, kept),
            "f1_with_overlap": measures.f1(true[seen], kept[seen]),
            "auc": measures.area_under_curve(true, outcome.confidence),
            "precisions": [round(value, 4) for value in measures.precisions(true, outcome.confidence)],
            **errors,
            "extent_m": extent,
            "success": errors["ate_m"] < min(SUCCESS_M, SUCCESS_SHARE * extent),
            "seconds_per_closure": outcome.seconds / max(len(kept), 1),
        }
    )
