"""Factors as lines of text files: tag, keys, numbers, and a count of factors that the format cannot hold.

A format says of every class of factors that it knows which numbers stand behind the identifiers (`Part`). What it does
not know is counted, never dropped silently, and so is noise that has no information matrix.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.losses import loss_comment, loss_words
from pgti_gtsam.datasets.noise import ROTATION_FIRST
from pgti_gtsam.datasets.text import LARGEST
from pgti_gtsam.errors import InvalidValueError, MissingValueError
from pgti_gtsam.pose_graph import key_label

Numbers = NDArray[np.float64]
TRANSLATION_FIRST = np.argsort(ROTATION_FIRST)


class Part(NamedTuple):
    """How a format writes a class of factors: tag, further identifiers, and the numbers behind them.

    The numbers are made of the factor and the information in GTSAM's tangent space; numbers that are not finite say
    that the format cannot hold the factor.
    """

    tag: str
    parameters: tuple[int, ...]
    numbers: Callable[[Any, Numbers], Numbers]


class EdgeLine(NamedTuple):
    """A factor as a line, and the words of its robust loss."""

    tag: str
    keys: list[int]
    parameters: tuple[int, ...]
    numbers: Numbers
    loss: list[str]

    def lines(self, names: Mapping[int, object], time: str | None = None) -> list[str]:
        """The line under these names of the variables, behind a comment with the loss, if any.

        Parameters
        ----------
        names : mapping
            Names of the variables in the file, by key.
        time : str, optional
            Timestamp of the line, in formats with timestamps.
        """
        ids = [names[key] for key in self.keys] + list(self.parameters)
        head = [self.tag, *([] if time is None else [time])]
        line = " ".join([*head, *map(str, ids), number_text(self.numbers)])
        return [loss_comment(ids, self.loss), line] if self.loss else [line]


def edge_lines(graph: gtsam.NonlinearFactorGraph, parts: Mapping[str, Part]) -> tuple[list[EdgeLine], Counter[str]]:
    """The lines that a format can hold, by slot, and the count of other factors, by class.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    parts : mapping
        How the format writes each class of factors, by class name.
    """
    edges, unwritten = [], Counter[str]()
    for slot in range(graph.size()):
        factor = graph.at(slot)
        if factor is None:
            continue
        name, edge = type(factor).__name__, None
        if name in parts:
            edge = _edge(parts[name], factor)
            name += "" if edge else " with a noise model or a measurement that the format has no word for"
        if edge:
            edges.append(edge)
        else:
            unwritten[name] += 1
    return edges, unwritten


def _edge(part: Part, factor: Any) -> EdgeLine | None:
    """The line of a factor; None where the noise or measurement cannot be written."""
    model, loss = factor.noiseModel(), list[str]()
    if isinstance(model, gtsam.noiseModel.Robust):
        loss, model = loss_words(model.robust()), model.noise() if loss_words(model.robust()) else None
    if not isinstance(model, gtsam.noiseModel.Gaussian) or model.isConstrained():
        return None
    numbers = part.numbers(factor, np.asarray(model.information()))
    if not (np.abs(numbers) <= LARGEST).all():  # false of NaN too
        return None
    return EdgeLine(part.tag, list(factor.keys()), part.parameters, numbers, loss)


def check_known(edges: Iterable[EdgeLine], known: Collection[int]) -> None:
    """Refuse a factor of a key without a value.

    Parameters
    ----------
    edges : iterable of EdgeLine
    known : collection of int
        Keys with a value.

    Raises
    ------
    MissingValueError
    """
    missing = next((key for edge in edges for key in edge.keys if key not in known), None)
    if missing is not None:
        raise MissingValueError(
            f"expected a value for every key, got none for {key_label(missing)}; add it or remove its factors"
        )


def checked_numbers(key: int, numbers: Numbers) -> Numbers:
    """The numbers of a vertex.

    Parameters
    ----------
    key : int
        Named in the error.
    numbers : Numbers

    Raises
    ------
    InvalidValueError
        A number is not finite, or beyond 1e30.
    """
    if not (np.abs(numbers) <= LARGEST).all():
        raise InvalidValueError(
            f"expected finite values up to {LARGEST:g}, got {numbers.tolist()} at {key_label(key)}; leave it out"
        )
    return numbers


def pose_numbers(pose: Pose) -> Numbers:
    """x, y, heading; in space x, y, z and a quaternion x, y, z, w."""
    if isinstance(pose, gtsam.Pose2):
        return np.array([pose.x(), pose.y(), pose.theta()])
    turn = pose.rotation().toQuaternion()
    return np.array([*pose.translation(), turn.x(), turn.y(), turn.z(), turn.w()])


def triangle(matrix: Numbers) -> Numbers:
    """Upper triangle of a matrix, row by row."""
    return np.asarray(matrix[np.triu_indices(len(matrix))])


def number_text(numbers: Numbers) -> str:
    """Numbers with all their digits."""
    return " ".join(map(repr, numbers.tolist()))
