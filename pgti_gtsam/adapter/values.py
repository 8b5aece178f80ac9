"""The contents of a `gtsam.Values`: the keyframes with their centres, and landmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.errors import InvalidValueError, NoPoseError
from pgti_gtsam.factor_graphs import BETWEEN, keys_of, measured_from

_CALIBRATIONS = ("Cal3_S2", "Cal3DS2", "Cal3Bundler", "Cal3Fisheye", "Cal3Unified", "Cal3f")
_CAMERAS = (*(f"{kind}{k}" for kind in ("PinholeCamera", "PinholePose") for k in _CALIBRATIONS), "SphericalCamera")


def _pose_of_similarity2(value: gtsam.Similarity2) -> gtsam.Pose2:
    return gtsam.Pose2(value.rotation(), value.transformFrom(np.zeros(2)))


def _pose_of_similarity3(value: gtsam.Similarity3) -> gtsam.Pose3:
    return gtsam.Pose3(value.rotation(), value.transformFrom(np.zeros(3)))


def _pose_of_gal3(value: gtsam.Gal3) -> gtsam.Pose3:
    return gtsam.Pose3(value.rotation(), value.position())


def _pose_of_extended(value: gtsam.ExtendedPose3d) -> gtsam.Pose3:
    """Column 0 is the position and column 1 the velocity, as in NavState, the same group."""
    return gtsam.Pose3(value.rotation(), value.x(0))


_POSE_OF: dict[str, Callable[[Any], gtsam.Pose2 | gtsam.Pose3]] = {
    "NavState": lambda value: value.pose(),
    "Similarity3": _pose_of_similarity3,
    "Similarity2": _pose_of_similarity2,
    "Gal3": _pose_of_gal3,
    "ExtendedPose3d": _pose_of_extended,
    "Se23": _pose_of_extended,
    **{camera: lambda value: value.pose() for camera in _CAMERAS},
}
"""Pose part of every other type of value that has one, by the name in `Values.at<Name>`."""

_DIMENSIONS_WITHOUT_POSE = {1, 2, 3}  # scalars, points, rotations; Pose2 is told apart by its own reader


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Keyframes:
    """Pose variables of a graph in the order of their keys.

    Attributes
    ----------
    keys : (n,) uint64
    positions : (n, 3) float, m
        Where the origin of each pose lies in the world; for a similarity, scale included.
    index : dict from key to row
    poses : dict from key to gtsam.Pose2 or gtsam.Pose3
        Keyframes that are not plain Pose2 or Pose3 values.
    values : gtsam.Values
    """

    keys: NDArray[np.uint64]
    positions: NDArray[np.float64]
    index: dict[int, int]
    poses: dict[int, Any]
    values: gtsam.Values

    def pose(self, key: int) -> Any:
        """The Pose2 or Pose3 of a keyframe."""
        return self.poses.get(key) or typed_value(self.values, "Pose3", key) or self.values.atPose2(key)

    def measured(self, factor: Any, first: int) -> Any | None:
        """Pose of a factor's other keyframe, seen from the keyframe `first`, as the factor measures it.

        A similarity, a NavState and their like measure from the value at `first`, in that value's scale, say.

        Parameters
        ----------
        factor : gtsam.NonlinearFactor
            A factor of two keys.
        first : int
            The key from which the pose is seen.

        Returns
        -------
        gtsam.Pose2, gtsam.Pose3 or None
            None where the factor measures no pose.
        """
        if isinstance(factor, BETWEEN) or not measures_pose(factor):
            return measured_from(factor, first)
        motion = factor.measured()
        value = typed_value(self.values, type(motion).__name__, first)
        if value is None:
            return None
        reached = value.compose(motion if keys_of(factor)[0] == first else motion.inverse())
        return self.pose(first).between(_POSE_OF[type(motion).__name__](reached))

    def to_world(self, key: int, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """World coordinates, (3,), of a point given in the frame of a keyframe, (2,) or (3,).

        Parameters
        ----------
        key : int
        point : (2,) or (3,) float
        """
        pose = self.pose(key)
        placed = pose.transformFrom(point[: 2 if isinstance(pose, gtsam.Pose2) else 3])
        return in_space(placed)


def measures_pose(factor: Any) -> bool:
    """Whether a factor measures the relative pose of two keyframes, of any type that `Keyframes.pose` reads."""
    return isinstance(factor, BETWEEN) or (
        hasattr(factor, "measured") and type(factor.measured()).__name__ in _POSE_OF and len(keys_of(factor)) == 2
    )


def read_keyframes(values: gtsam.Values) -> Keyframes:
    """Find every pose among the values.

    Raises
    ------
    NoPoseError, InvalidValueError
    """
    keys_3d, keys_2d = _plain_poses(values)
    others = _other_poses(values, set(keys_3d) | set(keys_2d))
    keys = np.array([*keys_3d, *keys_2d, *others], dtype=np.uint64)
    if len(keys) == 0:
        raise NoPoseError(
            f"expected poses among the values, got {values.size()} values of which none is a pose; "
            "pass the values that belong to the factor graph"
        )

    # where each has its centre
    positions, is_finite = np.zeros((len(keys), 3)), np.ones(len(keys), dtype=bool)
    n_3d, n_plain = len(keys_3d), len(keys_3d) + len(keys_2d)
    if keys_3d:
        rows = gtsam.utilities.extractPose3(values)
        positions[:n_3d], is_finite[:n_3d] = rows[:, 9:12], np.isfinite(rows).all(axis=1)
    if keys_2d:
        rows = gtsam.utilities.extractPose2(values)
        positions[n_3d:n_plain, :2], is_finite[n_3d:n_plain] = rows[:, :2], np.isfinite(rows).all(axis=1)
    for row, pose in enumerate(others.values(), start=n_plain):
        centre = pose.translation()
        positions[row, : len(centre)] = centre
        is_finite[row] = np.isfinite(pose.matrix()).all()

    # in the order of their keys
    order = np.argsort(keys)
    keys, positions = keys[order], positions[order]
    _check_finite(keys, positions, is_finite[order])
    index = {int(key): i for i, key in enumerate(keys)}
    return Keyframes(keys=keys, positions=positions, index=index, poses=others, values=values)


def pose_keys(values: gtsam.Values) -> set[int]:
    """Keys of all poses, of any type that `Keyframes.pose` reads."""
    plain = {key for keys in _plain_poses(values) for key in keys}
    return plain | _other_poses(values, plain).keys()


def _plain_poses(values: gtsam.Values) -> tuple[list[int], list[int]]:
    """Keys of Pose3 values and of Pose2 values."""
    return list(gtsam.utilities.allPose3s(values).keys()), list(gtsam.utilities.allPose2s(values).keys())


def _other_poses(values: gtsam.Values, plain: set[int]) -> dict[int, Any]:
    found: dict[int, Any] = {}
    for key, dimension in values.dims().items():
        if key in plain or dimension in _DIMENSIONS_WITHOUT_POSE:
            continue
        for name, pose_of in _POSE_OF.items():
            value = typed_value(values, name, key)
            if value is not None:
                found[key] = pose_of(value)
                break
    return found


def typed_value(values: gtsam.Values, name: str, key: int) -> Any | None:
    """Value of a key if the value has the named type, else None: `Values` tells a type only by trying.

    Parameters
    ----------
    values : gtsam.Values
    name : str
        Name of a type, as in `values.atPose3`.
    key : int
    """
    try:
        return getattr(values, f"at{name}")(key)
    except RuntimeError:
        return None


def in_space(point: NDArray[np.float64]) -> NDArray[np.float64]:
    """A point of the plane, (2,), at height zero; a point in space, (3,), unchanged."""
    return point if len(point) == 3 else np.array([point[0], point[1], 0.0])


def landmark_position(values: gtsam.Values, key: int) -> NDArray[np.float64] | None:
    """Position of a landmark, (3,), z = 0 in the plane, or None if the value is no point.

    Parameters
    ----------
    values : gtsam.Values
    key : int

    Raises
    ------
    InvalidValueError
        The position is not finite.
    """
    for name in ("Point3", "Point2"):
        point = typed_value(values, name, key)
        if point is not None:
            if not np.isfinite(point).all():
                raise InvalidValueError(
                    f"expected a finite position, got {point.tolist()} at landmark {gtsam.DefaultKeyFormatter(key)}"
                )
            return in_space(point)
    return None


def _check_finite(keys: NDArray[np.uint64], positions: NDArray[np.float64], is_finite: NDArray[np.bool_]) -> None:
    bad = ~(is_finite & np.isfinite(positions).all(axis=1))
    if bad.any():
        i = int(bad.argmax())
        turned = " and a rotation that is not finite" if np.isfinite(positions[i]).all() else ""
        raise InvalidValueError(
            f"expected a finite pose, got position {positions[i].tolist()}{turned} "
            f"at keyframe {gtsam.DefaultKeyFormatter(int(keys[i]))}"
        )


def insert_point(values: gtsam.Values, key: int, point: NDArray[np.float64]) -> None:
    """Add a point (2,) or (3,), in space as a Point3 proper.

    ``Values.insert`` takes any array for a vector of dynamic size, and ``Values.update`` confuses such a vector with
    a point. Python has no way to add a Point2 proper; GTSAM's factors read the vector all the same.

    Parameters
    ----------
    values : gtsam.Values
    key : int
    point : (2,) or (3,) float
    """
    insert = values.insertPoint3 if len(point) == 3 else values.insert
    insert(key, np.asarray(point, dtype=float))
