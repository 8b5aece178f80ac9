"""The verdict on a map in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pgti_gtsam.integrity import Integrity

HARMLESS_BELOW = 0.26
"""Between the largest Λ that the paper's Table 4 calls harmless (KITTI-18, 0.1708) and the one that it calls
moderate (Campus-9, 0.3890): their geometric mean."""

BROKEN_ABOVE = 0.64
"""Between Campus-9 and the smallest Λ of a severe error in Table 4 (Campus-4, 1.0533): their geometric mean."""

Level = Literal["consistent", "harmless", "suspicious", "broken"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One of four levels, and a sentence or two for a person."""

    level: Level
    text: str


def verdict(integrity: Integrity) -> Verdict:
    """Judge a map by Λ against the paper's Table 4, and say at which scale it disagrees."""
    score, missing = integrity.score, len(integrity.inserted_edges)
    if missing == 0:
        return Verdict(
            level="consistent",
            text="Wherever two keyframes' free space meets, the pose graph connects them.",
        )
    count = f"{missing} pair{'s' if missing > 1 else ''} of keyframes share free space without a connection"
    if np.isinf(score):
        return Verdict(level="broken", text=f"{count}, among them a keyframe that no edge of the pose graph reaches.")
    split = integrity.split()
    scale = "over the whole map" if split.global_ > split.local else "within a neighbourhood"
    if score < HARMLESS_BELOW:
        return Verdict(level="harmless", text=f"{count}; this hardly changes how errors spread.")
    if score < BROKEN_ABOVE:
        return Verdict(
            level="suspicious", text=f"{count}; this changes how errors spread {scale}. Look at the places below."
        )
    return Verdict(
        level="broken",
        text=f"{count}; errors spread very differently {scale}. A loop is missing or false, passes of one place were "
        "never joined, or the map collides with itself through drift.",
    )
