"""A diagnosis in sentences: why something is named, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pgti_gtsam.diagnosis.records import ClosureFinding, Level, Place
from pgti_gtsam.integrity import Integrity


def place_words(
    numbers: Mapping[str, Any], labels: Sequence[str], closure: tuple[int, int] | None
) -> dict[str, str]:
    """Sentence and remedy of a place, from its numbers; `closure` is the one to blame, where one is."""
    earlier, later = (_stretch(ends, labels) for ends in numbers["revisit"].stretches)
    allows = _allows(numbers["allowance_m"], numbers["reach_m"])
    tie = _tie(numbers["proposal"], labels)
    first, second = (labels[k] for k in numbers["revisit"].closest)
    kind = numbers["kind"]
    if kind == "likely false closure":
        false = " – ".join(labels[k] for k in closure or ())
        return {
            "sentence": f"{later} touches {earlier} only because of the closure {false}, which the others contradict.",
            "remedy": f"Look again at the closure {false}; without it the two lie apart.",
        }
    if kind == "collision by drift":
        return {
            "sentence": f"{later} crosses {earlier} by chance: {allows}, and the contact is short.",
            "remedy": f"Find the loop that is missing between them. {tie}",
        }
    if kind == "undecided contact":
        if not np.isfinite(numbers["allowance_m"]):
            return {
                "sentence": f"{later} touches {earlier}, but no chain of ties leads from one to the other.",
                "remedy": f"A match of {first} with {second} decides, in any relative pose: the parts are not registered.",
            }
        return {
            "sentence": f"{later} touches {earlier}: a second pass, or chance, for {allows}.",
            "remedy": f"A match of {first} with {second} decides. {tie}",
        }
    if kind == "missed closure":
        return {
            "sentence": f"{later} passes through {earlier} again and no tie says so; {allows}.",
            "remedy": tie,
        }
    if kind == "untied second pass":
        return {
            "sentence": f"{later} runs beside {earlier}, tied too far away: {allows}, so the map is right here by luck.",
            "remedy": tie,
        }
    if kind == "tracking gap":
        return {
            "sentence": f"The track breaks off between {earlier} and {later}, whose spheres meet.",
            "remedy": f"Tie {first} and {second} by odometry or a match.",
        }
    return {
        "sentence": f"{later} and {earlier} are tied near by, but not everywhere they overlap.",
        "remedy": "Ignore: every overlap here follows from ties that the map has.",
    }


def closure_sentence(missed_m: float, missed_deg: float, allowed_m: float, *, is_false: bool, known: bool) -> str:
    """What the others say of a closure."""
    if not known:
        return "No other tie leads between its keyframes: nothing judges it."
    against = "contradicts" if is_false else "agrees with"
    return (
        f"It {against} all others: they predict its second keyframe {_metres(missed_m)} and {missed_deg:.0f}° away "
        f"from where it measures it, give or take {_metres(allowed_m)}."
    )


def verdict(integrity: Integrity, places: Sequence[Place], closures: Sequence[ClosureFinding]) -> tuple[Level, str]:
    """The verdict, and why."""
    if not len(integrity.merged_edges):
        return "undecided", "The pose graph has no edge and no two spheres meet: there is nothing to compare."
    if integrity.n_components_pose_graph == len(integrity.keyframe_scores) > 1:
        return "undecided", "No edge of the pose graph ties any two keyframes."
    false = [closure for closure in closures if closure.is_false]
    count = {kind: sum(place.kind == kind for place in places) for kind in {place.kind for place in places}}
    untied = sum(count.get(kind, 0) for kind in ("missed closure", "untied second pass", "tracking gap"))
    chance, open_ = count.get("collision by drift", 0), count.get("undecided contact", 0)
    if false or chance:
        parts = [
            *([f"{_count(len(false), 'closure')} {'contradicts' if len(false) == 1 else 'contradict'} all others"] if false else []),
            *([f"the track collides with itself by drift in {_count(chance, 'place')}"] if chance else []),
        ]
        return "inconsistent", f"{_capital(' and '.join(parts))}. The map cannot be right."
    if open_:
        more = f" {_capital(_count(untied, 'more place'))} {'is' if untied == 1 else 'are'} untied." if untied else ""
        return (
            "undecided",
            f"{_capital(_count(open_, 'contact'))} {'is a second pass or' if open_ == 1 else 'are second passes or'} "
            f"chance: the drift since allows both.{more}",
        )
    if untied:
        return (
            "incomplete",
            f"Nothing contradicts the map, but {_count(untied, 'place')} that the track passes again "
            f"{'is' if untied == 1 else 'are'} not tied.",
        )
    parts_of = integrity.n_components_pose_graph
    apart = f" The pose graph is in {parts_of} parts, whose places to each other nothing says." if parts_of > 1 else ""
    ties = "No closure contradicts the others, and every" if closures else "Every"
    return "consistent", f"{ties} place where free space meets is tied.{apart}"


def _stretch(ends: tuple[int, int], labels: Sequence[str]) -> str:
    first, last = (labels[k] for k in ends)
    return first if first == last else f"{first}–{last}"


def _allows(allowance_m: float, reach_m: float) -> str:
    return f"the drift between them may be {_metres(allowance_m)}, where their spheres reach {_metres(reach_m)}"


def _tie(proposal: Any, labels: Sequence[str]) -> str:
    if proposal is None:
        return "No tie leads between them: match them without a prediction."
    i, j = (labels[k] for k in proposal.keyframes)
    return f"Tie {i} and {j}: match them within {_metres(proposal.search_m)} and {3 * proposal.sigma_deg:.0f}° of the map."


def _metres(length: float) -> str:
    return f"{length:.2g} m" if length < 10 else f"{length:.0f} m"


def _count(number: int, what: str) -> str:
    return f"{'one' if number == 1 else number} {what}{'' if number == 1 else 's'}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
