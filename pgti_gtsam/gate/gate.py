"""The gate: closures and a map -> which of them are true, how probable, and why."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import gtsam
import numpy as np
from scipy.special import logit

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.adapter.values import Keyframes, read_keyframes
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError, MissingValueError
from pgti_gtsam.factor_graphs import Closure, check_map, checked_closure, closure_graphs
from pgti_gtsam.gate import paper_rule
from pgti_gtsam.gate.admission import Admission, Weight
from pgti_gtsam.gate.candidates import agreeing, implied_tie, measured_ties
from pgti_gtsam.gate.decision import ClosureDecision, Term, Verdict
from pgti_gtsam.gate.drift_model import Settled, drift_model
from pgti_gtsam.gate.map_with import MapWith
from pgti_gtsam.gate.options import GateOptions
from pgti_gtsam.gate.terms import contact_rise, drift
from pgti_gtsam.pose_graph import PoseGraph, Radii
from pgti_gtsam.track import track_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judgement:
    """Verdicts on some closures, and the map with those that passed.

    Attributes
    ----------
    decisions : tuple of ClosureDecision
        One for each closure, in the order given.
    settled : Settled
        The drift model with them.
    """

    decisions: tuple[ClosureDecision, ...]
    settled: Settled

    @property
    def accepted(self) -> tuple[int, ...]:
        """Which closures passed."""
        return tuple(k for k, decision in enumerate(self.decisions) if decision.accepted)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopClosureGate:
    """Judges loop closures by drift and free space. It holds options, and no state."""

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
        options = self.options
        return from_gtsam(
            graph,
            values,
            radii=radii,
            edges=options.edges,
            min_shared_landmarks=options.min_shared_landmarks,
            closures=closures,
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
            The map without the closure. Noise models are not read: what holds is what the drift model grants.
        values : gtsam.Values
            An estimate.
        closure : factor, list of factors or gtsam.NonlinearFactorGraph
            Factors that stand or fall together: between factors, or sightings of landmarks that the map knows.
        radii : float or mapping from key to float, m, optional
            As in `from_gtsam`.

        Raises
        ------
        InvalidClosureError
            An empty closure, a key without a value, a measurement that is not finite.
        UnsolvableGraphError
            The ties are so far apart in scale that nothing can be predicted.
        PgtiError
            Those of `from_gtsam`.
        """
        return self.judge(graph, values, [closure], radii).decisions[0]

    def evaluate_many(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[Closure],
        radii: Radii | None = None,
    ) -> list[ClosureDecision]:
        """Judge independent candidates, each against the same map; decisions come in their order."""
        offered = closure_graphs(closures)
        for closure in offered:
            checked_closure(closure, values)
        return [self.evaluate(graph, values, closure, radii) for closure in offered]

    def evaluate_group(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[Closure],
        radii: Radii | None = None,
    ) -> Judgement:
        """Judge closures that arrived together, the surest first: see `admission`."""
        return self.judge(graph, values, closures, radii)

    def judge(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[Closure],
        radii: Radii | None = None,
        *,
        odometry_is_sure: bool = False,
        progress: Callable[[int, int], None] = lambda done, of: None,
    ) -> Judgement:
        """Judge any number of closures by all that is known of the map and by each other.

        Parameters
        ----------
        graph, values, radii
            As in `evaluate`.
        closures : sequence of closures
        progress : callable
            Told how many closures are judged, and of how many.
        odometry_is_sure : bool
            Whether every factor between two keyframes of the map is odometry; `track.roles` tells otherwise.
        """
        # the map, and the closures as ties that do not hold yet
        check_map(graph, values)
        _check_values(graph, values)
        offered = [checked_closure(closure, values) for closure in closure_graphs(closures)]
        pose_graph = self.adapted(graph, values, radii, [] if odometry_is_sure else None)
        base, keyframes = drift_model(graph, values, pose_graph), read_keyframes(values)
        ties = [measured_ties(each, keyframes) or _implied(each, graph, keyframes, base.unit_m) for each in offered]
        model = base.extended([tie for own in ties for tie in own])
        rows = _rows(len(base.ties.pairs), ties)
        settled = model.settled(np.arange(len(model.ties.pairs)) < len(base.ties.pairs))

        # which of them hold
        found = MapWith(pose_graph=pose_graph, first=len(base.ties.pairs), beta=self.options.beta)
        own = np.arange(len(base.ties.pairs), len(model.ties.pairs))
        weights = [Weight(ties=each) for each in agreeing(settled, own, track_of(pose_graph).way_m / model.unit_m)]
        known: dict[int, Term] = {}
        contradicted: dict[int, float] = {}
        if self.options.rule == "log_odds":
            admission = Admission(
                model=model,
                needed=float(logit(self.options.min_probability)),
                contacts_of=found.contacts,
                active=settled.active,
                weights=weights,
                settled=settled,
                progress=progress,
            )
            admission.run()
            settled, contradicted = admission.settled, admission.member_odds
        else:
            settled, known = paper_rule.admitted(settled, weights, found.integrity, self.options)
        return Judgement(
            decisions=self._decisions(rows, weights, settled, contradicted, known, found, pose_graph), settled=settled
        )

    def _decisions(
        self,
        rows: list[list[int]],
        weights: list[Weight],
        settled: Settled,
        contradicted: dict[int, float],
        known: dict[int, Term],
        found: MapWith,
        pose_graph: PoseGraph,
    ) -> tuple[ClosureDecision, ...]:
        """What was found, closure by closure."""
        group_of = {int(tie): k for k, each in enumerate(weights) for tie in each.ties}
        scores = [found.scores(settled, each.ties) for each in weights] if self.options.scores else None
        decisions = []
        for own in rows:
            if not own:
                decisions.append(_ties_nothing())
                continue
            group = min((group_of[tie] for tie in own), key=lambda k: -len(weights[k].ties))
            terms = {self.options.rule: known[group]} if known else _terms(weights[group], pose_graph)
            odds = sum(term.log_odds for term in terms.values())
            odds = min([odds, *(contradicted[tie] for tie in own if tie in contradicted)])
            keys = sorted({int(pose_graph.keys[k]) for tie in own for k in settled.model.ties.pairs[tie]})
            decision = ClosureDecision(
                verdict=self._verdict(odds, is_tied=bool(settled.active[own].all())),
                log_odds=odds,
                terms=terms,
                reasons=tuple(
                    t.sentence for t in sorted(terms.values(), key=lambda t: -abs(np.nan_to_num(t.log_odds)))
                ),
                keys=tuple(keys),
                judged_with=len(weights[group].ties),
            )
            if scores is not None:
                decision = replace(decision, score=scores[group][0], global_score=scores[group][1])
            decisions.append(decision)
        return tuple(decisions)

    def _verdict(self, odds: float, *, is_tied: bool) -> Verdict:
        if is_tied:
            return "accepted"
        return "rejected" if odds <= -float(logit(self.options.min_probability)) else "undecided"


