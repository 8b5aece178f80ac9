"""A file or folder to be read, and the record of a format."""

from __future__ import annotations

import bz2
import gzip
import lzma
import zipfile
import zlib
from collections.abc import Callable, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any, NamedTuple

from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.text import TextFile, bare_name, joined, split_lines
from pgti_gtsam.errors import FileFormatError


def _only_member(path: Path) -> IO[bytes]:
    """The only file in a zip archive."""
    archive = zipfile.ZipFile(path)
    members = [info for info in archive.infolist() if not info.is_dir()]
    if len(members) != 1:
        raise FileFormatError(path, f"is a zip archive of {len(members)} files; unpack it and name the one to read")
    if members[0].flag_bits & 1:
        raise FileFormatError(path, "is a zip archive with a password; unpack it")
    return archive.open(members[0])


OPENERS: dict[bytes, Callable[[Path], Any]] = {
    b"\x1f\x8b": gzip.GzipFile,
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
    b"\x5d\x00\x00": lzma.LZMAFile,
    b"PK\x03\x04": _only_member,
}
HEAD = 4096  # bytes in which every format has named itself
STEP = 1 << 20  # bytes that are decompressed at a time

# The field's graphs shrink to a third, the most regular one to a twelfth (gzip). What unpacks to 200 times its size
# after the first 16 MB, or to more than 4 GB, is taken for a trap.
LARGEST_RATIO, FREE_BYTES, LARGEST_BYTES = 200, 1 << 24, 1 << 32


class Format(NamedTuple):
    """A file format: name for people, recognition of a source, reader, and companion files."""

    name: str
    recognises: Callable[[Source], bool]
    parse: Callable[[Source], Dataset]
    takes_values: bool = False
    takes_loops: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """A file or folder, each part read once and only on demand.

    Attributes
    ----------
    path : Path
    values : Path, optional
        A second file that holds the values of a graph.
    loops : Path, optional
        A second file that lists the loops of a trajectory.
    ignore_unknown : bool
        Lines that tie two variables in an unknown way are counted instead of refused.
    more : tuple of Path
        Further text files of the same map.
    """

    path: Path
    values: Path | None = None
    loops: Path | None = None
    ignore_unknown: bool = False
    more: tuple[Path, ...] = ()

    @property
    def name(self) -> str:
        """The name without the endings of format and compression."""
        return self.path.resolve().name if self.is_folder else bare_name(self.path)

    @cached_property
    def is_folder(self) -> bool:
        """Whether the path is a folder."""
        return self.path.is_dir()

    @cached_property
    def head(self) -> bytes:
        """The first bytes, decompressed; none of a folder."""
        return b"" if self.is_folder else read_bytes(self.path, HEAD)

    @cached_property
    def data(self) -> bytes:
        """All bytes, decompressed."""
        return read_bytes(self.path)

    @cached_property
    def is_text(self) -> bool:
        """Whether this is a file whose first bytes are text."""
        return not self.is_folder and b"\0" not in self.head

    @property
    def tags(self) -> Set[str]:
        """First fields of the lines; empty without text."""
        return self.file.tags.keys() if self.is_text else set()

    @property
    def first(self) -> list[str]:
        """Fields of the first line; empty without text."""
        return self.file.lines[0].fields if self.is_text and self.file.lines else []

    @cached_property
    def file(self) -> TextFile:
        """The lines.

        Raises
        ------
        FileFormatError
            The file is binary or empty. Bytes that are not UTF-8 become "�".
        """
        first = split_lines(self.path, read_text(self.path), ignore_unknown=self.ignore_unknown)
        return joined([first, *map(read_lines, self.more)]) if self.more else first

    def blank(self) -> TextFile:
        """No lines: a file that takes notes and names this source in errors where the source is no text."""
        return TextFile(path=self.path, lines=(), tags={}, title=self.name)

    def error(self, message: str) -> FileFormatError:
        """An error that names this source."""
        return FileFormatError(self.path, message)

    def beside(self, name: str) -> Path:
        """A file in this folder, or in the folder of this file."""
        return (self.path if self.is_folder else self.path.parent) / name


def read_lines(path: Path) -> TextFile:
    """The lines of a plain or compressed text file; raises as `read_text` does."""
    return split_lines(path, read_text(path))


def read_text(path: Path) -> str:
    """Text of a plain or compressed file.

    Raises
    ------
    FileFormatError
        The file cannot be read, is damaged, empty or binary. Bytes that are not UTF-8 become "�".
    """
    data = read_bytes(path)
    if b"\0" in data:
        raise FileFormatError(path, "is binary, expected text")
    text = data.decode("utf-8-sig", errors="replace")
    if not text or text.isspace():
        raise FileFormatError(path, "is empty")
    return text if "\n" in text else text.replace("\r", "\n")  # as old Macs and some instruments end their lines


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """The first ``limit`` bytes of a plain or compressed file, or all.

    Parameters
    ----------
    path : Path
    limit : int, optional
        Bytes to read; all without.

    Raises
    ------
    FileFormatError
        No such file, a folder, a damaged file, or a file that unpacks to more than any map holds.
    """
    try:
        # plain, as its first bytes tell
        with path.open("rb") as file:
            start = file.read(6)
            opener = next((opener for magic, opener in OPENERS.items() if start.startswith(magic)), None)
            if opener is None:
                return start + file.read(-1 if limit is None else max(0, limit - len(start)))

        # compressed
        with opener(path) as stream:
            return bytes(stream.read(limit)) if limit is not None else _unpacked(path, stream)

    # no such file, or a damaged file
    except IsADirectoryError:
        raise FileFormatError(path, "is a directory, expected a file") from None
    except FileNotFoundError:
        raise FileFormatError(path, "no such file") from None
    except (
        OSError,
        EOFError,
        ValueError,
        zlib.error,
        lzma.LZMAError,
        zipfile.BadZipFile,
        NotImplementedError,
    ) as error:
        raise FileFormatError(path, f"cannot be read: {error}") from error


def _unpacked(path: Path, stream: IO[bytes]) -> bytes:
    """All of a compressed stream, in pieces, within the limits."""
    allowed = min(LARGEST_BYTES, max(FREE_BYTES, LARGEST_RATIO * path.stat().st_size))
    unpacked = bytearray()
    while piece := stream.read(STEP):
        unpacked += piece
        if len(unpacked) > allowed:
            raise FileFormatError(path, f"unpacks to more than {allowed >> 20} MB, which no map does; unpack it first")
    return bytes(unpacked)
