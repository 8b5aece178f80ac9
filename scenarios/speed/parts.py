"""The audit part by part, a closure more on a cached map, and a decision of the gate with its parts."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.drift.log_odds import log_odds
from pgti_gtsam.drift.settled import settle
from pgti_gtsam.estimate import optimised
from pgti_gtsam.gate.batch import closure_ends
from pgti_gtsam.gate.candidate_map import CandidateMaps
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.terms.contact_rise import local_rise
from pgti_gtsam.integrity import STABLE_TIMES, relative_distortion, stable_scores, time_grid
from pgti_gtsam.optimality import compare_optimality
from pgti_gtsam.report.document import audit_document
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from pgti_gtsam.spectral.laplacian import laplacian
from pgti_gtsam.spectral.locality import local_change
from pgti_gtsam.spectral.low_rank import SpectralState
from pgti_gtsam.support_graph import support_graph
from scenarios.speed.solvers import REAL, band

Row = dict[str, Any]

SIGHTINGS = 5
"""Landmarks that each keyframe of the synthetic map sees, new or old."""

N_DECISIONS = 10

GATED = {"intel": ("pose_graphs/intel.g2o", 0.5)}
"""As `solvers.REAL`: graphs that only the gate is timed on."""


class Stopwatch:
    """Processor time since the last look, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.process_time()

    def look(self, name: str) -> None:
        """Book what has passed on a name."""
        now = time.process_time()
        self.seconds[name] = now - self._last
        self._last = time.process_time()


def audit(case: str, data: Path) -> list[Row]:
    """The cost of each step of `pgti-gtsam audit`.

    Parameters
    ----------
    case : str
    data : Path
        Folder of all data.
    """
    watch = Stopwatch()

    # the steps of `assess`
    dataset, radii = _mapped(case, data)
    watch.look("reading")
    pose_graph = pgti.from_gtsam(dataset.graph, dataset.values, radii=radii)
    watch.look("adaptation")
    support = support_graph(pose_graph)
    watch.look("support graph")
    kernels = heat_kernels(len(pose_graph), pose_graph.edges, support.merged_edges)
    times = time_grid(kernels[1], 100)
    relative_distortion(kernels[0].signatures(times), kernels[1].signatures(times), 2)
    stable_scores(*kernels)
    watch.look("spectra")
    compare_optimality(pose_graph, support, kernels)
    watch.look("optimality")

    # the whole
    pgti.assess(pose_graph)
    watch.look("all of assess")
    found = pgti.diagnose(dataset.graph, dataset.values, radii=radii)
    watch.look("all of diagnose")
    audit_document(found, name=case, file_format="")
    watch.look("document")
    sizes = {"case": case, "n_keyframes": len(pose_graph), "n_factors": dataset.graph.size()}
    return [{**sizes, "part": part, "seconds": seconds} for part, seconds in watch.seconds.items()]


def _mapped(case: str, data: Path) -> tuple[datasets.Dataset, float | None]:
    if case == "kitti_00_stereo":
        return datasets.builtin(), None
    if case in REAL:
        name, radius = REAL[case]
        return datasets.read(data / name), radius
    return _landmark_map(int(case.removeprefix("landmarks-"))), None


def _landmark_map(n: int) -> datasets.Dataset:
    """A straight road of n keyframes, each with five of the n landmarks in view."""
    graph, values, landmark = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.symbol_shorthand.L
    unit3, unit2 = gtsam.noiseModel.Unit.Create(3), gtsam.noiseModel.Unit.Create(2)
    for k in range(n):
        values.insert(k, gtsam.Pose2(k, 0, 0))
        values.insert(landmark(k), np.array([k, 3.0]))
        if k:
            graph.push_back(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(1, 0, 0), unit3))
        for seen in range(k, min(k + SIGHTINGS, n)):
            bearing, reach = gtsam.Rot2.atan2(3.0, seen - k), float(np.hypot(seen - k, 3.0))
            graph.push_back(gtsam.BearingRangeFactor2D(k, landmark(seen), bearing, reach, unit2))
    return datasets.Dataset(name=f"landmarks-{n}", format="synthetic", graph=graph, values=values)


