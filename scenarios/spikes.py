"""Which rise of PGTI tells a false closure: "a spurious closure makes the score spike" (section 6.3.1), measured.

Closures come in time order onto a map that ties all earlier true closures. A candidate is tied alone, the drift model
brings the map to the optimum with and without the candidate, and seven scores are compared before and after. Candidates
are the first true match of every revisit and all false matches, sampled where there are many: the further matches of a
revisit that is tied already move nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

import pgti_gtsam as pgti
from pgti_gtsam.datasets.chain import poses_of
from pgti_gtsam.drift.settled import settle
from pgti_gtsam.gate.candidate_map import CandidateMaps
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.terms.contact_rise import local_rise
from scenarios.arrivals import KITTI, MOST, REAL, Arrivals, Trial, arrivals
from scenarios.measures import area_under_curve
from scenarios.worlds.layouts import LAYOUTS

SPIKES = {
    "score": "Λ",
    "global_score": "Λ_glob",
    "mean_score": "Z̄",
    "keyframe": "ζ_i",
    "keyframe_global": "ζ_glob,i",
    "stable": "σ_i",
    "contact": "contact rise",
}
"""What is compared before and after. Λ_glob is the paper's; with an index, the largest rise of any keyframe's own
score; σ is the stable score, at fixed times; the contact rise is what the gate weighs: σ near what changed, without the
overlaps that the closure explains."""

TRAINING = 1000
"""Seeds from here on are for choices: the limits of `limits_of`."""

AROUND = 10
"""Keyframes at both ends within which an earlier true closure makes a true one a further match of its revisit."""

LOST = 0.01
"""Share of true closures that a limit may cost."""

DRIFTED = 1.0
"""Allowance, in free radii ρ, up to which a map has hardly drifted between a closure's ends."""

FEW = 5
"""Candidates of either kind below which a map has no row of its own."""


def trials(names: Sequence[str], seeds: Sequence[int], data: Path | None) -> list[Trial]:
    """Every world at every seed, and all real maps once.

    Parameters
    ----------
    names : sequence of str
        Worlds.
    seeds : sequence of int
    data : Path, optional
        Folder of all data.
    """
    found = [Trial(name, seed) for name in names for seed in seeds]
    return found if data is None else found + [Trial(name, 0) for name in REAL]


def row(trial: Trial, data: Path | None) -> dict[str, Any]:
    """Every candidate of a map: whether true, whether free space comes into contact, and the rises.

    Parameters
    ----------
    trial : Trial
    data : Path, optional
        Folder of all data.
    """
    arriving = arrivals(trial, data)
    found = candidates(arriving, np.random.default_rng(trial.seed))
    counts = {"keyframes": arriving.values.size(), "offered": len(arriving.closures)}
    return trial._asdict() | counts | {"candidates": found}


def candidates(arriving: Arrivals, random: np.random.Generator) -> list[dict[str, Any]]:
    """Candidates in time order, drawn where there are many, each tied to the map of all true closures before.

    Parameters
    ----------
    arriving : Arrivals
    random : numpy.random.Generator
        Of the draw.
    """
    ends = [_ends(closure) for closure in arriving.closures]
    chosen = _sample(ends, arriving.true, random)
    chain = poses_of(arriving.values)
    estimate: dict[int, Any] = {}
    tied, found = [], []
    for k, closure in enumerate(arriving.closures):
        if k in chosen:
            estimate = _continued(estimate, chain, ends[k][1])
            reference = _map_until(arriving, ends[k][1], tied, estimate)
            estimate = _drawn(reference)
            seen = {"true": bool(arriving.true[k]), "overlapping": bool(arriving.overlapping[k])}
            found.append(seen | {"ends": list(ends[k])} | spikes(reference, closure))
        if arriving.true[k]:
            tied.append(closure)
    return found


def spikes(reference: ReferenceMap, closure: gtsam.NonlinearFactorGraph) -> dict[str, float]:
    """The rise of each of `SPIKES` when a closure is tied; `allowed`, the drift between the ends, in ρ.

    Parameters
    ----------
    reference : ReferenceMap
    closure : gtsam.NonlinearFactorGraph
    """
    # the map without and with the closure, at either optimum
    without, (ties,) = reference.offered([closure])
    active = without.active.copy()
    active[ties] = True
    tied = settle(without.model, active, without)
    maps = CandidateMaps(reference=reference, offered=without)
    before, after = maps.integrity(without), maps.integrity(tied)

    # what rises
    drift = without.covariances(without.model.ties.pairs[ties])
    contact, _ = local_rise(maps.contacts(without), maps.contacts(tied))
    found = {
        "allowed": without.model.units.allowances_m(drift)[0] / without.model.units.unit_m,
        "score": after.score - before.score,
        "global_score": after.split().global_ - before.split().global_,
        "mean_score": after.mean_score - before.mean_score,
        "keyframe": np.max(after.keyframe_scores - before.keyframe_scores),
        "keyframe_global": np.max(after.split().keyframe_globals - before.split().keyframe_globals),
        "stable": np.max(after.stable_scores - before.stable_scores),
        "contact": contact.rise,
    }
    return {name: float(f"{rise:.5g}") for name, rise in found.items()}


def _sample(ends: Sequence[tuple[int, int]], true: NDArray[np.bool_], random: np.random.Generator) -> set[int]:
    """First matches of true revisits, and false closures: at most `MOST` of either."""
    first, passed = [], []
    for k in np.flatnonzero(true).tolist():
        if not any(abs(i - ends[k][0]) <= AROUND and abs(j - ends[k][1]) <= AROUND for i, j in passed):
            first.append(k)
        passed.append(ends[k])
    kinds = (np.array(first, dtype=int), np.flatnonzero(~true))
    return {int(k) for kind in kinds for k in random.permutation(kind)[:MOST]}


