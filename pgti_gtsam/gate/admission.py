"""The true closures among candidates: the surest revisit is tied first, and the others are asked again.

Each revisit is weighed by the prediction of the ties so far (`drift.log_odds`). Of the passing revisits, the surest is
taken, and the predictions of the others follow (Gaussian conditioning), so that two contradicting revisits never pass
together; then the map is brought to its optimum, and the rest weighed anew. Where the drift alone leaves doubt, the
free space decides (`terms.contact_rise`); a revisit that the free space refuses is asked again when more is tied. In
the end every member is compared with all the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from pgti_gtsam.drift.left_out import left_out
from pgti_gtsam.drift.log_odds import AGREES, log_odds, log_odds_together
from pgti_gtsam.drift.model import DriftModel
from pgti_gtsam.drift.own_closures import poorer_odometry
from pgti_gtsam.drift.settled import Settled, settle
from pgti_gtsam.drift.units import Units
from pgti_gtsam.gate.decision import Change, Term
from pgti_gtsam.gate.terms import contact_rise, drift
from pgti_gtsam.gate.terms.contact_rise import Contacts, local_rise

MEMBERS = 8
"""Most members by which a revisit is weighed: those between them say nothing new."""

AT_ONCE = 48
"""Most revisits that are taken between one optimum and the next."""

DOUBT = 10.0
"""Log odds of the drift beyond which the free space is not asked."""

WEIGHED = 4 * AT_ONCE
"""Revisits, the surest when last weighed, that are weighed again before all others are."""

HOPELESS = -100.0
"""Log odds below which a revisit is not weighed again: no tie elsewhere brings it back."""

MORE_DRIFT = 1.3
"""Factor by which the odometry must turn out poorer, in variance, before closures that failed are weighed again."""

MOST_ROUNDS = 5
"""Times that refused revisits are asked again."""

MOST_CHECKS = 10
"""Times that members are compared with all the others; each takes out at least the worst."""

Array = NDArray[np.float64]
Ties = NDArray[np.int64]


@dataclass(slots=True, kw_only=True, eq=False)
class Weight:
    """The evidence on a revisit.

    Attributes
    ----------
    ties : (g,) int
        Of the drift model.
    drift : float
        Log odds by the drift when tied, or in the end; NaN where no tie leads between the keyframes, infinite before
        the first weighing.
    missed_m, missed_rad, allowed_m : float
        Difference between the middle member and the prediction, and the prediction's standard deviation.
    rise : Change or None
        Stable score of the keyframe whose score rises most, where the free space was asked; the keyframe's index.
    """

    ties: Ties
    drift: float = np.inf
    missed_m: float = np.nan
    missed_rad: float = np.nan
    allowed_m: float = np.inf
    rise: Change | None = None
    worst: int | None = None
    refused_with: int | None = None

    def note(self, units: Units, missed: Array, spread: Array, odds: float) -> None:
        """Note the evidence of the drift.

        Parameters
        ----------
        units : Units
        missed : (d,) float
            Difference between the middle member and the prediction.
        spread : (d, d) float
            Covariance of the prediction.
        odds : float
            Log odds of all members together.
        """
        place = units.translation
        self.drift = odds
        self.missed_m = float(np.linalg.norm(missed[place]))
        self.missed_rad = float(np.linalg.norm(np.delete(missed, np.arange(len(missed))[place])))
        self.allowed_m = float(units.allowances_m(spread[None])[0])

    def weigh(
        self, units: Units, later: Sequence[Any], missed: Array, spread: Array, unobserved: Array | None = None
    ) -> None:
        """Weigh the revisit by some members.

        Parameters
        ----------
        units : Units
        later : sequence of g gtsam.Pose2 or gtsam.Pose3
            Of the later keyframe of each member.
        missed : (g, d) float
            Differences from the prediction.
        spread : (g d, g d) float
            Joint covariance of the prediction.
        unobserved : (g, d, d) float, optional
            Covariance along the directions that members leave open; none leaves any without.
        """
        odds = np.nan
        if np.isfinite(spread).all():
            whole = spread if unobserved is None else spread + block_diag(*unobserved)
            odds = log_odds_together(units, later, range(len(later)), missed, whole) + AGREES * (len(later) - 1)
        middle, d = len(later) // 2, missed.shape[1]
        inner = slice(middle * d, (middle + 1) * d)
        self.note(units, missed[middle], spread[inner, inner], odds)

    @property
    def drift_term(self) -> Term:
        """The evidence of the drift in words."""
        return drift.term(self.drift, self.missed_m, self.missed_rad, self.allowed_m)

    @property
    def log_odds(self) -> float:
        """All evidence together."""
        return self.drift + (0.0 if self.rise is None else contact_rise.log_odds(self.rise.rise))


@dataclass(slots=True, kw_only=True, eq=False)
class Admission:
    """A map and closures that ask to be tied.

    Attributes
    ----------
    model : DriftModel
    needed : float
        Log odds from which a closure passes.
    contacts_of : callable
        Contacts of the map at an optimum.
    active : (m,) bool
        Ties that hold.
    weights : list of Weight
    member_odds : dict from tie to float
        Log odds of members that all the others contradict, and that were taken out again.
    nearest : Settled
        The last optimum that was computed; ties beyond that optimum may have passed since.
    """

    model: DriftModel
    needed: float
    contacts_of: Callable[[Settled], Contacts]
    active: NDArray[np.bool_]
    weights: list[Weight]
    nearest: Settled
    progress: Callable[[int, int], None] = lambda done, of: None
    member_odds: dict[int, float] = field(default_factory=dict)
    _poorer: float = 1.0
    _contacts: tuple[Settled, Contacts] | None = None
    _rounds: int = 0

    @property
    def settled(self) -> Settled:
        """The optimum of the ties that hold. Computed on demand: most verdicts need no optimum."""
        if not np.array_equal(self.nearest.active, self.active):
            self.nearest = settle(self.model, self.active, self.nearest)
        return self.nearest

    def run(self) -> None:
        """Tie the passing revisits."""
        while self._passes():
            self.progress(self._n_offered() - self._n_open(), self._n_offered())
        self._compare_members()
        self.progress(self._n_offered(), self._n_offered())

    def _passes(self) -> bool:
        """Whether some revisit was tied or refused, or may pass now that could not before."""
        found = self._take(self._surest()) or self._take_doubtful() or self._join_parts()
        return found or self._widened() or self._asked_again()

    def _open(self) -> list[Weight]:
        return [each for each in self.weights if not self.active[each.ties].any() and each.refused_with is None]

    def _n_open(self) -> int:
        return sum(len(each.ties) for each in self._open())

    def _n_offered(self) -> int:
        return sum(len(each.ties) for each in self.weights)

    def _surest(self) -> list[Weight]:
        """Revisits that pass in turn, each given the earlier. Where many are open, few are weighed at a time."""
        hopeful = [each for each in self._open() if not each.drift < HOPELESS]
        if not hopeful:  # no optimum for none
            return []
        new = [each for each in hopeful if each.drift == np.inf]
        for asked in (new or _surest_first(hopeful)[:WEIGHED], hopeful):
            self._weigh_all(asked)
            passing = _surest_first([each for each in asked if each.drift > self.needed])[:AT_ONCE]
            if passing:
                return self._one_by_one(passing)
        return []

    def _weigh_all(self, asked: list[Weight]) -> None:
        """By the present map: single closures at once, revisits in turn."""
        ties, single = self.model.ties, [each for each in asked if len(each.ties) == 1]
        own = np.array([each.ties[0] for each in single], dtype=np.int64)
        spreads = self._poorer * self.settled.covariances(ties.pairs[own])
        odds = log_odds(self.model.units, self.settled.residuals[own], spreads + self.model.unobserved(own))
        for each, residual, spread, found in zip(single, self.settled.residuals[own], spreads, odds, strict=True):
            each.note(self.model.units, residual, spread, float(found))

        # those of several
        rest = [each for each in asked if len(each.ties) > 1]
        members = [some_of(each.ties) for each in rest]
        joint = self.settled.joint_covariances([ties.pairs[some] for some in members])
        for each, some, spread in zip(rest, members, joint, strict=True):
            self._weigh(each, some, self.settled.residuals[some], self._poorer * spread)

    def _one_by_one(self, passing: list[Weight]) -> list[Weight]:
        """The revisits that pass given the earlier, the surest first, where linear predictions hold.

        Conditioning on a revisit takes W Wᵀ off the covariance of all; the blocks are formed on demand. A revisit whose
        prediction one of the earlier turns too far waits for the next optimum.
        """
        members, d = [some_of(each.ties) for each in passing], len(self.model.units.spread)
        pairs = np.concatenate([self.model.ties.pairs[own] for own in members])
        spread = self._poorer * self.settled.joint_covariances([pairs])[0]
        missed = np.concatenate([self.settled.residuals[own].ravel() for own in members])
        known, ends = np.empty((len(missed), 0)), d * np.cumsum([0, *map(len, members)])
        taken: list[Weight] = []
        moved = np.empty((0, len(missed)))
        for each, own, span in zip(passing, members, map(slice, ends[:-1].tolist(), ends[1:].tolist()), strict=True):
            block = spread[span, span] - known[span] @ known[span].T
            if taken:
                if self.model.units.bends(moved[:, span].reshape(-1, d)):
                    continue
                self._weigh(each, own, missed[span].reshape(-1, d), block)
            if each.drift <= self.needed:
                continue
            taken.append(each)

            # what it says of all the others
            root = np.linalg.cholesky(block + np.diag(self.model.ties.variances[own].ravel()))
            columns = np.linalg.solve(root, spread[span] - known[span] @ known.T).T
            moved = np.vstack([moved, columns @ np.linalg.solve(root, missed[span])])
            known, missed = np.hstack([known, columns]), missed - moved[-1]
        return taken

    def _weigh(self, each: Weight, own: Ties, missed: Array, spread: Array) -> None:
        """A revisit of several closures by the differences of some members from the prediction."""
        later = [self.settled.poses[j] for j in self.model.ties.pairs[own, 1].tolist()]
        unobserved = self.model.unobserved(own) if self.model.unobservable else None
        each.weigh(self.model.units, later, missed, spread, unobserved)

    def _take(self, chosen: Sequence[Weight]) -> bool:
        """Tie revisits, but refuse revisits that the free space contradicts; whether there were any."""
        doubtful = [each for each in chosen if each.drift < DOUBT]
        if doubtful:
            tried = self._ask_free_space(doubtful, chosen)
            failing = [each for each in doubtful if each.log_odds <= self.needed]

            # one of several may be at fault
            if failing and len(chosen) > 1:
                self._ask_by_halves(doubtful)
                failing = [each for each in doubtful if each.log_odds <= self.needed]
            for each in failing:
                each.refused_with = int(self.active.sum())
            chosen = [each for each in chosen if each not in failing]
            if not failing:
                self.nearest = tried
        self.active = self._active_with(chosen)
        return bool(chosen or doubtful)

    def _ask_free_space(self, doubtful: Sequence[Weight], chosen: Sequence[Weight]) -> Settled:
        """Note the evidence of the free space on revisits, with all chosen revisits tied; the optimum with those."""
        before = self._contacts_at(self.settled)
        tried = settle(self.model, self._active_with(chosen), self.settled)
        rise = local_rise(before, self._contacts_at(tried))
        for each in doubtful:
            each.rise, each.worst = rise
        return tried

    def _ask_by_halves(self, doubtful: Sequence[Weight]) -> None:
        """Note the evidence of the free space on revisits: together, and by halves where one may be at fault."""
        self._ask_free_space(doubtful, doubtful)
        if len(doubtful) > 1 and any(each.log_odds <= self.needed for each in doubtful):
            middle = len(doubtful) // 2
            self._ask_by_halves(doubtful[:middle])
            self._ask_by_halves(doubtful[middle:])

    def _contacts_at(self, settled: Settled) -> Contacts:
        if self._contacts is None or self._contacts[0] is not settled:
            self._contacts = settled, self.contacts_of(settled)
        return self._contacts[1]

    def _active_with(self, chosen: Sequence[Weight]) -> NDArray[np.bool_]:
        active = self.active.copy()
        for each in chosen:
            active[each.ties] = True
        return active

    def _take_doubtful(self) -> bool:
        """The best revisit that passes if no spheres come into contact."""
        open_ = [each for each in self._open() if each.drift > self.needed - contact_rise.log_odds(0.0)]
        return bool(open_) and self._take([max(open_, key=lambda each: each.drift)])

    def _join_parts(self) -> bool:
        """The largest revisit that joins parts without a tie between: nothing else can place the parts."""
        open_ = [each for each in self._open() if np.isnan(each.drift)]
        return bool(open_) and self._take([max(open_, key=lambda each: len(each.ties))])

    def _widened(self) -> bool:
        """Whether the tied closures show poorer odometry than assumed."""
        tied = self._tied()
        if not len(tied) or (len(tied) == 1 and not self._open()):  # nobody asks how poor: no optimum for that
            return False
        poorer = poorer_odometry(self.model.units, *left_out(self.settled, tied))
        if poorer < MORE_DRIFT * self._poorer:
            return False
        self._poorer = poorer
        return True

    def _asked_again(self) -> bool:
        """Whether revisits are open again that were refused when fewer ties held."""
        held = int(self.active.sum())
        again = [each for each in self.weights if each.refused_with is not None and each.refused_with < held]
        if self._rounds == MOST_ROUNDS or not again:
            return False
        self._rounds += 1
        for each in again:
            each.refused_with = None
        return True

    def _tied(self) -> Ties:
        offered = np.concatenate([np.empty(0, dtype=np.int64), *(each.ties for each in self.weights)])
        return np.asarray(offered[self.active[offered]])

    def _compare_members(self) -> None:
        """Take out members that all the others contradict."""
        for _ in range(MOST_CHECKS):
            tied = self._tied()
            if len(tied) < 2:  # a lone closure was compared with all others when it was weighed
                return
            missed, others = left_out(self.settled, tied)
            odds = log_odds(self.model.units, missed, self._poorer * others + self.model.unobserved(tied))
            misfits = odds < 0
            if not misfits.any():
                return
            out = misfits & (odds <= odds[misfits].min() / 2)
            self.member_odds |= dict(zip(tied[out].tolist(), odds[out].tolist(), strict=True))
            self.active = self.active.copy()
            self.active[tied[out]] = False


def some_of(ties: Ties) -> Ties:
    """At most `MEMBERS` members, evenly spread."""
    if len(ties) <= MEMBERS:
        return ties
    return np.asarray(ties[np.unique(np.linspace(0, len(ties) - 1, MEMBERS).round().astype(np.int64))])


def _surest_first(weights: list[Weight]) -> list[Weight]:
    """By the drift's log odds when last weighed; revisits that nothing predicts come last."""
    return sorted(weights, key=lambda each: -np.nan_to_num(each.drift, nan=-np.inf))
