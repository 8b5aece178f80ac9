"""The other formats: TORO, Victoria Park, KITTI stereo, laser logs, labels beside the file, GTSAM's archives."""

import math
from pathlib import Path
from xml.etree import ElementTree

import gtsam
import numpy as np
import pytest
from small_files import CARMEN, CHAIN, FLIRTLIB, SCAN, TORO, TORO_3D, VICTORIA, read_text

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import between_factors, closure_slots, poses_of
from pgti_gtsam.datasets.formats import gtsam_archive
from pgti_gtsam.errors import FileFormatError, InvalidOptionError

L7 = gtsam.symbol("l", 7)


def information(dataset, slot):
    return dataset.graph.at(slot).noiseModel().information()


def refuses(folder, text, message, line=None, name="graph.txt"):
    with pytest.raises(FileFormatError, match=message) as caught:
        read_text(folder, text, name)
    assert caught.value.line == line


# TORO


def test_toro_order_of_information_and_a_bearing_range_landmark(tmp_path):
    dataset = read_text(tmp_path, TORO)
    np.testing.assert_allclose(information(dataset, 0), np.diag([10, 20, 30]), atol=1e-12)
    np.testing.assert_allclose(dataset.values.atPoint2(L7), [0, 2], atol=1e-12)
    np.testing.assert_allclose(dataset.graph.at(1).noiseModel().sigmas(), [0.0349, 0.1])
    assert dataset.notes == ("ignored lines: 1 'EQUIV'",)


def test_edges_whose_information_is_an_upper_triangle_by_rows_are_recognised(tmp_path):
    dataset = read_text(tmp_path, "EDGE2 0 1 1 0 0 3 0 1 4 0 5\n")
    np.testing.assert_allclose(information(dataset, 0), [[3, 0, 1], [0, 4, 0], [1, 0, 5]], atol=1e-12)
    assert any("upper triangle" in note for note in dataset.notes)


def test_spatial_edges_put_translation_first_and_euler_angles_as_gtsam_does(tmp_path):
    dataset = read_text(tmp_path, TORO_3D)
    np.testing.assert_allclose(information(dataset, 0), np.diag([4, 5, 6, 1, 2, 3]), atol=1e-12)
    dataset = read_text(tmp_path, "EDGE3 0 1 1 2 3 0.1 0.2 0.3\n")
    expected = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, 0.2, 0.1), np.array([1.0, 2, 3]))
    assert dataset.values.atPose3(1).equals(expected, 1e-12)
    np.testing.assert_allclose(information(dataset, 0), np.eye(6))
    assert any("unit information assumed" in note for note in dataset.notes)


def test_w100_stores_its_odometry_backwards():
    dataset = datasets.builtin("w100")
    assert (len(poses_of(dataset.values)), dataset.graph.size(), len(closure_slots(dataset))) == (100, 300, 201)


def test_sphere2500_comes_with_its_truth():
    dataset = datasets.builtin("sphere2500")
    assert (len(poses_of(dataset.values)), len(closure_slots(dataset))) == (2500, 2450)
    assert list(dataset.truth.keys()) == list(dataset.values.keys())


def test_malformed_toro_lines_are_named(tmp_path):
    refuses(tmp_path, "EDGE3 0 1 1 2 3 0.1 0.2 0.3 1\n", "expected 9 or 30 or 45 fields, got 10", 1)
    refuses(tmp_path, TORO + "BR 0 8 0.1 0 0.1 0.1\n", "positive range and sigmas", 6)
    refuses(tmp_path, TORO + "BR 5 8 0.1 1 0.1 0.1\n", "vertex 5 has no vertex line", 6)
    refuses(tmp_path, datasets_text("T1_city10000_04.txt"), "expected 6 or 12 fields, got 9", 1)


def datasets_text(name):
    with open(gtsam.findExampleDataFile(name), encoding="utf-8") as file:
        return file.read()


# Victoria Park


