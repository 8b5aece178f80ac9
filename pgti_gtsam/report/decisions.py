"""Verdicts on loop closures as JSON-ready records: one for each, from which the terminal lines are drawn.

A number that JSON does not have is the text "infinite" or "undefined".
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pgti_gtsam.gate import ClosureDecision
from pgti_gtsam.gate.evidence import Change
from pgti_gtsam.gate.rules import doubts
from pgti_gtsam.pose_graph import key_label

SCHEMA = "pgti-gtsam/closures"
SCHEMA_VERSION = 1

Record = dict[str, Any]
Scores = Mapping[str, Change]


def decision_records(
    decisions: Mapping[int, ClosureDecision],
    ends: Mapping[int, Sequence[int]],
    *,
    true_closures: AbstractSet[int] | None = None,
    evidence: bool = True,
    scores: Mapping[int, Scores] | None = None,
) -> list[Record]:
    """One record for each closure, by the later of its keyframes.

    Parameters
    ----------
    decisions : mapping of slot to ClosureDecision
        Closures that were judged as one share a decision.
    ends : mapping of slot to (int, int)
        Keys of their keyframes.
    true_closures : set of int, optional
        Slots of those that are known to be true; None where nothing is known.
    evidence : bool
        Whether to measure what the verdict did not need, too, where the bending alone condemned a closure.
    scores : mapping of slot to mapping of name to Change, optional
        More that was measured before and after.

    Returns
    -------
    list of dict
        ``slot``, ``keys``, ``keyframes`` (the keys in words), ``accepted``, ``doubt``, ``reasons``, ``is_true``,
        ``judged_with`` (slots of the others that were judged as one with it); with evidence also ``doubts`` (what each
        witness has against it; where the bending alone condemned it, ``doubt`` is that share), ``evidence`` (every
        number of `Evidence`) and ``seconds``; and ``scores``, if any.
    """
    together: dict[int, list[int]] = {}
    for slot, decision in decisions.items():
        together.setdefault(id(decision), []).append(slot)
    ordered = sorted(decisions, key=lambda slot: (max(ends[slot]), min(ends[slot]), slot))
    return [
        _record(slot, decisions[slot], ends[slot])
        | {"is_true": None if true_closures is None else slot in true_closures}
        | {"judged_with": [other for other in together[id(decisions[slot])] if other != slot]}
        | (_evidence(decisions[slot]) if evidence else {})
        | ({"scores": {name: _change(change) for name, change in scores[slot].items()}} if scores else {})
        for slot in ordered
    ]


def _record(slot: int, decision: ClosureDecision, ends: Sequence[int]) -> Record:
    return {
        "slot": slot,
        "keys": list(ends),
        "keyframes": [key_label(key) for key in ends],
        "accepted": decision.accepted,
        "doubt": _number(decision.doubt),
        "reasons": list(decision.reasons),
    }


def _evidence(decision: ClosureDecision) -> Record:
    found = decision.evidence
    return {
        "doubts": {name: _number(share) for name, share in doubts(found, decision.options).items()},
        "evidence": {field.name: _plain(getattr(found, field.name)) for field in fields(found)},
        "seconds": asdict(decision.seconds),
    }


def worst_first(records: Iterable[Record]) -> list[Record]:
    """Records with evidence, by falling sum of what the witnesses say."""

    def total(record: Record) -> float:
        return sum(float(str(share).replace("infinite", "inf")) for share in record["doubts"].values())

    return sorted(records, key=total, reverse=True)


def write_json_lines(records: Iterable[Mapping[str, Any]], path: Path) -> None:
    """Write records as strict JSON, one a line."""
    lines = [json.dumps(record, allow_nan=False, ensure_ascii=False) + "\n" for record in records]
    path.write_text("".join(lines), encoding="utf-8")


def closures_document(
    records: Sequence[Record],
    *,
    name: str,
    file_format: str,
    notes: Sequence[str],
    options: Mapping[str, Any],
    unjudged: Sequence[Sequence[int]],
) -> Record:
    """The closures of a finished map as one JSON-ready mapping, worst first.

    ``unjudged`` names the keyframes of those on which a keyframe hangs alone, so that the map cannot be had without.
    """
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "pgti_gtsam_version": version("pgti-gtsam"),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "options": dict(options),
        "closures": worst_first(records),
        "unjudged": [[key_label(key) for key in ends] for ends in unjudged],
    }


def _change(change: Change) -> Record:
    return {"before": _number(change.before), "after": _number(change.after), "rise": _number(change.rise)}


def _plain(value: Any) -> Any:
    return _change(value) if isinstance(value, Change) else _number(value)


def _number(value: Any) -> Any:
    """A number as JSON has it; all else as it is."""
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return "undefined" if math.isnan(value) else ("infinite" if value > 0 else "-infinite")
