"""Real false closures: KITTI with the loops that DLoopDetector reported, through the gate with its defaults.

Every fifth frame is a keyframe, as for the detector, and 4 m around each are assumed free, which suits the roads.
"""

from __future__ import annotations

import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.datasets import Dataset
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.estimate import optimised
from pgti_gtsam.factor_graphs import graph_of, keys_of, measured_from, slots_of
from scenarios.measures import trajectory_errors

EVERY, RADIUS_M = 5, 4.0
TRUE_ACCEPTED, FALSE_ACCEPTED = 0.98, 0.02
"""Least share of true and largest of false closures accepted with which a sequence passes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """The gate's answer on a file, or on all files of a sequence.

    `ate_m` is the absolute trajectory error against the ground truth after rigid alignment, `ate_only_true_m` that of
    the optimum with the true closures alone; None without ground truth.
    """

    file: str
    true: int
    true_accepted: int
    false: int
    false_accepted: int
    ate_m: float | None
    ate_only_true_m: float | None
    seconds: float

    @property
    def rates(self) -> dict[str, float]:
        """Shares accepted; without closures to accept, the shares of a faultless gate."""
        return {
            "true_accepted_rate": self.true_accepted / self.true if self.true else 1.0,
            "false_accepted_rate": self.false_accepted / self.false if self.false else 0.0,
        }

    @property
    def passes(self) -> bool:
        """Whether enough true and few enough false closures were accepted."""
        rates = self.rates
        return rates["true_accepted_rate"] >= TRUE_ACCEPTED and rates["false_accepted_rate"] <= FALSE_ACCEPTED


def run(
    data: Path,
    sequences: Sequence[str],
    alphas: Sequence[str],
    tell: Callable[[str], None],
    *,
    in_time_order: bool = False,
) -> dict[str, dict[str, Any]]:
    """Gate every labelled file of the sequences; counts and rates by sequence, its files below.

    In time order the counts are those after a last review.

    Parameters
    ----------
    data : Path
        Folder of the sequences.
    sequences : sequence of str
    alphas : sequence of str
        Detector thresholds, as in the files' names.
    tell : callable
        Called with a line of progress.
    in_time_order : bool
        Whether closures are gated as they come.
    """
    found = {}
    for sequence in sequences:
        # every file of the sequence
        rows = []
        for path in files(data, sequence, alphas):
            steps = driven(path) if in_time_order else (gated(path),)
            for row in steps:
                tell(_line(row))
            rows.append(steps[-1])

        # the sequence as a whole
        total = Row(
            file=sequence,
            **{name: sum(getattr(row, name) for row in rows) for name in _COUNTS},
            ate_m=_worst([row.ate_m for row in rows]),
            ate_only_true_m=_worst([row.ate_only_true_m for row in rows]),
        )
        found[sequence] = {
            **_record(total),
            "passes": total.passes,
            "files": [_record(row) | {"file": row.file} for row in rows],
        }
    return found


_COUNTS = ("true", "true_accepted", "false", "false_accepted", "seconds")


def files(data: Path, sequence: str, alphas: Sequence[str]) -> list[Path]:
    """Labelled files of a sequence, in the folder of the dataset or of all data.

    Parameters
    ----------
    data : Path
        Folder of the sequences.
    sequence : str
    alphas : sequence of str
        Detector thresholds, as in the files' names.

    Raises
    ------
    InvalidOptionError
        No file fits.
    """
    folders = [data / sequence, data / "kitti_robustslam" / sequence, data]
    pattern = re.compile(rf"kitti_{re.escape(sequence)}_alpha_(\d+\.?\d*)\.g2o(\.gz|\.bz2)?$")
    for folder in folders:
        matches = [(pattern.match(path.name), path) for path in sorted(folder.glob("kitti_*.g2o*"))]
        paths = [
            path
            for match, path in matches
            if match
            and (not alphas or match[1] in alphas)
            and (folder / f"{path.name.split('.g2o')[0]}_GT_LC.txt").is_file()
        ]
        if paths:
            return paths
    raise InvalidOptionError(
        f"expected kitti_{sequence}_alpha_*.g2o{' with alpha ' + ', '.join(alphas) if alphas else ''} and its "
        f"_GT_LC.txt in one of {', '.join(map(str, folders))}, got none; --data names the folder of the sequences"
    )


def gated(path: Path) -> Row:
    """Gate a file with its labels."""
    dataset = _read(path)
    closures = datasets.closure_slots(dataset)
    started = time.process_time()
    result = pgti.gate_graph(dataset.graph, dataset.values, radii=RADIUS_M, closures=closures)
    seconds = time.process_time() - started
    return _row(path.name, dataset, set(result.accepted), result.values, seconds)


def driven(path: Path) -> tuple[Row, Row]:
    """Gate a file in time order, by a gated smoother: the verdicts at the end, and after a last review."""
    # what every keyframe brings
    dataset = _read(path)
    closures, brought = set(datasets.closure_slots(dataset)), defaultdict(list)
    for slot, factor in slots_of(dataset.graph):
        brought[max(keys_of(factor))].append((slot, factor))

    # in time order, from where the smoother has the keyframe before
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    smoother, slot_of = pgti.GatedISAM2(parameters, radii=RADIUS_M), {}
    started = time.process_time()
    for key in sorted(dataset.values.keys()):
        odometry = [factor for slot, factor in brought[key] if slot not in closures]
        offered = [(slot, factor) for slot, factor in brought[key] if slot in closures]
        values = gtsam.Values()
        values.insert(key, _predicted(smoother, odometry, dataset.values, key))
        if not smoother.estimate().size():
            odometry.append(gtsam.PriorFactorPose2(key, values.atPose2(key), gtsam.noiseModel.Unit.Create(3)))
        update = smoother.update(graph_of(odometry), values, [factor for _, factor in offered])
        slot_of |= dict(zip(update.closures, [slot for slot, _ in offered], strict=True))

    # all of them once more, as a whole
    found = []
    for what in ("as they come", "after a review"):
        if found:
            smoother.revise(smoother.review_afresh())
        accepted = {slot_of[number] for number in smoother.admitted}
        seconds = time.process_time() - started
        found.append(_row(f"{path.name}, {what}", dataset, accepted, smoother.estimate(), seconds))
    return found[0], found[1]


def _predicted(smoother: pgti.GatedISAM2, odometry: list[Any], values: gtsam.Values, key: int) -> gtsam.Pose2:
    """Pose of a keyframe by the step from the keyframe before; the file's pose for the first."""
    for factor in odometry:
        before = min(keys_of(factor))
        return smoother.calculateEstimatePose2(before).compose(measured_from(factor, before))
    return values.atPose2(key)