def test_victoria_park_holds_covariances(tmp_path):
    dataset = read_text(tmp_path, VICTORIA)
    np.testing.assert_allclose(dataset.graph.at(0).noiseModel().sigmas(), [0.01, 0.02, 0.03])
    sighting = dataset.graph.at(1)  # straight to the left at 2 m: x is across, y along the ray
    np.testing.assert_allclose(sighting.noiseModel().sigmas(), [np.sqrt(0.4) / 2, np.sqrt(0.1)])
    np.testing.assert_allclose(dataset.values.atPoint2(gtsam.symbol("l", 2)), [1, 2], atol=1e-12)
    refuses(tmp_path, VICTORIA + "LANDMARK 1 2 0 2 0.4 0 0\n", "positive definite covariance", 4)


def test_all_of_victoria_park_agrees_with_gtsam_but_for_the_sightings_weights():
    dataset = datasets.builtin("victoria_park")
    graph, values = gtsam.load2D(gtsam.findExampleDataFile("victoria_park.txt"))
    assert (len(poses_of(dataset.values)), dataset.values.size()) == (6969, 6969 + 151)
    assert dataset.graph.size() == graph.size() == 6968 + 3640
    ours, theirs = poses_of(dataset.values), poses_of(values)
    assert all(ours[key].equals(theirs[key], 1e-9) for key in theirs)
    assert dataset.graph.at(0).equals(graph.at(0), 1e-9)


# KITTI stereo


def test_kitti_00():
    dataset = datasets.builtin()
    assert (dataset.name, dataset.format) == ("kitti00", "KITTI stereo")
    poses = poses_of(dataset.values)
    assert (len(poses), dataset.values.size()) == (135, 135 + 26136)
    assert dataset.graph.size() == 134 + 88781
    assert set(dataset.graph.keyVector()) == set(dataset.values.keys())
    assert closure_slots(dataset) == ()
    assert any("assumed sigma of 1 pixel" in note for note in dataset.notes)
    first = next(dataset.graph.at(i) for i in range(134, 140))
    x0, l7 = first.keys()
    assert (x0, l7) == (gtsam.symbol("x", 0), L7)
    np.testing.assert_allclose(dataset.values.atPoint3(l7), [-6.64609, -4.05136, 16.7814])  # camera 0 is the origin
    assert first.error(dataset.values) < 0.1  # the stored point projects to the stored pixels


STEREO = "0 3 320 300 100 0 0 {z}\n1 3 322 300 100 0 0 9\n"
CAMERAS = "0 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n1 1 0 0 0 0 1 0 0 0 0 1 {z} 0 0 0 1\n"
CALIBRATION = "700 700 0 320 100 0.5\n"


OBSERVATIONS, POSES = STEREO.format(z=10), CAMERAS.format(z=1)


def stereo(folder, factors=OBSERVATIONS, poses=POSES, calibration=CALIBRATION):
    for kind, text in (("camera_poses", poses), ("calibration", calibration)):
        if text is not None:
            (folder / f"VO_{kind}7.txt").write_text(text)
    return read_text(folder, factors, "VO_stereo_factors7.txt")


def test_a_landmark_is_placed_by_its_first_observation(tmp_path):
    dataset = stereo(tmp_path)
    np.testing.assert_allclose(dataset.values.atPoint3(gtsam.symbol("l", 3)), [0, 0, 10])
    assert [type(dataset.graph.at(i)).__name__ for i in range(3)] == [
        "BetweenFactorPose3",
        "GenericStereoFactor3D",
        "GenericStereoFactor3D",
    ]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"poses": None}, "expected VO_camera_poses7.txt beside it, which is missing"),
        ({"calibration": None}, "expected VO_calibration7.txt beside it, which is missing"),
        ({"poses": POSES.splitlines()[0]}, "camera 1 has no pose in VO_camera_poses7.txt"),
        ({"poses": CAMERAS.format(z="nan")}, "finite number, got 'nan'"),
        ({"poses": POSES.replace("0 1 0 0", "0 2 0 0")}, "rigid motion"),
        ({"poses": POSES * 2}, "camera 0 is defined a second time"),
        ({"calibration": "700 700 0 320 100 -0.5"}, "positive fx, fy and baseline"),
        ({"calibration": "700 700 0 320 100"}, "expected 6 fields, got 5"),
        ({"factors": STEREO.format(z=-10)}, "line 1: expected a landmark in front of the cameras"),
        ({"factors": OBSERVATIONS + "0 4 320 300\n"}, "line 3: expected 8 fields, got 4"),
    ],
)
def test_malformed_stereo_files_are_named(tmp_path, files, message):
    with pytest.raises(FileFormatError, match=message):
        stereo(tmp_path, **files)


