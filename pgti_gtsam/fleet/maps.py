"""The maps that are meant: files, and maps in folders."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from pgti_gtsam.datasets import is_map
from pgti_gtsam.errors import InvalidOptionError


def maps_in(paths: Iterable[Path]) -> tuple[list[Path], list[Path]]:
    """Files unchanged, and from each folder the maps that a reader recognises; each once.

    Returns
    -------
    maps : list of Path
    others : list of Path
        Files in the folders that no reader takes for a map, hidden ones left out.

    Raises
    ------
    InvalidOptionError
        A path that does not exist, or folders without any map.
    """
    found: dict[Path, bool] = {}
    for path in paths:
        if not path.exists():
            raise InvalidOptionError(f"expected maps or folders of maps, got {path}, which does not exist")
        found |= dict(_inside(path)) if path.is_dir() else {path: True}
    maps = [path for path, known in found.items() if known]
    if not maps:
        raise InvalidOptionError("expected at least one map, got folders in which no reader finds one")
    return maps, [path for path, known in found.items() if not known]


def _inside(folder: Path) -> Iterator[tuple[Path, bool]]:
    """A folder that is a map by itself, else the files in it and in the folders below, and whether each is a map."""
    if is_map(folder):
        yield folder, True
        return
    for each in sorted(folder.iterdir()):
        if each.name.startswith("."):
            continue
        if each.is_dir():
            yield from _inside(each)
        else:
            yield each, each.is_file() and is_map(each)  # a pipe is none, and reading from one may never end
