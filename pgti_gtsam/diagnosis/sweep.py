"""Does a verdict depend on the radius? The same map audited with smaller and larger spheres."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import gtsam

from pgti_gtsam.diagnosis import diagnose
from pgti_gtsam.diagnosis.records import Diagnosis, Level

FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Of the radii."""

FRAGILE = (0.5, 2.0)
"""Factors between which the verdict must not change."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Swept:
    """A diagnosis with all radii scaled by a factor."""

    factor: float
    diagnosis: Diagnosis


def radius_sweep(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    diagnosis: Diagnosis,
    *,
    closures: Collection[int] | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> list[Swept]:
    """Diagnose a map with its radii scaled by each of `FACTORS`, and edges chosen as before.

    Parameters
    ----------
    graph, values
        The map.
    diagnosis : Diagnosis
        The diagnosis with the radii unscaled.
    closures : collection of int, optional
        As in `diagnose`.
    progress : callable
        Called with a few words on each step.
    """
    pose_graph = diagnosis.pose_graph
    adapted, keys = pose_graph.adaptation, pose_graph.keys.tolist()
    edges, shared = (None, None) if adapted is None else (tuple(adapted.edges), adapted.min_shared_landmarks)
    found = [Swept(factor=1.0, diagnosis=diagnosis)]

    # the same with other radii
    for factor in (factor for factor in FACTORS if factor != 1.0):
        progress(f"radii times {factor:g}")
        radii = dict(zip(keys, (factor * pose_graph.radii).tolist(), strict=True))
        other = diagnose(graph, values, radii=radii, edges=edges, min_shared_landmarks=shared, closures=closures)
        found.append(Swept(factor=factor, diagnosis=other))
    return sorted(found, key=lambda each: each.factor)


def fragile(verdicts: dict[float, Level]) -> bool:
    """Whether the verdict changes between half and twice the radii."""
    return len({level for factor, level in verdicts.items() if FRAGILE[0] <= factor <= FRAGILE[1]}) > 1
