"""Maps of several robots or sessions, joined by links: each link is judged before the link fuses anything.

1. A map is a part of the factor graph that no factor ties to the rest, in a frame of any choice.
2. Two maps join where links of different revisits agree better than chance (`agreement`); the surest pair of maps joins
   first. A lone link joins nothing, for nothing tells whether the link is true.
3. The gate judges all other links within the joined map. A joined map may bring in a third map: two links, each to
   either of the two, support each other now.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import gtsam
import numpy as np
from scipy.special import expit

from pgti_gtsam.adapter.values import typed_value
from pgti_gtsam.errors import InvalidClosureError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import BETWEEN, Closure, check_map, checked_closure, factors_of, keys_of, measured_from
from pgti_gtsam.gate.decision import metres
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.reference_map import ReferenceMap
from pgti_gtsam.merging.agreement import Agreement, best_agreement
from pgti_gtsam.merging.single_map import SingleMap, maps_of
from pgti_gtsam.pose_graph import Radii

__all__ = ["Gain", "Joining", "LinkVerdict", "Merged", "merge"]

SAMPLED = 300
"""Pairs of keyframes of a map that its gain is measured by."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkVerdict:
    """Verdict on a link.

    Attributes
    ----------
    verdict : {"accepted", "undecided", "rejected"}
    probability : float
        Of a true link; NaN where nothing judges the link.
    keys : tuple of int
        Of the keyframes, ascending.
    sentence : str
    """

    verdict: Literal["accepted", "undecided", "rejected"]
    probability: float
    keys: tuple[int, ...]
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Joining:
    """Two maps that were joined.

    Attributes
    ----------
    maps : (str, str)
        Names; of maps that were joined before all names, between plus signs.
    links : tuple of int
        The links that joined the maps.
    probability : float
        Of these links being true.
    """

    maps: tuple[str, str]
    links: tuple[int, ...]
    probability: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gain:
    """Gain of a map.

    Attributes
    ----------
    map : str
    n_links : int
        Accepted links to keyframes of the map.
    before_m, after_m : float
        Standard deviation of the drift between two keyframes of the map, the median of many pairs, alone and in the
        end.
    """

    map: str
    n_links: int
    before_m: float
    after_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Merged:
    """Maps after the links were judged.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        The factors of all maps, and the accepted links.
    values : gtsam.Values
        The optimum. Maps that were not joined lie beside each other, too far apart to touch.
    closures : tuple of int, or None
        Slots of the closures in the graph, links included, where closures were told.
    links : tuple of LinkVerdict
        In the order given.
    order : tuple of Joining
        The surest first.
    gains : tuple of Gain
        For each map.
    left_out : tuple of int
        Keys of variables that no factor ties to any keyframe: neither graph nor values hold them.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    closures: tuple[int, ...] | None
    links: tuple[LinkVerdict, ...]
    order: tuple[Joining, ...]
    gains: tuple[Gain, ...]
    left_out: tuple[int, ...]


def merge(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    links: Sequence[Closure],
    radii: Radii | None = None,
    *,
    closures: Collection[int] | None = None,
    gate: LoopClosureGate | None = None,
) -> Merged:
    """Join maps by the true links. Graph and values stay untouched.

    Parameters
    ----------
    graph, values, radii, closures
        As in `from_gtsam`: all maps together, each in a frame of its own. Keys tell keyframes of different maps apart.
    links : sequence of factors, lists of factors or graphs
        A between factor each, between keyframes of two maps, or within a map.
    gate : LoopClosureGate, optional
        The gate's `min_probability` is asked of pairs of links too.

    Raises
    ------
    InvalidClosureError
        A link with a key that no map has.
    PgtiError
        As of `from_gtsam` and of the gate.
    """
    # the maps, each alone
    check_map(graph, values)
    merger = _Merger(
        maps=[(own, own.name) for own in maps_of(graph, values, closures)],
        links=[_checked(link, values) for link in links],
        radii=radii,
        gate=gate or LoopClosureGate(),
    )
    alone = [own for own, _ in merger.maps]

    # joined as far as links are sure
    merger.run()
    whole = merger.whole()
    return Merged(
        graph=whole.graph,
        values=whole.values,
        closures=None if whole.closures is None else tuple(sorted(whole.closures)),
        links=merger.verdicts(),
        order=tuple(merger.order),
        gains=tuple(merger.gain(own, whole) for own in alone),
        left_out=tuple(sorted(set(values.keys()).difference(*(own.values.keys() for own in alone)))),
    )


class _Merger:
    """Maps that become fewer, and the verdicts on links so far."""

    def __init__(
        self, *, maps: list[tuple[SingleMap, str]], links: Sequence[Any], radii: Radii | None, gate: LoopClosureGate
    ) -> None:
        self.maps, self.links, self.radii, self.gate = maps, links, radii, gate
        self.keys = [tuple(sorted({key for factor in factors_of(link) for key in keys_of(factor)})) for link in links]
        self.known: dict[int, LinkVerdict] = {}
        self.order: list[Joining] = []
        self._agreements: dict[tuple[str, str], tuple[Agreement | None, list[int]]] = {}

    def run(self) -> None:
        """Judge links within maps, and join the surest two maps, until no pair is sure enough."""
        for k in range(len(self.maps)):
            self._judge_within(k)
        while True:
            sure = [(found.log_odds, a, b, found, own) for a, b, found, own in self._pairs() if found is not None]
            best = max(sure, key=lambda each: each[0], default=None)
            if best is None or expit(best[0]) < self.gate.options.min_probability:
                return
            self._join(*best[1:])

    def _pairs(self) -> list[tuple[int, int, Agreement | None, list[int]]]:
        """For every two maps with links between the two: how the links agree, and the links."""
        found = []
        for a, b in combinations(range(len(self.maps)), 2):
            own = [k for k in range(len(self.links)) if k not in self.known and self._ends(k) == {a, b}]
            names = (self.maps[a][1], self.maps[b][1])
            if len(own) > 1 and names not in self._agreements:
                self._agreements[names] = (self._agreement(a, b, own), own)
            if names in self._agreements:
                found.append((a, b, *self._agreements[names]))
        return found

    def _ends(self, link: int) -> set[int]:
        """The maps that a link has keyframes of."""
        return {k for k, (own, _) in enumerate(self.maps) for key in self.keys[link] if own.values.exists(key)}

    def _agreement(self, a: int, b: int, links: list[int]) -> Agreement | None:
        """How the links between two maps agree; groups are places in the list of links."""
        pair = self.maps[a][0].centred().joined(self.maps[b][0].centred(), [])
        reference = self._reference(pair)
        offered, rows = reference.offered([self.links[k] for k in links])
        link_of = {tie: k for k, own in zip(links, rows, strict=True) for tie in own}
        found = best_agreement(offered, reference.revisits(offered))
        if found is None:
            return None
        return replace(
            found, groups=tuple(np.array([link_of[tie] for tie in group.tolist()], np.int64) for group in found.groups)
        )

    def _join(self, a: int, b: int, found: Agreement, links: list[int]) -> None:
        """Join two maps, and judge the other links between the two."""
        # the second map where the surest link puts it
        (first, name), (second, other) = self.maps[a], self.maps[b]
        passed = np.concatenate(found.groups).tolist()
        moved = second.moved(_motion(first, second, self.links[passed[0]]))
        pair = first.joined(moved, [self.links[k] for k in passed])
        pair = _at(pair, optimised(pair.graph, pair.values))

        # what joined them
        probability = float(expit(found.log_odds))
        said = f"Links of {len(found.groups)} revisits agree to {metres(found.missed_m)}: {name} and {other} join."
        self.order.append(Joining(maps=(name, other), links=tuple(passed), probability=probability))
        for k in passed:
            self.known[k] = LinkVerdict(
                verdict="accepted",
                probability=probability,
                keys=self.keys[k],
                sentence=said,
            )
        self.maps[b:] = self.maps[b + 1 :]
        self.maps[a] = (pair, f"{name} + {other}")
        self._judge_within(a)

    def _judge_within(self, k: int) -> None:
        """Let the gate judge the links within a map, and tie links that pass."""
        own, name = self.maps[k]
        inside = [link for link in range(len(self.links)) if link not in self.known and self._ends(link) == {k}]
        if not inside:
            return
        offered = [self.links[link] for link in inside]
        decisions = self.gate.judge(self._reference(own), offered).decisions
        for link, decision in zip(inside, decisions, strict=True):
            self.known[link] = LinkVerdict(
                verdict=decision.verdict,
                probability=decision.probability,
                keys=self.keys[link],
                sentence=" ".join(decision.reasons),
            )
        passed = [self.links[link] for link in inside if self.known[link].verdict == "accepted"]
        if passed:
            tied = own.tied(passed)
            self.maps[k] = (_at(tied, optimised(tied.graph, tied.values)), name)

    def _reference(self, own: SingleMap) -> ReferenceMap:
        return self.gate.reference_map(own.graph, own.values, own.radii(self.radii), own.closures)

    def whole(self) -> SingleMap:
        """All maps side by side, so far apart that no sphere of one meets another's."""
        whole = self.maps[0][0]
        for own, _ in self.maps[1:]:
            left, right = self._width(whole), self._width(own)
            away = [left[1] - right[0] + left[2] + right[2], 0.0, 0.0]
            planar = isinstance(_pose(own, own.first), gtsam.Pose2)
            motion = gtsam.Pose2(away[0], 0.0, 0.0) if planar else gtsam.Pose3(gtsam.Rot3(), away)
            whole = whole.joined(own.moved(motion), [])
        return whole

    def _width(self, own: SingleMap) -> tuple[float, float, float]:
        """First and last x of a map's keyframes, and twice the largest radius, m."""
        seen = self.gate.adapted(own.graph, own.values, own.radii(self.radii), own.closures)
        x = seen.positions[:, 0]
        return float(x.min()), float(x.max()), 2 * float(seen.radii.max())

    def verdicts(self) -> tuple[LinkVerdict, ...]:
        """Of all links, with links that nothing judges."""
        return tuple(self.known.get(k) or self._open(k) for k in range(len(self.links)))

    def _open(self, k: int) -> LinkVerdict:
        names = " and ".join(self.maps[place][1] for place in sorted(self._ends(k)))
        return LinkVerdict(
            verdict="undecided",
            probability=np.nan,
            keys=self.keys[k],
            sentence=f"No link of another revisit between {names} agrees well enough: the link fuses nothing.",
        )

    def gain(self, own: SingleMap, whole: SingleMap) -> Gain:
        """How much surer a map knows the relative positions of keyframes."""
        before, after = (self._reference(each) for each in (own, whole))
        keys = before.pose_graph.keys.tolist()
        pairs = np.random.default_rng(0).integers(len(keys), size=(SAMPLED, 2))
        places = np.searchsorted(after.pose_graph.keys, np.array(keys, dtype=np.uint64))
        spread = [
            float(np.median(each.settled.model.units.allowances_m(each.settled.covariances(asked))))
            for each, asked in ((before, pairs), (after, places[pairs]))
        ]
        accepted = [link for link in self.known.values() if link.verdict == "accepted"]
        n_links = sum(any(own.values.exists(key) for key in link.keys) for link in accepted)
        return Gain(map=own.name, n_links=n_links, before_m=spread[0], after_m=spread[1])


def _checked(link: Closure, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """The link as a graph, if a between factor of two keyframes."""
    checked = checked_closure(link, values)
    factors = factors_of(checked)
    if len(factors) != 1 or not isinstance(factors[0], BETWEEN):
        raise InvalidClosureError(
            f"expected a link of one between factor, got {', '.join(type(each).__name__ for each in factors)}"
        )
    return checked


def _motion(first: SingleMap, second: SingleMap, link: gtsam.NonlinearFactorGraph) -> Any:
    """The motion of the second map to the place beside the first that a link measures."""
    factor = factors_of(link)[0]
    a, b = sorted(keys_of(factor), key=first.values.exists, reverse=True)
    return _pose(first, a).compose(measured_from(factor, a)).compose(_pose(second, b).inverse())


def _pose(own: SingleMap, key: int) -> Any:
    return typed_value(own.values, "Pose3", key) or own.values.atPose2(key)


def _at(own: SingleMap, values: gtsam.Values) -> SingleMap:
    """The same map at other values."""
    return replace(own, values=values)
