"""Maps of stella_vslam and OpenVSLAM (``.msg``, MessagePack): keyframes, landmarks and the graph between keyframes.

A keyframe holds its pose from world to camera (``rot_cw`` a quaternion x, y, z, w, ``trans_cw``), the landmark of every
keypoint (``lm_ids``, −1 for none), its parent in the spanning tree and the keyframes of its loop edges.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gtsam
import msgpack
import numpy as np

from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.sparse_model import sparse_model

NAME = "stella_vslam map"


def parse(source: Source) -> Dataset:
    """Keyframes, landmarks and the graph between keyframes: the tree gives ties, the loop edges closures.

    Raises
    ------
    FileFormatError
        A file that is cut off, or lacks parts of a stella_vslam map.
    """
    try:
        content = msgpack.unpackb(source.data, strict_map_key=False)
        keyframes = {int(key): keyframe for key, keyframe in content["keyframes"].items()}
        places = {int(key): np.array(mark["pos_w"], float) for key, mark in content["landmarks"].items()}
        poses = {key: _pose(keyframe) for key, keyframe in keyframes.items()}
        marks = [(key, int(mark)) for key, keyframe in keyframes.items() for mark in keyframe["lm_ids"]]
        seen = np.array([pair for pair in marks if pair[1] >= 0], np.int64)
        parents = {key: int(keyframe["span_parent"]) for key, keyframe in keyframes.items()}
        edges = {(key, int(other)) for key, keyframe in keyframes.items() for other in keyframe["loop_edges"]}
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, msgpack.UnpackException) as error:
        raise source.error(f"is a damaged map of stella_vslam: {type(error).__name__} {error}") from error
    ties = [(parent, key) for key, parent in sorted(parents.items()) if parent in poses]
    loops = sorted({(min(pair), max(pair)) for pair in edges if set(pair) <= poses.keys() and pair[0] != pair[1]})
    return sparse_model(source, format=NAME, poses=poses, points=places, seen=seen, ties=ties, loops=loops)


def _pose(keyframe: Mapping[str, Any]) -> gtsam.Pose3:
    """Camera to world."""
    quaternion = np.array(keyframe["rot_cw"], float)
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), np.array(keyframe["trans_cw"], float)).inverse()


def _recognises(source: Source) -> bool:
    is_map = source.head[:1] >= b"\x80" and (source.head[:1] <= b"\x8f" or source.head[:1] in (b"\xde", b"\xdf"))
    return is_map and b"cameras" in source.head and b"keyframe" in source.head


FORMAT = Format(NAME, _recognises, parse)
