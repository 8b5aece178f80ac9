"""A gate in front of every loop closure: evidence in units of free space -> accepted or rejected, and why."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import gtsam
import numpy as np

from pgti_gtsam.gate.evidence import Change, Contacts, Evidence, Seconds, contacts, local_rise
from pgti_gtsam.gate.rules import (
    GateOptions,
    chi2_objections,
    doubts,
    free_space_objections,
    global_rise_objections,
    no_objection,
)
from pgti_gtsam.gate.survey import Radii, Survey, survey
from pgti_gtsam.gate.trial import TRIAL_ITERATIONS, checked_closure, factors_of, joined, largest_strain_m, optimised
from pgti_gtsam.integrity import Integrity, assess
from pgti_gtsam.pose_graph import PoseGraph


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosureDecision:
    """Verdict on one closure.

    Attributes
    ----------
    accepted : bool
    reasons : tuple of str
        Short sentences: every limit that was exceeded, or why there is no objection.
    evidence : Evidence
    closure : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        The map optimised with the closure, in the caller's noise models, whatever the verdict.
    """

    accepted: bool = False
    reasons: tuple[str, ...] = ()
    evidence: Evidence
    closure: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    options: GateOptions
    survey: Survey = field(repr=False)

    @property
    def doubt(self) -> float:
        """What is left of the case for the closure: rejected, by the default rule, beyond one."""
        return sum(doubts(self.evidence, self.options).values())

    @property
    def before(self) -> Integrity:
        """PGTI of the map without the closure, computed when first asked for."""
        return self.survey.integrity

    @cached_property
    def after(self) -> Integrity:
        """PGTI of the map with the closure, computed when first asked for."""
        return assess(self.pose_graph, beta=self.survey.beta)

    @cached_property
    def pose_graph(self) -> PoseGraph:
        """The map with the closure, as `from_gtsam` reads it."""
        return self.survey.adapted(joined(self.survey.graph, self.closure), self.values)

    @property
    def score(self) -> Change:
        """Λ before and after."""
        return Change(before=self.before.score, after=self.after.score)

    @property
    def global_score(self) -> Change:
        """Λ_glob before and after: the evidence of the paper's rule."""
        return Change(before=self.before.split().global_, after=self.after.split().global_)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroupDecision:
    """Verdict on closures that arrived together.

    Attributes
    ----------
    decisions : tuple of ClosureDecision
        One for each closure, in the order given: that of the largest part which it passed or failed in.
    survey : Survey
        The map with every accepted closure.
    """

    decisions: tuple[ClosureDecision, ...]
    survey: Survey

    @property
    def accepted(self) -> tuple[int, ...]:
        """Which closures passed."""
        return tuple(k for k, decision in enumerate(self.decisions) if decision.accepted)

    @property
    def values(self) -> gtsam.Values:
        """The optimum with every accepted closure."""
        return self.survey.values


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopClosureGate:
    """Judges loop closures by what they do to free space. It holds options, and no state."""

    options: GateOptions = field(default_factory=GateOptions)

    def survey(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, radii: Radii | None = None) -> Survey:
        """The map before any candidate, for `judge`: worth keeping where several are weighed against it.

        Raises
        ------
        PgtiError
            Those of `from_gtsam`; `UnsolvableGraphError` where the map has no optimum.
        """
        options = self.options
        return survey(
            graph,
            values,
            radii,
            edges=options.edges,
            min_shared_landmarks=options.min_shared_landmarks,
            beta=options.beta,
        )

    def evaluate(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closure: gtsam.NonlinearFactorGraph,
        radii: Radii | None = None,
    ) -> ClosureDecision:
        """Judge one closure. Graph, values and closure stay untouched.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
            The map without the closure. Components that no prior holds are held at a pose of theirs.
        values : gtsam.Values
            An estimate; the gate optimises its own copy from there.
        closure : gtsam.NonlinearFactorGraph
            Factors between keyframes of the map, which stand or fall together. One that repeats a tie
            which the map already has changes nothing and is accepted; odometry is judged like any other.
        radii : float or mapping from key to float, m, optional
            As in `from_gtsam`.

        Raises
        ------
        InvalidClosureError
            An empty closure, a key without a value, a measurement that is not finite.
        UnsolvableGraphError
            The map has no optimum.
        PgtiError
            Those of `from_gtsam`.
        """
        checked_closure(closure, values)
        return self.judge(self.survey(graph, values, radii), closure)

    def evaluate_many(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[gtsam.NonlinearFactorGraph],
        radii: Radii | None = None,
    ) -> list[ClosureDecision]:
        """Judge independent candidates, each against the same map; decisions come in their order."""
        for closure in closures:
            checked_closure(closure, values)
        before = self.survey(graph, values, radii)
        return [self.judge(before, closure) for closure in closures]

    def evaluate_group(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[gtsam.NonlinearFactorGraph],
        radii: Radii | None = None,
    ) -> GroupDecision:
        """Judge closures that arrived together: all at once, and where that fails in parts.

        Members that most others agree with come first, among equals those for which the map need bend least.
        A part that fails is halved, and its second half judged with what the first one left, down to single
        closures, so that one bad match does not sink nine good ones.
        """
        for closure in closures:
            checked_closure(closure, values)
        return self.judge_group(self.survey(graph, values, radii), closures)

    def judge(self, before: Survey, closure: gtsam.NonlinearFactorGraph) -> ClosureDecision:
        """Judge one closure against a map that was surveyed."""
        checked_closure(closure, before.values)
        decision = _tried(before, closure, self.options)
        evidence, options = decision.evidence, self.options
        if options.rule == "global_rise":
            objections = global_rise_objections(decision.global_score, options)
        else:
            objections = free_space_objections(evidence, options)
        if options.chi2_confidence is not None:
            objections += chi2_objections(evidence, options.chi2_confidence)
        reasons = objections or [no_objection(evidence)]
        return replace(decision, accepted=not objections, reasons=tuple(reasons))

    def judge_group(self, before: Survey, closures: Sequence[gtsam.NonlinearFactorGraph]) -> GroupDecision:
        """Judge closures that arrived together against a map that was surveyed."""
        decisions: dict[int, ClosureDecision] = {}
        parts = [list(range(len(closures)))]
        while parts:
            part = parts.pop()
            if not part:
                continue
            decision = self.judge(before, joined(*(closures[k] for k in part)))
            if decision.accepted:
                before = admitted(before, decision)
            if decision.accepted or len(part) == 1:
                decisions |= dict.fromkeys(part, decision)
            else:
                ordered = part if len(part) < len(closures) else most_trusted_first(before, closures)
                middle = len(part) // 2
                parts += [ordered[middle:], ordered[:middle]]
        return GroupDecision(decisions=tuple(decisions[k] for k in range(len(closures))), survey=before)


