"""Verdicts on loop closures as JSON-ready records: a record for each, from which the terminal lines are drawn.

Numbers are written as `encode` says.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any

from pgti_gtsam import encode, outputs
from pgti_gtsam.adapter.values import Keyframes
from pgti_gtsam.gate import Change, ClosureDecision
from pgti_gtsam.pose_graph import key_label
from pgti_gtsam.report.digits import in_stable_digits

Record = dict[str, Any]


def decision_records(
    decisions: Mapping[int, ClosureDecision],
    ends: Mapping[int, Sequence[int]],
    *,
    true_closures: AbstractSet[int] | None = None,
) -> list[Record]:
    """A record for each closure, by the later keyframe.

    Parameters
    ----------
    decisions : mapping of slot to ClosureDecision
    ends : mapping of slot to (int, int)
        Keys of the closures' keyframes.
    true_closures : set of int, optional
        Slots of closures known to be true; None where nothing is known.

    Returns
    -------
    list of dict
        ``slot``, ``keys``, ``keyframes`` (the keys in words), ``verdict``, ``accepted``, ``probability``,
        ``log_odds``, ``terms`` (by name: ``value``, ``log_odds``, ``sentence``), ``reasons``, ``judged_with`` (how many
        closures of its revisit were weighed together), ``score`` and ``global_score`` (``before``, ``after``, ``rise``,
        or None), ``is_true``.
    """
    ordered = sorted(decisions, key=lambda slot: (max(ends[slot]), min(ends[slot]), slot))
    return [
        _record(slot, decisions[slot], ends[slot])
        | {"is_true": None if true_closures is None else slot in true_closures}
        for slot in ordered
    ]


def _record(slot: int, decision: ClosureDecision, ends: Sequence[int]) -> Record:
    return {
        "slot": slot,
        "keys": list(ends),
        "keyframes": [key_label(key) for key in ends],
        **evidence(decision),
    }


@in_stable_digits
def evidence(decision: ClosureDecision) -> Record:
    """The verdict on a closure with its reasons, as `decision_records` has them."""
    return {
        "verdict": decision.verdict,
        "accepted": decision.accepted,
        "probability": encode.number(decision.probability),
        "log_odds": encode.number(decision.log_odds),
        "terms": {
            name: {
                "value": encode.number(term.value),
                "log_odds": encode.number(term.log_odds),
                "sentence": term.sentence,
            }
            for name, term in decision.terms.items()
        },
        "reasons": list(decision.reasons),
        "judged_with": decision.judged_with,
        "score": _change(decision.score),
        "global_score": _change(decision.global_score),
    }


def least_probable_first(records: Iterable[Record]) -> list[Record]:
    """Records by rising probability; records without a probability last."""

    def odds(record: Record) -> float:
        return math.inf if record["log_odds"] is None else encode.decoded(record["log_odds"])

    return sorted(records, key=odds)


def write_json_lines(records: Iterable[Mapping[str, Any]], path: Path) -> None:
    """Write records as strict JSON, a record a line.

    Parameters
    ----------
    records : iterable of mapping
    path : Path
    """
    outputs.write_text(path, "".join(map(encode.line, records)))


def closures_document(
    records: Sequence[Record],
    *,
    name: str,
    file_format: str,
    notes: Sequence[str],
    options: Mapping[str, Any],
    unjudged: Sequence[Sequence[int]],
    keyframes: Keyframes,
    odometry: Iterable[Sequence[int]],
    drawn: str,
) -> Record:
    """The closures of a map as a JSON-ready mapping, least probable first.

    Parameters
    ----------
    records : sequence of dict
        As `decision_records` makes them. ``ends`` is added: the closure's keyframes as indices, the earlier first.
    name, file_format, notes, options
        As in `audit_document`.
    unjudged : sequence of (int, int)
        Keys of closures without which a keyframe would hang on nothing, so that no map exists without the closure.
    keyframes : Keyframes
        Where the map has the keyframes: ``label`` and ``position``, m.
    odometry : iterable of (int, int)
        Keys of keyframes that odometry ties.
    drawn : str
        The source of the positions, in words that complete "The map is drawn ...".
    """
    index = keyframes.index
    return {
        **encode.heading("closures"),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "options": dict(options),
        "closures": [
            record | {"ends": sorted(index[key] for key in record["keys"])} for record in least_probable_first(records)
        ],
        "unjudged": [[key_label(key) for key in ends] for ends in unjudged],
        "drawn": drawn,
        "keyframes": {
            "label": [key_label(key) for key in keyframes.keys.tolist()],
            "position": keyframes.positions.tolist(),
        },
        "edges": {"odometry": [sorted(index[key] for key in ends) for ends in odometry]},
    }


def _change(change: Change | None) -> Record | None:
    if change is None:
        return None
    return {name: encode.number(getattr(change, name)) for name in ("before", "after", "rise")}
