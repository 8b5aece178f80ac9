"""The paper's gate (section 6.3.1) alone: a closure is spurious when the integrity score jumps.

Every revisit is tied when its last match has come, and kept if the score does not jump. The paper names Λ_glob, which
is read at the worst keyframe of the map, so that an old defect hides a jump elsewhere. With the rules "keyframe_rise"
and "keyframe_global_rise" each keyframe's ζ, or the global part of its ζ, is compared with itself.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.drift.settled import Settled, settle
from pgti_gtsam.gate.admission import Weight
from pgti_gtsam.gate.decision import Term
from pgti_gtsam.gate.options import GateOptions
from pgti_gtsam.integrity import Integrity

SCORES = {
    "global_rise": "Λ_glob",
    "keyframe_rise": "ζ of the keyframe where ζ rises most",
    "keyframe_global_rise": "ζ_glob of the keyframe where ζ_glob rises most",
}
"""What each rule compares, in the words of a sentence."""


def admitted(
    settled: Settled, weights: list[Weight], integrity_of: Callable[[Settled], Integrity], options: GateOptions
) -> tuple[Settled, list[dict[str, Term]]]:
    """The map with the revisits that pass, and the measurements of each.

    Parameters
    ----------
    settled : Settled
    weights : list of Weight
        Evidence of each revisit.
    integrity_of : callable
        The scores of a map.
    options : GateOptions
    """
    before = integrity_of(settled)
    terms: list[dict[str, Term]] = [{} for _ in weights]
    for k in sorted(range(len(weights)), key=lambda k: int(settled.model.ties.pairs[weights[k].ties].max())):
        active = settled.active.copy()
        active[weights[k].ties] = True
        tried = settle(settled.model, active, settled)
        after = integrity_of(tried)
        terms[k] = {options.rule: _term(before, after, options)}
        if terms[k][options.rule].log_odds > 0:
            settled, before = tried, after
    return settled, terms


def _term(before: Integrity, after: Integrity, options: GateOptions) -> Term:
    """The jump in words; the rule knows no odds, so that the odds are certain either way."""
    first, second = (_scores(each, options) for each in (before, after))
    rises = np.subtract(second, first, out=np.zeros(len(first)), where=first != second)  # infinity stays infinity
    worst = int(np.argmax(rises))
    rise = float(rises[worst])
    change = f"from {first[worst]:.2f} to {second[worst]:.2f} (limit +{options.max_rise:g})"
    return Term(
        value=rise,
        log_odds=np.inf if rise <= options.max_rise else -np.inf,
        sentence=f"{SCORES[options.rule]} goes {change}.",
    )


def _scores(integrity: Integrity, options: GateOptions) -> NDArray[np.float64]:
    """What the rule compares: a score of the map, (1,), or of every keyframe, (n,)."""
    if options.rule == "keyframe_rise":
        return integrity.keyframe_scores
    split = integrity.split(options.beta)
    return np.array([split.global_]) if options.rule == "global_rise" else split.keyframe_globals