def test_the_other_stereo_files_say_which_one_is_wanted(tmp_path):
    refuses(tmp_path, CALIBRATION, "looks like KITTI calibration; expected the VO_stereo_factors file")
    refuses(tmp_path, POSES, "looks like KITTI camera poses; expected the VO_stereo_factors file")
    refuses(tmp_path, OBSERVATIONS, "expected stereo_factors in its name")


# laser scans


def test_radii_are_the_smallest_valid_ranges(tmp_path):
    """Of 81.91, 1.5, 0 and nan only 1.5 is a measurement below the maximum of 50 m; of 81.91, 50, 0, −1 none is."""
    dataset = read_text(tmp_path, FLIRTLIB)
    assert dict(dataset.radii) == {0: 1.5, 2: 0.75}
    assert "1 poses have no scan with a valid range and so no radius" in dataset.notes
    assert closure_slots(dataset) == (2,)
    np.testing.assert_allclose(information(dataset, 0), np.diag([100, 100, 500]), atol=1e-12)


def test_malformed_scans_are_named(tmp_path):
    scan = SCAN.format(ranges="1 2 3 4", time=1)
    refuses(tmp_path, scan + FLIRTLIB, "expected a VERTEX2 line before the first ROBOTLASER1", 1)
    refuses(tmp_path, "VERTEX2 0 0 0 0\n" + scan + scan, "one scan per vertex, got a second one for vertex 0", 3)
    refuses(tmp_path, "VERTEX2 0 0 0 0\n" + scan.replace(" 4 1 ", " 400 1 "), "expected a count and as many", 2)
    refuses(tmp_path, "VERTEX2 0 0 0 0\n" + scan.replace(" 4 1 ", " 3 1 "), "behind the readings|expected a count", 2)
    refuses(tmp_path, "VERTEX2 0 0 0 0\n" + scan.replace(" 4 1 ", " 4 x "), "range in metres.*'x'", 2)
    refuses(tmp_path, "VERTEX2 0 0 0 0\nROBOTLASER1 0\n", "expected a count", 2)
    refuses(
        tmp_path, CARMEN.replace("FLASER 3", "FLASER 4"), "expected 9 fields behind the readings of FLASER, got 8", 2
    )
    refuses(tmp_path, CARMEN.replace("FLASER 3", "FLASER -3"), "count '-3'", 2)


def test_keyframes_of_a_log_follow_the_distance_travelled(tmp_path):
    dataset = read_text(tmp_path, CARMEN, "drive.clf")
    positions = [round(pose.x(), 9) for pose in poses_of(dataset.values).values()]
    assert positions == [0, 0.6, 1.2, 1.8, 2.4, 3.0, 3.6, 4.2, 4.8, 5.4]  # scans every 0.2 m, keyframes after 0.5 m
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0)
    assert dataset.radii[0] == 1.0
    assert dataset.radii[5] == 2.0  # its own three readings are 2.5, 50 and 2
    assert closure_slots(dataset) == ()
    assert dataset.true_closures is None
    assert any("no drive.relations" in note for note in dataset.notes)
    assert len(poses_of(datasets.read_carmen(tmp_path / "drive.clf", step_m=2.0).values)) == 3
    with pytest.raises(InvalidOptionError, match="positive steps"):
        datasets.read_carmen(tmp_path / "drive.clf", step_m=0.0)
    read_text(tmp_path, CHAIN)
    with pytest.raises(FileFormatError, match="expected a CARMEN log"):
        datasets.read_carmen(tmp_path / "graph.txt")


def test_turning_on_the_spot_makes_keyframes_too(tmp_path):
    text = "".join(f"FLASER 1 2.00 0 0 {0.3 * i} 0 0 {0.3 * i} {i}.0 host {i}.0\n" for i in range(30))
    assert len(poses_of(read_text(tmp_path, text).values)) == 15


def test_newer_logs_are_read_as_well(tmp_path):
    scans = [SCAN.format(ranges="3 2 50 60", time=i).replace("host", f"host{i}") for i in range(3)]
    text = "".join(scan.replace("60 0 0 0 0 0", f"60 0 {i} 0 0 {i}") for i, scan in enumerate(scans))
    dataset = read_text(tmp_path, text)
    assert (dataset.format, dict(dataset.radii)) == ("CARMEN log", {0: 2.0, 1: 2.0, 2: 2.0})


