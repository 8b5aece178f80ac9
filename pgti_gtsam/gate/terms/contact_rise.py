"""Free space that comes to touch where nothing connects: what a closure changes at the keyframe that suffers most.

A spurious closure folds the map: spheres of unconnected places come to overlap, and the keyframes there see
a different heat kernel on pose graph and merged graph. The paper weighs the largest change on the map (Λ), which
an old defect elsewhere can mask. Here every keyframe is compared with itself, before and after, near what changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.gate.decision import Change, Term
from pgti_gtsam.integrity import stable_scores
from pgti_gtsam.pair_codes import Pairs, codes_of, pairs_of
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from pgti_gtsam.spectral.laplacian import adjacency
from pgti_gtsam.support_graph import overlapping_spheres
from pgti_gtsam.track import chains_of, step_edges

RISE = (1.5, -3.4)
"""Log odds by the rise r of the worst keyframe's stable score, c₀ + c₁ r, on top of the drift's. `python -m scenarios
rise` measures what the pair is worth: of 391 revisits of the seven ray-cast worlds (seeds 1000 to 1007) that the drift
leaves within ±10, asked one by one as they come, all 135 true and 15 of 256 false ones are accepted. The likeliest pair
that still accepts 95 % of the true ones, (−1.1, −4.3), accepts none of the false ones, but leaves a single first match
after a kilometre of drift undecided, which this one accepts."""

GATE_TIMES = np.geomspace(0.2, 200.0, 40)
"""Times of the local score. At 200 the heat of a bare odometry chain has crossed √(2·200) = 20 keyframes to
either side: as far as a closure's overlaps reach around it, and no farther than they should be blamed."""

REGION = 300
"""Keyframes around a change on which the local score is computed: at the last of `GATE_TIMES` a chain's heat is
then seven standard deviations from the border, and four decompositions of that size
take a few hundredths of a second."""

CHANGED = 150
"""Changed keyframes at most that the score is asked of, those with most changes first: half of `REGION`, so
that they keep surroundings. A closure that changes more has folded the map in many places, and shows in each."""


SEEN = 0.005
"""Rise below which the sentence tells of none: two digits show no difference."""

