"""The odometry chain: how far the sensor travelled between keyframes, and whom that connects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def track_edges(steps: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.int64]:
    """Pairs of keyframes that the track itself connects: travelled distance ≤ r_i + r_j.

    Spheres larger than the spacing of the keyframes overlap along the track although nothing is
    wrong there. The paper's premise that G_p is denser than G_f (section 5.1) holds again once every
    pair whose spheres must meet, however the track bends between them, counts as connected.

    Parameters
    ----------
    steps : (n − 1,) float, m
        Measured distance from each keyframe to the next, NaN where no odometry joins them.
    radii : (n,) float, m

    Returns
    -------
    (m, 2) int
        i < j.
    """
    chain = np.concatenate([[0], np.cumsum(np.isnan(steps))])
    travelled = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    last_of_chain = np.searchsorted(chain, chain, side="right")
    found = []
    for gap in range(1, len(radii)):
        i = np.arange(len(radii) - gap)
        i = i[i + gap < last_of_chain[i]]
        reach = travelled[i + gap] - travelled[i]
        connected = reach <= radii[i] + radii[i + gap]
        found.append(np.stack([i[connected], i[connected] + gap], axis=1))
        if not (reach <= radii[i] + radii.max()).any():
            break
    return np.concatenate(found) if found else np.empty((0, 2), dtype=np.int64)
