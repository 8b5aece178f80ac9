"""Maps of every format, damaged as hypothesis draws it: bytes, words and lines changed in one of their files."""

import functools
import re
import tempfile
from pathlib import Path

import gtsam
from hypothesis import strategies as st
from small_files import TEXTS
from test_datasets_formats import CALIBRATION, OBSERVATIONS, POSES
from test_datasets_models import WRITERS, Model
from test_datasets_rtabmap import Database, drifted, truth

from pgti_gtsam.datasets import write_g2o

WORDS = [
    "nan",
    "inf",
    "-inf",
    "1e400",
    "1e99",
    "1e-320",
    "1e30",
    "x",
    "1_0",
    "-1",
    "0",
    "1",
    "2",
    "3",
    "99999999999999999999",
    "9223372036854775807",
    "½",
    "٣",
    "²",
    "<b>",
    "0x10",
    "VERTEX_SE2",
    "EDGE_SE2",
    "#",
    "-",
    "+",
    ".",
    "1e",
    "2147483648",
    "-0.0",
]
NUMBERS = [
    "0",
    "-0.0",
    "1e-320",
    "1e-9",
    "1",
    "-1",
    "2",
    "3.14159265",
    "100",
    "1e6",
    "1e9",
    "1e15",
    "1e20",
    "1e30",
    "-1e30",
]
BLOBS = [
    b"\0",
    b"\xff",
    b"\xff" * 8,
    b"\x7f\xff\xff\xff",
    b"\n",
    b"\r",
    b"\xef\xbb\xbf",
    b" ",
    b"9" * 5000,
    b"\xdf\xff\xff\xff\xff",
]
GLIM = "num_submaps: 3\nnum_all_frames: 30\nnum_matching_cost_factors: 1\nmatching_cost vgicp 0 2\n"
SUBMAP = "id: {i}\nT_world_origin: \n1 0 0 {i}\n0 1 0 0\n0 0 1 0\n0 0 0 1\nT_lidar_imu: \n1 0 0 0\n"


def _rtabmap(path):
    database, steps, pose = Database(path), drifted(12), truth(0)
    for i in range(12):
        database.node(i + 1, pose)
        if i < len(steps):
            database.link(i + 1, i + 2, 0, steps[i])
            pose = pose.compose(steps[i])
    database.link(1, 12, 1, truth(0).between(truth(11)))
    database.optimised({i + 1: truth(i) for i in range(12)})
    database.close()


def _laps(path, spatial):
    """Two laps of eight keyframes with three closures."""
    drawn = [truth(12.5 * i) for i in range(16)]
    poses = drawn if spatial else [gtsam.Pose2(*pose.translation()[:2], pose.rotation().yaw()) for pose in drawn]
    tie = gtsam.BetweenFactorPose3 if spatial else gtsam.BetweenFactorPose2
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    for i, j in [*((i, i + 1) for i in range(15)), (0, 8), (3, 11), (7, 15)]:
        step = poses[i].between(poses[j])
        graph.push_back(tie(i, j, step, gtsam.noiseModel.Unit.Create(6 if spatial else 3)))
    write_g2o(graph, values, path)


def _archive(folder):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(1.3), gtsam.noiseModel.Unit.Create(3)
    )
    for key in range(5):
        values.insert(key, gtsam.Pose2(key, 0, 0))
    for i, j in [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4)]:
        graph.push_back(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(j - i, 0, 0), noise))
    (folder / "graph.txt").write_text(graph.serialize())
    (folder / "values.txt").write_text(values.serialize())