def updates(case: str) -> list[Row]:
    """A closure more on a cached chain: by low-rank update of all keyframes, and by its neighbourhood alone."""
    # the cached map
    _, size, width = case.split("-")
    n, edges = int(size), band(int(size), int(width))
    watch = Stopwatch()
    state = SpectralState.of(n, edges)
    matrix = laplacian(n, edges)
    watch.look("state")
    rows = [{"case": case, "what": "factorising the map once", "seconds": watch.seconds["state"]}]

    # more closures
    for count in (1, 10):
        inserted = np.stack([n // 2 + np.arange(count), n // 2 + 37 + np.arange(count)], axis=1)
        tried = {
            "diagonals at all keyframes": lambda i=inserted: state.bounded_kernel_with(i).diagonals(STABLE_TIMES),
            "with the ends of the spectrum": lambda i=inserted: state.kernel_with(i).diagonals(STABLE_TIMES),
            "neighbourhood alone": lambda i=inserted: local_change(matrix, i, STABLE_TIMES),
        }
        rows += [
            {"case": case, "what": what, "n_inserted": count, "seconds": _best_of(5, task)}
            for what, task in tried.items()
        ]
    return rows


def _best_of(count: int, task: Callable[[], object]) -> float:
    found = []
    for _ in range(count):
        started = time.process_time()
        task()
        found.append(time.process_time() - started)
    return min(found)


def decisions(case: str, data: Path) -> list[Row]:
    """True closures taken out of a map and offered again, and false closures, against an optimisation of the map.

    Parameters
    ----------
    case : str
    data : Path
        Folder of all data.
    """
    # the map without closures, and offers
    dataset, radius = _gated(case, data)
    watch = Stopwatch()
    best = optimised(dataset.graph, dataset.values)
    watch.look("one optimisation")
    graph, offers = _offers(dataset, best, radius)
    gate = pgti.LoopClosureGate()
    common = {
        "case": case,
        "n_keyframes": len(gate.adapted(graph, best, radius)),
        "one_optimisation": watch.seconds["one optimisation"],
    }
    reference = gate.reference_map(graph, best, radius)

    # every offer, timed
    judged = {
        "a decision on a {} closure": lambda closure: gate.evaluate(graph, best, closure, radius),
        "the same against a kept reference map, {}": lambda closure: gate.judge(reference, [closure]).decisions[0],
    }
    rows = []
    for (what, judge), (kind, closures) in product(judged.items(), offers.items()):
        seconds, accepted = [], 0
        for closure in closures:
            started = time.process_time()
            accepted += judge(closure).accepted
            seconds.append(time.process_time() - started)
        rows.append(
            {
                **common,
                "what": what.format(kind),
                "seconds": float(np.median(seconds)),
                "slowest": max(seconds),
                "accepted": accepted,
                "offered": len(seconds),
            }
        )

    # parts of a decision
    found = [_stages(gate, graph, best, closure, radius) for closure in offers["true"]]
    parts = {part: float(np.median([seconds[part] for seconds in found])) for part in found[0]}
    return rows + [{**common, "what": part, "seconds": seconds} for part, seconds in parts.items()]


def _gated(case: str, data: Path) -> tuple[datasets.Dataset, float]:
    """A graph whose closures are judged, and its free radius in m."""
    if case == "w10000":
        return datasets.read(Path(gtsam.findExampleDataFile("w10000.graph"))), 0.4
    name, radius = (REAL | GATED)[case]
    dataset = datasets.read(data / name)
    return (datasets.subsample(dataset, 5) if case == "kitti_00" else dataset), radius


def _stages(
    gate: pgti.LoopClosureGate,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    closure: gtsam.NonlinearFactorGraph,
    radius: float,
) -> dict[str, float]:
    """The cost of each step of a decision on a closure that passes, s: the calls of `LoopClosureGate.evaluate`."""
    # the map without the closure
    watch = Stopwatch()
    pose_graph = gate.adapted(graph, values, radius)
    watch.look("adapting")
    reference = ReferenceMap.of(graph, values, pose_graph, gate.options.beta)
    watch.look("drift model and its optimum without the closure")

    # what the map predicts of the closure, and the map with it
    settled, [own] = reference.offered([closure])
    model = settled.model
    log_odds(model.units, settled.residuals[own], settled.covariances(model.ties.pairs[own]))
    watch.look("weighing")
    tied = settle(model, np.ones_like(settled.active), settled)
    watch.look("optimum with the closure")

    # Λ and Λ_glob with and without
    maps = CandidateMaps(reference=reference, offered=settled)
    reference.scored  # noqa: B018
    watch.look("factorising the graphs of the map, once")
    maps.scores(settled.active, [np.array(own)])
    watch.look("Λ and Λ_glob before and after")

    # free space with and without
    before, after = maps.contacts(settled), maps.contacts(tied)
    watch.look("contacts with and without")
    local_rise(before, after)
    watch.look("contact rise, where the drift leaves doubt")
    return watch.seconds


def _offers(
    dataset: datasets.Dataset, best: gtsam.Values, radius: float
) -> tuple[gtsam.NonlinearFactorGraph, dict[str, list[gtsam.NonlinearFactorGraph]]]:
    """The map without some closures; these closures; and as many between random keyframes."""
    rng = np.random.default_rng(0)
    pose_graph = pgti.from_gtsam(dataset.graph, best, radii=radius)
    slots = rng.choice(list(closure_ends(pose_graph, dataset.graph)), N_DECISIONS, replace=False).tolist()
    graph = gtsam.NonlinearFactorGraph(dataset.graph)
    offers: dict[str, list[gtsam.NonlinearFactorGraph]] = {"true": [], "false": []}
    for slot in slots:
        factor = graph.at(slot)
        first, second = rng.choice(pose_graph.keys, 2, replace=False).tolist()
        wrong = type(factor)(first, second, factor.measured(), factor.noiseModel())
        graph.remove(slot)
        for kind, own in (("true", factor), ("false", wrong)):
            closure = gtsam.NonlinearFactorGraph()
            closure.push_back(own)
            offers[kind].append(closure)
    return graph, offers
