"""Every factor family of the wheel that matters, in small graphs with known answers."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

import pgti_gtsam as pgti
from pgti_gtsam.adapter.families import Family, family_of
from pgti_gtsam.errors import (
    InvalidOptionError,
    InvalidValueError,
    MissingValueError,
    NoPoseError,
    NoRadiusError,
    UnusedValueError,
)

UNIT = {d: gtsam.noiseModel.Unit.Create(d) for d in range(1, 10)}
TILTED = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.3), np.array([1.0, 2.0, 3.0]))
LEVER = gtsam.Pose3(gtsam.Rot3.RzRyRx(-0.3, 0.2, 0.5), np.array([0.1, -0.4, 0.2]))
STEREO = gtsam.Cal3_S2Stereo(700, 710, 0.1, 600, 180, 0.5)
PINHOLE = gtsam.Cal3_S2(700, 700, 0, 320, 240)
POINT = np.array([1.5, 2.5, 9.0])


def graph_of(*factors):
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    return graph


def values_of(**by_key):
    values = gtsam.Values()
    for name, value in by_key.items():
        values.insert(gtsam.symbol(name[0], int(name[1:])), value)
    return values


def between(i, j, model=None, pose=None):
    return gtsam.BetweenFactorPose3(X(i), X(j), pose or gtsam.Pose3(), model or UNIT[6])


LINE = values_of(**{f"x{i}": gtsam.Pose3(gtsam.Rot3(), np.array([float(i), 0, 0])) for i in range(4)})

POSES = {
    "Pose2": (gtsam.Pose2(1, 2, 0.3), [1, 2, 0]),
    "Pose3": (TILTED, [1, 2, 3]),
    "Similarity2": (gtsam.Similarity2(gtsam.Rot2(0.1), np.array([1.0, 2.0]), 2.0), [2, 4, 0]),
    "Similarity3": (gtsam.Similarity3(TILTED.rotation(), TILTED.translation(), 2.0), [2, 4, 6]),
    "NavState": (gtsam.NavState(TILTED, np.ones(3)), [1, 2, 3]),
    "Gal3": (gtsam.Gal3(TILTED.rotation(), TILTED.translation(), np.ones(3), 0.5), [1, 2, 3]),
}


@pytest.mark.parametrize("name", POSES)
def test_every_pose_type_is_a_keyframe_where_its_origin_lies(name):
    pose, position = POSES[name]
    values = gtsam.Values()
    for key in (X(2), X(1)):
        values.insert(key, pose)
    factor_class = getattr(gtsam, f"BetweenFactor{name}")
    dimension = values.dims()[X(1)]
    model = gtsam.noiseModel.Unit.Create(dimension)
    adapted = pgti.from_gtsam(graph_of(factor_class(X(2), X(1), pose.between(pose), model)), values, radii=1.0)
    assert adapted.labels == ["x1", "x2"]
    assert adapted.edges.tolist() == [[0, 1]]
    np.testing.assert_allclose(adapted.positions, [position, position])
    np.testing.assert_allclose(adapted.edge_information[0], np.eye(dimension), atol=1e-12)
    assert adapted.adaptation.used == {f"BetweenFactor{name}": 1}


def test_a_camera_is_a_keyframe_at_its_pose():
    values = values_of(x0=gtsam.PinholeCameraCal3_S2(TILTED, PINHOLE), l0=POINT)
    adapted = pgti.from_gtsam(graph_of(gtsam.GeneralSFMFactorCal3_S2(np.zeros(2), UNIT[2], X(0), L(0))), values)
    np.testing.assert_allclose(adapted.positions, [[1, 2, 3]])
    assert adapted.radii[0] == pytest.approx(np.linalg.norm(POINT - [1, 2, 3]))


def test_edges_keep_their_slots_whatever_way_they_are_stored_and_slots_may_be_empty():
    graph = graph_of(between(1, 0), between(0, 1), between(1, 2), between(2, 3), between(0, 3))
    graph.remove(3)
    adapted = pgti.from_gtsam(graph, LINE, radii=0.1, edges=["between"])
    assert adapted.edges.tolist() == [[0, 1], [0, 3], [1, 2]]
    assert adapted.edge_slots == ((0, 1), (4,), (2,))
    assert adapted.adaptation.empty_slots == 1
    np.testing.assert_allclose(adapted.edge_information[0], 2 * np.eye(6))


def test_information_of_a_reversed_factor_weighs_the_same_error_alike():
    measured = TILTED.inverse() * LEVER
    values = values_of(x0=LEVER, x1=TILTED.compose(gtsam.Pose3.Expmap(0.3 * np.arange(6.0))))
    model = gtsam.noiseModel.Diagonal.Sigmas(0.1 * np.arange(1.0, 7.0))
    stored = gtsam.BetweenFactorPose3(X(1), X(0), measured, model)
    information = pgti.from_gtsam(graph_of(stored), values, radii=1.0).edge_information[0]
    error = gtsam.Pose3.Logmap(measured * values.atPose3(X(0)).between(values.atPose3(X(1))))
    assert 0.5 * error @ information @ error == pytest.approx(stored.error(values), rel=1e-9)


def test_robust_noise_counts_with_its_base_and_hard_constraints_without_information():
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
    robust = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Isotropic.Sigma(6, 0.5))
    hard = gtsam.noiseModel.Constrained.All(6)
    adapted = pgti.from_gtsam(graph_of(between(0, 1, robust), between(1, 2, hard), between(2, 3)), LINE, radii=1.0)
    np.testing.assert_allclose(adapted.edge_information[0], 4 * np.eye(6))
    assert np.isnan(adapted.edge_information[adapted.edges.tolist().index([1, 2])]).all()


def bearing_range_3d(pose, point, lever=None):
    return gtsam.BearingRangeFactor3D(X(0), L(0), pose.bearing(point), pose.range(point), UNIT[3])


def stereo(pose, point, lever=None):
    sensor = pose * lever if lever else pose
    measured = gtsam.StereoCamera(sensor, STEREO).project(point)
    return gtsam.GenericStereoFactor3D(measured, UNIT[3], X(0), L(0), STEREO, *([lever] if lever else []))


@pytest.mark.parametrize(
    "factor",
    [
        bearing_range_3d(TILTED, POINT),
        stereo(TILTED, POINT),
        stereo(TILTED, POINT, LEVER),
        gtsam.GenericProjectionFactorCal3_S2(np.zeros(2), UNIT[2], X(0), L(0), PINHOLE),
        gtsam.GenericProjectionFactorCal3_S2(np.zeros(2), UNIT[2], X(0), L(0), PINHOLE, LEVER),
        gtsam.BearingFactor3D(X(0), L(0), TILTED.bearing(POINT), UNIT[2]),
        gtsam.RangeFactor3D(X(0), L(0), 99.0, UNIT[1]),
        gtsam.RangeFactorWithTransform3D(X(0), L(0), 99.0, UNIT[1], LEVER),
        gtsam.GeneralSFMFactor2Cal3_S2(np.zeros(2), UNIT[2], X(0), L(0), gtsam.symbol("k", 0)),
    ],
    ids=lambda factor: type(factor).__name__,
)
def test_a_landmark_with_a_value_gives_the_distance_to_it(factor):
    adapted = pgti.from_gtsam(graph_of(factor), values_of(x0=TILTED, l0=POINT))
    assert adapted.radii[0] == pytest.approx(np.linalg.norm(POINT - TILTED.translation()), rel=1e-12)
    assert adapted.adaptation.n_landmarks == 1


@pytest.mark.parametrize(
    "factor",
    [bearing_range_3d(TILTED, POINT), stereo(TILTED, POINT), stereo(TILTED, POINT, LEVER)],
    ids=["bearing-range", "stereo", "stereo with lever arm"],
)
def test_without_a_value_the_measurement_places_the_landmark(factor):
    neighbour = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 2.5, 8.0]))
    graph = graph_of(factor, between(0, 1))
    adapted = pgti.from_gtsam(graph, values_of(x0=TILTED, x1=neighbour))
    assert adapted.radii[0] == pytest.approx(np.linalg.norm(POINT - TILTED.translation()), rel=1e-9)
    # The neighbour sees nothing itself: its nearest landmark is the one that x0 sees.
    assert adapted.radii[1] == pytest.approx(np.linalg.norm(POINT - neighbour.translation()), rel=1e-9)


def test_in_the_plane_the_measurement_places_the_landmark_too():
    pose, point = gtsam.Pose2(1, 2, 0.7), np.array([3.0, -1.0])
    factor = gtsam.BearingRangeFactor2D(X(0), L(0), pose.bearing(point), pose.range(point), UNIT[2])
    odometry = gtsam.BetweenFactorPose2(X(0), X(1), gtsam.Pose2(), UNIT[3])
    adapted = pgti.from_gtsam(graph_of(factor, odometry), values_of(x0=pose, x1=gtsam.Pose2(3, 0, 0)))
    assert adapted.radii == pytest.approx([np.hypot(2, 3), 1.0])


@pytest.mark.parametrize(("measured", "lever", "radius"), [(5.0, 0.0, 5.0), (5.0, 2.0, 3.0), (1.0, 2.0, 0.0)])
def test_a_range_without_a_value_guarantees_what_its_lever_arm_leaves(measured, lever, radius):
    ranged = gtsam.RangeFactorWithTransform2D(X(0), L(0), measured, UNIT[1], gtsam.Pose2(0, lever, 1.0))
    other = gtsam.RangeFactor2D(X(1), L(0), 7.0, UNIT[1])
    adapted = pgti.from_gtsam(graph_of(ranged, other), values_of(x0=gtsam.Pose2(), x1=gtsam.Pose2(1, 0, 0)))
    assert adapted.radii == pytest.approx([radius, 7.0])
    assert adapted.adaptation.keyframes_without_radius == int(radius == 0)


def smart(*keys):
    factor = gtsam.SmartProjectionPoseFactorCal3_S2(gtsam.noiseModel.Isotropic.Sigma(2, 1.0), PINHOLE)
    for key in keys:
        pixel = gtsam.PinholeCameraCal3_S2(LINE.atPose3(key), PINHOLE).project(np.array([1.0, 0.5, 4.0]))
        factor.add(pixel, key)
    return factor


def test_a_smart_factor_is_triangulated_and_one_that_cannot_be_is_counted():
    adapted = pgti.from_gtsam(graph_of(smart(X(0), X(2)), smart(X(1)), between(1, 3), between(0, 1)), LINE)
    distances = [np.linalg.norm([1.0 - i, 0.5, 4.0]) for i in range(4)]
    assert adapted.radii == pytest.approx([distances[0], distances[1], distances[2], 0.0], rel=1e-6)
    assert adapted.adaptation.n_landmarks == 1
    assert adapted.adaptation.landmarks_without_position == 1
    assert adapted.adaptation.keyframes_without_radius == 1


def test_a_smart_factor_out_of_an_archive_is_triangulated_anew():
    graph, read = graph_of(smart(X(0), X(2)), between(0, 1), between(1, 3)), gtsam.NonlinearFactorGraph()
    expected = pgti.from_gtsam(graph, LINE)
    read.deserialize(graph.serialize())
    adapted = pgti.from_gtsam(read, LINE)
    assert adapted.radii == pytest.approx(expected.radii, rel=1e-6)
    assert adapted.adaptation.n_landmarks == 1


def test_a_smart_stereo_factor_is_triangulated():
    unstable = pytest.importorskip("gtsam_unstable")
    factor = unstable.SmartStereoProjectionPoseFactor(gtsam.noiseModel.Isotropic.Sigma(3, 1.0))
    for key in (X(0), X(1)):
        seen = gtsam.StereoCamera(LINE.atPose3(key), STEREO).project(np.array([0.5, 0.0, 6.0]))
        factor.add(seen, key, STEREO)
    values = LINE.extract([X(0), X(1)])
    adapted = pgti.from_gtsam(graph_of(factor), values)
    assert adapted.radii == pytest.approx([np.hypot(0.5, 6)] * 2, rel=1e-6)


def test_covisibility_connects_those_who_share_enough_landmarks():
    values, factors = gtsam.Values(LINE), []
    shared = {0: range(0, 20), 1: range(5, 25), 2: range(20, 40), 3: [39]}
    for i, landmarks in shared.items():
        for k in landmarks:
            factors.append(gtsam.RangeFactor3D(X(i), L(k), 1.0, UNIT[1]))
    for k in range(40):
        values.insert(L(k), np.array([k, 5.0, 0]))
    adapted = pgti.from_gtsam(graph_of(*factors), values)
    assert adapted.edges.tolist() == [[0, 1]]
    assert adapted.edge_sources.tolist() == [pgti.EdgeSource.COVISIBILITY | pgti.EdgeSource.ODOMETRY]
    assert adapted.adaptation.max_shared_landmarks == 15
    assert pgti.from_gtsam(graph_of(*factors), values, min_shared_landmarks=16).edges.tolist() == []
    assert pgti.from_gtsam(graph_of(*factors), values, min_shared_landmarks=1).edges.tolist() == [
        [0, 1],
        [1, 2],
        [2, 3],
    ]
    # x1 sees landmarks from 5 on; x0, connected to it, also those from 0: its nearest of them counts.
    assert adapted.radii[1] == pytest.approx(np.hypot(0, 5.0))


def test_radii_replace_or_supply_and_bring_track_covisibility():
    chain = graph_of(between(0, 1, pose=step(1)), between(1, 2, pose=step(1)), between(2, 3, pose=step(1)))
    adapted = pgti.from_gtsam(chain, LINE, radii={X(0): 1.0, X(2): 1.0})
    assert adapted.radii.tolist() == [1, 0, 1, 0]
    assert [0, 2] in adapted.edges.tolist()
    assert adapted.adaptation.edges == {"between": 3, "covisibility": 0, "track": 4}
    without = pgti.from_gtsam(chain, LINE, radii=1.0, edges=["between"])
    assert without.edges.tolist() == [[0, 1], [1, 2], [2, 3]]


def step(length):
    return gtsam.Pose3(gtsam.Rot3(), np.array([length, 0.0, 0.0]))


def test_the_track_is_measured_by_odometry_and_follows_gaps_and_reversals_of_keys():
    values = values_of(x0=gtsam.Pose3(), x4=step(0.1), x5=step(0.2), y0=step(0.3), y1=step(0.4))
    reverse = gtsam.BetweenFactorPose3(X(4), X(0), step(-1.0), UNIT[6])
    onward = gtsam.BetweenFactorPose3(X(4), X(5), step(1.0), UNIT[6])
    y = [gtsam.symbol("y", i) for i in range(2)]
    other = gtsam.BetweenFactorPose3(y[0], y[1], step(1.0), UNIT[6])
    adapted = pgti.from_gtsam(graph_of(reverse, onward, other), values, radii=0.9)
    # The values crowd together within 0.4 m, but two metres were travelled from x0 to x5.
    assert adapted.edges.tolist() == [[0, 1], [1, 2], [3, 4]]
    assert pgti.from_gtsam(graph_of(reverse, onward, other), values, radii=1.0).edges.tolist() == [
        [0, 1],
        [0, 2],
        [1, 2],
        [3, 4],
    ]


def test_known_factors_are_ignored_unknown_ones_counted_and_nothing_is_lost():
    custom = gtsam.CustomFactor(UNIT[1], [X(3)], lambda this, values, jacobians: np.zeros(1))
    prior = gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), UNIT[6])
    gps = gtsam.GPSFactor(X(2), np.zeros(3), UNIT[3])
    graph = graph_of(prior, gps, custom, custom, between(0, 1), between(1, 2), smart(X(0), X(1)))
    found = pgti.from_gtsam(graph, LINE).adaptation
    assert found.ignored == {"PriorFactorPose3": 1, "GPSFactor": 1}
    assert found.unknown == {"CustomFactor": 2}
    assert sum(sum(part.values()) for part in (found.used, found.ignored, found.unknown)) == graph.nrFactors()


def test_every_factor_class_of_the_wheel_that_a_graph_can_hold_has_a_family():
    # Abstract bases, and CustomFactor, whose meaning is the caller's, cannot have one.
    without = {"NoiseModelFactor", "NonlinearFactor", "CustomFactor", "QpCost"}
    classes = [c for c in vars(gtsam).values() if isinstance(c, type) and issubclass(c, gtsam.NonlinearFactor)]
    unknown = {c.__name__ for c in classes if family_of(c.__name__) is Family.UNKNOWN}
    assert {name for name in unknown if not name.startswith("SmartFactorBase")} == without
    assert len(classes) > 400


def test_graph_and_values_stay_untouched():
    graph = graph_of(between(0, 1), between(2, 3), stereo(TILTED, POINT, LEVER), smart(X(0), X(2)))
    values = gtsam.Values(LINE)
    values.insert(L(0), POINT)
    graph.error(values)  # GTSAM itself makes a smart factor remember its triangulation
    before = graph.serialize(), values.serialize()
    pgti.from_gtsam(graph, values)
    assert (graph.serialize(), values.serialize()) == before


def test_bad_input_is_named_by_key_and_slot():
    pose_nan = values_of(x0=gtsam.Pose3(), x1=gtsam.Pose3(gtsam.Rot3(), np.array([np.nan, 0, 0])))
    landmark = graph_of(gtsam.BearingFactor3D(X(0), L(7), gtsam.Unit3(1, 0, 0), UNIT[2]))
    one = values_of(x0=gtsam.Pose3())
    cases = [
        (
            MissingValueError,
            r"factor 1 \(BetweenFactorPose3\) with x9",
            graph_of(between(0, 1), between(1, 9)),
            LINE,
            {},
        ),
        (MissingValueError, "l7, which has none", landmark, one, {}),
        (MissingValueError, "l7.*another type", landmark, values_of(x0=gtsam.Pose3(), l7=1.5), {}),
        (UnusedValueError, "x2", graph_of(between(0, 1)), LINE, {"radii": 1.0}),
        (NoPoseError, "1 values of which none is a pose", graph_of(), values_of(l0=POINT), {}),
        (NoPoseError, "0 values", graph_of(), gtsam.Values(), {}),
        (NoRadiusError, "--radius", graph_of(between(0, 1), between(2, 3)), LINE, {}),
        (NoRadiusError, "--radius", graph_of(between(0, 1), between(2, 3)), LINE, {"radii": 0.0}),
        (InvalidValueError, "keyframe x1", graph_of(between(0, 1)), pose_nan, {"radii": 1.0}),
        (InvalidValueError, "landmark l7", landmark, values_of(x0=gtsam.Pose3(), l7=np.array([0, np.inf, 0])), {}),
        (InvalidValueError, "more metres, got -1.0", graph_of(between(0, 1), between(2, 3)), LINE, {"radii": -1.0}),
        (InvalidValueError, "more metres, got nan", graph_of(between(0, 1), between(2, 3)), LINE, {"radii": np.nan}),
        (InvalidValueError, "l7, which is none", graph_of(between(0, 1), between(2, 3)), LINE, {"radii": {L(7): 1.0}}),
        (InvalidOptionError, "'loops'", graph_of(between(0, 1)), LINE, {"edges": ["loops"]}),
        (InvalidOptionError, "min_shared_landmarks", graph_of(between(0, 1)), LINE, {"min_shared_landmarks": 0}),
    ]
    for error, words, graph, values, options in cases:
        with pytest.raises(error, match=words):
            pgti.from_gtsam(graph, values, **options)