@functools.cache
def maps():
    """By name: bytes of all files by their place in a folder, and which file or folder is read."""
    found = {name: ({"graph.txt": text.encode()}, "graph.txt") for name, text in TEXTS.items()}
    files = {"VO_stereo_factors7.txt": OBSERVATIONS, "VO_camera_poses7.txt": POSES, "VO_calibration7.txt": CALIBRATION}
    found["stereo"] = {name: text.encode() for name, text in files.items()}, "VO_stereo_factors7.txt"
    glim = {"graph.txt": GLIM, **{f"{i:06d}/data.txt": SUBMAP.format(i=i) for i in range(3)}}
    found["GLIM"] = {name: text.encode() for name, text in glim.items()}, "."
    for name, write in {
        **{name: functools.partial(write, Model()) for name, write in WRITERS.items()},
        "laps": lambda folder: _laps(folder / "laps.g2o", spatial=False),
        "laps in space": lambda folder: _laps(folder / "laps.g2o", spatial=True),
        "RTAB-Map": lambda folder: _rtabmap(folder / "map.db"),
        "archive": _archive,
    }.items():
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            write(folder)
            files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        found[name] = (
            files,
            "." if len(files) > 1 and name != "archive" else "graph.txt" if name == "archive" else next(iter(files)),
        )
    return found


@st.composite
def damaged(draw, names=None):
    """Files by place, what is read, and the file of values or None."""
    name = draw(st.sampled_from(sorted(names or maps())))
    files, read = maps()[name]
    files = dict(files)
    place = draw(st.sampled_from(sorted(files)))
    data = files[place]
    for _ in range(draw(st.integers(1, 4))):
        data = _changed(draw, data)
    files[place] = data
    return files, read, "values.txt" if name == "archive" else None


def _changed(draw, data):
    kind = draw(st.sampled_from(["word", "bytes", "line", "cut", "blob", "bit"]))
    if kind == "word":
        spans = [match.span() for match in re.finditer(rb"[^\s,:]+", data)]
        if spans:
            start, end = draw(st.sampled_from(spans))
            return data[:start] + draw(st.sampled_from(WORDS)).encode() + data[end:]
    if kind == "line":
        lines = data.split(b"\n")
        i, j = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        lines[i : i + 1] = draw(st.sampled_from([[], [lines[i], lines[i]], [lines[j]], [lines[i] + b" " + lines[j]]]))
        return b"\n".join(lines)
    at = draw(st.integers(0, max(len(data) - 1, 0)))
    if kind == "cut":
        return data[:at]
    if kind == "bit" and data:
        return data[:at] + bytes([data[at] ^ (1 << draw(st.integers(0, 7)))]) + data[at + 1 :]
    length = draw(st.sampled_from([0, 1, 4, 8]))
    return data[:at] + draw(st.sampled_from(BLOBS) | st.binary(max_size=8)) + data[at + length :]


def put(files, folder):
    """Write files into an empty folder."""
    for place, data in files.items():
        path = folder / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


@st.composite
def odd_maps(draw):
    """g2o text of two laps whose numbers, identifiers and lines are changed but stay in range; and a radius."""
    data = maps()[draw(st.sampled_from(["laps", "laps in space"]))][0]["laps.g2o"]
    lines = [line.split() for line in data.decode().splitlines()]
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(lines) - 1))
        words = lines[at]
        first = 2 if words[0].startswith("VERTEX") else 3
        change = draw(st.sampled_from(["number", "number", "number", "numbers", "identifier", "drop", "repeat"]))
        if change == "number":
            words[draw(st.integers(first, len(words) - 1))] = draw(st.sampled_from(NUMBERS))
        elif change == "numbers":
            words[first:] = [draw(st.sampled_from(NUMBERS)) for _ in words[first:]]
        elif change == "identifier":
            words[draw(st.integers(1, first - 1))] = draw(st.sampled_from(["0", "1", "5", "15", "99", "-3"]))
        elif change == "drop" and len(lines) > 3:
            del lines[at]
        elif change == "repeat":
            lines.append(list(words))
    radius = draw(st.sampled_from([1e-12, 0.5, 1.0, 30.0, 1e6, 1e300]))
    return "\n".join(map(" ".join, lines)), radius
