"""The track: which keyframes follow each other, how far the sensor travelled between them, and whom that connects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.pose_graph import EdgeSource, PoseGraph


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Keyframes in the order in which the sensor passed them, which is that of their keys.

    Attributes
    ----------
    chain : (n,) int
        Ascending number of the chain that each keyframe is on: a new one begins where odometry is missing.
    way_m : (n,) float
        Way along the keyframes' positions, m, from the first one on, gaps between chains included.
    """

    chain: NDArray[np.int64]
    way_m: NDArray[np.float64]

    @property
    def n_chains(self) -> int:
        """Number of chains."""
        return int(self.chain[-1]) + 1


def track_of(pose_graph: PoseGraph) -> Track:
    """The track of a pose graph, from its edges that are marked as odometry.

    Where no edge is, as in a pose graph made by hand, all keyframes count as one chain.
    """
    n = len(pose_graph)
    steps = pose_graph.edges[pose_graph.edge_sources & EdgeSource.ODOMETRY > 0]
    broken = np.ones(n - 1, dtype=bool) if len(steps) else np.zeros(n - 1, dtype=bool)
    broken[steps[steps[:, 1] == steps[:, 0] + 1, 0]] = False
    lengths = np.linalg.norm(np.diff(pose_graph.positions, axis=0), axis=1)
    return Track(chain=np.concatenate([[0], np.cumsum(broken)]), way_m=np.concatenate([[0.0], np.cumsum(lengths)]))


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
