"""How exactly the true ties of a map hold its keyframes, where odometry is poor: a net of beams with loose joints.

With p and φ small displacements and turns of the keyframes, in the axes of the world, a tie (i, j) holds p_j − p_i −
φ_i × (x_j − x_i) and φ_j − φ_i, both with a standard deviation of its own, alike in all directions. That needs the true
places x of the keyframes, and neither their attitude nor the map's estimate.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import SuperLU, splu

from scenarios.diagnosis.stretches import Pairs
from scenarios.worlds.solid import Array

POOR, MATCH, MATCH_RAD = 0.03, 0.125, 0.075
"""Standard deviations of poor odometry after one ρ, in ρ and rad, and of a closure, in ρ and in rad; ρ is the median
radius. The package grants the same: a map is tied if it need not be trusted further than that."""

LEAST_STEP = 0.05
"""Least length of a step, in ρ."""

ANCHOR = 1e-4
"""Standard deviation of the first keyframe of each part."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Held:
    """Keyframes and the ties that hold the keyframes.

    Attributes
    ----------
    places : (n, d) float
        In ρ.
    part : (n,) int
        Groups of keyframes that hang together.
    factor : SuperLU
        Of the information matrix of all displacements and turns.
    """

    places: Array
    part: NDArray[np.int32]
    factor: SuperLU

    @classmethod
    def by(cls, places: Array, steps: Pairs, closures: Pairs) -> Held:
        """Held by steps of odometry and by closures, (s, 2) and (c, 2) int; places are in ρ.

        Parameters
        ----------
        places : (n, d) float
            In ρ.
        steps : (s, 2) int
        closures : (c, 2) int
        """
        # what each tie holds, and how well
        n, ties = len(places), np.concatenate([steps, closures])
        lengths = np.maximum(np.linalg.norm(np.diff(places[steps], axis=1)[:, 0], axis=1), LEAST_STEP)
        moved, turned = (
            np.concatenate([POOR * np.sqrt(lengths), np.full(len(closures), match)]) for match in (MATCH, MATCH_RAD)
        )
        shifts, turns = _shifts(places, ties), _turns(places, ties)
        n_axes, n_turns = places.shape[1], turns.shape[0] // len(ties)
        weighted = sparse.vstack(
            [
                sparse.diags_array(np.repeat(1 / moved, n_axes)) @ shifts,
                sparse.diags_array(np.repeat(1 / turned, n_turns)) @ turns,
            ]
        )

        # each part is held somewhere
        _, part = csgraph.connected_components(sparse.coo_array((np.ones(len(ties)), ties.T), shape=(n, n)))
        gauge_priors = np.zeros((n, n_axes + n_turns))
        gauge_priors[np.unique(part, return_index=True)[1]] = ANCHOR**-2
        information = weighted.T @ weighted + sparse.diags_array(gauge_priors.ravel())
        return cls(places=places, part=part, factor=splu(sparse.csc_array(information)))

    def deviations(self, pairs: Pairs) -> Array:
        """Standard deviation of j's place seen from i along the least certain axis, (k,) in ρ; infinite where apart."""
        if not len(pairs):
            return np.zeros(0)
        n_axes = self.places.shape[1]
        shifts = _shifts(self.places, pairs)
        covariances = shifts @ self.factor.solve(shifts.T.toarray())
        blocks = np.array([covariances[k : k + n_axes, k : k + n_axes] for k in range(0, len(covariances), n_axes)])
        found = np.sqrt(np.maximum(np.linalg.eigvalsh(blocks)[:, -1], 0.0))
        return np.where(self.part[pairs[:, 0]] == self.part[pairs[:, 1]], found, np.inf)


def _shifts(places: Array, pairs: Pairs) -> sparse.csr_array:
    """Rows of p_j − p_i − φ_i × (x_j − x_i), axis by axis of every pair."""
    n, n_axes = places.shape
    planes = list(combinations(range(n_axes), 2))
    n_own = n_axes + len(planes)
    i, j = pairs.T
    away, first = places[j] - places[i], n_axes * np.arange(len(pairs))
    entries = []
    for axis in range(n_axes):
        entries += [(first + axis, n_own * j + axis, np.ones(len(pairs)))]
        entries += [(first + axis, n_own * i + axis, -np.ones(len(pairs)))]
    for k, (a, b) in enumerate(planes, n_axes):  # a turn in the plane of two axes carries the one towards the other
        entries += [(first + a, n_own * i + k, away[:, b]), (first + b, n_own * i + k, -away[:, a])]
    return _rows(entries, n_axes * len(pairs), n_own * n)


def _turns(places: Array, pairs: Pairs) -> sparse.csr_array:
    """Rows of φ_j − φ_i, turn by turn of every pair."""
    n, n_axes = places.shape
    n_turns = n_axes * (n_axes - 1) // 2
    n_own = n_axes + n_turns
    i, j = pairs.T
    first = n_turns * np.arange(len(pairs))
    entries = []
    for k in range(n_turns):
        entries += [(first + k, n_own * j + n_axes + k, np.ones(len(pairs)))]
        entries += [(first + k, n_own * i + n_axes + k, -np.ones(len(pairs)))]
    return _rows(entries, n_turns * len(pairs), n_own * n)


def _rows(entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Array]], n_rows: int, n: int) -> sparse.csr_array:
    rows, columns, values = (np.concatenate(each) for each in zip(*entries, strict=True))
    return sparse.coo_array((values, (rows, columns)), shape=(n_rows, n)).tocsr()
