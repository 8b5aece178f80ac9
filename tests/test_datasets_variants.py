"""One map written in many ways is one map, and what is no map says what it is."""

import io
import lzma
import tarfile
import zipfile

import gtsam
import numpy as np
import pytest
from small_files import read_text

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import poses_of
from pgti_gtsam.errors import FileFormatError

UPPER = "1 0 0 1 0 1"
VERTICES = [f"VERTEX_SE2 {i} {i} 0 0" for i in range(4)]
EDGES = [f"EDGE_SE2 {i} {i + 1} 1 0 0 {UPPER}" for i in range(3)]
PLAIN = "\n".join(VERTICES + EDGES) + "\n"
SPATIAL = "".join(f"VERTEX_SE3:QUAT {i} {i} 0 0 0 0 0 1\n" for i in range(3))
SPATIAL += "".join(f"EDGE_SE3:QUAT {i} {i + 1} 1 0 0 0 0 0 1\n" for i in range(2))


def zipped(*names):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.writestr(name, PLAIN)
    return stream.getvalue()


def tarred():
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        member = tarfile.TarInfo("map.g2o")
        member.size = len(PLAIN)
        archive.addfile(member, io.BytesIO(PLAIN.encode()))
    return stream.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbf" + PLAIN.replace(" ", "\t").replace("\n", "  \r\n").encode(),
        PLAIN.replace("\n", "\r").encode(),
        PLAIN.replace("\n", "  # said by hand\n").encode(),
        "\n".join([*VERTICES[::-1], *EDGES]).encode(),
        "\n".join([*EDGES, *VERTICES]).encode(),
        zipped("maps/map.g2o"),
        lzma.compress(PLAIN.encode(), format=lzma.FORMAT_ALONE),
        lzma.compress(PLAIN.encode()),
    ],
    ids=["tabs, CRLF and a mark", "CR", "comments behind", "backwards", "edges first", "zip", "lzma", "xz"],
)
def test_a_map_is_the_same_however_it_is_written(tmp_path, data):
    (tmp_path / "other").write_bytes(data)
    plain, other = read_text(tmp_path, PLAIN), datasets.read(tmp_path / "other")
    assert other.graph.equals(plain.graph, 1e-12)
    assert other.values.equals(plain.values, 1e-12)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (zipped("a.g2o", "b.g2o"), "is a zip archive of 2 files; unpack it and name the one to read"),
        (tarred(), "a tar archive, which is not read; unpack it and name the file in it"),
        (b"\x28\xb5\x2f\xfd\x04", "packed by Zstandard, which is not read; unpack it first"),
        (PLAIN.encode("utf-16"), "text in UTF-16, which is not read; save it as UTF-8"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS.*run `git lfs pull`"),
        (b"<!DOCTYPE html>\n<html></html>\n", "a web page, which is not read; the download went wrong"),
        (b"\x80\x05\x95\x00", r"a Python pickle, which is not read; write graph.serialize\(\)"),
        (b"0.0 np.float64(1.0) 0 0 0 0 0 1\n", r"holds 'np.float64\(1.0\)' on line 1"),
        (b"VERTEX_SE2 0 0 0 0\n", "holds 1 pose and nothing that ties it; expected two keyframes at least"),
    ],
)
def test_what_is_no_map_says_what_it_is(tmp_path, data, message):
    (tmp_path / "file").write_bytes(data)
    with pytest.raises(FileFormatError, match=message):
        datasets.read(tmp_path / "file")


def test_edges_of_one_pose_are_none_of_two(tmp_path):
    """Behind the pose of a gravity edge stands a direction, whose 0 is also the number of a keyframe."""
    gravity = "".join(f"EDGE_SE3_GRAVITY {i} 0 0 -1 9 0 0 9 0 9\n" for i in range(1, 3))
    dataset = read_text(tmp_path, SPATIAL + gravity)
    assert dataset.graph.size() == 2
    assert "ignored lines: 2 'EDGE_SE3_GRAVITY'" in dataset.notes


def test_points_seen_from_the_body_need_no_sensor(tmp_path):
    text = SPATIAL + f"VERTEX_XYZ 9 1 1 0\nEDGE_SE3_XYZ 0 9 1 1 0 {UPPER}\nEDGE_SE3_XYZ 2 9 -1 1 0 {UPPER}\n"
    dataset = read_text(tmp_path, text)
    assert dataset.graph.size() == 4
    np.testing.assert_allclose(dataset.values.atPoint3(gtsam.symbol("l", 9)), [1, 1, 0])
    assert dataset.graph.error(dataset.values) == pytest.approx(0.0, abs=1e-12)


def test_a_trajectory_is_in_the_order_of_time(tmp_path):
    dataset = read_text(tmp_path, "".join(f"{i}.5 {i} 0 0 0 0 0 1\n" for i in (2, 0, 3, 1)))
    assert [pose.x() for pose in poses_of(dataset.values).values()] == [0, 1, 2, 3]
    assert "lines are put in the order of time, and counted in it" in dataset.notes


def test_poses_may_be_whole_matrices(tmp_path):
    rows = [f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(3)]
    short, whole = (read_text(tmp_path, "".join(f"{row}{end}\n" for row in rows)) for end in ("", " 0 0 0 1"))
    assert (whole.format, short.format) == ("KITTI trajectory", "KITTI trajectory")
    assert whole.values.equals(short.values, 0.0)
