"""Steps of a track: the pairs of keyframes that lead from each keyframe to the next keyframe of its robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.pair_codes import codes_of, pairs_of
from pgti_gtsam.track.chains import Pairs, chains_of

NEIGHBOURS = 10
"""Most keyframes from one end of a step or of a lone skip to the other. Windows of visual odometry are shorter."""

DENSE = 0.3
"""Least share of the pairs at some distance on a chain that are tied where every keyframe is registered against its
neighbours as a matter of course."""

LEAST_DENSE = 3
"""Least number of them: on a chain of three keyframes a single tie is all pairs."""


def steps_among(keys: NDArray[np.uint64], measured: Pairs, covisible: Pairs, held: NDArray[np.bool_]) -> Pairs:
    """Steps among pairs that factors tie and pairs that see the same, (s, 2), sorted.

    Parameters
    ----------
    keys : (n,) uint64
        Keys of the keyframes, ascending.
    measured : (k, 2) int
        Pairs that factors tie.
    covisible : (l, 2) int
        Pairs with shared landmarks.
    held : (n,) bool
        Keyframes that other factors tie.
    """
    # pairs of one robot, but for those that two chains running through each other outvote where neighbours are rare
    n, robots = len(keys), keys >> np.uint64(56)
    codes = np.unique(codes_of(np.concatenate([measured, covisible]), n))
    pairs = pairs_of(codes, n)
    pairs = pairs[robots[pairs[:, 0]] == robots[pairs[:, 1]]]
    _, robot, sizes = np.unique(robots, return_inverse=True, return_counts=True)
    on = robot[pairs[:, 0]]
    rare = np.bincount(on[pairs[:, 1] == pairs[:, 0] + 1], minlength=len(sizes)) < DENSE * (sizes - 1)
    pairs = pairs[~(rare[on] & _are_nearest(n, pairs) & _contested(n, pairs))]

    # neighbours, and nearest keyframes farther apart on chains that cross
    gap = np.diff(pairs, axis=1)[:, 0]
    by_factor = np.isin(codes_of(pairs, n), codes_of(measured, n))
    steps = pairs[gap == 1]
    hops = pairs[_are_nearest(n, pairs) & by_factor & (gap > 1) & (gap <= NEIGHBOURS)]
    goes_on = np.isin(hops[:, 0], [*steps[:, 1], *hops[:, 1]]) | np.isin(hops[:, 1], [*steps[:, 0], *hops[:, 0]])
    steps = np.concatenate([steps, hops[goes_on & _crossed(n, hops)]])

    # what stands in for steps that are missing
    reached, chain, stand_ins = held.copy(), chains_of(n, steps), []
    reached[steps.ravel()] = True
    dense = dense_to(robot, pairs, pairs)
    left = by_factor & (gap <= NEIGHBOURS) & (chain[pairs[:, 0]] != chain[pairs[:, 1]])
    for i, j in pairs[left][np.argsort(gap[left], kind="stable")].tolist():
        if chain[i] != chain[j] and (j - i <= dense[robot[i]] or not (reached[i] and reached[j])):
            stand_ins.append((i, j))
            reached[[i, j]], chain[chain == chain[j]] = True, chain[i]
    codes = np.unique(codes_of(np.concatenate([steps, np.array(stand_ins, dtype=np.int64).reshape(-1, 2)]), n))
    return pairs_of(codes, n)


def _nearest(n: int, pairs: Pairs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first later and the last earlier keyframe tied to each keyframe, (n,) each; n and −1 where none is."""
    later, earlier = np.full(n, n), np.full(n, -1)
    np.minimum.at(later, pairs[:, 0], pairs[:, 1])
    np.maximum.at(earlier, pairs[:, 1], pairs[:, 0])
    return later, earlier


def _are_nearest(n: int, pairs: Pairs) -> NDArray[np.bool_]:
    """Pairs of keyframes that are each other's nearest."""
    later, earlier = _nearest(n, pairs)
    return np.asarray((later[pairs[:, 0]] == pairs[:, 1]) & (earlier[pairs[:, 1]] == pairs[:, 0]))


def _contested(n: int, pairs: Pairs) -> NDArray[np.bool_]:
    """Pairs (i, j) between two chains: one chain goes on from i past j, the other came to j from before i.

    Without the pair p, which has no nearer keyframe, leads to j, and i to q, likewise: p < i < j < q.
    """
    later, earlier = _nearest(n, pairs)
    lowest, highest = np.full(n, n), np.full(n, -1)
    near = np.diff(pairs, axis=1)[:, 0] <= NEIGHBOURS
    coming = pairs[near & (later[pairs[:, 0]] == pairs[:, 1])]
    going = pairs[near & (earlier[pairs[:, 1]] == pairs[:, 0])]
    np.minimum.at(lowest, coming[:, 1], coming[:, 0])
    np.maximum.at(highest, going[:, 0], going[:, 1])
    return np.asarray((lowest[pairs[:, 1]] < pairs[:, 0]) & (highest[pairs[:, 0]] > pairs[:, 1]))


def _crossed(n: int, hops: Pairs) -> NDArray[np.bool_]:
    """Hops (i, j) that another hop crosses: from between i and j to beyond, or from before to between."""
    i, j = hops.T
    end, start = np.full(n, -1), np.full(n, n)
    end[i], start[j] = j, i
    found = np.zeros(len(hops), dtype=bool)
    for step in range(1, NEIGHBOURS):
        between = np.minimum(i + step, j - 1)
        found |= (between > i) & ((end[between] > j) | (start[between] < i))
    return found


def dense_to(chain: NDArray[np.int64], pairs: Pairs, ends: Pairs) -> NDArray[np.int64]:
    """For each chain, the number of neighbours to which all keyframes are tied as a matter of course, (c,).

    Parameters
    ----------
    chain : (n,) int
        Chain of every keyframe.
    pairs : (k, 2) int
        Ties.
    ends : (l, 2) int
        Pairs of ends of skips.
    """
    _, first = np.unique(ends, axis=0, return_index=True)
    on, gaps = chain[pairs[first, 0]], np.diff(ends[first], axis=1)[:, 0]
    sizes = np.bincount(chain)
    dense, left, gap = np.ones_like(sizes), np.ones(len(sizes), dtype=bool), 2
    while left.any():
        count = np.bincount(on[gaps == gap], minlength=len(sizes))
        left &= count >= np.maximum(LEAST_DENSE, DENSE * (sizes - gap))
        dense[left] = gap
        gap += 1
    return dense
