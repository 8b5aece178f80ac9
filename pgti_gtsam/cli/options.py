"""Shared parts of the commands: options, reading, the check of outputs."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from pgti_gtsam import datasets
from pgti_gtsam.adapter import EDGE_SOURCES, MIN_SHARED_LANDMARKS
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.datasets.formats import FORMATS
from pgti_gtsam.dense_map import radii_from_cloud
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.plain_text import visible

READ_NOTES: ContextVar[tuple[str, ...]] = ContextVar("notes of the map that was read", default=())
KINDS = ", ".join(format.name for format in FORMATS)
File = Annotated[
    list[Path] | None,
    typer.Argument(help=f"Map, one of: {KINDS}. Default: KITTI 00 from GTSAM.", show_default=False),
]
Map = Annotated[list[Path], typer.Argument(help="Map with loop closures, of any kind that audit reads.")]
OneMap = Annotated[bool, typer.Option("--one-map", help="The files are sessions or robots of one map, in one frame.")]
Loops = Annotated[
    Path | None,
    typer.Option(help="Loops of a trajectory, one a line: two indices or timestamps, and the relative pose if known."),
]
IgnoreUnknown = Annotated[
    bool, typer.Option("--ignore-unknown", help="Leave out lines that tie two poses in an unknown way.")
]
Values = Annotated[
    Path | None, typer.Option("--values", help="Archive of the values, where FILE is an archived graph.")
]
Radius = Annotated[float | None, typer.Option(help="Free distance around every keyframe, in metres.")]
Cloud = Annotated[Path | None, typer.Option(help="Point cloud or mesh: radii are the distances to it (needs Open3D).")]
Edges = Annotated[
    str | None,
    typer.Option(
        help=f"What connects keyframes, from {','.join(EDGE_SOURCES)}. Default: the first two; "
        "all three where radii do not come from landmarks or no landmarks are shared."
    ),
]
MinShared = Annotated[
    int | None,
    typer.Option(
        help=f"Landmarks that two keyframes must share to be connected. Default: {MIN_SHARED_LANDMARKS}, "
        "or 1 where no two share so many."
    ),
]
Every = Annotated[int, typer.Option(help="Keep every so many-th pose as a keyframe, odometry composed; 1: all.")]
Beta = Annotated[float, typer.Option(help="Share of the time scales that counts as local.")]


CLOSED_PIPE = 141
"""Exit code where the reader of standard output left, as of a process that SIGPIPE ends."""


class Terminal(Console):
    """A console that ends quietly, with a code that is no verdict, where the reader of its output has left."""

    def on_broken_pipe(self) -> None:
        """End; further output is discarded."""
        discard_output()
        raise SystemExit(CLOSED_PIPE)


def discard_output() -> None:
    """Let the end of the process find a standard output that takes everything."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFiles:
    """The files of a map and how to read them; no file: the default map."""

    files: Sequence[Path] | None
    values: Path | None = None
    loops: Path | None = None
    one_map: bool = False
    ignore_unknown: bool = False

    def check_outputs(self, outputs: Iterable[Path | None], *inputs: Path | None) -> None:
        """Refuse outputs that cannot be written, that would overwrite an input, or each other."""
        check_outputs(outputs, [*(self.files or ()), self.values, self.loops, *inputs])

    def read(self) -> datasets.Dataset:
        """The dataset in the files.

        Raises
        ------
        InvalidOptionError
            Several files without --one-map.
        PgtiError
            Errors of reading.
        """
        files = self.files or ()
        if len(files) > 1 and not self.one_map:
            raise InvalidOptionError(f"expected one map, got {len(files)} files; if they are one map say --one-map")
        if self.one_map:
            return datasets.read_one_map(files, ignore_unknown=self.ignore_unknown)
        if not files:
            return datasets.builtin()
        return datasets.read(files[0], self.values, loops=self.loops, ignore_unknown=self.ignore_unknown)


def read_map(files: MapFiles, radius: float | None, cloud: Path | None, every: int = 1) -> tuple[datasets.Dataset, Any]:
    """The dataset of a file, thinned out on request, with its radii for `from_gtsam`.

    Parameters
    ----------
    files : MapFiles
    radius : float, optional
        Metres around every keyframe.
    cloud : Path, optional
        Point cloud or mesh from which radii are measured.
    every : int
        Keep every so many-th pose.

    Raises
    ------
    InvalidOptionError
        Both a radius and a cloud.
    PgtiError
        Errors of reading, of `subsample` and of `radii_from_cloud`.
    """
    dataset = datasets.subsample(files.read(), every)
    READ_NOTES.set(dataset.notes)
    if cloud is None:
        return dataset, radius if radius is not None else dataset.radii
    if radius is not None:
        raise InvalidOptionError("expected --radius or --cloud, got both")
    keyframes = read_keyframes(dataset.values)
    distances = radii_from_cloud(keyframes.positions, cloud)
    return dataset, dict(zip(keyframes.keys.tolist(), distances.tolist(), strict=True))


def terminal() -> Terminal:
    """Standard output, as all commands print to it."""
    return Terminal(highlight=False)


def print_paths(paths: Mapping[str, Path | None], console: Console) -> None:
    """Say where the requested files are.

    Parameters
    ----------
    paths : mapping
        Files by their name for people; None for files that were not asked for.
    console : Console
    """
    for what, path in paths.items():
        if path is not None:
            console.print(f"{what}: {visible(str(path))}", style="dim", markup=False, soft_wrap=True)


def split_names(names: str | None) -> tuple[str, ...] | None:
    """Names between commas."""
    return None if names is None else tuple(name.strip() for name in names.split(","))


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Refuse outputs that cannot be written, that would overwrite an input, or each other.

    Parameters
    ----------
    outputs, inputs : iterable
        Files to write, and files to read; None for options that were not given.
    """
    named, read = ([path for path in paths if path is not None] for paths in (outputs, inputs))
    for output in named:
        _check_output(output, read)
    for one, other in combinations(named, 2):
        if one.resolve() == other.resolve():
            raise InvalidOptionError(f"expected a file for each output, got {one} for two; name another file")


def _check_output(output: Path, inputs: list[Path]) -> None:
    if any(path.exists() and output.exists() and path.samefile(output) for path in inputs):
        raise InvalidOptionError(f"expected an output of its own, got the input {output}; name another file")
    if output.is_dir() or not output.parent.is_dir():
        raise InvalidOptionError(f"expected a file in an existing folder, got {output}")
    if not os.access(output if output.exists() else output.parent, os.W_OK):
        raise InvalidOptionError(f"expected a file that may be written, got {output}: permission denied")
