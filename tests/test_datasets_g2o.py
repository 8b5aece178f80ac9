"""g2o files: what GTSAM's reader reads comes out the same, and what it drops comes out right."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_files import CHAIN, G2O, G2O_3D, read_text

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import closure_slots, poses_of
from pgti_gtsam.errors import FileFormatError

L0, L5 = gtsam.symbol("l", 0), gtsam.symbol("l", 5)


def same_as_gtsam(path, *, spatial):
    graph, values = gtsam.readG2o(str(path), spatial)
    dataset = datasets.read(path)
    assert dataset.graph.size() == graph.size()
    assert dataset.graph.error(dataset.values) == pytest.approx(graph.error(values), rel=1e-9, abs=1e-9)
    assert dataset.values.equals(values, 1e-9)


@pytest.mark.parametrize(
    ("name", "spatial"),
    [
        ("pose2example.txt", False),
        ("noisyToyGraph.txt", False),
        ("pose3example-offdiagonal.txt", True),
        ("pose3example-grid.txt", True),
        ("toyExample.g2o", True),
        ("Klaus3.g2o", True),
        ("known_landmark_localization_20.g2o", True),
        ("edge_se3_trackxyz_example.g2o", True),
    ],
)
def test_what_gtsam_reads_comes_out_the_same(name, spatial):
    same_as_gtsam(gtsam.findExampleDataFile(name), spatial=spatial)


def test_a_full_spatial_information_matrix_is_swapped_to_rotation_first():
    dataset = datasets.read(gtsam.findExampleDataFile("pose3example-offdiagonal.txt"))
    graph, _ = gtsam.readG2o(gtsam.findExampleDataFile("pose3example-offdiagonal.txt"), True)
    ours, theirs = (g.at(0).noiseModel().information() for g in (dataset.graph, graph))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "landmarks", "sightings"),
    [("city_trees_1k", 66, 406), ("victoria_park_1k", 48, 606)],
)
def test_landmarks_that_gtsam_drops_are_read(name, landmarks, sightings):
    dataset = datasets.builtin(name)
    assert len(poses_of(dataset.values)) == 1000
    assert dataset.values.size() == 1000 + landmarks
    assert dataset.graph.size() == 999 + sightings
    assert closure_slots(dataset) == ()


def test_poses_and_landmarks_of_one_number_are_two_variables(tmp_path):
    dataset = read_text(tmp_path, G2O)
    assert set(dataset.values.keys()) == {0, 1, 2, L0, L5}
    assert set(dataset.graph.at(3).keys()) == {0, 2}  # factors keep the order of the file
    assert closure_slots(dataset) == ()  # that edge says what the two steps say
    np.testing.assert_allclose(dataset.values.atPoint2(L0), [1, 1])
    np.testing.assert_allclose(dataset.values.atPoint2(L5), [1, 2], atol=1e-12)  # has no vertex: from its sighting


def test_a_landmark_without_a_vertex_is_put_where_its_nearest_sighting_has_it(tmp_path):
    text = CHAIN + "LANDMARK2 3 1 9 9 1 0 1\nLANDMARK2 5 1 2 0 1 0 1\nLANDMARK2 9 1 -5 7 1 0 1\n"
    np.testing.assert_allclose(read_text(tmp_path, text).values.atPoint2(gtsam.symbol("l", 1)), [3, 0], atol=1e-12)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(
    point=st.tuples(*[st.floats(-20, 20)] * 2).filter(lambda p: np.hypot(*p) > 0.1),
    root=st.tuples(*[st.floats(-3, 3)] * 3),
)
def test_planar_sightings_keep_their_cost_to_first_order(tmp_path_factory, point, root):
    """½ |δ|²_Λ in x and y is ½ |J⁻¹δ|² in bearing and range: for small δ the factor's error is the file's."""
    a, b, c = root
    information = np.array([[a, b], [0, c]]).T @ np.array([[a, b], [0, c]]) + 0.5 * np.eye(2)
    i11, i12, i22 = information[0, 0], information[0, 1], information[1, 1]
    text = f"VERTEX_SE2 0 1 2 0.5\nEDGE_SE2_XY 0 1 {point[0]} {point[1]} {i11} {i12} {i22}\n"
    dataset = read_text(tmp_path_factory.getbasetemp(), text)
    pose = dataset.values.atPose2(0)
    for delta in np.eye(2) * 1e-5 * np.hypot(*point):
        moved = gtsam.Values()
        moved.insert(0, pose)
        moved.insert(gtsam.symbol("l", 1), pose.transformFrom(np.array(point) + delta))
        assert dataset.graph.error(moved) == pytest.approx(0.5 * delta @ information @ delta, rel=1e-3)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(
    point=st.tuples(*[st.floats(-20, 20)] * 3).filter(lambda p: np.linalg.norm(p) > 0.5),
    seed=st.integers(0, 1000),
)
def test_spatial_sightings_pass_through_the_sensor_offset(tmp_path_factory, point, seed):
    """The residual and its cost are those of the point as the sensor sees it, wherever the sensor sits."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3))
    information = root @ root.T + 0.5 * np.eye(3)
    triangle = " ".join(str(x) for x in information[np.triu_indices(3)])
    quaternion = rng.normal(size=4)
    offset = gtsam.Pose3(gtsam.Rot3.Quaternion(*quaternion / np.linalg.norm(quaternion)), rng.normal(size=3))
    x, y, z, w = quaternion[[1, 2, 3, 0]]
    position = " ".join(str(value) for value in offset.translation())
    text = (
        f"PARAMS_SE3OFFSET 7 {position} {x} {y} {z} {w}\nVERTEX_SE3:QUAT 0 1 2 3 0.5 0.5 0.5 0.5\n"
        f"EDGE_SE3_TRACKXYZ 0 1 7 {point[0]} {point[1]} {point[2]} {triangle}\n"
    )
    if np.linalg.norm(offset.transformFrom(np.array(point))) < 0.1:
        return
    dataset = read_text(tmp_path_factory.getbasetemp(), text)
    sensor = dataset.values.atPose3(0) * offset
    for delta in np.eye(3) * 1e-5:
        moved = gtsam.Values()
        moved.insert(0, dataset.values.atPose3(0))
        moved.insertPoint3(gtsam.symbol("l", 1), sensor.transformFrom(np.array(point) + delta))
        assert dataset.graph.error(moved) == pytest.approx(0.5 * delta @ information @ delta, rel=2e-2)


