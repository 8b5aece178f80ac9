"""Sightings of landmarks by keyframes, and the covisibility edges and minimum-sphere radii that follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """Sightings of landmarks from keyframes.

    Attributes
    ----------
    keyframes, landmarks : (k,) int
        Index of the keyframe and of the landmark of each sighting; a pair may occur repeatedly.
    distances : (k,) float, m
        Distance from the keyframe's centre to the landmark; NaN where not known.
    landmark_positions : (l, 3) float, m
        NaN where a landmark could not be placed.
    n_keyframes : int
    """

    keyframes: NDArray[np.int64]
    landmarks: NDArray[np.int64]
    distances: NDArray[np.float64]
    landmark_positions: NDArray[np.float64]
    n_keyframes: int

    def incidence(self) -> sparse.csr_array:
        """(n, l) matrix with a 1 where a keyframe sees a landmark."""
        shape = (self.n_keyframes, len(self.landmark_positions))
        seen = sparse.coo_array((np.ones(len(self.keyframes)), (self.keyframes, self.landmarks)), shape=shape)
        incidence = seen.tocsr()
        incidence.data[:] = 1.0
        return incidence


def covisibility_edges(sightings: Sightings, min_shared_landmarks: int) -> tuple[NDArray[np.int64], int]:
    """Pairs of keyframes that see at least so many landmarks in common.

    Parameters
    ----------
    sightings : Sightings
    min_shared_landmarks : int

    Returns
    -------
    edges : (m, 2) int, i < j
    max_shared_landmarks : int
        The most that any two keyframes share; zero without two keyframes.
    """
    incidence = sightings.incidence()
    shared = sparse.triu(incidence @ incidence.T, k=1).tocoo()
    enough = shared.data >= min_shared_landmarks
    edges = np.stack([shared.row[enough], shared.col[enough]], axis=1).astype(np.int64)
    return edges, int(shared.data.max(initial=0))


def minimum_sphere_radii(
    sightings: Sightings, positions: NDArray[np.float64], edges: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Radius of the minimum sphere of every keyframe (Eq. 13): distance to its nearest landmark.

    The landmarks of a keyframe are the landmarks that the keyframe or a keyframe connected to the
    first sees (section 3.1 of the paper). A keyframe without any has radius zero.

    Parameters
    ----------
    sightings : Sightings
    positions : (n, 3) float, m
    edges : (m, 2) int
        Connected keyframes.

    Returns
    -------
    (n,) float, m
    """
    n = len(positions)
    if not len(sightings.keyframes):
        return np.zeros(n)
    radii = np.full(n, np.inf)
    np.fmin.at(radii, sightings.keyframes, sightings.distances)
    incidence = sightings.incidence()
    both = np.concatenate([edges, edges[:, ::-1]])
    neighbours = sparse.coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(n, n)).tocsr()
    for i in range(n):
        rows = neighbours.indices[neighbours.indptr[i] : neighbours.indptr[i + 1]]
        if len(rows):
            seen = np.concatenate([incidence.indices[incidence.indptr[j] : incidence.indptr[j + 1]] for j in rows])
            offsets = sightings.landmark_positions[seen] - positions[i]
            squared = np.fmin.reduce(np.einsum("kd,kd->k", offsets, offsets), initial=np.inf)
            radii[i] = np.fmin(radii[i], np.sqrt(squared))
    return np.where(np.isfinite(radii), radii, 0.0)
