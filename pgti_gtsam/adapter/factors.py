"""One pass over a factor graph: the connectivity and the free space that every factor reports."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.families import Family, family_of
from pgti_gtsam.adapter.values import Keyframes, landmark_position
from pgti_gtsam.errors import MissingValueError, UnusedValueError
from pgti_gtsam.factor_graphs import keys_of, slots_of
from pgti_gtsam.sightings import Sightings

Vector = NDArray[np.float64]

_NOWHERE = np.full(3, np.nan)
_ARCHIVED_NUMBER = re.compile(r"-?\d\.\d+e[+-]\d+")


@dataclass(slots=True)
class _Landmark:
    """A landmark before placement: index, value if there is a value, else the nearest sighting."""

    index: int
    position: Vector
    has_value: bool
    nearest: float = np.inf


class Between(NamedTuple):
    """Two keyframes tied by a factor, i < j.

    The information in the tangent space of j, or None; the measured distance in metres, or NaN; the measured pose of j
    seen from i, a gtsam.Pose2 or gtsam.Pose3, or None; and whether an inertial or other factor of the motion ties them,
    which is odometry for sure.
    """

    i: int
    j: int
    slot: int
    information: Vector | None
    length: float
    pose: Any
    is_motion: bool = False


@dataclass(slots=True)
class FactorReader:
    """Collects, factor by factor, the parts of the pose graph.

    A factor of an unknown class that ties two keyframes, and nothing else, counts as the tie that it is.

    Attributes
    ----------
    reads_noise : bool
        Whether information matrices are read.
    between : list of Between
    held : set of int
        Keyframes that a factor of another family ties to something.
    counts : a counter of class names for each family
    """

    keyframes: Keyframes
    reads_noise: bool = True
    between: list[Between] = field(default_factory=list)
    held: set[int] = field(default_factory=set)
    counts: dict[Family, Counter[str]] = field(default_factory=lambda: {f: Counter() for f in Family})
    empty_slots: int = 0
    _landmarks: dict[int, _Landmark] = field(default_factory=dict)
    _seen_from: list[int] = field(default_factory=list)
    _seen: list[int] = field(default_factory=list)
    _measured: list[float] = field(default_factory=list)
    _tied: set[int] = field(default_factory=set)

    def read(self, graph: gtsam.NonlinearFactorGraph) -> None:
        """Read every factor of the graph.

        Raises
        ------
        MissingValueError, UnusedValueError, InvalidValueError
        """
        handlers = {
            Family.BETWEEN: self._between,
            Family.MOTION: self._motion,
            Family.SIGHTING: self._sighting,
            Family.SMART: self._smart,
        }
        found = slots_of(graph)
        self.empty_slots += graph.size() - len(found)
        for slot, factor in found:
            # what it is
            name, keys = type(factor).__name__, factor.keys()
            family = family_of(name)
            if family is Family.UNKNOWN and len(keys) == 2 and self.keyframes.index.keys() >= set(keys):
                family = Family.BETWEEN
            self.counts[family][name] += 1

            # what it says
            self._tied.update(keys)
            if family in handlers:
                handlers[family](slot, factor, keys)
            if family != Family.BETWEEN and len(keys) > 1:
                self.held.update(self.keyframes.index[key] for key in keys if key in self.keyframes.index)
        self._check_every_pose_is_tied()

    def sightings(self) -> Sightings:
        """All sightings, with distances from the values where a landmark has a value."""
        seen_from, seen = np.array(self._seen_from, dtype=np.int64), np.array(self._seen, dtype=np.int64)
        positions = np.array([mark.position for mark in self._landmarks.values()]).reshape(-1, 3)
        distances = np.linalg.norm(positions[seen] - self.keyframes.positions[seen_from], axis=1)
        measured = np.array(self._measured)
        return Sightings(
            keyframes=seen_from,
            landmarks=seen,
            distances=np.where(np.isnan(measured), distances, measured),
            landmark_positions=positions,
            n_keyframes=len(self.keyframes.keys),
        )

    def _between(self, slot: int, factor: Any, keys: list[int]) -> None:
        i, j = (self._keyframe(slot, factor, key) for key in keys[:2])
        if i == j:
            return
        measured = factor.measured() if hasattr(factor, "measured") else None
        pose = self.keyframes.measured(factor, int(self.keyframes.keys[min(i, j)]))
        information = _information(factor) if self.reads_noise else None
        if i > j:
            information = _reversed(information, measured)
            i, j = j, i
        self.between.append(Between(i, j, slot, information, _length(measured), pose))

    def _motion(self, slot: int, factor: Any, keys: list[int]) -> None:
        rows = sorted({self.keyframes.index[key] for key in keys if key in self.keyframes.index})
        if len(rows) > 1:
            self.between.append(Between(rows[0], rows[-1], slot, None, np.nan, None, is_motion=True))
            return

        # a velocity may lack, a pose not
        missing = next((key for key in keys if not self.keyframes.values.exists(key)), None)
        if missing is not None:
            raise MissingValueError(_missing(slot, factor, missing))

    def _sighting(self, slot: int, factor: Any, keys: list[int]) -> None:
        i, mark = self._keyframe(slot, factor, keys[0]), self._landmark(slot, factor, keys)
        measured = np.nan
        if not mark.has_value:
            local, measured = _measured_point(factor)
            if local is None and np.isnan(measured):
                raise MissingValueError(_missing(slot, factor, keys[_landmark_slot(factor)]))
            if local is not None and measured < mark.nearest:
                mark.position, mark.nearest = self.keyframes.to_world(keys[0], local), measured
        self._see(i, mark.index, measured)

    def _smart(self, slot: int, factor: Any, keys: list[int]) -> None:
        rows = [self._keyframe(slot, factor, key) for key in dict.fromkeys(keys)]
        mark = _Landmark(len(self._landmarks), _triangulated(factor, self.keyframes.values), True)
        self._landmarks[-1 - slot] = mark
        for i in rows:
            self._see(i, mark.index, np.nan)

    def _see(self, keyframe: int, landmark: int, measured: float) -> None:
        self._seen_from.append(keyframe)
        self._seen.append(landmark)
        self._measured.append(measured)

    def _keyframe(self, slot: int, factor: Any, key: int) -> int:
        row = self.keyframes.index.get(key)
        if row is None:
            raise MissingValueError(_missing(slot, factor, key))
        return row

    def _landmark(self, slot: int, factor: Any, keys: list[int]) -> _Landmark:
        key = keys[_landmark_slot(factor)]
        mark = self._landmarks.get(key)
        if mark is None:
            position = None
            if self.keyframes.values.exists(key):
                position = landmark_position(self.keyframes.values, key)
                if position is None:
                    raise MissingValueError(
                        f"expected a point as the value of landmark {gtsam.DefaultKeyFormatter(key)} "
                        f"of factor {slot} ({type(factor).__name__}), got another type; "
                        "pass the values that belong to the graph"
                    )
            known = position is not None
            mark = _Landmark(len(self._landmarks), _NOWHERE if position is None else position, known)
            self._landmarks[key] = mark
        return mark

    def _check_every_pose_is_tied(self) -> None:
        free = next((int(key) for key in self.keyframes.keys if int(key) not in self._tied), None)
        if free is not None:
            raise UnusedValueError(
                f"expected every pose to appear in a factor, got pose {gtsam.DefaultKeyFormatter(free)} "
                "with a value and no factor; remove its value or add its factors"
            )


def _missing(slot: int, factor: Any, key: int) -> str:
    return (
        f"expected a value for every key, got factor {slot} ({type(factor).__name__}) "
        f"with {gtsam.DefaultKeyFormatter(key)}, which has none; add it to the values or remove the factor"
    )


def _landmark_slot(factor: Any) -> int:
    """Place of the landmark among a factor's keys: behind the pose and, in `ProjectionFactorPPP`, the sensor."""
    return 2 if type(factor).__name__.startswith("ProjectionFactorPPP") else 1


