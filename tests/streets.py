"""Small worlds for the gate: a robot on streets or floors, odometry that drifts, closures that are true or not."""

from dataclasses import dataclass, field

import gtsam
import numpy as np

STEP = 2.0
RADIUS = 3.0


@dataclass
class World:
    """Truth and what the robot knows of it; keyframe k has key k."""

    truth: list
    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    values: gtsam.Values = field(default_factory=gtsam.Values)

    def closure(self, i, j, measured=None):
        """Closure between two keyframes, true unless told otherwise."""
        closure = gtsam.NonlinearFactorGraph()
        closure.push_back(between(i, j, self.truth[i].between(self.truth[j]) if measured is None else measured))
        return closure


def between(i, j, measured, scale=1.0):
    if isinstance(measured, gtsam.Pose2):
        model = gtsam.noiseModel.Diagonal.Sigmas(scale * np.array([0.05, 0.05, 0.01]))
        return gtsam.BetweenFactorPose2(i, j, measured, model)
    model = gtsam.noiseModel.Diagonal.Sigmas(scale * np.array([0.01, 0.01, 0.01, 0.05, 0.05, 0.05]))
    return gtsam.BetweenFactorPose3(i, j, measured, model)


def driven(steps, *, bias=0.0, noise=0.0, seed=0, model_scale=1.0):
    """World of a robot that makes the given true steps; each measured one turns by `bias` too much, plus noise."""
    rng = np.random.default_rng(seed)
    planar = isinstance(steps[0], gtsam.Pose2)
    pose = gtsam.Pose2() if planar else gtsam.Pose3()
    world = World([pose])
    world.values.insert(0, pose)
    guess = pose
    for i, step in enumerate(steps):
        error = noise * rng.normal(size=3 if planar else 6)
        error[2] += bias
        measured = step.compose((gtsam.Pose2 if planar else gtsam.Pose3).Expmap(error))
        guess = guess.compose(measured)
        world.truth.append(world.truth[-1].compose(step))
        world.values.insert(i + 1, guess)
        world.graph.push_back(between(i, i + 1, measured, model_scale))
    return world


def straight(length):
    return [gtsam.Pose2(STEP, 0, 0)] * round(length / STEP)


def turn(angle):
    """Two steps that together turn by an angle."""
    return [gtsam.Pose2(STEP / 2, 0, angle / 2)] * 2


def block(length, times=1):
    """Steps around a square block, as often as told, left turns."""
    return [*straight(length), *turn(np.pi / 2)] * 4 * times


def ramp(side, rise, floors):
    """Steps of a parking ramp: squares that climb, seen from above one on top of the other."""
    flat = [gtsam.Pose3(gtsam.Rot3(), [STEP, 0, 0])] * round(side / STEP)
    corner = [gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 4), [STEP / 2, 0, 0])] * 2
    lap = [*flat, *corner] * 4
    climb = rise / len(lap)
    return [gtsam.Pose3(step.rotation(), step.translation() + [0, 0, climb]) for step in lap] * floors


def optimum(graph, values):
    """Of a caller's graph, its first keyframe held."""
    first = next(iter(values.keys()))
    held = gtsam.NonlinearFactorGraph(graph)
    planar = gtsam.utilities.allPose2s(values).size() > 0
    prior, pose = (gtsam.PriorFactorPose2, values.atPose2) if planar else (gtsam.PriorFactorPose3, values.atPose3)
    held.push_back(prior(first, pose(first), gtsam.noiseModel.Isotropic.Sigma(3 if planar else 6, 1e-3)))
    return gtsam.LevenbergMarquardtOptimizer(held, values).optimize()
