"""How probably two stretches that touch in a map run through the same space: by the drift, and by how people drive.

The drift model knows how far the later stretch may truly lie from its place in the map, seen from the earlier stretch.
In some of all these positions the two stretches meet. The share of such positions is the posterior probability of a
meeting where all positions are alike before looking. The share weighs the drift against the spheres, and the shape of
the contact too: streets that cross go on crossing wherever the drift shifts them, and a long parallel pass is lost by
a shift to the side alone. But positions are not alike before looking: people and robots come back to places where they
were. The weight of that is fitted, on drives whose truth is known.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from pgti_gtsam.places import WINDOW
from pgti_gtsam.track import Track

DRAWN = 256
"""Positions of the later stretch that are drawn: a share of one half is known to 3 %."""

CONTACT = np.array([3.5, 1.24])
"""Log odds that two stretches in contact run through the same space: c₀ + c₁ logit q, q the share of `meeting_share`.
With c₁ = 1 that is Bayes' rule, and c₀ the log odds before looking: 28 to 1. Fitted to 5544 contacts of odometry in
the seven ray-cast worlds, of which 96 % were real (`python -m scenarios contacts`: seeds 1000 to 1015, 0.5 to 3 times
the simulator's drift, and a scale that shrinks by 2 to 40 %), to all seeds; a fit to the even ones tells the odd ones
apart as well (area under the curve 0.92). Fitted likewise, the length of the contact and the drift against the
spheres, which were asked before, reach 0.88; together with the share they add nothing. Nor does the angle between
the stretches, nor how often the later stretch, moved so, would touch other ways by chance."""

ASKED = 24
"""Keyframes at most of the later stretch that are asked whether they meet the earlier one."""

Array = NDArray[np.float64]
Stretch = tuple[int, int]


def same_space(share: float) -> float:
    """Probability that two stretches in contact run through the same space."""
    return float(expit(CONTACT @ (1.0, logit(share))))


def meeting_share(
    poses: tuple[Any, ...],
    positions: Array,
    radii: Array,
    track: Track,
    stretches: tuple[Stretch, Stretch],
    anchor: int,
    covariance: Array,
) -> float:
    """Share of the later stretch's possible positions in which spheres of both stretches meet.

    The earlier stretch is widened by `WINDOW` keyframes at either end.

    Parameters
    ----------
    poses : tuple of n gtsam.Pose2 or gtsam.Pose3
    positions : (n, d) float
        Of the poses, m.
    radii : (n,) float, m
    track : Track
    stretches : ((int, int), (int, int))
        First and last keyframe of either, as `Revisit` has them.
    anchor : int
        The keyframe of the later stretch whose relative pose is drawn; the stretch moves with it as a rigid body.
    covariance : (d, d) float
        Of the pose of the anchor seen from the earlier stretch, in the tangent space of the anchor.
    """
    # both stretches, the later in the frame of the anchor
    earlier, later = _along(stretches[0], track, WINDOW), _along(stretches[1], track, 0)
    earlier = np.setdiff1d(earlier, later)
    asked = later[np.unique(np.linspace(0, len(later) - 1, ASKED).round().astype(int))]
    turn, centre = np.asarray(poses[anchor].rotation().matrix()), positions[anchor]
    own = (positions[asked] - centre) @ turn
    reach = radii[asked][:, None] + radii[earlier]

    # where the drift may have left it
    root = _root(covariance)
    moves = np.random.default_rng(0).standard_normal((DRAWN, len(covariance))) @ root.T
    met = 0
    for move in moves:
        moved = type(poses[anchor]).Expmap(move)
        places = (own @ moved.rotation().matrix().T + moved.translation()) @ turn.T + centre
        gaps = np.linalg.norm(places[:, None] - positions[earlier], axis=2)
        met += bool((gaps <= reach).any())
    return (met + 0.5) / (DRAWN + 1)


def _along(stretch: Stretch, track: Track, more: int) -> NDArray[np.int64]:
    """Keyframes of a stretch, and so many more at either end, on its chain."""
    place = np.empty(len(track.order), dtype=np.int64)
    place[track.order] = np.arange(len(track.order))
    first, last = sorted(place[list(stretch)].tolist())
    near = track.order[max(first - more, 0) : last + more + 1]
    return np.asarray(near[track.chain[near] == track.chain[stretch[0]]])


def _root(covariance: Array) -> Array:
    """A matrix root of a covariance; eigenvalues that rounding made negative count as zero."""
    squares, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(squares, 0.0)))
