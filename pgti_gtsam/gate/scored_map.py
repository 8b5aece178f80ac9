"""A map with known Λ and Λ_glob, from which the scores of maps with a few more edges follow quickly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgti_gtsam.integrity import scores
from pgti_gtsam.pair_codes import Codes, codes_of, pairs_of
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.spectral.low_rank import SpectralState
from pgti_gtsam.support_graph import overlapping_spheres

TOLERANCE = 1e-5
"""Error of the signatures relative to the largest one: a decision needs four digits of Λ."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoredMap:
    """A pose graph G_p and its merged graph G_m, both factorised.

    Attributes
    ----------
    n_keyframes : int
    edges, merged : (m,) int
        Codes i · n + j, i < j, of the edges of G_p and of G_m.
    pose, free : SpectralState
        Of G_p and of G_m.
    beta : float
        As in `assess`.
    scores : (float, float)
        Λ and Λ_glob.
    """

    n_keyframes: int
    edges: Codes
    merged: Codes
    pose: SpectralState
    free: SpectralState
    beta: float
    scores: tuple[float, float]

    @classmethod
    def of(cls, pose_graph: PoseGraph, beta: float) -> ScoredMap:
        """Factorise a map, at the cost of two new heat kernels.

        Parameters
        ----------
        pose_graph : PoseGraph
        beta : float
            Share of the times that is local.
        """
        n, (edges, merged) = len(pose_graph), _edges_of(pose_graph)
        pose, free = (SpectralState.of(n, pairs_of(codes, n), TOLERANCE) for codes in (edges, merged))
        known = scores(pose.kernel, free.kernel, beta=beta)
        return cls(n_keyframes=n, edges=edges, merged=merged, pose=pose, free=free, beta=beta, scores=known)

    def scores_of(self, pose_graph: PoseGraph) -> tuple[float, float]:
        """Λ and Λ_glob of another map of the same keyframes; the fewer edges differ, the sooner."""
        n, (edges, merged) = self.n_keyframes, _edges_of(pose_graph)
        more, less, more_free, less_free = (
            pairs_of(np.setdiff1d(one, other), n)
            for one, other in (
                (edges, self.edges),
                (self.edges, edges),
                (merged, self.merged),
                (self.merged, merged),
            )
        )
        pose = self.pose.kernel_with(more, less) if len(less) else self.pose.bounded_kernel_with(more)
        return scores(pose, self.free.kernel_with(more_free, less_free), beta=self.beta)


def _edges_of(pose_graph: PoseGraph) -> tuple[Codes, Codes]:
    """Codes of the edges of G_p and of G_m, sorted and unique."""
    n = len(pose_graph)
    edges, free = (
        np.unique(codes_of(pairs, n))
        for pairs in (pose_graph.edges, overlapping_spheres(pose_graph.positions, pose_graph.radii))
    )
    return edges, np.union1d(edges, free)
