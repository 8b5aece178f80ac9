"""Chains of keyframes, the way along chains, and the ties along chains, of a pose graph whose steps are marked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csgraph

from pgti_gtsam.pose_graph import EdgeSource, PoseGraph

Pairs = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Keyframes chain after chain, each chain in the order of its keys, in which the sensor passed.

    Attributes
    ----------
    chain : (n,) int
        Number of each keyframe's chain. Chains are counted by their first keyframes; they need not be
        contiguous.
    order : (n,) int
        The keyframes, chain after chain.
    way_m : (n,) float
        Way along the keyframes' positions in that order, m, from the first one on, gaps between chains included.
    """

    chain: NDArray[np.int64]
    order: NDArray[np.int64]
    way_m: NDArray[np.float64]

    @property
    def n_chains(self) -> int:
        """Number of chains."""
        return int(self.chain.max()) + 1


def closure_edges(pose_graph: PoseGraph) -> NDArray[np.bool_]:
    """The loop closures among the edges of a pose graph, (m,): factors between keyframes that are not odometry."""
    odometry = EdgeSource.ODOMETRY | EdgeSource.SKIP
    sources = pose_graph.edge_sources
    return np.asarray((sources & EdgeSource.BETWEEN > 0) & (sources & odometry == 0))


def step_edges(pose_graph: PoseGraph) -> NDArray[np.bool_]:
    """The steps of the track among the edges of a pose graph, (m,).

    Without marked steps, as in a pose graph made by hand, the steps are the edges between neighbours.
    """
    steps = pose_graph.edge_sources & EdgeSource.ODOMETRY > 0
    if not steps.any():
        steps = np.diff(pose_graph.edges, axis=1)[:, 0] == 1
    return np.asarray(steps)


def track_of(pose_graph: PoseGraph) -> Track:
    """The track of a pose graph, from its edges that are marked as steps.

    Without marked edges, as in a pose graph made by hand, all keyframes count as one chain.
    """
    n, steps = len(pose_graph), pose_graph.edges[pose_graph.edge_sources & EdgeSource.ODOMETRY > 0]
    chain = chains_of(n, steps) if len(steps) else np.zeros(n, dtype=np.int64)
    order = np.argsort(chain, kind="stable")
    way_m = np.empty(n)
    lengths = np.linalg.norm(np.diff(pose_graph.positions[order], axis=0), axis=1)
    way_m[order] = np.concatenate([[0.0], np.cumsum(lengths)])
    return Track(chain=chain, order=order, way_m=way_m)


def chains_of(n: int, steps: Pairs) -> NDArray[np.int64]:
    """Number of the chain of each of n keyframes, (n,), counted by the first keyframes.

    Parameters
    ----------
    n : int
        Number of keyframes.
    steps : (s, 2) int
    """
    links = coo_array((np.ones(len(steps)), (steps[:, 0], steps[:, 1])), shape=(n, n))
    _, part = csgraph.connected_components(links, directed=False)
    _, first, number = np.unique(part, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[number], dtype=np.int64)


def track_edges(steps: NDArray[np.float64], radii: NDArray[np.float64]) -> Pairs:
    """Pairs of keyframes that the track itself connects: travelled distance ≤ r_i + r_j.

    Spheres larger than the spacing of the keyframes overlap along the track although nothing is
    wrong there. The paper's premise that G_p is denser than G_f (section 5.1) holds again once every
    pair whose spheres must meet, however the track bends between them, counts as connected.

    Parameters
    ----------
    steps : (n − 1,) float, m
        Measured distance from each keyframe to the next in the order of a `Track`, NaN where no odometry joins them.
    radii : (n,) float, m
        In that order.

    Returns
    -------
    (m, 2) int
        Places in that order, i < j.
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
