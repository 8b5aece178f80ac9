"""Robust losses in text files: a comment ``# 3 7 ROBUST Huber 1.345`` on the line before the edge from 3 to 7.

No text format has a word for losses. A comment is passed over by other readers: other readers get the edge with its
Gaussian noise. The identifiers follow the edge's tag, and a position has its identifier twice; GTSAM's planar
reader (4.3.0) loses every edge behind a comment that does not start with two numbers. Behind the name of a class of
``gtsam.noiseModel.mEstimator`` stand the parameter (none for ``Null``), and ``Scalar`` where the loss weighs every
component of a residual by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gtsam

from pgti_gtsam.datasets.text import TextFile, is_number, quote

MARK = "ROBUST"
_M = gtsam.noiseModel.mEstimator
_NAMES = (
    "Huber",
    "Cauchy",
    "Tukey",
    "Fair",
    "DCS",
    "GemanMcClure",
    "TruncatedLeastSquares",
    "Welsch",
    "L2WithDeadZone",
    "AsymmetricCauchy",
    "AsymmetricTukey",
    "Null",
)
LOSSES: dict[str, Any] = {name: getattr(_M, name) for name in _NAMES}


def loss_words(loss: Any) -> list[str]:
    """The words for a loss; none where no words exist (a custom loss, a graduated loss).

    Python cannot ask a loss for the parameter; the archive has the number: ``… scheme parameter …``.
    """
    name = type(loss).__name__
    if name not in LOSSES:
        return []
    archive = loss.serialize()
    words = [name] if name == "Null" else [name, repr(float(archive.split()[9]))]
    return next((said for said in (words, [*words, "Scalar"]) if _made(said).serialize() == archive), [])


def loss_comment(ids: Sequence[object], words: Sequence[str]) -> str:
    """The comment for the edge with these identifiers behind its tag.

    Parameters
    ----------
    ids : sequence of object
        Identifiers of the edge.
    words : sequence of str
        As for a loss.
    """
    return " ".join(["#", str(ids[0]), str(ids[1] if len(ids) > 1 else ids[0]), MARK, *words])


def losses(file: TextFile) -> dict[int, Any]:
    """Losses that comments of a file name, by the line that follows.

    Raises
    ------
    FileFormatError
        The name of a loss without its parameter, or before a line with other identifiers.
    """
    comments = [line for line in file.comments if MARK in line.text and line.fields[3:4] == [MARK]]
    found, fields = {}, {line.number: line.fields for line in file.lines} if comments else {}
    for line in comments:
        ids, words = line.fields[1:3], line.fields[4:]
        if not _is_loss(words):
            message = f"expected a loss as in '# 3 7 ROBUST Huber 1.345', got {quote(line.text)}"
            raise file.error(message, line.number)
        named = fields.get(line.number + 1, [])[1:3]
        if ids != named and (ids[0] != ids[1] or ids[:1] != named[:1]):
            raise file.error(f"expected an edge of {quote(' '.join(ids))} on the line after this loss", line.number)
        found[line.number + 1] = _made(words)
    return found


def _is_loss(words: list[str]) -> bool:
    if not words or words[0] not in LOSSES:
        return False
    behind = words[1:-1] if words[-1] == "Scalar" else words[1:]
    if words[0] == "Null":
        return not behind
    return len(behind) == 1 and is_number(behind[0]) and float(behind[0]) > 0.0


def _made(words: list[str]) -> Any:
    scheme = _M.Base.ReweightScheme.Scalar if words[-1] == "Scalar" else _M.Base.ReweightScheme.Block
    if words[0] == "Null":
        return _M.Null.Create()
    return LOSSES[words[0]].Create(float(words[1]), scheme)
