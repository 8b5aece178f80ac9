"""Files that cannot be read: the likely format, and the export that helps."""

from __future__ import annotations

from typing import NamedTuple, NoReturn

from pgti_gtsam.datasets.source import Source
from pgti_gtsam.datasets.text import TextFile, is_number, quote

LOOPS = "and their loop closures as a list for --loops"
BESIDE = "; expected the VO_stereo_factors file beside it"
ENDINGS = {  # Boost archives name no class in their first bytes
    ".osa": "an atlas of ORB-SLAM3 (.osa), which is not read; call SaveKeyFrameTrajectoryTUM",
    ".posegraph": "a pose graph of slam_toolbox (.posegraph), which is not read; write its poses as TUM, " + LOOPS,
}
TABLES = {6: "looks like KITTI calibration" + BESIDE, 17: "looks like KITTI camera poses" + BESIDE}


class Foreign(NamedTuple):
    """The format of a file with these bytes in its head, at the start or anywhere, and what to do about it."""

    signature: bytes
    at_start: bool
    name: str
    advice: str


FOREIGN = (
    Foreign(
        b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b",
        True,
        "a Cartographer state (.pbstream)",
        "write its constraints as g2o, or its nodes as a TUM trajectory " + LOOPS,
    ),
    Foreign(
        b"CSimpleMap",
        False,
        "an MRPT simple map (.simplemap)",
        "run `sm-cli export-keyframes` of MOLA, which writes a TUM trajectory",
    ),
    Foreign(b"#ROSBAG", True, "a ROS bag", "run the SLAM program on it and give its map"),
    Foreign(b"\x89MCAP0", True, "an MCAP recording", "run the SLAM program on it and give its map"),
    Foreign(b"# .PCD", True, "a point cloud (PCD)", "give the pose graph here, and the cloud as --cloud"),
    Foreign(b"ply\n", True, "a point cloud or mesh (PLY)", "give the pose graph here, and the cloud as --cloud"),
    Foreign(b"ply\r", True, "a point cloud or mesh (PLY)", "give the pose graph here, and the cloud as --cloud"),
    Foreign(b"LASF", True, "a point cloud (LAS)", "give the pose graph here, and the cloud as --cloud in PLY"),
    Foreign(b"ASTM-E57", True, "a point cloud (E57)", "give the pose graph here, and the cloud as --cloud in PLY"),
    Foreign(b"ustar", False, "a tar archive", "unpack it and name the file in it"),
    Foreign(b"7z\xbc\xaf\x27\x1c", True, "a 7z archive", "unpack it and name the file in it"),
    Foreign(b"Rar!", True, "a RAR archive", "unpack it and name the file in it"),
    Foreign(b"\x28\xb5\x2f\xfd", True, "a file packed by Zstandard", "unpack it first"),
    Foreign(b"\xff\xfe", True, "text in UTF-16", "save it as UTF-8"),
    Foreign(b"\xfe\xff", True, "text in UTF-16", "save it as UTF-8"),
    Foreign(b"version https://git-lfs", True, "a pointer of Git LFS in place of the file", "run `git lfs pull`"),
    Foreign(b"<!DOCTYPE html", True, "a web page", "the download went wrong: fetch the file itself"),
    Foreign(b"<html", True, "a web page", "the download went wrong: fetch the file itself"),
    Foreign(b"\x89PNG", True, "a picture", "give the pose graph"),
    Foreign(b"\xff\xd8\xff", True, "a picture", "give the pose graph"),
    Foreign(b"%PDF", True, "a PDF document", "give the pose graph"),
    Foreign(b"\x89HDF", True, "an HDF5 file", "write the graph as g2o, or its poses as a TUM trajectory"),
    Foreign(b"\x93NUMPY", True, "a NumPy array", "write the graph as g2o, or its poses as a TUM trajectory"),
    *(
        Foreign(b"\x80" + bytes([protocol]), True, "a Python pickle", "write graph.serialize() and values.serialize()")
        for protocol in range(2, 6)
    ),
)


def refuse(source: Source) -> NoReturn:
    """Name the likely format of a source that no reader recognises.

    Raises
    ------
    FileFormatError
        Always.
    """
    if source.is_folder:
        raise source.error("is a directory that holds no map; name the file in it")
    if source.path.suffix in ENDINGS:
        raise source.error(f"looks like {ENDINGS[source.path.suffix]}")
    for foreign in FOREIGN:
        if source.head.startswith(foreign.signature) if foreign.at_start else foreign.signature in source.head:
            raise source.error(f"looks like {foreign.name}, which is not read; {foreign.advice}")
    raise source.error(_text(source.file) if source.is_text else "is binary, of no format that is read")


def _text(file: TextFile) -> str:
    """The likely format of a text file."""
    if not file.lines:
        return "holds nothing but comments; expected a map, as g2o for instance"
    first = file.lines[0].text
    if first[0] in "{[<":
        kind = "XML" if first[0] == "<" else "JSON"
        return f"looks like {kind}, which is not read; write the graph as g2o, or its poses as a TUM trajectory"
    if "," in first:
        return "looks like a table with commas; a trajectory is 'timestamp x y z qx qy qz qw' with blanks (TUM)"
    if all(map(is_number, first.split())):
        width = len(first.split())
        unknown = f"is a table of {width} numbers, which is no known format; a TUM trajectory has 8, KITTI's 12"
        return TABLES.get(width, unknown)
    if is_number(first.split()[0]):
        word = next(word for word in first.split() if not is_number(word))
        return f"looks like a table of numbers, but holds {quote(word)} on line {file.lines[0].number}"
    shown = ", ".join(quote(tag, 20) for tag in list(file.tags)[:3])
    return f"is of no known format: its lines start with {shown}; expected a map, as g2o for instance"
