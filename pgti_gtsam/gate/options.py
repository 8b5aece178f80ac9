"""The gate's options."""

from __future__ import annotations

from dataclasses import dataclass

from pgti_gtsam.adapter import MIN_SHARED_LANDMARKS, checked_sources
from pgti_gtsam.checks import real, shown, whole
from pgti_gtsam.errors import InvalidOptionError

SCORED = 2000
"""Keyframes, times revisits, up to which Λ and Λ_glob are computed unasked: a tenth of a second."""

RULES = ("log_odds", "global_rise", "keyframe_rise", "keyframe_global_rise")


@dataclass(frozen=True, slots=True, kw_only=True)
class GateOptions:
    """The evidence that the gate weighs, and the probability that the gate asks for.

    Attributes
    ----------
    rule : {"log_odds", "global_rise", "keyframe_rise", "keyframe_global_rise"}
        The default adds up the evidence of drift and free space. The others are the paper's rule (section 6.3.1)
        alone: reject a closure when Λ_glob rises by more than `max_rise`, when any keyframe's ζ does, or when any
        keyframe's ζ_glob does.
    min_probability : float
        A closure is accepted from this probability on, rejected from the complement down, and undecided between.
    max_rise : float
        Of the paper's rule; the paper names no number.
    scores : bool, optional
        Whether decisions hold Λ and Λ_glob before and after. By default where the map's keyframes, times the
        revisits that are judged together, are no more than `SCORED`.
    beta : float
        β of Λ_loc and Λ_glob.
    edges, min_shared_landmarks
        As in `from_gtsam`.
    """

    rule: str = "log_odds"
    min_probability: float = 0.95
    max_rise: float = 0.2
    scores: bool | None = None
    beta: float = 0.5
    edges: tuple[str, ...] | None = None
    min_shared_landmarks: int = MIN_SHARED_LANDMARKS

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise InvalidOptionError(f"expected rule from {', '.join(RULES)}, got {self.rule!r}")
        if not 0.5 <= real(self.min_probability, "min_probability") < 1:
            raise InvalidOptionError(
                f"expected min_probability from 0.5 to below 1, got {self.min_probability}; a closure that is more "
                "likely false than true is never accepted"
            )
        if not real(self.max_rise, "max_rise") > 0:
            raise InvalidOptionError(f"expected max_rise above 0, got {self.max_rise}")
        if not 0 < real(self.beta, "beta") < 1:
            raise InvalidOptionError(f"expected beta between 0 and 1, got {self.beta}")
        whole(self.min_shared_landmarks, "min_shared_landmarks", least=1)
        if self.edges is not None:
            checked_sources(self.edges)
        if self.scores not in (None, True, False):
            raise InvalidOptionError(f"expected scores True, False or None, got {shown(self.scores)}")

    def wants_scores(self, keyframes: int) -> bool:
        """Whether Λ and Λ_glob are computed for so many keyframes, times revisits."""
        return keyframes <= SCORED if self.scores is None else self.scores
