"""Classes of GTSAM factors, sorted by the information on connectivity and free space."""

from __future__ import annotations

import enum
import functools
import re


class Family(enum.Enum):
    """The meaning of a factor for the pose graph."""

    BETWEEN = "ties two poses"
    MOTION = "ties a pose to the next by the motion between"
    SIGHTING = "a pose sees a landmark variable"
    SMART = "several poses see one landmark, which is triangulated"
    IGNORED = "says nothing about connectivity or free space"
    UNKNOWN = "not known to the adapter; a tie where it ties two poses"


_POSE = r"(Pose2|Pose3|Similarity2|Similarity3|NavState|Gal3|Se23|ExtendedPose3d)"

_CLASSES = {
    Family.BETWEEN: (
        rf"BetweenFactor{_POSE}",
        r"BetweenFactorEMPose2",
        rf"Frobenius(Left)?BetweenFactor(NL)?{_POSE}",
        rf"(NonlinearEquality2|FrobeniusFactor){_POSE}",
        r"EssentialMatrixConstraint",
        r"(Bearing|Range|BearingRange)FactorPose[23]",
        r"RangeFactorWithTransformPose[23]",
        r"RangeFactor(Calibrated|Simple)Camera",
    ),
    Family.MOTION: (
        r"(Galilean)?(Combined)?ImuFactor\w*",
        r"ConstantVelocityFactor|WnoaMotionFactorPose[23]",
    ),
    Family.SIGHTING: (
        r"(Bearing|Range|BearingRange)Factor[23]D",
        r"RangeFactorWithTransform(Bias)?[23]D",
        r"RangeFactor(Calibrated|Simple)CameraPoint",
        r"PoseToPointFactor\w*",
        r"GenericProjectionFactor\w+",
        r"ProjectionFactorPPPC?\w*",
        r"GenericStereoFactor3D",
        r"GeneralSFMFactor2?(Pose)?(Cal3\w+|SphericalCamera)",
        r"PlanarProjectionFactor2",
    ),
    Family.SMART: (
        r"SmartProjection(Pose|Rig)?Factor\w*",
        r"SmartStereoProjection(Pose)?Factor",
    ),
    Family.IGNORED: (
        # priors and hard values of one variable, marginals
        r"(Extended)?PriorFactor\w+",
        r"FrobeniusPrior\w+",
        r"Pose(Rotation|Translation)Prior[23]D",
        r"NonlinearEquality(?!2(Pose|Sim|Nav|Gal))\w+",
        r"ConcentratedGaussian\w+",
        r"KarcherMeanFactor\w+",
        r"LinearContainerFactor",
        # attitude, satellite, magnetic, barometric
        r"(AHRS|Attitude|Barometric|Mag|MagPose)Factor\w*",
        r"GPSFactor\w*",
        r"(Differential|DoubleDifference|Undifferenced)?(Pseudorange|CarrierPhase|Doppler)Factor\w*",
        r"WnoaInterpFactor\w+|WnoaMotionFactorPoint[123]",
        # between variables that are no poses
        r"(BetweenFactor|Frobenius(Left)?(Between)?Factor(NL)?)(ConstantBias|Double|Point[23]|Rot[23]|SL4|SO[34n]|Vector)",
        r"RangeFactor[23]|QuadraticRangeFactor[23]|RelativeTranslationFactor[23]",
        r"(Rotate|RotateDirections|Wahba|Shonan|VectorNorm)Factor\d?",
        # planes, epipolar geometry, calibration, curve fitting, landmarks seen by fixed cameras
        r"(Local)?OrientedPlane3(Factor|DirectionPrior)",
        r"(Essential)?TransferFactor\w+|EssentialMatrixFactor\w*|SelfCalibrationFactor",
        r"TriangulationFactor\w+|ReferenceFrameFactor\w+",
        r"(Manifold|Vector|Component)*(Evaluation|Derivative)?Factor(Chebyshev|Fourier)\w+",
        # known landmarks that the factor keeps to itself
        r"KnownLandmarkFactor2?Pose[23]|PlanarProjectionFactor[13]",
    ),
}

_HOLDING = re.compile(
    rf"((Extended)?PriorFactor|NonlinearEquality|FrobeniusPrior|ConcentratedGaussian){_POSE}"
    r"|PoseTranslationPrior[23]D|GPSFactor\w*"
)

_PATTERNS = [(family, re.compile("|".join(patterns))) for family, patterns in _CLASSES.items()]


@functools.cache
def family_of(class_name: str) -> Family:
    """Family of a factor class, by its name in the wheel.

    A pose of NavState, Similarity or camera type stands for its position. Planes, known landmarks, priors and satellite
    factors are known and ignored. Inertial factors and constant velocity are odometry, and nothing else.
    """
    return next((family for family, pattern in _PATTERNS if pattern.fullmatch(class_name)), Family.UNKNOWN)


@functools.cache
def holds_position(class_name: str) -> bool:
    """Whether factors of a class fix where a keyframe is in the world, by the class's name in the wheel."""
    return _HOLDING.fullmatch(class_name) is not None
