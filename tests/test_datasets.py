"""Any file: its format is found from its content, and whatever is wrong with it is said in one sentence."""

import bz2
import gzip
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_files import BAL, CARMEN, CHAIN, FLIRTLIB, G2O, KITTI, PYFG, TEXTS, TORO, TUM, VICTORIA, read_text

from pgti_gtsam import datasets
from pgti_gtsam.datasets import formats
from pgti_gtsam.errors import FileFormatError, InvalidOptionError, PgtiError


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (G2O, "g2o"),
        (TORO, "TORO graph"),
        (VICTORIA, "Victoria Park"),
        (FLIRTLIB, "FLIRTLib scan graph"),
        (CARMEN, "CARMEN log"),
        (PYFG, "PyFG graph"),
        (TUM, "TUM trajectory"),
        (KITTI, "KITTI trajectory"),
        (BAL, "BAL problem"),
    ],
)
@pytest.mark.parametrize("ending", ["g2o", "graph", "log", "nothing"])
def test_the_content_tells_the_format_whatever_the_ending(tmp_path, text, name, ending):
    dataset = read_text(tmp_path, text, f"map.{ending}")
    assert (dataset.name, dataset.format) == ("map", name)


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_every_variable_of_every_factor_has_a_value(tmp_path, text):
    dataset = read_text(tmp_path, text)
    assert set(dataset.graph.keyVector()) <= set(dataset.values.keys())
    assert all(dataset.graph.exists(slot) for slot in datasets.closure_slots(dataset))
    assert not any("Prior" in type(dataset.graph.at(slot)).__name__ for slot in range(dataset.graph.size()))


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_line_ends_comments_and_empty_lines_change_nothing(tmp_path, text):
    plain = read_text(tmp_path, text)
    decorated = "\ufeff# a comment\r\n\r\n" + text.replace("\n", " \t\r\n") + "\n\n"
    other = read_text(tmp_path, decorated)
    assert other.graph.equals(plain.graph, 1e-12)
    assert other.values.equals(plain.values, 1e-12)


@pytest.mark.parametrize(("compress", "ending"), [(gzip.compress, "gz"), (bz2.compress, "bz2")])
def test_compressed_files_are_read_as_they_are(tmp_path, compress, ending):
    path = tmp_path / f"map.g2o.{ending}"
    path.write_bytes(compress(G2O.encode()))
    dataset = datasets.read(path)
    assert dataset.name == "map"
    assert dataset.graph.equals(read_text(tmp_path, G2O).graph, 1e-12)
    path.write_bytes(compress(G2O.encode())[:-9])
    with pytest.raises(FileFormatError, match="cannot be read"):
        datasets.read(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b" \n\n", "is empty"),
        (b"# only\n# comments\n", "nothing but comments"),
        (bytes(range(256)) * 4, "is binary"),
        ("EDGE_SE2 0 1".encode("utf-16"), "in UTF-16, which is not read; save it as UTF-8"),
        (b"once upon a time\nthere was a map\n", "no known format"),
        (b"1.5 2.5 3.5\n", "a table of 3 numbers"),
        (b"\xfa\xff\xfe no text\n", "no known format"),
        (b"FIX 0\n", "no known format"),
    ],
)
def test_other_content_is_refused(tmp_path, content, message):
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=message):
        datasets.read(path)


def test_a_missing_file_and_a_directory_are_named(tmp_path):
    with pytest.raises(FileFormatError, match="no such file"):
        datasets.read(tmp_path / "absent.g2o")
    with pytest.raises(FileFormatError, match="is a directory"):
        datasets.read(tmp_path)


def test_broken_bytes_in_a_comment_do_no_harm(tmp_path):
    path = tmp_path / "map.g2o"
    path.write_bytes(b"# Stra\xdfe\n" + G2O.encode())
    assert datasets.read(path).graph.size() == 5