AT_ONCE = 2_000_000  # pairs of keyframes that are compared in one go: some hundred megabytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """The pairs of keyframes of a pose graph that are connected, and those that only touch.

    Attributes
    ----------
    connected : (c,) int
        Codes i · n + j, i < j, of the pose graph's edges and of the overlaps that the edges explain.
    merged : (m,) int
        Codes of `connected` and of all other overlaps.
    """

    pose_graph: PoseGraph
    connected: NDArray[np.int64]
    merged: NDArray[np.int64]

    @property
    def unexplained(self) -> int:
        """Number of overlaps that nothing explains."""
        return len(self.merged) - len(self.connected)


def contacts(pose_graph: PoseGraph) -> Contacts:
    """Connected and merged pairs, with explained overlaps among the connected."""
    n = len(pose_graph)
    connected = np.unique(codes_of(np.concatenate([pose_graph.edges, bridged_overlaps(pose_graph)]), n))
    free = codes_of(overlapping_spheres(pose_graph.positions, pose_graph.radii), n)
    return Contacts(pose_graph=pose_graph, connected=connected, merged=np.union1d(connected, free))


def bridged_overlaps(pose_graph: PoseGraph) -> Pairs:
    """Overlaps that a closure makes a matter of course, (k, 2).

    The rule along the track (`track.track_edges`) holds through a closure between a and b: when
    the way from i along the track to a, across to b, and along the track to j is no longer than
    r_i + r_j, the spheres of i and j must meet, however the way bends. Lengths are those of the
    estimate, so that every pair found does overlap.
    """
    # the track, and what bridges it, by places on it
    n, steps = len(pose_graph), step_edges(pose_graph)
    chain = chains_of(n, pose_graph.edges[steps])
    order = np.argsort(chain, kind="stable")
    chain, positions, radii = chain[order], pose_graph.positions[order], pose_graph.radii[order]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    bridging = ~steps & (pose_graph.edge_sources & EdgeSource.BETWEEN > 0)
    bridges = np.sort(np.argsort(order)[pose_graph.edges[bridging]], axis=1)
    gaps = np.linalg.norm(positions[bridges[:, 0]] - positions[bridges[:, 1]], axis=1)

    # what lies near by on both sides
    reach = 2 * radii.max() - gaps
    bridges, gaps, reach = bridges[reach >= 0], gaps[reach >= 0], reach[reach >= 0]
    first = np.searchsorted(travelled, travelled[bridges] - reach[:, None])
    ends = np.searchsorted(travelled, travelled[bridges] + reach[:, None], side="right")
    found = []
    for part in _even_parts(np.prod(ends - first, axis=1)):
        bridge, p, q = _pairs_across(first[part], ends[part])
        a, b = bridges[part][bridge].T
        slack = radii[p] - np.abs(travelled[p] - travelled[a]) + radii[q] - np.abs(travelled[q] - travelled[b])
        met = (slack >= gaps[part][bridge]) & (chain[p] == chain[a]) & (chain[q] == chain[b]) & (p != q)
        found.append(np.stack([p[met], q[met]], axis=1))
    return np.asarray(order[np.concatenate([np.empty((0, 2), dtype=np.int64), *found])])


def _even_parts(sizes: NDArray[np.int64]) -> Iterator[slice]:
    """Slices of at least one item, and of at most `AT_ONCE` in size where an item is not larger itself."""
    start = 0
    while start < len(sizes):
        count = max(int(np.searchsorted(np.cumsum(sizes[start:]), AT_ONCE, side="right")), 1)
        yield slice(start, start + count)
        start += count


def _pairs_across(first: Pairs, ends: Pairs) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """All pairs between the two windows [first, ends) of every bridge: the bridge, and both places."""
    widths = ends - first
    counts = np.prod(widths, axis=1)
    bridge = np.repeat(np.arange(len(counts)), counts)
    k = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return bridge, first[bridge, 0] + k // widths[bridge, 1], first[bridge, 1] + k % widths[bridge, 1]


def local_rise(before: Contacts, after: Contacts) -> tuple[Change, int | None]:
    """Stable score of the keyframe whose score rises most, and its index.

    Only keyframes near a changed edge or overlap can change, so the score is computed on the `REGION`
    keyframes nearest to the changes, in hops: the cost does not grow with the map.

    Parameters
    ----------
    before, after : Contacts
        Of the same keyframes.

    Returns
    -------
    change : Change
        Zero to zero where nothing changed.
    index : int or None
        None where nothing changed.
    """
    n = len(before.pose_graph)
    changed = _changed(before, after, n)
    if not len(changed):
        return Change(before=0.0, after=0.0), None
    region = _region(changed, pairs_of(np.union1d(before.merged, after.merged), n), n)
    place = np.full(n, -1)
    place[region] = np.arange(len(region))
    graphs = [_inside(place, pairs_of(c, n)) for s in (before, after) for c in (s.connected, s.merged)]
    p0, m0, p1, m1 = heat_kernels(len(region), *graphs)
    old, new = stable_scores(p0, m0, GATE_TIMES), stable_scores(p1, m1, GATE_TIMES)
    rises = (new - old)[place[changed]]
    worst = int(changed[np.argmax(rises)])
    return Change(before=float(old[place[worst]]), after=float(new[place[worst]])), worst


def _changed(before: Contacts, after: Contacts, n: int) -> NDArray[np.int64]:
    """Keyframes at which an edge or an overlap comes or goes, the keyframes with most changes, ascending."""
    codes = [np.setxor1d(getattr(before, name), getattr(after, name)) for name in ("connected", "merged")]
    counts = np.bincount(pairs_of(np.concatenate(codes), n).ravel(), minlength=n)
    most = np.argsort(-counts, kind="stable")[: min(CHANGED, int((counts > 0).sum()))]
    return np.sort(most)


def _region(seeds: NDArray[np.int64], edges: Pairs, n: int) -> NDArray[np.int64]:
    """At most `REGION` vertices nearest to the seeds in hops, ascending, all of a ring or the first of it."""
    neighbours = adjacency(n, edges)
    inside = np.zeros(n, dtype=bool)
    inside[seeds] = True
    ring = seeds
    while len(ring) and inside.sum() < REGION:
        reached = np.unique(neighbours[:, ring].indices).astype(np.int64)
        ring = reached[~inside[reached]][: REGION - int(inside.sum())]
        inside[ring] = True
    return np.flatnonzero(inside)


def _inside(place: NDArray[np.int64], edges: Pairs) -> Pairs:
    moved = place[edges]
    return np.asarray(moved[(moved >= 0).all(axis=1)])


def log_odds(rise: float) -> float:
    """Log odds of true against false for a rise; a fall says no more than no rise."""
    return RISE[0] + RISE[1] * max(rise, 0.0)


def term(change: Change, label: str | None) -> Term:
    """The evidence in words; `label` names the keyframe that suffers most, None where nothing changed.

    Parameters
    ----------
    change : Change
    label : str, optional
        Name of the keyframe that suffers most; None where nothing changed.
    """
    if label is None:
        sentence = "No contact of free space changes."
    elif change.rise > SEEN:
        sentence = (
            f"Free space around {label} comes to touch places that nothing connects: its score rises from "
            f"{change.before:.2f} to {change.after:.2f}."
        )
    else:
        before, after = f"{change.before:.2f}", f"{change.after:.2f}"
        goes = f"stays at {before}" if before == after else f"goes from {before} to {after}"
        sentence = f"No keyframe's score rises: it {goes} around {label}."
    return Term(value=change.rise, log_odds=log_odds(change.rise), sentence=sentence)
