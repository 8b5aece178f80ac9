"""A map against an earlier audit: changes for better or worse between two audits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pgti_gtsam.errors import InvalidValueError

GRAVITY = ("consistent", "incomplete", "undecided", "inconsistent")
"""Verdicts, from the best to the worst."""

FELL = 0.1
"""By how much the probability of a closure must fall, or rise, to be told."""

Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """The changes from an audit to the next.

    Attributes
    ----------
    verdicts : (str, str)
        Before and after.
    scores, collision_scores : (float or str, float or str)
        Λ, and Λ of the collisions alone; "infinite" for infinite scores.
    new_places, gone_places : tuple of documents
        Places of the later audit between stretches without a place of the same kind in the earlier audit, and
        the reverse.
    closures : tuple of (str, float, float)
        Keyframes of a closure, and its probability before and after, where that moved by more than `FELL`, the largest
        fall first.
    """

    verdicts: tuple[str, str]
    scores: tuple[Any, Any]
    collision_scores: tuple[Any, Any]
    new_places: tuple[Document, ...]
    gone_places: tuple[Document, ...]
    closures: tuple[tuple[str, float, float], ...]

    @property
    def is_worse(self) -> bool:
        """Whether the verdict is graver, a place is new, or the gate would take a closure for false now."""
        graver = GRAVITY.index(self.verdicts[1]) > GRAVITY.index(self.verdicts[0])
        is_false_now = any(before >= 0.5 > after for _, before, after in self.closures)
        return graver or bool(self.new_places) or is_false_now


def compare(old: Document, new: Document) -> Comparison:
    """Compare two audits of a map; keyframes are known by their labels.

    Parameters
    ----------
    old, new : mapping
        Documents as `audit_document` makes them.

    Raises
    ------
    InvalidValueError
        The two have no keyframe in common.
    """
    if not set(old["keyframes"]["label"]) & set(new["keyframes"]["label"]):
        raise InvalidValueError(
            f"expected two audits of one map, got {old['input']['name']} and {new['input']['name']}, "
            "which have no keyframe in common"
        )

    # places by kind and stretches, closures by name
    places = [
        [(place["kind"], *_stretches(place, document)) for place in document["places"]] for document in (old, new)
    ]
    probabilities = [
        {_named(closure, document): closure["probability"] for closure in document["closures"]}
        for document in (old, new)
    ]

    # what changed
    moved = [
        (name, before, after)
        for name, before in probabilities[0].items()
        if (after := probabilities[1].get(name)) is not None and before is not None and abs(after - before) > FELL
    ]
    return Comparison(
        verdicts=(old["verdict"]["level"], new["verdict"]["level"]),
        scores=(old["summary"]["score"], new["summary"]["score"]),
        collision_scores=(old["summary"]["collisions"]["score"], new["summary"]["collisions"]["score"]),
        new_places=_only(new["places"], places[1], places[0]),
        gone_places=_only(old["places"], places[0], places[1]),
        closures=tuple(sorted(moved, key=lambda each: each[2] - each[1])),
    )


def _only(documents: Sequence[Document], own: Sequence[Any], others: Sequence[Any]) -> tuple[Document, ...]:
    """Places that are not among the others."""
    return tuple(
        document
        for document, place in zip(documents, own, strict=True)
        if not any(_is_same(place, other) for other in others)
    )


def _is_same(one: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    """Whether two places are of the same kind and share keyframes on both stretches."""
    (kind, first, second), (other_kind, third, fourth) = one, other
    straight, crossed = bool(first & third and second & fourth), bool(first & fourth and second & third)
    return kind == other_kind and (straight or crossed)


def _stretches(place: Document, document: Document) -> tuple[frozenset[str], frozenset[str]]:
    """Labels of the keyframes on either stretch of a place."""
    labels = document["keyframes"]["label"]
    first, second = (frozenset(labels[start : end + 1]) for start, end in place["stretches"])
    return first, second


def _named(closure: Document, document: Document) -> str:
    i, j = closure["keyframes"]
    return f"{document['keyframes']['label'][i]} – {document['keyframes']['label'][j]}"
