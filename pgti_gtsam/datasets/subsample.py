"""Fewer keyframes: every k-th pose, with the odometry between composed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.chain import (
    Between,
    Pose,
    between_factors,
    poses_of,
    tracked,
)
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError
from pgti_gtsam.factor_graphs import between_factor
from pgti_gtsam.pose_graph import key_label


class Step(NamedTuple):
    """A relative pose and the covariance of its right-hand error in GTSAM's tangent space, (3, 3) or (6, 6)."""

    pose: Pose
    covariance: NDArray[np.float64]


def subsample(dataset: Dataset, every: int = 5) -> Dataset:
    """Keep every ``every``-th pose of each chain, counted from the first; keys do not change.

    Closures, sightings and other factors stay where all their poses do, landmarks where a factor does.
    Where a step of odometry is missing, the composed step is missing too.

    Parameters
    ----------
    dataset : Dataset
    every : int
        1 keeps everything.

    Returns
    -------
    Dataset
        Composed odometry first, then the other factors, in order.

    Raises
    ------
    InvalidOptionError
        ``every`` is below 1.
    InvalidGraphError
        A step with a singular covariance or information matrix, which cannot be composed.
    """
    if every < 1:
        raise InvalidOptionError(f"expected to keep every pose (1) or fewer, got every={every}")
    if every == 1:
        return dataset
    keys, (chains, closures) = list(poses_of(dataset.values)), tracked(dataset)
    dropped = set(keys) - {key for chain in chains for key in chain[::every]}

    # steps in between become one
    closing = set(closures)
    links = _links(chains, [between for between in between_factors(dataset.graph) if between.slot not in closing])
    graph = _composed_odometry(chains, links, every)
    notes = [f"one pose in {every} is kept, {len(keys) - len(dropped)} of {len(keys)}; {graph.size()} composed steps"]
    steps = {between.slot for betweens in links.values() for between in betweens}
    slots = _copy_factors(dataset.graph, graph, steps, dropped)

    # closures stay closures, even where the poses between their ends are gone
    kept = tuple(slots[slot] for slot in closures if slot in slots)
    if len(kept) < len(closures):
        notes.append(f"{len(closures) - len(kept)} closures went with the poses that were not kept")

    # all else that names a pose
    radii, true, truth = dataset.radii, dataset.true_closures, dataset.truth
    return replace(
        dataset,
        graph=graph,
        values=_without(dataset.values, dropped | _unseen(dataset.values, graph, keys)),
        radii=None if radii is None else MappingProxyType({k: radii[k] for k in radii if k not in dropped}),
        closures=kept,
        true_closures=None if true is None else frozenset(slots[slot] for slot in true if slot in slots),
        truth=None if truth is None else _without(truth, dropped),
        notes=(*dataset.notes, *notes),
    )


def compose(first: Step, second: Step) -> Step:
    """Two consecutive steps as a single step.

    T₁ Exp(ξ₁) T₂ Exp(ξ₂) = T₁ T₂ Exp(Ad(T₂⁻¹) ξ₁) Exp(ξ₂), so to first order
    Σ = Ad(T₂⁻¹) Σ₁ Ad(T₂⁻¹)ᵀ + Σ₂ (Barfoot and Furgale, doi:10.1109/TRO.2014.2298059).

    Parameters
    ----------
    first, second : Step
    """
    carry = second.pose.inverse().AdjointMap()
    covariance = carry @ first.covariance @ carry.T + second.covariance
    return Step(first.pose * second.pose, covariance)


def _links(chains: Sequence[Sequence[int]], odometry: Sequence[Between]) -> dict[tuple[int, int], list[Between]]:
    """The odometry from each pose to the next on the chain."""
    links: dict[tuple[int, int], list[Between]] = {pair: [] for chain in chains for pair in pairwise(chain)}
    for between in odometry:
        if between.ends in links:
            links[between.ends].append(between)
    return links


def _composed_odometry(
    chains: Sequence[Sequence[int]], links: Mapping[tuple[int, int], Sequence[Between]], every: int
) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for keys in chains:
        for i in range(0, len(keys) - every, every):
            pairs = list(pairwise(keys[i : i + every + 1]))
            if all(links[pair] for pair in pairs):
                step = reduce(compose, [_step(links[pair][0], pair[0]) for pair in pairs])
                model = gtsam.noiseModel.Gaussian.Covariance(step.covariance)
                graph.push_back(between_factor(keys[i], keys[i + every], step.pose, model))
    return graph


def _step(link: Between, key: int) -> Step:
    """The step that leads away from ``key``; a step stored the other way round is inverted, error and all."""
    model = link.factor.noiseModel()
    gaussian: Any = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
    information = np.asarray(gaussian.information())
    if not np.isfinite(information).all() or np.linalg.matrix_rank(information) < len(information):
        ends = f"{key_label(link.first)} to {key_label(link.second)}"
        message = f"odometry from {ends} says nothing in some direction, so steps cannot be composed; keep every pose"
        raise InvalidGraphError(message)
    measured, covariance = link.factor.measured(), np.linalg.inv(information)
    if key == link.first:
        return Step(measured, covariance)
    carry = measured.AdjointMap()  # (T Exp ξ)⁻¹ = T⁻¹ Exp(−Ad(T) ξ)
    return Step(measured.inverse(), carry @ covariance @ carry.T)


def _copy_factors(
    source: gtsam.NonlinearFactorGraph,
    target: gtsam.NonlinearFactorGraph,
    steps: Collection[int],
    dropped: Set[int],
) -> dict[int, int]:
    """Add the factors that are no steps and touch no dropped pose; old slots to new slots."""
    slots = {}
    for slot in range(source.size()):
        factor = source.at(slot)
        if factor is not None and slot not in steps and dropped.isdisjoint(factor.keys()):
            slots[slot] = target.size()
            target.push_back(factor)
    return slots


def _unseen(values: gtsam.Values, graph: gtsam.NonlinearFactorGraph, poses: Sequence[int]) -> set[int]:
    """Variables that are no poses and that no factor refers to."""
    return set(values.keys()) - set(poses) - set(graph.keyVector())


def _without(values: gtsam.Values, dropped: Collection[int]) -> gtsam.Values:
    fewer = gtsam.Values(values)
    for key in dropped:
        if fewer.exists(key):
            fewer.erase(key)
    return fewer
