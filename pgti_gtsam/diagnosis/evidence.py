"""The independent evidence of a map on its own rigidity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgti_gtsam.places import places_on
from pgti_gtsam.pose_graph import EdgeSource, PoseGraph
from pgti_gtsam.track import track_of

BESIDE = 1.0
"""Way along the track, as `places_on` has it, up to which two keyframes are neighbours: five keyframes or 5 ρ."""


def counted_once(pose_graph: PoseGraph) -> PoseGraph:
    """The same map without covisibility of neighbours on the track, but for the steps of the track.

    A point that is followed along the track is seen by ten keyframes and so makes forty-five pairs, all by the
    same few sightings that the odometry was made of, and all with the same error of scale or heading. As forty-five
    measurements they would make the drift a third of what it is. On landmark maps of odometry alone (training seeds
    1000 to 1003 of the ray-cast worlds) one of ten relative positions was off by more than 2.9 of their standard
    deviations on a campus and 2.0 in a garage; with the steps alone by 1.5 and 1.1, and no more in the other worlds.
    """
    along, sources = places_on(pose_graph, track_of(pose_graph)), pose_graph.edge_sources
    is_echo = (sources & (EdgeSource.BETWEEN | EdgeSource.ODOMETRY)) == 0
    is_echo &= np.abs(np.diff(along[pose_graph.edges], axis=1)[:, 0]) <= BESIDE
    kept = np.flatnonzero(~is_echo)
    information = pose_graph.edge_information
    return replace(
        pose_graph,
        edges=pose_graph.edges[kept],
        edge_sources=sources[kept],
        edge_slots=tuple(pose_graph.edge_slots[k] for k in kept.tolist()),
        edge_information=None if information is None else information[kept],
    )
