"""A pose graph grown along its keyframes: at each size the edges, the overlaps, and the explained overlaps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.pair_codes import without
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.support_graph import explained_overlaps, overlapping_spheres, support_graph

Pairs = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stage:
    """The graph of the first keyframes.

    Attributes
    ----------
    n_keyframes : int
    edges : (m, 2) int
        E_p of these keyframes.
    inserted_edges : (l, 2) int
        Pairs whose spheres meet without an edge.
    n_collisions : int
        Inserted edges that nothing explains.
    n_new : int
        Inserted edges that the stage before did not have.
    positions : (n_keyframes, 3) float, m
        Positions of the keyframes in the estimate of this stage.
    """

    n_keyframes: int
    edges: Pairs
    inserted_edges: Pairs
    n_collisions: int
    n_new: int
    positions: NDArray[np.float64]


def sizes(n: int, every: int) -> list[int]:
    """Numbers of keyframes at which the growing graph is measured: every so many, and all.

    Parameters
    ----------
    n : int
        Keyframes of the whole graph.
    every : int
        Keyframes between two stages.
    """
    return sorted({*range(every, n, every), n})


def grown(pose_graph: PoseGraph, wanted: Sequence[int]) -> Iterator[Stage]:
    """The graph induced by the first keyframes, in the order of their keys, with the final estimate.

    Overlaps are found once; a stage has the overlaps whose later keyframe has come. The explained overlaps only grow
    with the graph, so that each stage starts from the explained overlaps of the stage before. New explanations follow
    from an edge at a new keyframe, or at the odometry neighbour of a new keyframe, where a rung begins: only these
    edges are walked.

    Parameters
    ----------
    pose_graph : PoseGraph
    wanted : sequence of int
        Sizes, ascending.
    """
    n, edges = len(pose_graph), pose_graph.edges
    overlaps = without(overlapping_spheres(pose_graph.positions, pose_graph.radii), edges, n)
    odometry = edges[pose_graph.edge_sources & EdgeSource.ODOMETRY > 0]
    explained, before = np.zeros(len(overlaps), dtype=bool), 0
    for size in wanted:
        own, present, rails = edges[edges[:, 1] < size], overlaps[:, 1] < size, odometry[odometry[:, 1] < size]
        undecided = present & ~explained
        if undecided.any():
            # edges from which something new may follow
            known = np.concatenate([own, overlaps[explained]])
            touched = np.arange(size) >= before
            touched[rails[touched[rails].any(axis=1)]] = True
            fresh = known[touched[known].any(axis=1)]
            explained[undecided] = explained_overlaps(size, known, overlaps[undecided], rails, fresh)
        yield Stage(
            n_keyframes=size,
            edges=own,
            inserted_edges=overlaps[present],
            n_collisions=int((present & ~explained).sum()),
            n_new=int((present & (overlaps[:, 1] >= before)).sum()),
            positions=pose_graph.positions[:size],
        )
        before = size


def recorded(pose_graphs: Iterable[PoseGraph]) -> Iterator[Stage]:
    """The stages of a pipeline's own record: each graph with the estimate of its time.

    An inserted edge is new where no earlier graph had it, whatever became of it in between.
    """
    seen: set[tuple[int, int]] = set()
    for pose_graph in pose_graphs:
        support = support_graph(pose_graph)
        named = {(int(i), int(j)) for i, j in pose_graph.keys[support.inserted_edges]}
        yield Stage(
            n_keyframes=len(pose_graph),
            edges=pose_graph.edges,
            inserted_edges=support.inserted_edges,
            n_collisions=len(support.collision_edges),
            n_new=len(named - seen),
            positions=pose_graph.positions,
        )
        seen |= named
