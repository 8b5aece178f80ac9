"""Links between maps in a document."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from pgti_gtsam import encode
from pgti_gtsam.merging import Merged
from pgti_gtsam.pose_graph import key_label


def merging_record(merged: Merged) -> dict[str, Any]:
    """Links with verdict and probability, joinings the surest first, the gain of each map, and what no map holds."""
    return {
        "links": [
            {
                "keyframes": [key_label(key) for key in link.keys],
                "verdict": link.verdict,
                "probability": encode.number(link.probability),
                "sentence": link.sentence,
            }
            for link in merged.links
        ],
        "order": [asdict(joining) for joining in merged.order],
        "gains": [
            asdict(gain) | {"before_m": encode.number(gain.before_m), "after_m": encode.number(gain.after_m)}
            for gain in merged.gains
        ],
        "left_out": [key_label(key) for key in merged.left_out],
    }