def _read(path: Path) -> Dataset:
    """Every fifth frame, or all frames where some loops lie between."""
    dataset = datasets.read(path)
    kept = datasets.subsample(dataset, EVERY)
    return kept if len(datasets.closure_slots(kept)) == len(datasets.closure_slots(dataset)) else dataset


def _row(name: str, dataset: Dataset, accepted: set[int], values: gtsam.Values, seconds: float) -> Row:
    closures, true = set(datasets.closure_slots(dataset)), set(dataset.true_closures or ())
    only_true = gtsam.NonlinearFactorGraph(dataset.graph)
    for slot in closures - true:
        only_true.remove(slot)
    return Row(
        file=name,
        true=len(true),
        true_accepted=len(true & accepted),
        false=len(closures - true),
        false_accepted=len(accepted - true),
        ate_m=_ate_m(dataset, values),
        ate_only_true_m=_ate_m(dataset, optimised(only_true, values)),
        seconds=seconds,
    )


def _ate_m(dataset: Dataset, values: gtsam.Values) -> float | None:
    if dataset.truth is None:
        return None
    keys = [key for key in dataset.truth.keys() if values.exists(key)]  # noqa: SIM118
    return trajectory_errors(*([poses.atPose2(key) for key in keys] for poses in (dataset.truth, values)))["ate_m"]


def _worst(errors: list[float | None]) -> float | None:
    known = [error for error in errors if error is not None]
    return float(np.max(known)) if known else None


def _record(row: Row) -> dict[str, Any]:
    return {**asdict(row), **row.rates}


def _line(row: Row) -> str:
    error = "" if row.ate_m is None else f"  error {row.ate_m:6.2f} m, with only true ones {row.ate_only_true_m:6.2f} m"
    return (
        f"{row.file:44s} true {row.true_accepted:4d} of {row.true:4d}  false {row.false_accepted:4d} of {row.false:4d}"
        f"{error}  {row.seconds:6.1f} s"
    )


def lines(found: dict[str, dict[str, Any]]) -> Iterator[str]:
    """A line for each sequence."""
    for sequence, row in found.items():
        yield (
            f"{sequence}: {row['true_accepted']} of {row['true']} true and {row['false_accepted']} of {row['false']} "
            f"false closures accepted: {'passes' if row['passes'] else 'fails'}"
        )
