"""A drive over a network of ways: first passes, passes again in either direction, crossings."""

from __future__ import annotations

import gtsam
import networkx as nx
import numpy as np

from scenarios.worlds.solid import Array


def drive(ways: nx.Graph, random: np.random.Generator, length_m: float, step_m: float) -> list[gtsam.Pose3]:
    """Poses a step apart, looking ahead; x is forward, z up but for the slope.

    Parameters
    ----------
    ways : nx.Graph
    random : np.random.Generator
    length_m : float
    step_m : float
    """
    corners = np.array(_walk(ways, random, length_m))
    sides = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(sides)])
    at = np.arange(step_m, min(length_m, way[-1]) - step_m, step_m)
    places, ahead, behind = (_along(corners, way, at + shift * step_m) for shift in (0.0, 0.5, -0.5))
    return [_looking(place, to - back) for place, to, back in zip(places, ahead, behind, strict=True)]


def _walk(ways: nx.Graph, random: np.random.Generator, length_m: float) -> list[tuple[float, float, float]]:
    """Random, with a liking for rare ways; back the way the robot came only at a dead end."""
    nodes = sorted(ways.nodes)
    walk, passed, driven = [nodes[int(random.integers(len(nodes)))]], {}, 0.0
    while driven < length_m + 1.0:
        here = walk[-1]
        choices = sorted(ways[here])
        if len(choices) > 1 and len(walk) > 1:
            choices.remove(walk[-2])
        weights = np.array([0.3 ** passed.get(frozenset((here, there)), 0) for there in choices])
        there = choices[int(random.choice(len(choices), p=weights / weights.sum()))]
        passed[frozenset((here, there))] = passed.get(frozenset((here, there)), 0) + 1
        driven += float(np.linalg.norm(np.subtract(there, here)))
        walk.append(there)
    return walk


def _along(corners: Array, way: Array, at: Array) -> Array:
    return np.stack([np.interp(at, way, corners[:, k]) for k in range(3)], axis=1)


def _looking(place: Array, ahead: Array) -> gtsam.Pose3:
    yaw = float(np.arctan2(ahead[1], ahead[0]))
    pitch = -float(np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1])))
    return gtsam.Pose3(gtsam.Rot3.Ypr(yaw, pitch, 0.0), place)