def test_long_relations_beside_a_log_become_true_closures(tmp_path):
    short = "".join(f"{10 + i} {11 + i} 0.2 0 0 0 0 0\n" for i in range(29))
    path = tmp_path / "drive.relations"
    path.write_text(short + "11.0 35.01 4.8 0.1 0 0 0 0.2\n11.0 77.7 4.8 0.1 0 0 0 0.2\n")
    dataset = read_text(tmp_path, CARMEN, "drive.clf")
    (closure,) = closure_slots(dataset)
    factor = dataset.graph.at(closure)
    first, second = (dataset.values.atPose2(key).x() for key in tuple(factor.keys()))
    assert (first, second) == pytest.approx((0.2, 5.0))
    assert factor.measured().equals(gtsam.Pose2(4.8, 0.1, 0.2), 1e-12)
    assert dataset.true_closures == {closure}
    assert any("1 relations name a time at which there is no scan" in note for note in dataset.notes)
    path.write_text("11.0 35.0 4.8 0.1 0 0 0\n")
    with pytest.raises(FileFormatError, match=r"drive.relations, line 1: expected 8 fields, got 7"):
        read_text(tmp_path, CARMEN, "drive.clf")


# labels beside a graph


def kitti_like(folder, labels):
    turn = math.pi / 3
    text = "".join(f"EDGE_SE2 {i} {i + 1} 1 0 {turn} 1 0 0 1 0 1\n" for i in range(6))
    text += f"EDGE_SE2 1 6 -0.5 {-math.sin(turn)} {-turn} 1 0 0 1 0 1\nEDGE_SE2 5 0 0 0 0 1 0 0 1 0 1\n"
    (folder / "k_alpha_0.5_GT_LC.txt").write_text(labels)
    (folder / "k_GT.g2o").write_text("EDGE_SE2 0 1 2 0 0 1 0 0 1 0 1\n")
    return read_text(folder, text, "k_alpha_0.5.g2o")


@pytest.mark.parametrize("labels", ["1 6\n", "6 1\n", "# true\n\n6 1\n1 6\n"])
def test_labels_name_pairs_in_either_order(tmp_path, labels):
    dataset = kitti_like(tmp_path, labels)
    assert closure_slots(dataset) == (7, 6)  # by the later pose
    assert dataset.true_closures == {6}
    assert dataset.truth.atPose2(1).x() == 2.0
    assert "1 of 2 closures measure exactly the identity" in dataset.notes


def test_labels_that_fit_no_closure_are_told(tmp_path):
    dataset = kitti_like(tmp_path, "1 6\n77 78\n1 2\n")
    assert dataset.true_closures == {6}
    assert any(note.startswith("2 pairs") for note in dataset.notes)
    with pytest.raises(FileFormatError, match=r"_GT_LC.txt, line 1: expected 2 fields"):
        kitti_like(tmp_path, "1 6 5\n")


def test_a_file_of_true_loops_says_so_in_its_name(tmp_path):
    text = CHAIN + "EDGE_SE2 9 12 -1 0 0 1 0 0 1 0 1\nEDGE_SE2 12 3 -1 0 0 1 0 0 1 0 1\n"
    dataset = read_text(tmp_path, text, "kitti_99_odom_GT_LC.g2o")
    assert dataset.true_closures == set(closure_slots(dataset)) == {4}
    assert dataset.truth is None


# GTSAM's archives


@pytest.fixture
def archives(tmp_path):
    dataset = read_text(tmp_path, CHAIN)
    paths = tmp_path / "graph.dat", tmp_path / "values.dat"
    paths[0].write_text(dataset.graph.serialize())
    paths[1].write_text(dataset.values.serialize())
    return dataset, *paths


def test_an_archive_gives_back_what_was_written(archives):
    written, graph, values = archives
    dataset = datasets.read(graph, values)
    assert dataset.format == "GTSAM archive"
    assert dataset.graph.equals(written.graph, 1e-12)
    assert dataset.values.equals(written.values, 1e-12)
    assert closure_slots(dataset) == closure_slots(written)


