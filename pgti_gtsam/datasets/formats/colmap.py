"""COLMAP sparse models, binary or text: the poses of ``images`` and the tracks of ``points3D``.

The path names the folder (or a folder above ``sparse/0``) or either file. A pose is a quaternion w, x, y, z and a
translation from world to camera. Images need not be in the order of time: only covisibility ties the images.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import Format, Source, read_bytes, read_lines, read_text
from pgti_gtsam.datasets.sparse_model import sparse_model
from pgti_gtsam.datasets.text import MAX_ID, Line, TextFile, parse_numbers
from pgti_gtsam.errors import FileFormatError

NAME = "COLMAP sparse model"
IMAGE = struct.Struct("<i7di")
POINT = struct.Struct("<Q3d3BdQ")
NO_POINT = "expected images.bin and points3D.bin, or both as .txt, side by side"


class Points(NamedTuple):
    """Positions by identifier, and the pairs (image, point) of all tracks."""

    places: dict[int, NDArray[np.float64]]
    seen: NDArray[np.int64]


def parse(source: Source) -> Dataset:
    """Keyframes, points and sightings of a model, at the model's own scale.

    Raises
    ------
    FileFormatError
        A file is missing, cut off or malformed, or no image sees a point.
    """
    folder, ending = _model(source)
    images, points = folder / f"images{ending}", folder / f"points3D{ending}"
    if not points.is_file():
        raise source.error(NO_POINT)
    poses = _binary_images(images) if ending == ".bin" else _text_images(images)
    model = _binary_points(points) if ending == ".bin" else _text_points(read_lines(points))
    dataset = sparse_model(source, format=NAME, poses=poses, points=model.places, seen=model.seen)
    return dataset if source.is_folder else replace(dataset, name=folder.resolve().name)


def _binary_images(path: Path) -> dict[int, gtsam.Pose3]:
    data, poses, at = read_bytes(path), {}, 8
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            number, *pose, _ = IMAGE.unpack_from(data, at)
            at = data.index(b"\0", at + IMAGE.size) + 1
            at += 8 + 24 * struct.unpack_from("<Q", data, at)[0]
            poses[number] = _camera(pose)
    except (struct.error, ValueError, OverflowError):
        raise FileFormatError(path, f"is cut off or no images.bin of COLMAP, at byte {at}") from None
    if at > len(data):
        raise FileFormatError(path, f"is cut off: expected {at} bytes, got {len(data)}")
    return poses


def _binary_points(path: Path) -> Points:
    data, places, tracks, at = read_bytes(path), {}, [], 8
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            number, x, y, z, *_, length = POINT.unpack_from(data, at)
            images = np.frombuffer(data, "<i4", count=2 * length, offset=at + POINT.size)[::2]
            at += POINT.size + 8 * length
            places[number] = np.array([x, y, z])
            tracks.append(np.stack([images.astype(np.int64), np.full(length, number, np.int64)], axis=1))
    except (struct.error, ValueError, OverflowError):
        raise FileFormatError(path, f"is cut off or no points3D.bin of COLMAP, at byte {at}") from None
    return Points(places, np.concatenate([np.empty((0, 2), np.int64), *tracks]))


def _text_images(path: Path) -> dict[int, gtsam.Pose3]:
    """Every other line is a pose; the lines between, possibly empty, hold the pixels."""
    numbered = enumerate(read_text(path).split("\n"), 1)
    lines = [Line(number, text) for number, text in numbered if not text.startswith("#")]
    file, poses = TextFile(path=path, lines=(), tags={}), {}
    for line in lines[::2]:
        fields = line.fields
        if fields:
            if len(fields) < 10 or not fields[0].isdecimal():
                raise file.error("expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", line.number)
            try:
                poses[int(fields[0])] = _camera(parse_numbers(file, line, fields[1:8]))
            except ValueError:
                raise file.error("expected a unit quaternion QW QX QY QZ behind IMAGE_ID", line.number) from None
    return poses


def _text_points(file: TextFile) -> Points:
    places, tracks = {}, []
    for line in file.lines:
        numbers = parse_numbers(file, line, line.fields)
        if len(numbers) < 8 or len(numbers) % 2:
            raise file.error("expected POINT3D_ID X Y Z R G B ERROR and pairs IMAGE_ID POINT2D_IDX", line.number)
        if max(map(abs, (numbers[0], *numbers[8::2]))) > MAX_ID:
            raise file.error("expected POINT3D_ID and each IMAGE_ID below 2**63", line.number)
        places[int(numbers[0])] = np.array(numbers[1:4])
        tracks += [(int(image), int(numbers[0])) for image in numbers[8::2]]
    return Points(places, np.array(tracks, np.int64).reshape(-1, 2))


def _camera(numbers: list[float]) -> gtsam.Pose3:
    """Camera to world."""
    w, x, y, z, *translation = numbers
    norm = float(np.linalg.norm([w, x, y, z]))
    if not 0.5 < norm < 2.0 or not np.isfinite(translation).all():
        raise ValueError("no unit quaternion")
    rotation = gtsam.Rot3.Quaternion(w / norm, x / norm, y / norm, z / norm)
    return gtsam.Pose3(rotation, np.array(translation)).inverse()


def _model(source: Source) -> tuple[Path, str]:
    """Folder and ending of a model; an empty ending where no model is."""
    below = (".", "0", "sparse", "sparse/0")
    folders = [source.path / name for name in below] if source.is_folder else [source.path.parent]
    if not source.is_folder and source.path.stem not in ("images", "points3D"):
        return source.path, ""
    found = [
        (folder, ending) for folder in folders for ending in (".bin", ".txt") if (folder / f"images{ending}").is_file()
    ]
    preferred = [model for model in found if source.is_folder or model[1] == source.path.suffix]
    return preferred[0] if preferred else (source.path, "")


FORMAT = Format(NAME, lambda source: bool(_model(source)[1]), parse)