def _length(measured: Any) -> float:
    """Distance in metres that a relative pose measures; a similarity's is scaled to its first keyframe."""
    if hasattr(measured, "transformFrom") and hasattr(measured, "scale"):
        return float(np.linalg.norm(measured.translation()) * measured.scale())
    centre = getattr(measured, "translation", getattr(measured, "position", None))
    return float(np.linalg.norm(centre())) if callable(centre) else np.nan


def _information(factor: Any) -> Vector | None:
    """Information matrix of a factor, under a robust kernel that of the base; None without an information matrix."""
    model = factor.noiseModel() if hasattr(factor, "noiseModel") else None
    if isinstance(model, gtsam.noiseModel.Robust):
        model = model.noise()
    if not isinstance(model, gtsam.noiseModel.Gaussian) or model.isConstrained():
        return None
    matrix: Vector = model.information()
    return matrix


def _reversed(information: Vector | None, measured: Any) -> Vector | None:
    """Information of the reversed measurement z⁻¹, whose error is e = −Ad(z) e' with e' the error of z."""
    if information is None or not hasattr(measured, "AdjointMap"):
        return information
    adjoint = measured.inverse().AdjointMap()
    return np.asarray(adjoint.T @ information @ adjoint) if adjoint.shape == information.shape else None


def _measured_point(factor: Any) -> tuple[Vector | None, float]:
    """Point that a factor measures in the frame of its keyframe, and the distance, where the factor tells them."""
    name = type(factor).__name__
    if name == "GenericStereoFactor3D":
        camera = gtsam.StereoCamera(gtsam.Pose3(), factor.calibration())
        local = _sensor_pose(factor).transformFrom(camera.backproject(factor.measured()))
    elif name.startswith("BearingRangeFactor"):
        measured = factor.measured()
        bearing = measured.bearing()
        direction = bearing.point3() if isinstance(bearing, gtsam.Unit3) else [bearing.c(), bearing.s(), 0.0]
        local = np.asarray(direction) * measured.range()
    elif name.startswith("PoseToPointFactor"):
        local = np.asarray(factor.measured())
    elif name.startswith("RangeFactor"):
        # The sensor's distance is known, not the direction: what is free around it reaches at least so
        # far around the keyframe's centre.
        lever = np.linalg.norm(_sensor_pose(factor).translation()) if "WithTransform" in name else 0.0
        return None, max(float(factor.measured() - lever), 0.0)
    else:
        return None, np.nan
    return local, float(np.linalg.norm(local))