def admitted(before: Survey, decision: ClosureDecision) -> Survey:
    """The map with an accepted closure, which is at its optimum already."""
    started = time.perf_counter()
    return Survey(
        graph=joined(before.graph, decision.closure),
        values=decision.values,
        pose_graph=decision.pose_graph,
        adaptation=before.adaptation,
        beta=before.beta,
        seconds=(time.perf_counter() - started, 0.0),
    )


def most_trusted_first(before: Survey, closures: Sequence[gtsam.NonlinearFactorGraph]) -> list[int]:
    """Closures by how many of the others agree with them, among equals by how little the map need bend."""
    votes = before.yardstick.votes(closures)
    bendings = np.array([before.yardstick.bending(closure, before.values) for closure in closures])
    return [int(k) for k in np.lexsort((bendings, -votes))]


def _tried(before: Survey, closure: gtsam.NonlinearFactorGraph, options: GateOptions) -> ClosureDecision:
    """Add, optimise, adapt, compare; no verdict yet."""
    started = time.perf_counter()
    together = joined(before.graph, closure)
    values = optimised(together, before.values, max_iterations=TRIAL_ITERATIONS)
    bending = before.yardstick.bending(closure, values)
    optimal = time.perf_counter()
    pose_graph = before.with_closure(closure, values)
    adapted = time.perf_counter()
    after = contacts(pose_graph)
    score, worst = local_rise(before.contacts, after)
    spectral = time.perf_counter()
    unit = before.yardstick.unit_m
    strains = (
        largest_strain_m(before.closures, before.values) / unit,
        largest_strain_m([*before.closures, *factors_of(closure)], values) / unit,
    )
    evidence = Evidence(
        unit_m=unit,
        local_score=score,
        worst_key=None if worst is None else int(before.pose_graph.keys[worst]),
        strain=Change(before=strains[0], after=strains[1]),
        bending=bending,
        overlaps=Change(before=before.contacts.unexplained, after=after.unexplained),
        radius_loss=_radius_loss(before.contacts, after),
        chi2=Change(before=2 * before.graph.error(before.values), after=2 * together.error(values)),
        chi2_dof=sum(factor.dim() for factor in factors_of(closure)),
        seconds=Seconds(
            adaptation=before.seconds[0] + adapted - optimal,
            optimisation=before.seconds[1] + optimal - started,
            spectra=spectral - adapted,
        ),
    )
    return ClosureDecision(evidence=evidence, closure=joined(closure), values=values, options=options, survey=before)


def _radius_loss(before: Contacts, after: Contacts) -> float:
    old, new = before.pose_graph.radii, after.pose_graph.radii
    return float(np.max(1 - np.divide(new, old, out=np.ones_like(old), where=old > 0), initial=0.0))
