"""Ties that a diagnosis proposes, as a factor graph that a scan matcher can take."""

from __future__ import annotations

import gtsam

from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.diagnosis.records import Diagnosis
from pgti_gtsam.factor_graphs import between_factor


def proposal_graph(diagnosis: Diagnosis, values: gtsam.Values) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Proposed ties as between factors, gravest places first, and the poses of their keyframes.

    Every factor measures the predicted relative pose, with the covariance of the prediction: a region to search, not a
    measurement to believe.

    Parameters
    ----------
    diagnosis : Diagnosis
    values : gtsam.Values
        The values that were diagnosed.
    """
    keyframes, keys = read_keyframes(values), diagnosis.pose_graph.keys.tolist()
    graph, poses = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for place in diagnosis.places:
        if place.proposal is None:
            continue
        pose, (i, j) = place.proposal.pose, (keys[k] for k in place.proposal.keyframes)
        graph.push_back(between_factor(i, j, pose, gtsam.noiseModel.Gaussian.Covariance(place.proposal.covariance)))
        for key in (i, j):
            if not poses.exists(key):
                poses.insert(key, keyframes.pose(key))
    return graph, poses
