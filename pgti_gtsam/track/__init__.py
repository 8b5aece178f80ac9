"""The track: odometry and loop closures told apart, the chain of each keyframe, and the way travelled.

A robot is the letter of its keys; plain numbers belong to a single robot. A *step* ties two keyframes of a robot
that are each other's nearest: no factor leads from the earlier keyframe to a keyframe in between, and none from
there to the later keyframe. Neighbours in the order of the keys that a factor ties are a step. Keyframes farther apart
are a step where the chains of several robots run through each other under plain numbers: steps cross there, and each
goes on. A factor over several keyframes replaces a missing step where nothing else ties its keyframe, or where all are
registered against as many neighbours. A *chain* is a set of keyframes that steps join: a session of a robot, up to
where its odometry breaks off.

A factor over several steps is a *skip*, and odometry too, where the way explains the skip: see `Roles`. Every other
factor between keyframes is a loop closure.
"""

from pgti_gtsam.track.chains import Track, chains_of, closure_edges, step_edges, track_edges, track_of
from pgti_gtsam.track.roles import Roles, roles
from pgti_gtsam.track.skips import Tie

__all__ = [
    "Roles",
    "Tie",
    "Track",
    "chains_of",
    "closure_edges",
    "roles",
    "step_edges",
    "track_edges",
    "track_of",
]
