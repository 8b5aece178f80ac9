"""A gate in front of every loop closure: evidence in units of free space -> accepted or rejected, and why."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import gtsam
import numpy as np

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import Closure, check_map, checked_closure, closure_graphs, joined
from pgti_gtsam.gate.attempt import Attempt
from pgti_gtsam.gate.evidence import Change, Evidence, Seconds
from pgti_gtsam.gate.rules import (
    GateOptions,
    bending_objection,
    chi2_objections,
    doubt,
    free_space_objections,
    global_rise_objections,
    hopeless,
    no_objection,
)
from pgti_gtsam.gate.survey import Radii, Survey, survey
from pgti_gtsam.integrity import Integrity, assess
from pgti_gtsam.pose_graph import PoseGraph


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosureDecision:
    """Verdict on one closure.

    Attributes
    ----------
    accepted : bool
    reasons : tuple of str
        Short sentences: every limit that was exceeded, or why there is no objection. Where the bending alone
        condemns a closure, nothing else has been asked.
    doubt : float
        What the default rule holds against the closure, which it rejects beyond one; where the bending alone
        is beyond one, the bending's share.
    options : GateOptions
    attempt : Attempt
    """

    accepted: bool
    reasons: tuple[str, ...]
    doubt: float
    options: GateOptions
    attempt: Attempt = field(repr=False)

    @property
    def evidence(self) -> Evidence:
        """Every measured quantity, before and after; what the verdict did not need is measured now."""
        return self.attempt.evidence

    @property
    def closure(self) -> gtsam.NonlinearFactorGraph:
        """The factors that were judged."""
        return self.attempt.closure

    @property
    def values(self) -> gtsam.Values:
        """The map optimised with the closure, in the caller's noise models, whatever the verdict."""
        return self.attempt.values

    @property
    def seconds(self) -> Seconds:
        """Time spent so far. What several candidates share counts in each."""
        return self.attempt.seconds

    @property
    def survey(self) -> Survey:
        """The map that the closure was weighed against."""
        return self.attempt.before

    @property
    def before(self) -> Integrity:
        """PGTI of the map without the closure, computed when first asked for."""
        return self.survey.integrity

    @cached_property
    def after(self) -> Integrity:
        """PGTI of the map with the closure, computed when first asked for."""
        return assess(self.pose_graph, beta=self.options.beta)

    @cached_property
    def pose_graph(self) -> PoseGraph:
        """The map with the closure, as `from_gtsam` reads it."""
        return self.survey.adapted(self.attempt.together, self.values)

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

    def __post_init__(self) -> None:
        if not isinstance(self.options, GateOptions):
            raise InvalidOptionError(f"expected GateOptions as the options of a gate, got {self.options!r}")

    def adapted(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        radii: Radii | None = None,
        closures: Collection[int] | None = None,
    ) -> PoseGraph:
        """A map as the gate reads it: `from_gtsam` with the gate's options."""
        return from_gtsam(
            graph,
            values,
            radii=radii,
            edges=self.options.edges,
            min_shared_landmarks=self.options.min_shared_landmarks,
            closures=closures,
        )

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
        closure: Closure,
        radii: Radii | None = None,
    ) -> ClosureDecision:
        """Judge one closure. Graph, values and closure stay untouched.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
            The map without the closure. Components that no prior holds are held at a pose of theirs.
        values : gtsam.Values
            An estimate; the gate optimises its own copy from there.
        closure : gtsam.NonlinearFactor, sequence of them, or gtsam.NonlinearFactorGraph
            Factors between keyframes of the map, which stand or fall together; empty slots are passed over. One
            that repeats a tie which the map already has changes nothing and is accepted; odometry is judged like
            any other.
        radii : float or mapping from key to float, m, optional
            As in `from_gtsam`.

        Raises
        ------
        InvalidClosureError
            An empty closure or another type, a key without a value or with one of a type that the factor does not
            take, a measurement that is not finite.
        UnsolvableGraphError
            The map has no optimum.
        PgtiError
            Those of `from_gtsam`.
        """
        check_map(graph, values)
        checked = checked_closure(closure, values)
        return self.judge(self.survey(graph, values, radii), checked)

    def evaluate_many(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[Closure],
        radii: Radii | None = None,
    ) -> list[ClosureDecision]:
        """Judge independent candidates, each against the same map; decisions come in their order."""
        check_map(graph, values)
        checked = [checked_closure(closure, values) for closure in closure_graphs(closures)]
        before = self.survey(graph, values, radii)
        return [self.judge(before, closure) for closure in checked]

    def evaluate_group(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[Closure],
        radii: Radii | None = None,
    ) -> GroupDecision:
        """Judge closures that arrived together: all at once, and where that fails in parts.

        Members that most others agree with come first, among equals those for which the map need bend least.
        A part that fails is halved, and its second half judged with what the first one left, down to single
        closures, so that one bad match does not sink nine good ones.
        """
        check_map(graph, values)
        checked = [checked_closure(closure, values) for closure in closure_graphs(closures)]
        return self.judge_group(self.survey(graph, values, radii), checked)

    def judge(self, before: Survey, closure: Closure) -> ClosureDecision:
        """Judge one closure against a map that was surveyed."""
        attempt = Attempt(before=before, closure=checked_closure(closure, before.values))
        options = self.options
        if options.rule == "free_space" and hopeless(attempt.bending, options):
            return ClosureDecision(
                accepted=False,
                reasons=(bending_objection(attempt.bending, options),),
                doubt=attempt.bending / options.max_bending,
                options=options,
                attempt=attempt,
            )
        evidence = attempt.evidence
        tried = ClosureDecision(
            accepted=True, reasons=(), doubt=doubt(evidence, options), options=options, attempt=attempt
        )
        if options.rule == "global_rise":
            objections = global_rise_objections(tried.global_score, options)
        else:
            objections = free_space_objections(evidence, options)
        if options.chi2_confidence is not None:
            objections += chi2_objections(evidence, options.chi2_confidence)
        reasons = objections or [no_objection(evidence)]
        return replace(tried, accepted=not objections, reasons=tuple(reasons))

    def judge_group(self, before: Survey, closures: Sequence[Closure]) -> GroupDecision:
        """Judge closures that arrived together against a map that was surveyed."""
        offered = closure_graphs(closures)
        decisions: dict[int, ClosureDecision] = {}
        parts = [list(range(len(offered)))]
        while parts:
            part = parts.pop()
            if not part:
                continue
            decision = self.judge(before, joined(*(offered[k] for k in part)))
            if decision.accepted:
                before = admitted(before, decision)
            if decision.accepted or len(part) == 1:
                decisions |= dict.fromkeys(part, decision)
            else:
                ordered = part if len(part) < len(offered) else most_trusted_first(before, offered)
                middle = len(part) // 2
                parts += [ordered[middle:], ordered[:middle]]
        return GroupDecision(decisions=tuple(decisions[k] for k in range(len(offered))), survey=before)


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
    bendings = np.array([before.yardstick.bending(closure) for closure in closures])
    return [int(k) for k in np.lexsort((bendings, -votes))]