def test_a_sensor_offset_that_gtsam_refuses_is_read():
    dataset = datasets.read(gtsam.findExampleDataFile("edge_se3_trackxyz_nonidentity_offset.g2o"))
    assert dataset.graph.at(0).measured().range() == pytest.approx(np.linalg.norm([2.1, 1, 3]))
    dataset = datasets.read(gtsam.findExampleDataFile("edge_se3_trackxyz_missing_vertex.g2o"))
    expected = dataset.values.atPose3(7).transformFrom(np.array([2.0, 1, 3]))
    np.testing.assert_allclose(dataset.values.atPoint3(gtsam.symbol("l", 9)), expected)


def test_a_sighting_at_range_zero_is_left_out_and_told():
    with pytest.raises(FileFormatError, match="holds 1 pose and nothing that ties it") as caught:
        datasets.read(gtsam.findExampleDataFile("edge_se3_trackxyz_zero_range.g2o"))
    assert any("range zero" in note and "line 4" in note for note in caught.value.__notes__)


def test_positions_become_gps_factors_and_fix_none(tmp_path):
    dataset = read_text(tmp_path, G2O_3D)
    assert isinstance(dataset.graph.at(2), gtsam.GPSFactor)
    np.testing.assert_allclose(np.diag(dataset.graph.at(2).noiseModel().information()), [66, 66, 33])
    assert read_text(tmp_path, G2O).graph.size() == 5
    assert any("FIX" in note for note in read_text(tmp_path, G2O).notes)


def test_without_vertices_poses_are_chained_along_the_steps(tmp_path):
    dataset = read_text(tmp_path, CHAIN)
    assert {key: round(pose.x(), 9) for key, pose in poses_of(dataset.values).items()} == {3: 0, 5: 1, 9: 2}
    assert "the file stores no poses: they are chained from the odometry" in dataset.notes


def test_where_the_chain_is_broken_a_closure_stands_in(tmp_path):
    text = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 3 1 0 0 1 0 0 1 0 1\nEDGE_SE2 0 3 5 0 0 1 0 0 1 0 1\n"
    dataset = read_text(tmp_path, text)
    assert [pose.x() for pose in poses_of(dataset.values).values()] == [0, 1, 4, 5]
    assert any("1 closures" in note for note in dataset.notes)


