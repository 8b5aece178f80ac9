"""The trials: damages of maps, and a row of numbers for each."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pgti_gtsam.diagnosis import Diagnosis, diagnose
from pgti_gtsam.errors import PgtiError
from scenarios.diagnosis import covisible, damage, kitti, narrow, real, sparse
from scenarios.diagnosis.courses import course
from scenarios.diagnosis.damage import Case
from scenarios.diagnosis.expectation import Expectation, can_be_matched, expected
from scenarios.diagnosis.stretches import Pairs, any_chance, is_real

SPARSE, COVISIBLE, NARROW, REAL = "sparse", "covisible", "narrow", "real"

FALSE_SEEDS, DROPPED_SEEDS = 20, 5
"""False closures and dropped revisits that are drawn in every real graph."""

LARGE = ("intel", "fr079", "manhattan_olson3500")
"""Graphs of which a diagnosis takes ten seconds and more: a quarter of the draws."""


class Trial(NamedTuple):
    """A world or a graph's name, a seed, one of the four kinds of map, one of `damage.DAMAGES`."""

    world: str
    seed: int
    variant: str
    damage: str


def world_trials(
    worlds: Sequence[str], seeds: Sequence[int], undamaged_seeds: Sequence[int], covisible_seeds: Sequence[int]
) -> Iterator[Trial]:
    """Every damage in every world; more maps without.

    Parameters
    ----------
    worlds : sequence of str
    seeds : sequence of int
    undamaged_seeds : sequence of int
        Of further maps without damage.
    covisible_seeds : sequence of int
        Of maps with landmarks.
    """
    for seed, world, kind in product(sorted({*seeds, *undamaged_seeds}), worlds, damage.DAMAGES):
        if seed in (undamaged_seeds if kind == damage.NOTHING else seeds):
            yield Trial(world, seed, SPARSE, kind)
    for seed, world, kind in product(covisible_seeds, worlds, covisible.DAMAGES):
        yield Trial(world, seed, COVISIBLE, kind)


def narrow_trials(seeds: Sequence[int]) -> Iterator[Trial]:
    """Every damage in the worlds of a camera, seen by a wide and by a narrow camera."""
    for seed, world, kind, variant in product(seeds, narrow.WORLDS, covisible.DAMAGES, narrow.VARIANTS):
        yield Trial(world, seed, variant, kind)


def real_trials() -> list[Trial]:
    """Every damage of every real graph, drawn anew where the damage is random; the slow graphs last."""
    draws = {damage.FALSE: FALSE_SEEDS, damage.DROPPED: DROPPED_SEEDS}
    found = []
    for name, kind in product(real.RADII, real.DAMAGES):
        n_draws = draws.get(kind, 1)
        found += [Trial(name, seed, REAL, kind) for seed in range(-(-n_draws // 4) if name in LARGE else n_draws)]
    found += [Trial(kitti.NAME, 0, REAL, damage.ODOMETRY)]
    found += [Trial(kitti.NAME, percent, REAL, damage.SCALE) for percent in kitti.PERCENT]
    return sorted(found, key=lambda trial: (trial.world in LARGE, trial.seed))


def case(trial: Trial, data: Path | None) -> Case:
    """The case of a trial.

    Parameters
    ----------
    trial : Trial
    data : Path, optional
        Folder of all data.
    """
    if trial.variant == REAL:
        if data is None:
            raise ValueError("expected the folder of the real graphs, got none; give --data")
        make_real = kitti.case if trial.world == kitti.NAME else functools.partial(real.case, trial.world)
        return make_real(trial.seed, trial.damage, data)
    make = {SPARSE: sparse.case, COVISIBLE: covisible.case, NARROW: narrow.case}[trial.variant]
    return make(trial.world, trial.seed, trial.damage)


def row(trial: Trial, data: Path | None) -> dict[str, Any]:
    """Build, damage, diagnose, compare.

    Parameters
    ----------
    trial : Trial
    data : Path, optional
        Folder of all data.
    """
    # the diagnosis
    try:
        built = case(trial, data)
        begun = time.perf_counter()
        found = diagnose(built.graph, built.values, radii=built.radii)
        seconds = time.perf_counter() - begun
    except PgtiError as error:
        return trial._asdict() | {"failed": str(error)}

    # beside the truth
    right = expected(built, found.pose_graph)
    return (
        trial._asdict()
        | {"expected": verdict(trial, right), "verdict": found.verdict, "reason": found.reason}
        | {"n_keyframes": len(found.pose_graph), "n_closures": len(found.closures), "unit_m": _short(found.unit_m)}
        | {"n_real": right.n_real, "n_chance": right.n_chance, "n_untied": right.n_untied}
        | {"loosest": _short(right.loosest), "nearest_chance": _short(right.nearest_chance)}
        | _places(trial, built, found, right)
        | _closures(built, found, right)
        | (narrow.overlaps(trial.world, trial.seed, found) if _is_by_camera(trial) else {})
        | {"seconds": _short(seconds)}
    )


def _is_by_camera(trial: Trial) -> bool:
    return trial.variant in narrow.VARIANTS and trial.world in narrow.WORLDS


def verdict(trial: Trial, right: Expectation) -> str:
    """The verdict by the truth; of real graphs, by further knowledge.

    Parameters
    ----------
    trial : Trial
    right : Expectation
    """
    if trial.world in real.INCOMPLETE and right.verdict == "consistent":
        return "incomplete"
    return right.verdict


def _places(trial: Trial, built: Case, found: Diagnosis, right: Expectation) -> dict[str, Any]:
    """Places by kind, and of each: kind, whether real and whether tieable by the truth, probability, allowance."""
    kinds = [place.kind for place in found.places]
    each = [
        [place.kind, is_real(right.gaps, place.keyframes), _can_be_tied(trial, built, place.edges)]
        + [_short(place.probability), _short(place.allowance_m)]
        for place in found.places
    ]
    return {"kinds": {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}, "places": each}


def _can_be_tied(trial: Trial, built: Case, pairs: Pairs) -> bool:
    """Whether a matcher could tie some pair; a camera must look there too."""
    if _is_by_camera(trial):
        return narrow.can_be_tied(course(trial.world, trial.seed), pairs)
    return can_be_matched(built, pairs)


def _closures(built: Case, found: Diagnosis, right: Expectation) -> dict[str, Any]:
    """The rank of the false closures, the closures called false, and whether overlaps give them away."""
    order = [closure.slot for closure in found.closures]
    called = {closure.slot for closure in found.closures if closure.is_false}
    false, least = set(built.false_slots), next(iter(found.closures), None)
    return {
        "ranks": [order.index(slot) + 1 if slot in order else None for slot in built.false_slots],
        "false_called": len(called & false),
        "true_called": len(called - false),
        "visible": any_chance(right.gaps, found.integrity.collision_edges) if false else None,
        "least_log_odds": None if least is None else _short(least.log_odds),
        "least_missed_m": None if least is None else _short(least.missed_m),
        "least_allowed_m": None if least is None else _short(least.allowed_m),
    }


def _short(number: float) -> float | None:
    return float(f"{number:.3g}") if np.isfinite(number) else None
