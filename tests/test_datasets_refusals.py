"""Odd files that are refused, or read with a note, without any file of others."""

import struct
import zipfile

import gtsam
import numpy as np
import pytest
from small_files import G2O_3D, PYFG, read_text
from test_datasets_models import Model, write_colmap

from pgti_gtsam import datasets
from pgti_gtsam.datasets import reader
from pgti_gtsam.errors import FileFormatError

LONG = "9" * 5000
UNIT = "1 0 0 1 0 1"
SPATIAL = " ".join("1" if i == j else "0" for i in range(6) for j in range(i, 6))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("num_submaps: x\n", "expected one line 'num_submaps: n'"),
        ("num_submaps: 1\nnum_submaps: 1\n", "expected one line 'num_submaps: n'"),
        ("num_submaps: 1000000000\nnum_all_frames: 3\n", "looks like a dump of GLIM without 000000/data.txt"),
        (f"num_submaps: {LONG}\nnum_all_frames: 3\n", "expected an identifier, a whole number below"),
        (f"2 1 {LONG}\n0 0 1.5 2.5\n", "expected an identifier, a whole number below"),
        ("1000000000 1 1\n0 0 1.5 2.5\n", "expected 1 observations, then 9000000003 numbers"),
        (f"EDGE_SE2 -{LONG} 1 1 0 0 {UNIT}\n", "expected an identifier, a whole number below"),
        ("name,x,y\na,1,2\n", "looks like a table with commas"),
        ("<graph/>\n", "looks like XML"),
        (f"EDGE_SE2_OFFSET 0 1 4 4 1 0 0 {UNIT}\n", "sensor offset 4 has no PARAMS_SE2OFFSET line"),
        (PYFG.replace("VERTEX_XY L0 2 2\n", "").replace("EDGE_SE2_XY", "# EDGE_SE2_XY"), "no sighting places it"),
    ],
)
def test_texts_that_are_refused(tmp_path, text, message):
    with pytest.raises(FileFormatError, match=message):
        read_text(tmp_path, text)


def test_an_edge_to_itself_is_left_out_and_noted(tmp_path):
    dataset = read_text(tmp_path, f"EDGE_SE2 0 1 1 0 0 {UNIT}\nEDGE_SE2 1 1 1 0 0 {UNIT}\n")
    assert dataset.graph.size() == 1
    assert "left out 1 edges from a vertex to itself (first on line 2)" in dataset.notes


def test_edges_that_measure_a_position_alone_are_noted(tmp_path):
    """Upper triangles of Λ: in the plane without the heading, in space without the rotation, which stands last."""
    planar = f"EDGE_SE2 0 1 1 0 0 {UNIT}\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 0\n"
    place = " ".join("1" if i == j < 3 else "0" for i in range(6) for j in range(i, 6))
    spatial = "".join(f"EDGE_SE3:QUAT {i} {i + 1} 1 0 0 0 0 0 1 {m}\n" for i, m in enumerate((SPATIAL, place)))
    for text, what in ((planar, "heading"), (spatial, "rotation")):
        notes = read_text(tmp_path, text).notes
        assert any(f"information says nothing of {what}: 1 edges" in note for note in notes)


def test_a_tag_with_an_orientation_becomes_a_landmark(tmp_path):
    """As RTAB-Map writes tags: a vertex behind the last keyframe that edges lead to and none leaves."""
    poses = [f"VERTEX_SE3:QUAT {i} {i} 0 0 0 0 0 1" for i in range(3)]
    edges = [f"EDGE_SE3:QUAT {i} {i + 1} 1 0 0 0 0 0 1 {SPATIAL}" for i in range(2)]
    tag = ["VERTEX_SE3:QUAT 9 1 2 0 0 0 0 1", *(f"EDGE_SE3:QUAT {i} 9 {1 - i} 2 0 0 0 0 1 {SPATIAL}" for i in range(2))]
    lines = ["PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1", *poses, *edges, *tag]
    dataset = read_text(tmp_path, "\n".join(lines) + "\n", "map.g2o")
    np.testing.assert_allclose(dataset.values.atPoint3(gtsam.symbol("l", 9)), [1, 2, 0], atol=1e-9)
    assert not dataset.values.exists(9)
    assert any("1 tags with an orientation are read as landmarks, in 2 sightings" in note for note in dataset.notes)
    assert "tags" not in str(read_text(tmp_path, G2O_3D).notes)


def test_a_model_without_its_points_and_a_model_with_strays(tmp_path):
    (tmp_path / "alone").mkdir()
    (tmp_path / "whole").mkdir()
    write_colmap(Model(), tmp_path / "whole", ".txt")
    text = (tmp_path / "whole" / "images.txt").read_text()
    (tmp_path / "alone" / "images.txt").write_text(text)
    with pytest.raises(FileFormatError, match=r"expected images.bin and points3D.bin"):
        datasets.read(tmp_path / "alone" / "images.txt")
    points = tmp_path / "whole" / "points3D.txt"
    points.write_text(points.read_text() + "99 0 0 5 9 9 9 0.5 3 0 77 0\n")
    notes = datasets.read(tmp_path / "whole").notes
    assert "1 sightings by keyframes or of points that the model does not hold are left out" in notes


def test_zip_archives_with_a_password_or_many_files_are_refused(tmp_path):
    path = tmp_path / "map.g2o.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.g2o", f"EDGE_SE2 0 1 1 0 0 {UNIT}\n")
    assert datasets.read(path).graph.size() == 1
    data = bytearray(path.read_bytes())
    for signature, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        struct.pack_into("<H", data, data.index(signature) + flags, 1)
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="is a zip archive with a password"):
        datasets.read(path)
    with zipfile.ZipFile(path, "w") as archive:
        for name in "ab":
            archive.writestr(f"{name}.g2o", "FIX 0\n")
    with pytest.raises(FileFormatError, match="is a zip archive of 2 files"):
        datasets.read(path)


def test_built_in_data_that_the_wheel_lacks_are_named(monkeypatch):
    monkeypatch.setitem(reader.BUILTIN, "w100", "no such file of GTSAM")
    with pytest.raises(FileFormatError, match="is not among the data of the installed GTSAM"):
        datasets.builtin("w100")