def _sensor_pose(factor: Any) -> gtsam.Pose2 | gtsam.Pose3:
    """Body-to-sensor transform of a factor, which the wheel exposes only in the factor's archive.

    The archive ends with the transform: rotation matrix and translation in space, x, y, cos and sin in the plane.
    A stereo factor without a transform ends with its calibration.
    """
    numbers = [float(text) for text in _ARCHIVED_NUMBER.findall(factor.serialize())]
    if type(factor).__name__.endswith("2D"):
        x, y, cosine, sine = numbers[-4:]
        return gtsam.Pose2(x, y, float(np.arctan2(sine, cosine)))
    if hasattr(factor, "calibration") and np.array_equal(numbers[-6:], factor.calibration().vector()):
        return gtsam.Pose3()
    return gtsam.Pose3(gtsam.Rot3(np.reshape(numbers[-12:-3], (3, 3))), np.array(numbers[-3:]))


def _triangulated(factor: Any, values: gtsam.Values) -> Vector:
    """Position of a smart factor's landmark, NaN where triangulation fails.

    A smart factor remembers its last triangulation, here as in every `graph.error(values)`; the wheel
    cannot copy smart factors. A smart factor out of an archive remembers that the triangulation was valid and not
    where, until the keyframes move.
    """
    result = _point(factor, values)
    try:
        return np.asarray(result.get()) if result.valid() else _NOWHERE
    except RuntimeError:
        moved = gtsam.VectorValues()
        for key in keys_of(factor):
            moved.insert(key, np.full(values.dims()[key], _MOVED))
        _point(factor, values.retract(moved))
        result = _point(factor, values)
        return np.asarray(result.get()) if result.valid() else _NOWHERE


def _point(factor: Any, values: gtsam.Values) -> Any:
    """The triangulation of a smart factor, made anew where the keyframes have moved."""
    if type(factor).__name__.startswith("SmartStereo"):
        factor.error(values)  # triangulates; this class offers no point(values)
        return factor.point()
    return factor.point(values)


_MOVED = 0.01
"""A motion, m and rad, after which a smart factor triangulates anew."""
