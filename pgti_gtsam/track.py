"""The track: what is odometry and what a loop closure, which chain each keyframe is on, and the way travelled.

A robot is the letter of its keys; plain numbers are those of one robot. A *step* ties two keyframes of one robot of
which each is the other's nearest: no factor leads from the earlier one to one in between, and none to the later one
from there. Neighbours in the order of the keys that a factor ties are a step. Keyframes farther apart are one where
the chains of several robots run through each other under plain numbers: steps cross there, and each goes on. A factor
over several keyframes stands in for a step that is missing where nothing else ties its keyframe, or where all are
registered against as many neighbours. A *chain* is what steps hold together: a session of a robot, up to where its
odometry breaks off.

A factor over several steps is a *skip*, and odometry too, where the way explains it: see `Roles`. Every other factor
between keyframes is a loop closure.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csgraph

from pgti_gtsam.pose_graph import EdgeSource, PoseGraph

NEIGHBOURS = 10
"""Most keyframes from one end of a step or of a lone skip to the other. Windows of visual odometry are shorter."""

AGREES, AGREES_RAD = 0.25, 0.25
"""Most by which a skip may miss the chained steps, in parts of the way between its ends and in rad. Of 511 factors over
at most ten keyframes of intel, manhattan and city10000 the worst misses by 0.2 of the way and by 0.18 rad; the two of
MIT, across steps on which the wheels slip, miss by 0.26 and 0.42 and stay closures."""

RETURNS = 0.75
"""Distance between its ends, in parts of how far the way led off from the first, below which a factor brings the sensor
back to where it was, and is a loop closure however short the way."""

DENSE = 0.3
"""Least share of the pairs at some distance on a chain that are tied where every keyframe is registered against its
neighbours as a matter of course."""

LEAST_DENSE = 3
"""Least number of them: on a chain of three keyframes a single tie is all pairs."""

Pairs = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Keyframes chain after chain, each in the order in which its sensor passed them, which is that of their keys.

    Attributes
    ----------
    chain : (n,) int
        Number of the chain that each keyframe is on. Chains are counted by their first keyframes; they need not be
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


class Tie(NamedTuple):
    """A factor between two keyframes, `first` < `second`, and the pose of the second that it measures from the first.

    The pose is a gtsam.Pose2 or gtsam.Pose3, or None where the factor measures no whole pose.
    """

    first: int
    second: int
    pose: Any


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Roles:
    """What ties are to the track.

    Attributes
    ----------
    is_step : (m,) bool
        Ties of a keyframe to the next one of its chain.
    is_skip : (m,) bool
        Ties over several steps of one chain that the way explains: they agree with the steps between, and either they
        do not bring the sensor back to where it was, or all keyframes of the chain are tied to as many neighbours.
    chain : (n,) int
        As in `Track`.
    steps : (s, 2) int
        The steps, i < j, sorted; what two keyframes both see among them.
    """

    is_step: NDArray[np.bool_]
    is_skip: NDArray[np.bool_]
    chain: NDArray[np.int64]
    steps: Pairs

    @property
    def is_closure(self) -> NDArray[np.bool_]:
        """Ties that are no odometry, (m,)."""
        return ~(self.is_step | self.is_skip)


def roles(
    keys: NDArray[np.uint64],
    ties: Sequence[Tie],
    *,
    covisible: Pairs | None = None,
    held: NDArray[np.bool_] | None = None,
    closures: NDArray[np.bool_] | None = None,
) -> Roles:
    """Tell odometry from loop closures.

    Parameters
    ----------
    keys : (n,) uint64
        Of all keyframes, ascending.
    ties : sequence of m Tie
        All factors between keyframes.
    covisible : (k, 2) int, optional
        Keyframes that see the same landmarks, i < j: those of neighbours are steps.
    held : (n,) bool, optional
        Keyframes that other factors tie. One that is not, and that no step reaches, hangs on its nearest tie, which
        is odometry, for want of any other.
    closures : (m,) bool, optional
        Ties that are known to be loop closures. All others are odometry then.

    Notes
    -----
    Under plain numbers a closure between the last keyframe of one session and the first of the next looks like a
    step, as the numbers follow each other. Give `closures`, or the sessions letters of their own.
    """
    # the steps, and the chains that they make
    n, m = len(keys), len(ties)
    known = np.zeros(m, dtype=bool) if closures is None else closures
    pairs = np.array([tie[:2] for tie in ties], dtype=np.int64).reshape(-1, 2)
    steps = _steps(
        keys, pairs[~known], _NONE if covisible is None else covisible, np.zeros(n, bool) if held is None else held
    )
    chain = chains_of(n, steps)
    is_step = ~known & np.isin(_codes(pairs, n), _codes(steps, n))

    # what the way along them explains
    is_skip = ~known & ~is_step
    if closures is None:
        chosen = np.flatnonzero(is_skip & (chain[pairs[:, 0]] == chain[pairs[:, 1]]))
        is_skip = np.zeros(m, dtype=bool)
        walked = [tie for tie, own in zip(ties, is_step, strict=True) if own]
        is_skip[chosen] = _explained(n, chain, walked, [ties[k] for k in chosen.tolist()])
    return Roles(is_step=is_step, is_skip=is_skip, chain=chain, steps=steps)


def closure_edges(pose_graph: PoseGraph) -> NDArray[np.bool_]:
    """Which edges of a pose graph are loop closures, (m,): factors between keyframes that are no odometry."""
    odometry = EdgeSource.ODOMETRY | EdgeSource.SKIP
    sources = pose_graph.edge_sources
    return np.asarray((sources & EdgeSource.BETWEEN > 0) & (sources & odometry == 0))


def step_edges(pose_graph: PoseGraph) -> NDArray[np.bool_]:
    """Which edges of a pose graph are steps of the track, (m,).

    Where none is marked as one, as in a pose graph made by hand, they are those between neighbours.
    """
    steps = pose_graph.edge_sources & EdgeSource.ODOMETRY > 0
    if not steps.any():
        steps = np.diff(pose_graph.edges, axis=1)[:, 0] == 1
    return np.asarray(steps)


def track_of(pose_graph: PoseGraph) -> Track:
    """The track of a pose graph, from its edges that are marked as steps.

    Where no edge is, as in a pose graph made by hand, all keyframes count as one chain.
    """
    n, steps = len(pose_graph), pose_graph.edges[pose_graph.edge_sources & EdgeSource.ODOMETRY > 0]
    chain = chains_of(n, steps) if len(steps) else np.zeros(n, dtype=np.int64)
    order = np.argsort(chain, kind="stable")
    way_m = np.empty(n)
    lengths = np.linalg.norm(np.diff(pose_graph.positions[order], axis=0), axis=1)
    way_m[order] = np.concatenate([[0.0], np.cumsum(lengths)])
    return Track(chain=chain, order=order, way_m=way_m)


def chains_of(n: int, steps: Pairs) -> NDArray[np.int64]:
    """Number of the chain that each of n keyframes is on, (n,), counted by their first keyframes."""
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


_NONE = np.empty((0, 2), dtype=np.int64)


def _codes(pairs: Pairs, n: int) -> NDArray[np.int64]:
    return np.asarray(pairs[:, 0] * n + pairs[:, 1])


def _steps(keys: NDArray[np.uint64], measured: Pairs, covisible: Pairs, held: NDArray[np.bool_]) -> Pairs:
    """Steps among pairs that factors tie and pairs that see the same, (s, 2), sorted."""
    # pairs of one robot, but for those that two chains running through each other outvote where neighbours are rare
    n, robots = len(keys), keys >> np.uint64(56)
    codes = np.unique(_codes(np.concatenate([measured, covisible]), n))
    pairs = np.stack([codes // n, codes % n], axis=1)
    pairs = pairs[robots[pairs[:, 0]] == robots[pairs[:, 1]]]
    _, robot, sizes = np.unique(robots, return_inverse=True, return_counts=True)
    on = robot[pairs[:, 0]]
    rare = np.bincount(on[pairs[:, 1] == pairs[:, 0] + 1], minlength=len(sizes)) < DENSE * (sizes - 1)
    pairs = pairs[~(rare[on] & _are_nearest(n, pairs) & _contested(n, pairs))]

    # neighbours, and nearest keyframes farther apart on chains that cross
    gap = np.diff(pairs, axis=1)[:, 0]
    by_factor = np.isin(_codes(pairs, n), _codes(measured, n))
    steps = pairs[gap == 1]
    hops = pairs[_are_nearest(n, pairs) & by_factor & (gap > 1) & (gap <= NEIGHBOURS)]
    goes_on = np.isin(hops[:, 0], [*steps[:, 1], *hops[:, 1]]) | np.isin(hops[:, 1], [*steps[:, 0], *hops[:, 0]])
    steps = np.concatenate([steps, hops[goes_on & _crossed(n, hops)]])

    # what stands in for steps that are missing
    reached, chain, stand_ins = held.copy(), chains_of(n, steps), []
    reached[steps.ravel()] = True
    dense = _dense_to(robot, pairs, pairs)
    left = by_factor & (gap <= NEIGHBOURS) & (chain[pairs[:, 0]] != chain[pairs[:, 1]])
    for i, j in pairs[left][np.argsort(gap[left], kind="stable")].tolist():
        if chain[i] != chain[j] and (j - i <= dense[robot[i]] or not (reached[i] and reached[j])):
            stand_ins.append((i, j))
            reached[[i, j]], chain[chain == chain[j]] = True, chain[i]
    codes = np.unique(_codes(np.concatenate([steps, np.array(stand_ins, dtype=np.int64).reshape(-1, 2)]), n))
    return np.stack([codes // n, codes % n], axis=1)


def _nearest(n: int, pairs: Pairs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first later and the last earlier keyframe that each is tied to, (n,) each; n and −1 where there is none."""
    later, earlier = np.full(n, n), np.full(n, -1)
    np.minimum.at(later, pairs[:, 0], pairs[:, 1])
    np.maximum.at(earlier, pairs[:, 1], pairs[:, 0])
    return later, earlier


