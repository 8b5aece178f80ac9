"""Sparse models and dumps: COLMAP, ORB-SLAM text, BAL, stella_vslam, GLIM, PyFG; each file after its specification."""

import struct
from pathlib import Path

import gtsam
import msgpack
import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import between_factors, poses_of
from pgti_gtsam.errors import FileFormatError

MODELS = Path(__file__).parents[1] / ".." / "shared" / "data" / "sparse_models"
needs_models = pytest.mark.skipif(not MODELS.is_dir(), reason="the development data are not beside the checkout")


class Model:
    """Five keyframes on a line that look along their z axis at twelve points, each keyframe at some."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        self.poses = {
            key: gtsam.Pose3(gtsam.Rot3.Expmap(0.2 * rng.normal(size=3)), np.array([0.5 * i, 0, 0]))
            for i, key in enumerate((3, 4, 7, 8, 20))
        }
        self.points = {int(key): np.array([*rng.uniform(-1, 3, 2), rng.uniform(2, 6)]) for key in 5 * np.arange(12) + 1}
        drawn = {(k, int(p)) for k in self.poses for p in rng.choice(list(self.points), 7, replace=False)}
        self.seen = sorted(drawn | {(3, key) for key in self.points})

    def hand_built(self):
        """The model as a graph of GTSAM, without any reader."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for key, pose in self.poses.items():
            values.insert(key, pose)
        for key, point in self.points.items():
            values.insert(gtsam.symbol("l", key), point)
        noise = gtsam.noiseModel.Unit.Create(3)
        for key, landmark in self.seen:
            point = self.poses[key].transformTo(self.points[landmark])
            bearing, range_m = gtsam.Unit3(point), float(np.linalg.norm(point))
            graph.push_back(gtsam.BearingRangeFactor3D(key, gtsam.symbol("l", landmark), bearing, range_m, noise))
        return graph, values


def quaternion(rotation):
    turn = rotation.toQuaternion()
    return [turn.x(), turn.y(), turn.z(), turn.w()]


def write_colmap(model, folder, ending):
    tracks = {key: [image for image, point in model.seen if point == key] for key in model.points}
    images = []
    for key, pose in model.poses.items():
        inverse = pose.inverse()
        x, y, z, w = quaternion(inverse.rotation())
        images.append((key, [w, x, y, z, *inverse.translation()], [p for image, p in model.seen if image == key]))
    if ending == ".txt":
        text = "# Image list\n"
        for key, numbers, seen in images:
            text += f"{key} {' '.join(map(repr, map(float, numbers)))} 1 {key:04d}.png\n"
            text += " ".join(f"1.5 2.5 {point}" for point in seen) + "\n"
        (folder / "images.txt").write_text(text)
        lines = [
            f"{key} {' '.join(map(repr, map(float, point)))} 9 9 9 0.5 " + " ".join(f"{i} 0" for i in tracks[key])
            for key, point in model.points.items()
        ]
        (folder / "points3D.txt").write_text("# 3D point list\n" + "\n".join(lines) + "\n")
        return
    data = struct.pack("<Q", len(images))
    for key, numbers, seen in images:
        data += (
            struct.pack("<i7di", key, *numbers, 1) + f"{key:04d}.png".encode() + b"\0" + struct.pack("<Q", len(seen))
        )
        data += b"".join(struct.pack("<ddq", 1.5, 2.5, point) for point in seen)
    (folder / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(model.points))
    for key, point in model.points.items():
        data += struct.pack("<Q3d3BdQ", key, *point, 9, 9, 9, 0.5, len(tracks[key]))
        data += b"".join(struct.pack("<ii", image, 0) for image in tracks[key])
    (folder / "points3D.bin").write_bytes(data)


def write_stella(model, path):
    keyframes, previous = {}, -1
    for key, pose in model.poses.items():
        inverse = pose.inverse()
        keyframes[str(key)] = {
            "cam": "camera",
            "lm_ids": [-1, *(point for image, point in model.seen if image == key)],
            "loop_edges": [3] if key == 20 else [20] if key == 3 else [],
            "rot_cw": quaternion(inverse.rotation()),
            "span_parent": previous,
            "trans_cw": list(inverse.translation()),
        }
        previous = key
    landmarks = {str(key): {"pos_w": list(point), "ref_keyfrm": 3} for key, point in model.points.items()}
    content = {"cameras": {"camera": {}}, "keyframe_next_id": 21, "keyframes": keyframes, "landmarks": landmarks}
    path.write_bytes(msgpack.packb(content))


