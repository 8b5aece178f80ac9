"""The gate's verdict on a closure: plain numbers and words, without any reference to the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from scipy.special import expit

Verdict = Literal["accepted", "undecided", "rejected"]


def metres(length: float) -> str:
    """A length in words: two digits below ten metres, and of lengths that no map has."""
    return f"{length:.0f} m" if 10 <= length < 1e9 else f"{length:.2g} m"


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A quantity with and without the closure."""

    before: float
    after: float

    @property
    def rise(self) -> float:
        """After minus before."""
        return self.after - self.before


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """Evidence of one kind.

    Attributes
    ----------
    value : float
        The measurement, in the unit that the sentence names.
    log_odds : float
        Log odds of true against false, given the measurement.
    sentence : str
    """

    value: float
    log_odds: float
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureDecision:
    """Verdict on a closure.

    Attributes
    ----------
    verdict : {"accepted", "undecided", "rejected"}
    log_odds : float
        Of true against false, all evidence together; NaN where nothing judges the closure.
    terms : mapping of name to Term
        "drift", "contact_rise" where the drift left the closure in doubt, or the rule's name where
        the paper's rule is asked ("global_rise", …).
    reasons : tuple of str
        The terms' sentences, the heaviest first.
    keys : tuple of int
        Keys of the keyframes that the closure ties, ascending.
    judged_with : int
        Number of closures of the revisit that were weighed together, this closure included.
    score, global_score : Change or None
        Λ and Λ_glob of the map before and after the closure; None where `GateOptions.scores` left them
        out, or where no tie of keyframes was judged.
    """

    verdict: Verdict
    log_odds: float
    terms: Mapping[str, Term]
    reasons: tuple[str, ...]
    keys: tuple[int, ...]
    judged_with: int = 1
    score: Change | None = None
    global_score: Change | None = None

    @property
    def accepted(self) -> bool:
        """Whether the closure may be tied."""
        return self.verdict == "accepted"

    @property
    def probability(self) -> float:
        """Probability that the closure is true."""
        return float(expit(self.log_odds))