def test_unknown_lines_are_counted_by_tag(tmp_path):
    dataset = read_text(tmp_path, CHAIN + "FOO 1\n" * 12 + "<script>alert(1)</script> 2\n")
    (note,) = [note for note in dataset.notes if note.startswith("ignored")]
    assert "12 'FOO'" in note
    assert "1 '<script>alert(1)</script>'" in note


def test_many_unknown_tags_stay_one_short_sentence(tmp_path):
    dataset = read_text(tmp_path, CHAIN + "".join(f"TAG{i:050} 1\n" for i in range(1000)))
    (note,) = [note for note in dataset.notes if note.startswith("ignored")]
    assert "992 with 992 other tags" in note
    assert len(note) < 600


def test_values_belong_to_archives_only(tmp_path):
    path = tmp_path / "map.g2o"
    path.write_text(G2O)
    with pytest.raises(FileFormatError, match="leave the file of values out"):
        datasets.read(path, path)


def test_records_cannot_be_changed(tmp_path):
    dataset = read_text(tmp_path, FLIRTLIB)
    with pytest.raises(AttributeError):
        dataset.name = "other"
    with pytest.raises(TypeError):
        dataset.radii[0] = 1.0


@pytest.mark.parametrize("name", [name for name in datasets.BUILTIN if name not in {"kitti00", "w10000"}])
def test_the_data_of_the_wheel_come_by_name(name):
    dataset = datasets.builtin(name)
    assert dataset.name == name
    assert set(dataset.graph.keyVector()) == set(dataset.values.keys())


def test_another_name_is_refused_with_the_list():
    with pytest.raises(InvalidOptionError, match="kitti00, victoria_park"):
        datasets.builtin("<b>kitti99</b>")


JUNK = ["nan", "inf", "1e400", "1e99", "1e-320", "x", "1_0", "-1", "0", "99999999999999999999", "½", "<b>", "0x10"]
CHANGES = ["replace", "drop field", "add field", "drop line", "repeat line", "cut", "swap"]


@st.composite
def damaged(draw):
    """A small file with a few fields, lines or its end changed."""
    lines = [line.split(" ") for line in draw(st.sampled_from(list(TEXTS.values()))).splitlines()]
    for _ in range(draw(st.integers(1, 3))):
        i = draw(st.integers(0, len(lines) - 1))
        j = draw(st.integers(0, len(lines[i]) - 1)) if lines[i] else 0
        change = draw(st.sampled_from(CHANGES))
        if change == "replace" and lines[i]:
            lines[i][j] = draw(st.sampled_from(JUNK) | st.text(max_size=5))
        elif change == "drop field":
            lines[i] = lines[i][:j] + lines[i][j + 1 :]
        elif change == "add field":
            lines[i] = [*lines[i][:j], draw(st.sampled_from(JUNK)), *lines[i][j:]]
        elif change == "drop line" and len(lines) > 1:
            del lines[i]
        elif change == "repeat line":
            lines.append(lines[i])
        elif change == "cut":
            lines = [*lines[:i], lines[i][:j]]
        elif change == "swap":
            lines[0], lines[i] = lines[i], lines[0]
    return "\n".join(" ".join(fields) for fields in lines)


@settings(derandomize=True, deadline=None, max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(text=damaged())
def test_a_damaged_file_is_read_or_refused_but_never_crashes(tmp_path_factory, text):
    folder = tmp_path_factory.getbasetemp()
    try:
        dataset = read_text(folder, text, "damaged.txt")
    except PgtiError as error:
        message = str(error)
    else:
        message = ""
        assert set(dataset.graph.keyVector()) <= set(dataset.values.keys())
    assert "\n" not in message
    assert len(message) < 600 + len(str(folder))


def test_every_format_is_one_short_module():
    folder = Path(formats.__file__).parent
    lengths = {path.name: path.read_text(encoding="utf-8").count("\n") for path in folder.glob("*.py")}
    assert max(lengths.values()) <= 150, lengths
    assert len({format.name for format in formats.FORMATS}) == len(formats.FORMATS)