def write_bal(model, path):
    """By GTSAM itself, which counts cameras from 0 and has them look along −z."""
    data = gtsam.SfmData()
    places = {key: place for place, key in enumerate(model.poses)}
    for pose in model.poses.values():
        data.addCamera(gtsam.PinholeCameraCal3Bundler(pose, gtsam.Cal3Bundler(500.0, 0.0, 0.0, 0.0, 0.0)))
    for key, point in model.points.items():
        track = gtsam.SfmTrack(point)
        for image, seen in model.seen:
            if seen == key:
                track.addMeasurement(places[image], np.array([1.5, 2.5]))
        data.addTrack(track)
    gtsam.writeBAL(str(path), data)


def write_orb_slam(model, folder):
    lines = [
        " ".join(map(repr, [float(key), *map(float, pose.translation()), *quaternion(pose.rotation())]))
        for key, pose in model.poses.items()
    ]
    (folder / "KeyFrameTrajectory.txt").write_text("\n".join(lines) + "\n")
    lines = [
        " ".join(map(repr, [float(key), *(float(x) for i, p in model.seen if i == key for x in model.points[p])]))
        for key in model.poses
    ]
    (folder / "MapPointsInKeyFrames.txt").write_text("\n".join(lines) + "\n")


WRITERS = {
    "COLMAP binary": lambda model, folder: write_colmap(model, folder, ".bin") or folder,
    "COLMAP text": lambda model, folder: write_colmap(model, folder, ".txt") or folder,
    "ORB-SLAM": lambda model, folder: write_orb_slam(model, folder) or folder,
    "BAL": lambda model, folder: write_bal(model, folder / "bal.txt") or folder / "bal.txt",
    "stella_vslam": lambda model, folder: write_stella(model, folder / "map.msg") or folder / "map.msg",
}


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("seed", range(3))
def test_a_model_is_what_was_written_and_gives_the_radii_and_covisibility_of_a_graph_built_by_hand(
    tmp_path, kind, seed
):
    model = Model(seed)
    dataset = datasets.read(WRITERS[kind](model, tmp_path))
    found = list(poses_of(dataset.values).values())
    assert all(pose.equals(known, 1e-6) for pose, known in zip(found, model.poses.values(), strict=True))
    edges = ["covisibility"]
    ours = pgti.from_gtsam(dataset.graph, dataset.values, edges=edges, min_shared_landmarks=2)
    theirs = pgti.from_gtsam(*model.hand_built(), edges=edges, min_shared_landmarks=2)
    np.testing.assert_allclose(ours.radii, theirs.radii, rtol=1e-5)
    np.testing.assert_array_equal(ours.edges, theirs.edges)
    assert ours.adaptation.n_observations == len(model.seen)


@pytest.mark.parametrize("ending", [".bin", ".txt"])
def test_a_colmap_model_is_named_by_its_folder_a_file_or_the_folder_above(tmp_path, ending):
    folder = tmp_path / "sparse" / "0"
    folder.mkdir(parents=True)
    write_colmap(Model(), folder, ending)
    graphs = [
        datasets.read(p).graph for p in (tmp_path, folder, folder / f"images{ending}", folder / f"points3D{ending}")
    ]
    assert all(graph.equals(graphs[0], 1e-12) for graph in graphs)


@pytest.mark.parametrize("name", ["images.bin", "points3D.bin"])
@pytest.mark.parametrize("share", [0.001, 0.3, 0.99])
def test_a_colmap_model_that_is_cut_off_is_refused(tmp_path, name, share):
    write_colmap(Model(), tmp_path, ".bin")
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(FileFormatError, match="cut off"):
        datasets.read(tmp_path)


def test_an_image_without_points_does_not_shift_the_lines_of_a_text_model(tmp_path):
    model = Model()
    model.seen = [(key, point) for key, point in model.seen if key != 4]
    write_colmap(model, tmp_path, ".txt")
    dataset = datasets.read(tmp_path)
    assert list(poses_of(dataset.values)) == [3, 7, 8, 20]
    assert any("1 keyframes see no point" in note for note in dataset.notes)


