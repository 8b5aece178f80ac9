"""Labels and truth that lie beside a g2o file.

The KITTI graphs of dataset-RobustSLAM (Latif): ``kitti_06_alpha_0.15.g2o`` holds libviso2 odometry and the loops that
a detector reported, ``kitti_06_alpha_0.15_GT_LC.txt`` names the true closures, a pair of poses per line, and
``kitti_06_GT.g2o`` holds the ground-truth motion. In ``kitti_06_odom_GT_LC.g2o`` all loops are true. In the labelled
files of sequences 00, 06 and 07 a true loop measures a motion and a false loop exactly the identity: a comparison of
methods on these files must hide that from the methods. Other graphs come with ``NAME_ground_truth`` or
``NAME_groundtruth`` in the same folder.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from pgti_gtsam.datasets.chain import closure_slots
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.source import read_bytes, read_lines

LABELS = "_GT_LC"
DRIFTING = re.compile(r"^(.+)_(alpha_[\d.]+|odom|odom_GT_LC)$")  # names of files with odometry: sequence, kind


def with_labels(dataset: Dataset, path: Path) -> Dataset:
    """The dataset with the true closures, where a label file lies beside ``path`` or the file's name says so.

    Parameters
    ----------
    dataset : Dataset
    path : Path
        File of the dataset.

    Raises
    ------
    FileFormatError
        A label is no pair of identifiers.
    """
    name = DRIFTING.match(dataset.name)
    if name and name[2].endswith(LABELS):
        return replace(dataset, true_closures=frozenset(closure_slots(dataset)))
    labels = path.with_name(f"{dataset.name}{LABELS}.txt")
    if not labels.is_file():
        return dataset
    is_empty = not read_bytes(labels).strip()  # a sequence that never comes back has no true loop
    pairs = [] if is_empty else read_lines(labels).rows(ids=2, widths=[0]).ids.tolist()
    true = {frozenset(pair) for pair in pairs}  # the order of a pair says nothing
    ends = {slot: frozenset(dataset.graph.at(slot).keys()) for slot in closure_slots(dataset)}
    notes = [f"{labels.name} names the true closures", *_identity_note(dataset, ends)]
    if lost := len(true - set(ends.values())):
        notes.append(f"{lost} pairs in {labels.name} are no closure of the graph")
    return replace(
        dataset,
        true_closures=frozenset(slot for slot, pair in ends.items() if pair in true),
        notes=(*dataset.notes, *notes),
    )


def _identity_note(dataset: Dataset, closures: Iterable[int]) -> list[str]:
    factors: list[Any] = [dataset.graph.at(slot) for slot in closures]
    measured = [factor.measured().matrix() for factor in factors]
    count = sum(np.array_equal(matrix, np.eye(len(matrix))) for matrix in measured)
    return [f"{count} of {len(measured)} closures measure exactly the identity"] if count else []


def with_truth(dataset: Dataset, path: Path, read: Callable[[Path], Dataset]) -> Dataset:
    """The dataset with the ground-truth poses that ``read`` finds in a file beside ``path``, if any.

    Parameters
    ----------
    dataset : Dataset
    path : Path
        File of the dataset.
    read : callable
        Reader of the ground truth.
    """
    truth = next((other for other in _truth_paths(dataset.name, path) if other.is_file()), None)
    if truth is None:
        return dataset
    note = f"ground truth from {truth.name}"
    return replace(dataset, truth=gtsam.Values(read(truth).values), notes=(*dataset.notes, note))


def _truth_paths(name: str, path: Path) -> list[Path]:
    match = DRIFTING.match(name)
    names = [f"{match[1]}_GT"] if match else []
    names += [f"{name}_ground_truth", f"{name}_groundtruth"]
    return [path.with_name(other + path.name.removeprefix(name)) for other in names]
