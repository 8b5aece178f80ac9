"""A closure tried on a copy of the map: every quantity is measured when it is first asked for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property

import gtsam
import numpy as np

from pgti_gtsam.factor_graphs import BETWEEN, factors_of, joined
from pgti_gtsam.gate.evidence import Change, Contacts, Evidence, Seconds, contacts, local_rise
from pgti_gtsam.gate.survey import Survey
from pgti_gtsam.gate.trial import TRIAL_ITERATIONS, largest_strain_m, optimised, still_held
from pgti_gtsam.pose_graph import PoseGraph


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """A map and a closure, which is neither in nor out.

    How far the map must bend is known long before its optimum with the closure is: a verdict that needs no more
    asks for no more.

    Attributes
    ----------
    before : Survey
    closure : gtsam.NonlinearFactorGraph
    """

    before: Survey
    closure: gtsam.NonlinearFactorGraph
    _spent: dict[str, float] = field(
        default_factory=lambda: {"adaptation": 0.0, "optimisation": 0.0, "spectra": 0.0}, repr=False
    )

    @cached_property
    def bending(self) -> float:
        """How far the map must bend: see `Yardstick.bending`. By its optimum, where no between factor says."""
        yardstick = self.before.yardstick
        if not any(isinstance(factor, BETWEEN) for factor in factors_of(self.closure)):
            return yardstick.bent(self.values)
        with self._timed("optimisation"):
            return yardstick.bending(self.closure)

    @cached_property
    def together(self) -> gtsam.NonlinearFactorGraph:
        """The map's factors and the closure's."""
        return joined(self.before.graph, self.closure)

    @cached_property
    def values(self) -> gtsam.Values:
        """The map optimised with the closure, in the caller's noise models."""
        with self._timed("optimisation"):
            held = still_held(self.before.held, self.together, self.before.values)
            return optimised(self.together, self.before.values, held=held, max_iterations=TRIAL_ITERATIONS)

    @cached_property
    def pose_graph(self) -> PoseGraph:
        """The map with the closure, adapted."""
        values = self.values
        with self._timed("adaptation"):
            return self.before.with_closure(self.closure, values)

    @cached_property
    def evidence(self) -> Evidence:
        """Everything that the closure changes."""
        before, unit, old = self.before, self.before.yardstick.unit_m, self.before.contacts
        pose_graph = self.pose_graph
        with self._timed("spectra"):
            new = contacts(pose_graph)
            score, worst = local_rise(old, new)
        after_m = largest_strain_m([*before.closures, *factors_of(self.closure)], self.values)
        return Evidence(
            unit_m=unit,
            local_score=score,
            worst_key=None if worst is None else int(before.pose_graph.keys[worst]),
            strain=Change(before=before.strain_m / unit, after=after_m / unit),
            bending=self.bending,
            overlaps=Change(before=old.unexplained, after=new.unexplained),
            radius_loss=_radius_loss(old, new),
            chi2=Change(before=2 * before.graph.error(before.values), after=2 * self.together.error(self.values)),
            chi2_dof=sum(factor.dim() for factor in factors_of(self.closure)),
        )

    @property
    def seconds(self) -> Seconds:
        """Wall-clock time that was spent so far, with that on the map without the closure."""
        adaptation, optimisation = self.before.seconds
        return Seconds(
            adaptation=adaptation + self._spent["adaptation"],
            optimisation=optimisation + self._spent["optimisation"],
            spectra=self._spent["spectra"],
        )

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self._spent[part] += time.perf_counter() - started


def _radius_loss(before: Contacts, after: Contacts) -> float:
    old, new = before.pose_graph.radii, after.pose_graph.radii
    return float(np.max(1 - np.divide(new, old, out=np.ones_like(old), where=old > 0), initial=0.0))