def test_a_model_is_found_from_where_one_stands(tmp_path, monkeypatch):
    """In its own folder, above it, in ``sparse``; the map is called like the folder, not like a file in it."""
    folder = tmp_path / "street" / "sparse" / "0"
    folder.mkdir(parents=True)
    write_colmap(Model(), folder, ".bin")
    monkeypatch.chdir(folder)
    found = [datasets.read(path) for path in (".", "images.bin", "points3D.bin", "..", "../..", tmp_path / "street")]
    assert [dataset.name for dataset in found] == ["0", "0", "0", "sparse", "street", "street"]
    assert all(dataset.graph.equals(found[0].graph, 1e-9) for dataset in found)


def test_a_camera_without_a_direction_is_named_with_its_line(tmp_path):
    write_colmap(Model(), tmp_path, ".txt")
    lines = (tmp_path / "images.txt").read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    fields = lines[first].split()
    lines[first] = " ".join([fields[0], "0", "0", "0", "0", *fields[5:]])
    (tmp_path / "images.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(FileFormatError, match=f"images.txt, line {first + 1}: expected a unit quaternion QW QX QY QZ"):
        datasets.read(tmp_path)


def test_an_observation_of_a_camera_that_is_not_there_is_refused(tmp_path):
    write_bal(Model(), tmp_path / "map.txt")
    lines = (tmp_path / "map.txt").read_text().splitlines()
    lines[3] = " ".join(["77", *lines[3].split()[1:]])
    (tmp_path / "map.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(FileFormatError, match="line 4: expected cameras from 0 to 4 and points from 0 to 11"):
        datasets.read(tmp_path / "map.txt")


def test_models_are_laid_side_by_side(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_colmap(Model(), tmp_path / name, ".bin")
    dataset = datasets.read_one_map([tmp_path / "one", tmp_path / "two"])
    assert len(poses_of(dataset.values)) == 2 * len(Model().poses)
    assert dataset.closures == ()


def test_the_tree_of_stella_ties_and_its_loop_edges_are_closures(tmp_path):
    write_stella(Model(), tmp_path / "map.msg")
    dataset = datasets.read(tmp_path / "map.msg")
    ends = {between.slot: between.ends for between in between_factors(dataset.graph)}
    assert [ends[slot] for slot in dataset.closures] == [(3, 20)]
    assert set(ends.values()) == {(3, 4), (4, 7), (7, 8), (8, 20), (3, 20)}
    data = (tmp_path / "map.msg").read_bytes()
    (tmp_path / "map.msg").write_bytes(data[: len(data) // 2])
    with pytest.raises(FileFormatError, match="damaged map of stella_vslam"):
        datasets.read(tmp_path / "map.msg")


def test_numbers_that_a_bal_file_announces_and_does_not_hold_are_told(tmp_path):
    write_bal(Model(), tmp_path / "bal.txt")
    text = (tmp_path / "bal.txt").read_text().rstrip().rsplit("\n", 1)[0]
    (tmp_path / "bal.txt").write_text(text + "\n")
    with pytest.raises(FileFormatError, match=r"then 81 numbers of cameras and points, got .* 80 numbers"):
        datasets.read(tmp_path / "bal.txt")


def test_a_dump_of_glim_is_its_submaps_and_their_registrations(tmp_path):
    poses = [gtsam.Pose3(gtsam.Rot3.Rz(0.3 * i), np.array([5.0 * i, i, 0])) for i in range(4)]
    (tmp_path / "graph.txt").write_text(
        "num_submaps: 4\nnum_all_frames: 40\nnum_matching_cost_factors: 2\n"
        "matching_cost vgicp 0 1\nmatching_cost vgicp 3 0\n"
    )
    for i, pose in enumerate(poses):
        (tmp_path / f"{i:06d}").mkdir()
        rows = "\n".join(" ".join(map(str, row)) for row in pose.matrix())
        (tmp_path / f"{i:06d}" / "data.txt").write_text(f"id: {i}\nT_world_origin: \n{rows}\nT_lidar_imu: \n1 0 0 0\n")
    for path in (tmp_path, tmp_path / "graph.txt"):
        dataset = datasets.read(path)
        assert all(found.equals(poses[key], 1e-9) for key, found in poses_of(dataset.values).items())
        assert [b.ends for b in between_factors(dataset.graph)] == [(0, 1), (1, 2), (2, 3), (0, 3)]
        assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-12)
    (tmp_path / "000002" / "data.txt").unlink()
    with pytest.raises(FileFormatError, match=r"a dump of GLIM without 000002/data.txt"):
        datasets.read(tmp_path)


PYFG = """VERTEX_SE2 0.0 A0 0 0 0
VERTEX_SE2 1.0 A1 2 0 0
VERTEX_SE2 1.0 B0 5 0 0
VERTEX_SE2 2.0 B1 7 0 0
VERTEX_XY L0 2 2
EDGE_SE2 1.0 A0 A1 2 0 0 0.04 0 0 0.09 0 0.01
EDGE_SE2 2.0 B0 B1 2 0 0 0.04 0 0 0.09 0 0.01
EDGE_SE2 2.0 A1 B0 3 0 0 0.04 0 0 0.09 0 0.01
EDGE_RANGE 1.0 A0 L0 2.8284271247461903 0.25
EDGE_RANGE 1.0 A0 B0 5 0.25
"""


def test_pyfg_holds_covariances_and_names_robots_by_letter(tmp_path):
    (tmp_path / "map.pyfg").write_text(PYFG)
    dataset = datasets.read(tmp_path / "map.pyfg")
    assert dataset.format == "PyFG graph"
    assert list(poses_of(dataset.values)) == [gtsam.symbol(*name) for name in (("A", 0), ("A", 1), ("B", 0), ("B", 1))]
    np.testing.assert_allclose(dataset.graph.at(0).noiseModel().sigmas(), [0.2, 0.3, 0.1])
    np.testing.assert_allclose(dataset.graph.at(3).noiseModel().sigmas(), [0.5])
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-9)
    assert [dataset.graph.at(slot).keys() for slot in datasets.closure_slots(dataset)] == [
        [gtsam.symbol("A", 1), gtsam.symbol("B", 0)]
    ]
    assert any("1 ranges between two poses are left out" in note for note in dataset.notes)
    (tmp_path / "map.pyfg").write_text(PYFG + "EDGE_FANCY 1.0 A0 B1 3\n")
    with pytest.raises(FileFormatError, match=r"line 11: 'EDGE_FANCY' is not known.*--ignore-unknown"):
        datasets.read(tmp_path / "map.pyfg")
    assert datasets.read(tmp_path / "map.pyfg", ignore_unknown=True).ignored_edges == 1
    (tmp_path / "map.pyfg").write_text(PYFG.replace("A0 A1", "A0 first"))
    with pytest.raises(FileFormatError, match="line 6: expected a name of a letter and a number"):
        datasets.read(tmp_path / "map.pyfg")


@pytest.mark.parametrize(("name", "poses", "factors", "landmarks"), [("15", 473, 1258, 3), ("16", 201, 772, 4)])
def test_the_pyfg_of_the_wheel_is_read_whole(name, poses, factors, landmarks):
    """CORA's recordings of an underwater vehicle: ranges to beacons, whose variance is that of 0.75 m."""
    dataset = datasets.read(gtsam.findExampleDataFile(f"goats_{name}.pyfg"))
    assert len(poses_of(dataset.values)) == poses
    assert (dataset.graph.size(), dataset.values.size()) == (factors, poses + landmarks)
    ranges = [dataset.graph.at(slot) for slot in range(factors) if dataset.graph.at(slot).dim() == 1]
    assert len(ranges) == factors - poses + 1
    np.testing.assert_allclose([factor.noiseModel().sigmas() for factor in ranges], 0.75)


@needs_models
@pytest.mark.parametrize(
    ("name", "keyframes", "landmarks", "sightings", "score", "inserted"),
    [("colmap_street", 137, 3091, 31206, 0.068, 1), ("orbslam_handheld", 198, 8386, 49792, 6.859, 1440)],
)
def test_real_models_have_the_scores_of_graphs_built_by_hand(name, keyframes, landmarks, sightings, score, inserted):
    dataset = datasets.read(MODELS / name)
    pose_graph = pgti.from_gtsam(dataset.graph, dataset.values)
    counts = pose_graph.adaptation
    assert (len(pose_graph), counts.n_landmarks, counts.n_observations) == (keyframes, landmarks, sightings)
    integrity = pgti.assess(pose_graph)
    assert integrity.score == pytest.approx(score, rel=0.01)
    assert len(integrity.inserted_edges) == inserted
