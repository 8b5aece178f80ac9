"""A line of a pipeline, g2o text or a JSON object around g2o text, as vertices, ties and radii."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.assembly import Entry
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.formats import g2o
from pgti_gtsam.datasets.g2o_edges import EDGES, pose_edges
from pgti_gtsam.datasets.g2o_landmarks import POINTS, SIGHTING_TAGS, landmarks, points
from pgti_gtsam.datasets.landmarks import Sighting
from pgti_gtsam.datasets.losses import MARK
from pgti_gtsam.datasets.text import MAX_ID, TextFile, quote, split_lines
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import keys_of

RADIUS = "RADIUS"
PARAMETERS = {"PARAMS_SE2OFFSET": 3, "PARAMS_SE3OFFSET": 7}
WISHES = {"FIX", "VERTEX_SWITCH", "EDGE_SWITCH_PRIOR", "PARAMS_CAMERAPARAMETERS"}
"""Lines for an optimiser, of which nothing is read."""

KNOWN = {*g2o.POSES, *EDGES, *POINTS, *SIGHTING_TAGS, *PARAMETERS, *WISHES, g2o.POSITION, RADIUS}

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
"""A client's name, which becomes that of a file."""

Kind = Literal["odometry", "closure"]
Name = str | int | None


class Message(NamedTuple):
    """The content of a line: g2o lines, the pipeline's own name for them, their kind, and radii, m, by key."""

    texts: tuple[str, ...]
    name: Name = None
    kind: Kind | None = None
    radii: Mapping[int, float] = {}


@dataclass(slots=True, kw_only=True, eq=False)
class Tie:
    """Factors that come together, and the line of origin.

    Attributes
    ----------
    line : int
    message : Message
    factors : list
    keys : tuple of int
        Of all variables, in the order of the factors.
    is_edge : bool
        Whether this is a single factor between two poses.
    is_spatial : bool
    landmark : int, optional
        Of a single sighting.
    point : (2,) or (3,) float, optional
        Where the landmark is, seen from the pose, m.
    waits, is_taken : bool
        Whether the tie waits for vertices, and whether the wait is over.
    """

    line: int
    message: Message
    factors: list[Any]
    keys: tuple[int, ...]
    is_edge: bool
    is_spatial: bool
    landmark: int | None = None
    point: NDArray[np.float64] | None = None
    waits: bool = False
    is_taken: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Read:
    """The content of g2o lines."""

    poses: Mapping[int, Pose] = field(default_factory=dict)
    points: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    radii: Mapping[int, float] = field(default_factory=dict)
    parameters: Mapping[str, str] = field(default_factory=dict)
    ties: Sequence[Tie] = ()
    is_spatial: bool | None = None


def message_of(line: str) -> Message:
    """The content of a line without blanks at the ends.

    Raises
    ------
    InvalidOptionError
        A JSON object of other fields than `g2o`, `id`, `kind` and `radii`, or of other types.
    """
    if not line.startswith("{"):
        return Message((line,))
    try:
        said = json.loads(line)
    except ValueError as error:
        raise InvalidOptionError(f"expected a g2o line or a JSON object, got what is neither: {error}") from None
    unknown = sorted(set(said) - {"g2o", "id", "kind", "radii"})
    if unknown:
        raise InvalidOptionError(f"expected the fields g2o, id, kind and radii, got {quote(unknown[0])}")
    texts, name, kind = said.get("g2o", []), said.get("id"), said.get("kind")
    texts = [texts] if isinstance(texts, str) else texts
    if not isinstance(texts, list) or not all(isinstance(text, str) and "\n" not in text for text in texts):
        raise InvalidOptionError(f"expected g2o as a line or a list of lines, got {quote(texts)}")
    if not isinstance(name, str | int | None) or isinstance(name, bool):
        raise InvalidOptionError(f"expected id as text or a whole number, got {quote(name)}")
    if kind not in (None, "odometry", "closure"):
        raise InvalidOptionError(f"expected kind odometry or closure, got {quote(kind)}")
    return Message(tuple(texts), name, kind, _radii(said.get("radii", {})))


def client_of(line: str) -> str | None:
    """The name that a client gives itself, in a line before all others; None for any other line.

    Raises
    ------
    InvalidOptionError
        The name cannot be that of a file everywhere.
    """
    try:
        said = json.loads(line)
    except ValueError:
        return None
    if not isinstance(said, dict) or set(said) != {"client"}:
        return None
    if not isinstance(said["client"], str) or not NAME.fullmatch(said["client"]):
        raise InvalidOptionError(
            f"expected a client's name of up to 100 letters, digits, '.', '-' and '_', got {quote(said['client'])}"
        )
    return str(said["client"])


