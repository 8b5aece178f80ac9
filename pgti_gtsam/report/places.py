"""Where the map disagrees with the space: connections that the pose graph lacks, grouped into places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.integrity import Integrity
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.laplacian import connected_components


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """Keyframes in contact that the pose graph does not connect.

    Attributes
    ----------
    keyframes : (k,) int
        Those that an inserted edge touches, in order.
    worst : int
        The one with the largest stable score.
    n_inserted_edges : int
    """

    keyframes: NDArray[np.int64]
    worst: int
    n_inserted_edges: int


def find_places(pose_graph: PoseGraph, integrity: Integrity) -> list[Place]:
    """Group the inserted edges into places, worst first.

    Two keyframes that inserted edges touch belong to one place if an edge of the merged graph joins
    them. Places are ranked by their largest stable score, which stays where a defect is, while ζ may
    be largest far from the edges that caused it (section 6.3.2 of the paper, vertex 537).
    """
    touched = np.unique(integrity.inserted_edges)
    if len(touched) == 0:
        return []
    row = np.full(len(pose_graph), -1)
    row[touched] = np.arange(len(touched))
    within = row[integrity.merged_edges]
    n_places, place_of = connected_components(len(touched), within[(within >= 0).all(axis=1)])
    n_edges = np.bincount(place_of[row[integrity.inserted_edges[:, 0]]], minlength=n_places)
    order = np.lexsort((touched, -integrity.stable_scores[touched]))
    places = []
    for first in dict.fromkeys(place_of[order].tolist()):
        members = touched[place_of == first]
        worst = int(members[np.argmax(integrity.stable_scores[members])])
        places.append(Place(keyframes=members, worst=worst, n_inserted_edges=int(n_edges[first])))
    return places
