"""The role of each factor between keyframes on the track: a step, a skip or a loop closure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.pair_codes import codes_of, pairs_of
from pgti_gtsam.track.chains import Pairs, chains_of
from pgti_gtsam.track.skips import Tie, explained
from pgti_gtsam.track.steps import steps_among

_NONE = np.empty((0, 2), dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Roles:
    """The roles of ties on the track.

    Attributes
    ----------
    is_step : (m,) bool
        Ties of a keyframe to the next keyframe of its chain.
    is_skip : (m,) bool
        Ties over several steps of a chain that the way explains: the ties agree with the steps between, and either
        do not bring the sensor back to an earlier position, or all keyframes of the chain are tied to as many
        neighbours.
    chain : (n,) int
        As in `Track`.
    steps : (s, 2) int
        The steps, i < j, sorted; pairs of keyframes with shared landmarks among them.
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
    motions: NDArray[np.bool_] | None = None,
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
        Keyframes that see the same landmarks, i < j: the pairs of neighbours are steps.
    held : (n,) bool, optional
        Keyframes that other factors tie. A keyframe without such a factor, and without a step, hangs on its nearest
        tie, which is odometry, for want of any other.
    motions : (m,) bool, optional
        Ties that are known to be steps: those by inertial factors, say.
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
    steps = steps_among(
        keys, pairs[~known], _NONE if covisible is None else covisible, np.zeros(n, bool) if held is None else held
    )
    if motions is not None:
        steps = pairs_of(np.unique(codes_of(np.concatenate([steps, pairs[motions]]), n)), n)
    chain = chains_of(n, steps)
    is_step = ~known & np.isin(codes_of(pairs, n), codes_of(steps, n))

    # what the way along them explains
    is_skip = ~known & ~is_step
    if closures is None:
        chosen = np.flatnonzero(is_skip & (chain[pairs[:, 0]] == chain[pairs[:, 1]]))
        is_skip = np.zeros(m, dtype=bool)
        walked = [tie for tie, own in zip(ties, is_step, strict=True) if own]
        is_skip[chosen] = explained(n, chain, walked, [ties[k] for k in chosen.tolist()])
    return Roles(is_step=is_step, is_skip=is_skip, chain=chain, steps=steps)