def test_singular_information_is_kept_as_it_is(tmp_path):
    """Nothing is known across the motion: the cost there is zero, and along it what the file says."""
    dataset = read_text(tmp_path, "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 7 0\nEDGE_SE2 0 1 0 0 0 4 0 0 0 0 1\n")
    assert dataset.graph.error(dataset.values) == pytest.approx(2.0)
    np.testing.assert_allclose(dataset.graph.at(0).noiseModel().information(), np.diag([4.0, 0, 1]), atol=1e-12)


EDGE = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
VERTICES = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\n"
SPATIAL = "EDGE_SE3:QUAT 0 1 1 0 0 {} 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0\n", 1, "expected 6 or 12 or 15 fields, got 11"),
        (EDGE + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1 7\n", 2, "expected 12 fields, got 13"),
        (EDGE + "EDGE_SE2 0 1 1 0 zero 1 0 0 1 0 1\n", 2, "finite number, got 'zero'"),
        (EDGE + "EDGE_SE2 0 1 1 0 nan 1 0 0 1 0 1\n", 2, "finite number, got 'nan'"),
        (EDGE + "EDGE_SE2 0 1 inf 0 0 1 0 0 1 0 1\n", 2, "finite number, got 'inf'"),
        (EDGE + "EDGE_SE2 0 1 1_0 0 0 1 0 0 1 0 1\n", 2, "finite number, got '1_0'"),
        (EDGE + "EDGE_SE2 0 1 1e99 0 0 1 0 0 1 0 1\n", 2, "up to 1e.30 in size"),
        (EDGE + "EDGE_SE2 0 1.5 1 0 0 1 0 0 1 0 1\n", 2, "whole number below 2..63, got '1.5'"),
        (VERTICES + "EDGE_SE2 0 -1 1 0 0 1 0 0 1 0 1\n", 3, "a negative one that no vertex line defines"),
        (EDGE + f"EDGE_SE2 0 {2**63} 1 0 0 1 0 0 1 0 1\n", 2, "whole number"),
        (
            EDGE + "EDGE_SE2 0 1 1 0,5 0 1 0 0 1 0 1\n",
            2,
            "got '0,5', a decimal comma; write the file with LC_NUMERIC=C",
        ),
        (EDGE.replace("1 0 0 1 0 1\n", "1 2 3 4 5 6 7 8 9\n"), 1, "full matrix that is not symmetric.*6 numbers"),
        (VERTICES + EDGE + "EDGE_SE2 1 7 1 0 0 1 0 0 1 0 1\n", 4, "vertex 7 has no vertex line"),
        (VERTICES + EDGE + "LANDMARK2 7 1 1 0 1 0 1\n", 4, "vertex 7 has no vertex line"),
        (VERTICES + "VERTEX_SE2 1 5 5 5\n", 3, "VERTEX_SE2 1 is defined a second time"),
        (VERTICES + "VERTEX_XY 1 5 5\nVERTEX_XY 1 5 5\n", 4, "VERTEX_XY 1 is defined a second time"),
        (EDGE + "EDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n", 2, "vertex 5 has no vertex line, and no chain of edges"),
        (SPATIAL.format("0 0 0 0"), 1, "unit quaternion, got zero"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", 1, "unit quaternion, got zero"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nEDGE_SE3_TRACKXYZ 0 1 3 1 0 0 1 0 0 1 0 1\n", 2, "offset 3 has no PARAMS"),
        (EDGE + SPATIAL.format("0 0 0 1"), None, "planar or spatial"),
        (VERTICES + "VERTEX_TRACKXYZ 1 0 0 0\n", None, "planar or spatial"),
        ("LANDMARK2 0 1 1 0 1 0 1\n", None, "no pose"),
    ],
)
def test_a_malformed_line_is_named(tmp_path, text, line, message):
    with pytest.raises(FileFormatError, match=message) as caught:
        read_text(tmp_path, text)
    assert caught.value.line == line


def test_labels_in_messages_are_quoted_and_short(tmp_path):
    label = "<script>alert(1)</script>\x1b[31m" + "x" * 1000
    with pytest.raises(FileFormatError) as caught:
        read_text(tmp_path, f"EDGE_SE2 0 {label.replace(' ', '')} 1 0 0 1 0 0 1 0 1\n")
    message = str(caught.value).removeprefix(str(tmp_path))
    assert "got '<script>alert(1)</script>\\x1b[31m" in message
    assert len(message) < 200