def _ends(closure: gtsam.NonlinearFactorGraph) -> tuple[int, int]:
    earlier, later = sorted(closure.at(0).keys())
    return earlier, later


def _continued(estimate: Mapping[int, Any], chain: Mapping[int, Any], last: int) -> dict[int, Any]:
    """The estimate so far, and the keyframes up to the last by odometry from the end."""
    found, end = dict(estimate), max(estimate, default=None)
    for key, pose in chain.items():
        if key <= last and key not in found:
            found[key] = pose if end is None else estimate[end].compose(chain[end].between(pose))
    return found


def _map_until(
    arriving: Arrivals, last: int, tied: Sequence[gtsam.NonlinearFactorGraph], estimate: Mapping[int, Any]
) -> ReferenceMap:
    """The map at the time when its last keyframe has come."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for slot in range(arriving.odometry.size()):
        if max(arriving.odometry.at(slot).keys()) <= last:
            graph.push_back(arriving.odometry.at(slot))
    first = graph.size()
    for closure in tied:
        graph.push_back(closure.at(0))
    for key, pose in estimate.items():
        values.insert(key, pose)
    radii = arriving.radii
    if isinstance(radii, Mapping):
        radii = {key: radii[key] for key in estimate if key in radii}
    return pgti.LoopClosureGate().reference_map(graph, values, radii, range(first, graph.size()))


def _drawn(reference: ReferenceMap) -> dict[int, Any]:
    """Where the drift model has the keyframes, in the caller's frame of body."""
    turn = reference.settled.model.units.levelling.inverse()
    poses = (pose.compose(turn) for pose in reference.settled.poses)
    return dict(zip(reference.pose_graph.keys.tolist(), poses, strict=True))


def report(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Three tables as Markdown: area under the curve, false closures caught, and by limits of training seeds."""
    pools = _pools([row for row in rows if row["seed"] < TRAINING])
    training = [row for row in rows if row["seed"] >= TRAINING]
    yield from _table("area under the curve", pools, _area)
    yield from _table(f"false ones caught where {LOST:.0%} of the true are lost", pools, _caught_by_own_limit)
    if training:
        limits = limits_of(training)
        yield "\nlimits of the training seeds: " + ", ".join(f"{SPIKES[name]} {x:.3g}" for name, x in limits.items())
        yield from _table("false ones caught, true ones lost, by these", pools, partial(_by_limit, limits))


def limits_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The rise of each score that `LOST` of the true closures of some maps exceed."""
    found = [each for row in rows for each in row["candidates"]]
    return {name: _limit(_rises(found, name, is_true=True)) for name in SPIKES}


def _pools(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Candidates by map, of all seeds together, and of all worlds."""
    found: dict[str, list[Any]] = {}
    for each in rows:
        found.setdefault(each["map"], []).extend(each["candidates"])
    seen = [each for name in LAYOUTS for each in found.get(name, [])]
    real = [each for name in REAL for each in found.get(name, [])]
    return found | {
        "KITTI": [each for name in KITTI for each in found.get(name, [])],
        "all worlds": seen,
        "of which free space in contact": [each for each in seen if each["overlapping"]],
        f"of which drift up to {DRIFTED:g} ρ": [each for each in seen if each["allowed"] <= DRIFTED],
        f"of which drift above {DRIFTED:g} ρ": [each for each in seen if each["allowed"] > DRIFTED],
        "all real maps": real,
        f"of these drift up to {DRIFTED:g} ρ": [each for each in real if each["allowed"] <= DRIFTED],
        f"of these drift above {DRIFTED:g} ρ": [each for each in real if each["allowed"] > DRIFTED],
    }


def _table(title: str, pools: Mapping[str, list[Any]], cell: Callable[[list[Any], str], str]) -> Iterator[str]:
    yield f"\n{title}\n"
    yield f"| map | true | false | {' | '.join(SPIKES.values())} |"
    yield "|---|" + "---|" * (2 + len(SPIKES))
    for name, found in pools.items():
        true = sum(each["true"] for each in found)
        false = len(found) - true
        if min(true, false) >= FEW:
            yield f"| {name} | {true} | {false} | {' | '.join(cell(found, spike) for spike in SPIKES)} |"


def _rises(found: Sequence[Mapping[str, Any]], name: str, *, is_true: bool) -> NDArray[np.float64]:
    return np.array([each[name] for each in found if each["true"] is is_true], dtype=float)


def _limit(true: NDArray[np.float64]) -> float:
    """The least limit that at most `LOST` of these exceed."""
    return float(np.sort(true)[::-1][int(LOST * len(true))])


def _area(found: Sequence[Mapping[str, Any]], name: str) -> str:
    true, rises = (np.array([each[key] for each in found]) for key in ("true", name))
    return f"{area_under_curve(true, -rises):.2f}"


def _caught_by_own_limit(found: Sequence[Mapping[str, Any]], name: str) -> str:
    limit = _limit(_rises(found, name, is_true=True))
    return f"{np.mean(_rises(found, name, is_true=False) > limit):.0%}"


def _by_limit(limits: Mapping[str, float], found: Sequence[Mapping[str, Any]], name: str) -> str:
    false, true = (np.mean(_rises(found, name, is_true=is_true) > limits[name]) for is_true in (False, True))
    return f"{false:.0%}, {true:.0%}"
