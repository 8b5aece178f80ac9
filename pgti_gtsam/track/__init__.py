"""The track: what is odometry and what a loop closure, which chain each keyframe is on, and the way travelled.

A robot is the letter of its keys; plain numbers are those of one robot. A *step* ties two keyframes of one robot of
which each is the other's nearest: no factor leads from the earlier one to one in between, and none to the later one
from there. Neighbours in the order of the keys that a factor ties are a step. Keyframes farther apart are one where
the chains of several robots run through each other under plain numbers: steps cross there, and each goes on. A factor
over several keyframes stands in for a step that is missing where nothing else ties its keyframe, or where all are
registered against as many neighbours. A *chain* is what steps hold together: a session of a robot, up to where its
odometry breaks off.

A factor over several steps is a *skip*, and odometry too, where the way explains it: see `Roles`. Every other factor
between keyframes is a loop closure.
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