def _radii(said: object) -> dict[int, float]:
    if not isinstance(said, dict) or not all(isinstance(radius, int | float) for radius in said.values()):
        raise InvalidOptionError(f"expected radii as identifiers with metres, got {quote(said)}")
    wrong = next((key for key in said if not key.isdecimal() or int(key) > MAX_ID), None)
    if wrong is not None:
        raise InvalidOptionError(f"expected an identifier, a whole number below 2**63, got {quote(wrong)}")
    return {int(key): float(radius) for key, radius in said.items()}


def apart(message: Message) -> list[Message]:
    """A message for each line of a message, comments together with the next line.

    The lines of a closure stay together.
    """
    if message.kind == "closure" or len(message.texts) < 2:
        return [message]
    found: list[Message] = []
    comments: list[str] = []
    for text in message.texts:
        comments.append(text)
        if not text.startswith("#"):
            found.append(message._replace(texts=tuple(comments)))
            comments = []
    return found


def is_loss(line: str) -> bool:
    """Whether a line is a comment that gives the edge on the next line a robust loss."""
    return line.startswith("#") and MARK in line


def read(message: Message, line: int, parameters: Mapping[str, str]) -> Read:
    """The content of the g2o lines of a message.

    Parameters
    ----------
    message : Message
        Of a line, or of a closure.
    line : int
        Number of the line.
    parameters : mapping of str to str
        Earlier lines that say where sensors sit on their bodies, by tag and identifier.

    Raises
    ------
    FileFormatError, InvalidOptionError
        A malformed line; a line of an unknown kind; a line that ties a vertex to itself, or sees a landmark at no
        distance.
    """
    # known lines
    own = {" ".join(text.split()[:2]): text for text in message.texts if text.startswith(tuple(PARAMETERS))}
    before = [text for name, text in parameters.items() if name not in own]
    file = split_lines(Path("stream"), "\n".join((*before, *message.texts)))
    unknown = next((tag for tag in file.tags if tag not in KNOWN), None)
    if unknown is not None:
        raise InvalidOptionError(
            f"expected a g2o line such as EDGE_SE2, EDGE_SE3:QUAT or {RADIUS}, got {quote(unknown)}"
        )
    for tag, width in PARAMETERS.items():
        file.table(tag, ids=1, widths=[width])

    # vertices and ties
    said = {tag for tag in file.tags if tag not in PARAMETERS}
    poses = g2o.pose_vertices(file) if said & g2o.POSES.keys() else {}
    return Read(
        poses=poses,
        points=points(file) if said & POINTS.keys() else {},
        radii={**message.radii, **(_read_radii(file) if RADIUS in said else {})},
        parameters=own,
        ties=_ties(file, said, message, line),
        is_spatial=any("SE3" in tag or "XYZ" in tag for tag in said) if said - WISHES - {RADIUS} else None,
    )


def _read_radii(file: TextFile) -> dict[int, float]:
    table = file.table(RADIUS, ids=1, widths=[1], poses=1)
    return dict(zip(table.ids[:, 0].tolist(), table.numbers[:, 0].tolist(), strict=True))


def _ties(file: TextFile, said: set[str], message: Message, line: int) -> list[Tie]:
    """The factors of lines as a single tie; None without factors."""
    # factors, none of which may be left out
    entries: list[Entry] = pose_edges(file) if said & EDGES.keys() else []
    entries += g2o.positions(file) if g2o.POSITION in said else []
    seen: list[Sighting] = landmarks(file) if said & SIGHTING_TAGS else []
    expected = sum(len(file.tags[tag]) for tag in said if tag in EDGES or tag in SIGHTING_TAGS or tag == g2o.POSITION)
    if len(entries) + len(seen) < expected:
        raise InvalidOptionError(f"expected two ends that are apart, got a line without: {file.notes[-1]}")
    if not expected:
        return []

    # in the order of the lines
    by_line: list[Entry | Sighting] = sorted([*entries, *seen], key=itemgetter(0))
    factors = [named.factor for named in by_line]
    single = seen[0] if len(factors) == 1 and seen else None
    tie = Tie(
        line=line,
        message=message,
        factors=factors,
        keys=tuple(dict.fromkeys(key for factor in factors for key in keys_of(factor))),
        is_edge=len(factors) == 1 and not seen and len(entries[0].poses) == 2,
        is_spatial=any("SE3" in tag for tag in said),
        landmark=None if single is None else single.landmark,
        point=None if single is None else single.point,
    )
    return [tie]