def test_empty_slots_survive(archives):
    written, graph, values = archives
    written.graph.remove(0)
    graph.write_text(written.graph.serialize())
    dataset = datasets.read(graph, values)
    assert dataset.graph.size() == 3
    assert [between.slot for between in between_factors(dataset.graph)] == [1, 2]
    assert any("1 slots of the graph are empty" in note for note in dataset.notes)


def test_archives_of_the_wrong_kind_are_refused(archives, tmp_path):
    _, graph, values = archives
    with pytest.raises(FileFormatError, match="--values FILE"):
        datasets.read(graph)
    with pytest.raises(FileFormatError, match="holds GTSAM values; expected the factor graph"):
        datasets.read(values, graph)
    with pytest.raises(FileFormatError, match=r"graph.dat: expected an archive of gtsam.Values"):
        datasets.read(graph, graph)
    with pytest.raises(FileFormatError, match=r"graph.txt: expected a text archive of gtsam.Values"):
        datasets.read(graph, tmp_path / "graph.txt")
    with pytest.raises(FileFormatError, match=r"absent: no such file"):
        datasets.read(graph, tmp_path / "absent")
    path = tmp_path / "graph.bin"
    path.write_bytes(b"\x16\0\0\0\0\0\0\0serialization::archive\x13\0\x04\x08")
    with pytest.raises(FileFormatError, match="binary archive"):
        datasets.read(path, values)


@pytest.mark.parametrize("name", ["toy3D.xml", "randomGrid3D.xml"])
def test_xml_of_gtsam_itself_becomes_the_text_that_gtsam_reads(name):
    path = Path(gtsam.findExampleDataFile(name))
    read = gtsam.GaussianFactorGraph()
    read.deserialize(gtsam_archive.as_text(path))
    written = [float(item.text) for item in ElementTree.parse(path).getroot().iter("item") if is_decimal(item.text)]
    jacobians = [read.at(slot).augmentedJacobian() for slot in range(read.size())]
    np.testing.assert_allclose(np.concatenate([j.ravel("F") for j in jacobians]), written, rtol=1e-12)


def is_decimal(text):
    return text is not None and "e" in text


def test_an_xml_archive_gives_the_graph_of_the_text_archive(archives, tmp_path):
    """The tokens of a text archive, each in an element of its own: what XML writes, but for the elements' names."""
    written, graph, values = archives
    tokens = graph.read_text().split()
    body = "".join(f"<item>{token}</item>" for token in tokens[3:])
    body = body.replace("gtsam::BetweenFactor<gtsam::Pose2>", "gtsam::BetweenFactor&lt;gtsam::Pose2&gt;")
    head = '<?xml version="1.0"?><!DOCTYPE boost_serialization><boost_serialization signature="serialization::archive"'
    (tmp_path / "graph.xml").write_text(f'{head} version="{tokens[2]}"><data>{body}</data></boost_serialization>')
    dataset = datasets.read(tmp_path / "graph.xml", values)
    assert dataset.graph.equals(written.graph, 1e-12)
    (tmp_path / "graph.xml").write_text(f'{head} version="{tokens[2]}"><data>{body}</data>')
    with pytest.raises(FileFormatError, match="damaged or cut-off XML archive"):
        datasets.read(tmp_path / "graph.xml", values)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_cut_off_archive_is_refused_and_the_process_lives(archives, share):
    _, graph, values = archives
    text = values.read_text()
    values.write_text(text[: int(share * len(text))])
    with pytest.raises(FileFormatError, match=r"values.dat: is a damaged or cut-off archive"):
        datasets.read(graph, values)


def test_an_archive_that_ends_the_process_which_reads_it_is_refused(tmp_path):
    """Cut inside object number 41, the archive refers to object 4, of another class, and Boost believes it."""
    pose_graph, estimate = gtsam.readG2o(gtsam.findExampleDataFile("pose2example.txt"), False)
    text = pose_graph.serialize()
    graph, values = tmp_path / "graph.dat", tmp_path / "values.dat"
    graph.write_text(text[: text.index("\n41 ") + 2])
    values.write_text(estimate.serialize())
    with pytest.raises(FileFormatError, match="damaged or cut-off"):
        datasets.read(graph, values)
