"""The paper's gate (section 6.3.1) alone: a closure is spurious when the integrity score jumps.

Every revisit is tied when its last match has come, and kept if the score does not jump. The paper names Λ_glob. Its
maximum over the map and over the map's own times hides a jump behind an old defect; with the rule "keyframe_rise"
each keyframe's ζ is compared with itself.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgti_gtsam.gate.admission import Weight
from pgti_gtsam.gate.decision import Change, Term
from pgti_gtsam.gate.options import GateOptions
from pgti_gtsam.gate.settled import Settled, settle
from pgti_gtsam.integrity import Integrity


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
    if options.rule == "global_rise":
        change = Change(before=before.split(options.beta).global_, after=after.split(options.beta).global_)
        what = "Λ_glob"
    else:
        worst = int(np.argmax(after.keyframe_scores - before.keyframe_scores))
        change = Change(before=float(before.keyframe_scores[worst]), after=float(after.keyframe_scores[worst]))
        what = "ζ of the keyframe where ζ rises most"
    passes = change.rise <= options.max_rise
    sentence = f"{what} goes from {change.before:.2f} to {change.after:.2f} (limit +{options.max_rise:g})."
    return Term(value=change.rise, log_odds=np.inf if passes else -np.inf, sentence=sentence)