def _are_nearest(n: int, pairs: Pairs) -> NDArray[np.bool_]:
    """Pairs of which each is the other's nearest."""
    later, earlier = _nearest(n, pairs)
    return np.asarray((later[pairs[:, 0]] == pairs[:, 1]) & (earlier[pairs[:, 1]] == pairs[:, 0]))


def _contested(n: int, pairs: Pairs) -> NDArray[np.bool_]:
    """Pairs (i, j) between two chains: the one goes on from i past j, the other came to j from before i.

    Without the pair p, which has no nearer one, leads to j, and i to q, which has no nearer one: p < i < j < q.
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
    """Hops (i, j) that another one crosses: it leads from between i and j to beyond, or from before to between."""
    i, j = hops.T
    end, start = np.full(n, -1), np.full(n, n)
    end[i], start[j] = j, i
    found = np.zeros(len(hops), dtype=bool)
    for step in range(1, NEIGHBOURS):
        between = np.minimum(i + step, j - 1)
        found |= (between > i) & ((end[between] > j) | (start[between] < i))
    return found


def _explained(n: int, chain: NDArray[np.int64], steps: Sequence[Tie], ties: Sequence[Tie]) -> NDArray[np.bool_]:
    """Which ties within chains the way along the steps explains, (k,)."""
    # ties that may be skips, by their places on the track
    order = np.argsort(chain, kind="stable")
    pairs = np.array([tie[:2] for tie in ties], dtype=np.int64).reshape(-1, 2)
    ends = np.argsort(order)[pairs]
    gaps, dense = np.diff(ends, axis=1)[:, 0], _dense_to(chain, pairs, ends)[chain[pairs[:, 0]]]
    measured = np.array([tie.pose is not None for tie in ties], dtype=bool)
    asked = np.flatnonzero(measured & (gaps <= np.maximum(NEIGHBOURS, dense)))
    found = np.zeros(len(ties), dtype=bool)
    if not len(asked):
        return found

    # where the steps alone lead, and how far off from the first end
    poses, part = _reckoned(n, steps)
    positions = np.array([pose.translation() for pose in poses])[order]
    lengths, whole = np.linalg.norm(np.diff(positions, axis=0), axis=1), np.diff(part[order]) == 0
    way, break_ = (np.concatenate([[0.0], np.cumsum(each)]) for each in (lengths, ~whole))
    usual = float(np.median(lengths[whole])) if whole.any() else 0.0
    i, j = ends[asked].T
    off = np.zeros(len(asked))
    for ahead in range(1, int(gaps[asked].max()) + 1):
        off = np.maximum(off, np.linalg.norm(positions[np.minimum(i + ahead, j)] - positions[i], axis=1))

    # what agrees with the steps, and does not bring the sensor back or does so as a matter of course
    missed = [_missed(ties[k], poses) for k in asked.tolist()]
    missed_m, missed_rad, measured_m = np.array(missed).T
    agrees = (missed_m <= AGREES * np.maximum(way[j] - way[i], usual)) & (missed_rad <= AGREES_RAD)
    returns = (measured_m < RETURNS * off) & (off > usual)
    usual_gap = (gaps[asked] <= NEIGHBOURS) & ~returns | (gaps[asked] <= dense[asked])
    found[asked] = agrees & usual_gap & (break_[i] == break_[j])
    return found


def _dense_to(chain: NDArray[np.int64], pairs: Pairs, ends: Pairs) -> NDArray[np.int64]:
    """For each chain, up to how many keyframes away all are tied to their neighbours as a matter of course, (c,)."""
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


def _reckoned(n: int, steps: Sequence[Tie]) -> tuple[list[gtsam.Pose3], NDArray[np.int64]]:
    """Poses of n keyframes chained from the first of every part that measured steps hold together, and the parts."""
    leading: list[list[tuple[int, gtsam.Pose3]]] = [[] for _ in range(n)]
    for tie in steps:
        if tie.pose is not None:
            step = _spatial(tie.pose)
            leading[tie.first].append((tie.second, step))
            leading[tie.second].append((tie.first, step.inverse()))
    poses, part = [gtsam.Pose3()] * n, np.full(n, -1, dtype=np.int64)
    for root in range(n):
        if part[root] >= 0:
            continue
        part[root], queue = root, deque([root])
        while queue:
            here = queue.popleft()
            for there, step in leading[here]:
                if part[there] < 0:
                    poses[there], part[there] = poses[here].compose(step), root
                    queue.append(there)
    return poses, part


def _missed(tie: Tie, poses: Sequence[gtsam.Pose3]) -> tuple[float, float, float]:
    """By how much a tie misses what the steps lead to, m and rad, and the distance that it measures, m."""
    measured = _spatial(tie.pose)
    missed = measured.between(poses[tie.first].between(poses[tie.second]))
    turned = np.linalg.norm(gtsam.Rot3.Logmap(missed.rotation()))
    return float(np.linalg.norm(missed.translation())), float(turned), float(np.linalg.norm(measured.translation()))


def _spatial(pose: gtsam.Pose2 | gtsam.Pose3) -> gtsam.Pose3:
    return gtsam.Pose3(pose) if isinstance(pose, gtsam.Pose2) else pose