def _check_values(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Refuse a map with a key that has no value, or with one of another type than a factor asks for."""
    missing = next((key for key in graph.keyVector() if not values.exists(key)), None)
    if missing is not None:
        raise MissingValueError(
            f"expected a value for every key, got none for {gtsam.DefaultKeyFormatter(missing)}; "
            "add it to the values or remove its factors"
        )
    try:
        graph.error(values)
    except (RuntimeError, ValueError) as error:
        raise InvalidGraphError(
            f"expected factors that fit the values' types, got: {str(error).strip()}; look for a factor of Pose2 among "
            "Pose3, or the reverse"
        ) from error


def _implied(
    closure: gtsam.NonlinearFactorGraph, graph: gtsam.NonlinearFactorGraph, keyframes: Keyframes, unit_m: float
) -> list[Any]:
    tie = implied_tie(closure, graph, keyframes, unit_m)
    return [] if tie is None else [tie]


def _rows(first: int, ties: Sequence[Sequence[Any]]) -> list[list[int]]:
    """Which ties of the model each closure is."""
    ends = first + np.cumsum([0, *map(len, ties)])
    return [list(range(a, b)) for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]


def _terms(weight: Weight, pose_graph: PoseGraph) -> dict[str, Term]:
    terms = {"drift": drift.term(weight.drift, weight.missed_m, weight.missed_rad, weight.allowed_m)}
    if weight.rise is not None:
        label = None if weight.worst is None else pose_graph.labels[weight.worst]
        terms["contact_rise"] = contact_rise.term(weight.rise, label)
    return terms


def _ties_nothing() -> ClosureDecision:
    """A closure between keyframes of which nothing can be said, and that moves nothing."""
    return ClosureDecision(
        verdict="accepted",
        log_odds=np.nan,
        terms={},
        reasons=("It ties no two keyframes: nothing speaks against the closure, and nothing for it.",),
        keys=(),
    )
