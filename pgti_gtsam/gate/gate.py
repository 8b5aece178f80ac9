"""The gate: closures and a map -> the true closures, with probabilities and reasons."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.special import logit

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.checks import in_a_line
from pgti_gtsam.drift.left_out import given_others
from pgti_gtsam.drift.log_odds import log_odds
from pgti_gtsam.drift.settled import Settled, solvable
from pgti_gtsam.drift.ties import Ties
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError, MissingValueError
from pgti_gtsam.factor_graphs import Closure, check_map, checked_closure, closure_graphs, factors_of, keys_of
from pgti_gtsam.gate import paper_rule
from pgti_gtsam.gate.admission import DOUBT, Admission, Weight, some_of
from pgti_gtsam.gate.candidate_map import CandidateMaps
from pgti_gtsam.gate.decision import ClosureDecision, Term, Verdict
from pgti_gtsam.gate.kept.grown_map import GrownMap
from pgti_gtsam.gate.options import GateOptions
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.gate.terms import contact_rise
from pgti_gtsam.pose_graph import PoseGraph, Radii, key_label

_LOG = logging.getLogger(__name__)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judgement:
    """Verdicts on some closures, and the map with the closures that passed.

    Attributes
    ----------
    decisions : tuple of ClosureDecision
        A decision for each closure, in the order given.
    settled : Settled
        The last optimum of the drift model that decided a verdict; closures that passed after it are not in it.
    """

    decisions: tuple[ClosureDecision, ...]
    settled: Settled

    @property
    def accepted(self) -> tuple[int, ...]:
        """Whether each closure passed."""
        return tuple(k for k, decision in enumerate(self.decisions) if decision.accepted)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopClosureGate:
    """Judges loop closures by drift and free space. The gate has options, and no state."""

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
        """A map as the gate reads maps: `from_gtsam` with the gate's options.

        Parameters
        ----------
        graph, values
        radii : Radii, optional
            As for `from_gtsam`.
        closures : collection of int, optional
            Slots of the loop closures, where known.
        """
        options = self.options
        return from_gtsam(
            graph,
            values,
            radii=radii,
            edges=options.edges,
            min_shared_landmarks=options.min_shared_landmarks,
            closures=closures,
            information=False,
        )

    def reference_map(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        radii: Radii | None = None,
        closures: Collection[int] | None = None,
    ) -> ReferenceMap:
        """The map before any candidate, for `judge`: worth keeping where several closures are weighed against the same
        map.

        Parameters
        ----------
        graph, values, radii, closures
            As in `from_gtsam`.

        Raises
        ------
        MissingValueError, InvalidGraphError
            A key without a value, or a value of another type than a factor asks for.
        UnsolvableGraphError
            The ties are so far apart in scale that nothing can be predicted.
        PgtiError
            As of `from_gtsam`.
        """
        check_map(graph, values)
        _check_values(graph, values)
        pose_graph = self.adapted(graph, values, radii, closures)
        return ReferenceMap.of(graph, values, pose_graph, self.options.beta)

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
            The map without the closure. Noise models are not read: the drift model brings tolerances of its own.
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
        PgtiError
            As of `reference_map`.
        """
        return self.evaluate_group(graph, values, [closure], radii).decisions[0]

    def evaluate_many(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[Closure],
        radii: Radii | None = None,
    ) -> list[ClosureDecision]:
        """Judge independent candidates, each against the same map; decisions in the same order.

        Parameters
        ----------
        graph, values
        closures : sequence of Closure
        radii : Radii, optional
            As for `from_gtsam`.
        """
        check_map(graph, values)
        offered = [checked_closure(closure, values) for closure in closure_graphs(closures)]
        reference = self.reference_map(graph, values, radii)
        return [self.judge(reference, [closure]).decisions[0] for closure in offered]

    def evaluate_group(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        closures: Sequence[Closure],
        radii: Radii | None = None,
    ) -> Judgement:
        """Judge closures that arrived together, the surest first: see `admission`.

        Parameters
        ----------
        graph, values
        closures : sequence of Closure
        radii : Radii, optional
            As for `from_gtsam`.
        """
        check_map(graph, values)
        offered = [checked_closure(closure, values) for closure in closure_graphs(closures)]
        return self.judge(self.reference_map(graph, values, radii), offered)

    @solvable()
    def judge(
        self,
        reference: ReferenceMap,
        closures: Sequence[gtsam.NonlinearFactorGraph],
        progress: Callable[[int, int], None] = lambda done, of: None,
    ) -> Judgement:
        """Judge any number of closures by all that is known of the map and by each other.

        Parameters
        ----------
        reference : ReferenceMap
        closures : sequence of gtsam.NonlinearFactorGraph
            As from `factor_graphs.checked_closure`.
        progress : callable
            Told how many closures are judged, and of how many.

        Raises
        ------
        UnsolvableGraphError
            See `solvable`.
        """
        # the closures as ties that do not hold yet, those of one revisit together
        settled, rows = reference.offered(closures)
        maps = CandidateMaps(reference=reference, offered=settled)
        weights = [Weight(ties=ties) for ties in reference.revisits(settled)]

        # which of them hold, and why
        contradicted: dict[int, float] = {}
        if self.options.rule == "log_odds":
            admission = Admission(
                model=settled.model,
                needed=self._needed,
                contacts_of=maps.contacts,
                active=settled.active,
                weights=weights,
                nearest=settled,
                progress=progress,
            )
            admission.run()
            settled, active, contradicted = admission.nearest, admission.active, admission.member_odds
            terms = [_terms(weight, reference.pose_graph) for weight in weights]
        else:
            settled, terms = paper_rule.admitted(settled, weights, maps.integrity, self.options)
            active = settled.active

        # the verdict on each closure is that on the revisit which it is part of
        revisit_of = {int(tie): k for k, weight in enumerate(weights) for tie in weight.ties}
        is_scored = self.options.wants_scores(len(reference.pose_graph) * len(weights))
        scores = maps.scores(active, [weight.ties for weight in weights]) if is_scored and weights else None
        decisions = []
        for own in rows:
            if not own:
                decisions.append(_ties_nothing())
                continue
            k = max((revisit_of[tie] for tie in own), key=lambda k: len(weights[k].ties))
            against = [contradicted[tie] for tie in own if tie in contradicted]
            keys = reference.pose_graph.keys[np.unique(settled.model.ties.pairs[own])].tolist()
            score, global_score = (None, None) if scores is None else scores[k]
            decisions.append(
                replace(
                    self._decision(terms[k], against, is_tied=bool(active[own].all())),
                    keys=tuple(keys),
                    judged_with=len(weights[k].ties),
                    score=score,
                    global_score=global_score,
                )
            )
        return Judgement(decisions=tuple(decisions), settled=settled)

    def foreseen(
        self, grown: GrownMap, closure: gtsam.NonlinearFactorGraph
    ) -> tuple[ClosureDecision, GrownMap | None] | None:
        """Judge a closure by the drift alone, without a new optimum.

        Parameters
        ----------
        grown : GrownMap
        closure : gtsam.NonlinearFactorGraph
            As from `factor_graphs.checked_closure`.

        Returns
        -------
        (ClosureDecision, GrownMap or None) or None
            The verdict, and the map with the closure if passed, None where the closure takes more than a linear step.
            None for both where the verdict needs more evidence: the closure is no single between factor, nothing
            predicts the closure, the free space has to be asked, or another rule than the default decides.
        """
        tie = grown.offered(closure)
        if tie is None or self.options.rule != "log_odds":
            return None
        predicted = grown.predicted(tie)
        decision = self._decided_by_drift(grown, tie, predicted.missed, predicted.spread)
        if decision is None:
            return None
        tied = grown.tied(predicted) if decision.accepted else grown
        return replace(decision, keys=_keys(closure)), tied

    @solvable()
    def reviewed(
        self, grown: GrownMap, closures: Sequence[gtsam.NonlinearFactorGraph], held: Sequence[bool]
    ) -> tuple[ClosureDecision, ...] | None:
        """Judge a revisit by the drift alone, against a map without the revisit and without a new optimum.

        Parameters
        ----------
        grown : GrownMap
        closures : sequence of gtsam.NonlinearFactorGraph
            All closures of the revisit.
        held : sequence of bool
            Which of the closures hold in the map.

        Returns
        -------
        tuple of ClosureDecision or None
            None where the verdict needs more: see `foreseen`; or the closures disagree with each other.
        """
        ties = [tie for closure in closures if (tie := grown.offered(closure)) is not None]
        if len(ties) < len(closures) or self.options.rule != "log_odds":
            return None
        offered = reduce(Ties.joined, ties)
        predicted = grown.predicted_without(offered, held)
        if predicted is None or not grown.agree(offered, predicted[0]):
            return None

        # all together, and each against the others
        decision = self._decided_by_drift(grown, offered, *predicted)
        if decision is None:
            return None
        if decision.accepted and len(ties) > 1:
            odds = log_odds(grown.units, *given_others(*predicted, offered.variances))
            if (odds < 0).any():
                return None
        return tuple(replace(decision, keys=_keys(closure), judged_with=len(ties)) for closure in closures)

    def _decided_by_drift(self, grown: GrownMap, offered: Ties, missed: Array, spread: Array) -> ClosureDecision | None:
        """The verdict on closures of a revisit by some members; None where the free space has to be asked."""
        weight, d = Weight(ties=np.arange(len(missed))), missed.shape[1]
        own = some_of(weight.ties)
        rows = (d * own[:, None] + np.arange(d)).ravel()
        later = [grown.pose(j) for j in offered.pairs[own, 1].tolist()]
        weight.weigh(grown.units, later, missed[own], spread[np.ix_(rows, rows)])
        passes = weight.drift >= max(DOUBT, self._needed)
        if not passes and not weight.drift <= self._needed - contact_rise.log_odds(0.0):
            return None
        return self._decision({"drift": weight.drift_term}, [], is_tied=passes)

    @property
    def _needed(self) -> float:
        return float(logit(self.options.min_probability))

    def _decision(self, terms: Mapping[str, Term], against: Sequence[float], *, is_tied: bool) -> ClosureDecision:
        """The verdict by some evidence, and by the contradiction of all the other members."""
        odds = min([sum(term.log_odds for term in terms.values()), *against])
        open_: Verdict = "rejected" if odds <= -self._needed else "undecided"
        heaviest = sorted(terms.values(), key=lambda term: -abs(float(np.nan_to_num(term.log_odds))))
        verdict: Verdict = "accepted" if is_tied else open_
        reasons = tuple(term.sentence for term in heaviest)
        _LOG.debug("%s with log odds %.3g. %s", verdict, odds, reasons[0] if reasons else "")
        return ClosureDecision(verdict=verdict, log_odds=odds, terms=terms, reasons=reasons, keys=())


def _check_values(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Refuse a map with a key that has no value, or with a value of another type than a factor asks for."""
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
            f"expected factors that fit the values' types, got: {in_a_line(error)}; look for a factor of Pose2 among "
            "Pose3, or the reverse"
        ) from error


def _terms(weight: Weight, pose_graph: PoseGraph) -> dict[str, Term]:
    terms = {"drift": weight.drift_term}
    if weight.rise is not None:
        label = None if weight.worst is None else key_label(int(pose_graph.keys[weight.worst]))
        terms["contact_rise"] = contact_rise.term(weight.rise, label)
    return terms


def _keys(closure: gtsam.NonlinearFactorGraph) -> tuple[int, ...]:
    return tuple(sorted({key for factor in factors_of(closure) for key in keys_of(factor)}))


def _ties_nothing() -> ClosureDecision:
    """A closure between keyframes that the map does not relate: no evidence, and no motion."""
    return ClosureDecision(
        verdict="accepted",
        log_odds=np.nan,
        terms={},
        reasons=("It ties no two keyframes: nothing speaks against the closure, and nothing for it.",),
        keys=(),
    )
