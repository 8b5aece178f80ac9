"""A diagnosis in sentences: the reason of each finding, and the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgti_gtsam.diagnosis.records import ClosureFinding, Level, Place
from pgti_gtsam.gate.decision import metres
from pgti_gtsam.places import Compared


def place_words(place: Place, labels: Sequence[str]) -> tuple[str, str]:
    """The reason why a place is named, and the remedy.

    Parameters
    ----------
    place : Place
    labels : sequence of str
        Names of the keyframes.
    """
    earlier, later = (_stretch(ends, labels) for ends in place.keyframes)
    first, second = (labels[k] for k in place.revisit.closest)
    drift = f"drift {metres(place.allowance_m)}, spheres {metres(place.reach_m)}"
    tie = _tie(place.proposal, labels)
    false = " – ".join(labels[k] for k in place.closure or ())
    said: dict[str, tuple[str, str]] = {
        "likely false closure": (
            f"{later} touches {earlier} only through a closure that all others contradict.",
            f"Look again at the closure {false}.",
        ),
        "undecided contact": (
            f"{later} touches {earlier}: a second pass ({_percent(place.probability)}), or a crossing that drift made "
            f"({drift}).",
            f"A match decides. {tie}",
        ),
        "missed closure": (f"{later} passes through {earlier} again, and nothing ties the two ({drift}).", tie),
        "untied second pass": (
            f"{later} runs beside {earlier}, but is tied to it only far away: right by luck ({drift}).",
            tie,
        ),
        "tracking gap": (
            f"The track breaks off between {earlier} and {later}, whose spheres meet.",
            f"Tie {first} and {second} by odometry or a match.",
        ),
        "different view": (
            f"{later} comes near {earlier}, but neither sees what the other sees: a wall or a floor parts them, or "
            "they look different ways.",
            "Nothing to tie.",
        ),
        "incomplete fusion": (
            f"{later} and {earlier} overlap at more keyframes than are tied.",
            "Ignore: all of it follows from ties that the map has.",
        ),
    }

    # passes over each other
    if place.kind == "different view" and place.rise_m:
        rise = f"{metres(abs(place.rise_m))} {'above' if place.rise_m > 0 else 'below'}"
        return (
            f"{later} passes {rise} {earlier}, more than drift explains: another floor, or a bridge.",
            "Nothing to tie, unless one is seen from the other.",
        )

    # where nothing predicts, nothing but a match tells
    if place.kind == "undecided contact" and not np.isfinite(place.allowance_m):
        return (
            f"{later} touches {earlier}, but no chain of ties leads from one to the other.",
            f"A match of {first} with {second} decides; any relative pose is possible.",
        )
    return said[place.kind]


def closure_sentence(missed_m: float, missed_deg: float, allowed_m: float, *, is_false: bool, known: bool) -> str:
    """The evidence of the other ties on a closure.

    Parameters
    ----------
    missed_m, missed_deg : float
        Difference from the prediction by the other ties.
    allowed_m : float
        Standard deviation of the prediction.
    is_false : bool
    known : bool
        Whether other ties predict the closure.
    """
    if not known:
        return "No other tie leads between its keyframes: nothing judges it."
    against, remedy = ("contradicts", " Look again at it, or leave it out.") if is_false else ("agrees with", "")
    return (
        f"It {against} all others: they predict its second keyframe {metres(missed_m)} and {missed_deg:.0f}° away "
        f"from where it measures it, give or take {metres(allowed_m)}.{remedy}"
    )


def verdict(
    integrity: Compared, places: Sequence[Place], closures: Sequence[ClosureFinding], *, lacking: int = 0
) -> tuple[Level, str]:
    """The verdict with its reason. Passes without a common view make no map incomplete: no camera can tie such passes.

    Parameters
    ----------
    integrity : Integrity
    places : sequence of Place
    closures : sequence of ClosureFinding
    lacking : int
        Shared landmarks that fix two keyframes to each other, where nothing else does and no two share so many.
    """
    if not len(integrity.merged_edges):
        return "undecided", "The pose graph has no edge and no two spheres meet: there is nothing to compare."
    if integrity.n_components_pose_graph == len(integrity.keyframe_scores) > 1:
        return "undecided", "No edge of the pose graph ties any two keyframes."
    if lacking:
        parts = f"the pose graph is in {len(integrity.keyframe_scores)} parts"
        return "undecided", f"No edge ties two keyframes, and no two share the {lacking} landmarks that do: {parts}."

    # the gravest finding decides
    false = [closure for closure in closures if closure.is_false]
    count = {kind: sum(place.kind == kind for place in places) for kind in {place.kind for place in places}}
    untied = sum(count.get(kind, 0) for kind in ("missed closure", "untied second pass", "tracking gap"))
    open_ = count.get("undecided contact", 0)
    if false:
        said = f"{_count(len(false), 'closure')} {_verb(len(false), 'contradicts', 'contradict')} all others."
        return "inconsistent", _capital(said)
    if open_:
        more = f" {_capital(_count(untied, 'more place'))} {_verb(untied, 'is', 'are')} not tied." if untied else ""
        both = f"{_verb(open_, 'is a second pass or a crossing', 'are second passes or crossings')} that drift made."
        return "undecided", f"{_capital(_count(open_, 'contact'))} {both}{more}"
    if untied:
        passed = f"{_count(untied, 'place')} that the track passes again {_verb(untied, 'is', 'are')} not tied."
        return "incomplete", f"Nothing contradicts the map, but {passed}"
    parts_of = integrity.n_components_pose_graph
    apart = f" The pose graph is in {parts_of} parts, whose places to each other nothing says." if parts_of > 1 else ""
    ties = "No closure contradicts the others, and every" if closures else "Every"
    unseen = " or has no common view" if count.get("different view") else ""
    return "consistent", f"{ties} place where free space meets is tied{unseen}.{apart}"


def _stretch(ends: tuple[int, int], labels: Sequence[str]) -> str:
    first, last = (labels[k] for k in ends)
    return first if first == last else f"{first}–{last}"


def _tie(proposal: Any, labels: Sequence[str]) -> str:
    if proposal is None:
        return "Match them; nothing predicts where."
    i, j = (labels[k] for k in proposal.keyframes)
    angle = min(3 * proposal.sigma_deg, 180.0)
    return f"Match {i} with {j} within {metres(proposal.search_m)} and {angle:.0f}° of the map, and tie them."


def _percent(probability: float) -> str:
    return "less than 1 %" if probability < 0.01 else f"{100 * probability:.0f} %"


def _count(number: int, what: str) -> str:
    return f"{'one' if number == 1 else number} {what}{'' if number == 1 else 's'}"


def _verb(number: int, one: str, many: str) -> str:
    return one if number == 1 else many


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
