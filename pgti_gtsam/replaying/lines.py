"""A replay as JSON lines: the replayed graph first, then a line a moment, so that a stopped run goes on."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam import encode
from pgti_gtsam.errors import FileFormatError
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.replaying.moment import Measure, Moment

_ARRAYS = ("keyframe_scores", "positions")


def heading(pose_graphs: Iterable[PoseGraph], sizes: Sequence[int], measure: Measure) -> dict[str, Any]:
    """The first line: the format, how the graph is measured, and a digest of the graphs and of the moments' sizes.

    Parameters
    ----------
    pose_graphs : iterable of PoseGraph
    sizes : sequence of int
        Keyframes at each moment.
    measure : Measure
    """
    digest = hashlib.sha256(np.array(sizes, dtype=np.int64).tobytes())
    for each in pose_graphs:
        for array in (each.keys, each.positions, each.radii, each.edges, each.edge_sources):
            digest.update(np.ascontiguousarray(array).tobytes())
    return {
        **encode.heading("replay"),
        "digest": digest.hexdigest(),
        "measure": asdict(measure),
    }


def known_moments(path: Path | None, first: Mapping[str, Any]) -> list[Moment]:
    """Moments that a file holds, from the first on; empty without a file.

    A last line that was cut off when the run was stopped is cut from the file.

    Parameters
    ----------
    path : Path, optional
    first : mapping
        The first line, as `heading` makes it.

    Raises
    ------
    FileFormatError
        The file is of another map, measured otherwise, or no replay.
    """
    if path is None or not path.is_file():
        return []
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole != len(data):
        os.truncate(path, whole)
    try:
        rows = [json.loads(line) for line in data[:whole].splitlines()]
    except ValueError as error:
        raise FileFormatError(path, f"expected a JSON object a line, got {error}; name another file") from error
    if rows and rows[0] != first:
        raise FileFormatError(path, "expected a replay of this map with these options, got another; name another file")
    try:
        return [_moment(row) for row in rows[1:]]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            path, f"expected a moment a line, got another object ({error}); name another file"
        ) from error


@contextmanager
def appended(path: Path | None, first: Mapping[str, Any]) -> Iterator[Callable[[Moment], None]]:
    """A function that adds a moment to the file, which begins with the first line; without a file nothing is done.

    Parameters
    ----------
    path : Path, optional
    first : mapping
        The first line, as `heading` makes it.
    """
    if path is None:
        yield lambda moment: None
        return
    with path.open("a", encoding="utf-8") as file:
        if file.tell() == 0:
            file.write(encode.line(first))

        def add(moment: Moment) -> None:
            file.write(line(moment))
            file.flush()

        yield add


def line(moment: Moment) -> str:
    """A moment as a line of JSON."""
    row = {each.name: getattr(moment, each.name) for each in fields(Moment) if each.name not in _ARRAYS}
    row = {name: encode.number(value) for name, value in row.items()}
    return encode.line(row | {name: packed(getattr(moment, name)) for name in _ARRAYS})


def packed(array: NDArray[np.float32]) -> str:
    """Little-endian single precision in base64."""
    return base64.b64encode(np.ascontiguousarray(array, dtype="<f4").tobytes()).decode()


def _moment(row: Mapping[str, Any]) -> Moment:
    numbers = {name: value for name, value in row.items() if name not in _ARRAYS}
    values: dict[str, Any] = {
        name: value if isinstance(value, int) else encode.decoded(value) for name, value in numbers.items()
    }
    scores, positions = (np.frombuffer(base64.b64decode(row[name]), dtype="<f4").copy() for name in _ARRAYS)
    return Moment(**values | {"keyframe_scores": scores, "positions": positions.reshape(-1, 3)})
