"""The protocol of a pipeline with the gate: a map, lines in, answers out. The module knows no file and no process.

The first vertex that any line names stands at the pose of its vertex line, or at the origin; every other vertex where
its odometry leads from the smoother's estimate. The vertices decide the kind of an edge:

- between two known vertices the edge is a loop closure, judged at once;
- between a new vertex and the latest of its robot the edge is odometry, or the earliest where the new vertex comes
before; a
  robot is the first byte of its keys, so that symbols tell robots, and sessions, apart;
- the first edge that leads to an unknown robot places that robot;
- any other edge to a new vertex waits until odometry leads there, and is a closure then.

A JSON line may name the kind instead. Sightings and positions are closures only if the line says so.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter.values import insert_point
from pgti_gtsam.datasets.chain import Pose
from pgti_gtsam.datasets.text import quote
from pgti_gtsam.errors import FileFormatError, InvalidGraphError, InvalidOptionError, InvalidValueError, PgtiError
from pgti_gtsam.factor_graphs import graph_of, measured_from
from pgti_gtsam.gate import ClosureDecision, GatedISAM2, GatedUpdate, LoopClosureGate
from pgti_gtsam.pose_graph import key_label
from pgti_gtsam.report.decisions import evidence
from pgti_gtsam.stream.lines import Message, Name, Tie, apart, is_loss, message_of, read

ORIGIN = 1e-3
"""Standard deviation, m and rad, that the first vertex is held with: no relative pose depends on it."""

Answer = dict[str, Any]


@dataclass(slots=True, kw_only=True, eq=False)
class Session:
    """A map and the lines of its pipeline.

    Attributes
    ----------
    isam : GatedISAM2
    n_lines : int
        Lines that came.
    """

    isam: GatedISAM2
    n_lines: int = 0
    _is_spatial: bool | None = None
    _ends: dict[int, tuple[int, int]] = field(default_factory=dict)  # earliest and latest vertex, by robot
    _early: dict[int, list[Tie]] = field(default_factory=dict)  # what waits, by the vertices that are not there yet
    _radii: dict[int, float] = field(default_factory=dict)  # those that the smoother was not told
    _points: dict[int, NDArray[np.float64]] = field(default_factory=dict)  # landmarks that nothing sees yet
    _parameters: dict[str, str] = field(default_factory=dict)  # lines that say where sensors sit, the last of a name
    _undecided: dict[int, Answer] = field(default_factory=dict)  # head of the answer, by the closure's number
    _loss: str | None = None  # a comment for the next line

    @classmethod
    def started(cls, gate: LoopClosureGate, radius_m: float | None = None) -> Session:
        """A map without any vertex.

        Parameters
        ----------
        gate : LoopClosureGate
        radius_m : float, optional
            Metres around every keyframe; None where lines bring the radii.
        """
        return cls(isam=GatedISAM2(gate=gate, radii=radius_m))

    def answers(self, line: str) -> list[Answer]:
        """The answers to a line; nothing changes on an error.

        Parameters
        ----------
        line : str
            With or without the line break.
        """
        self.n_lines += 1
        line = line.strip()
        if is_loss(line):
            self._loss = line
            return []
        loss, self._loss = self._loss, None
        if not line or line.startswith("#"):
            return []
        name: Name = None
        try:
            message = message_of(line)
            name = message.name
            if loss is not None:
                message = message._replace(texts=(loss, *message.texts))
            return [answer for each in apart(message) for answer in self._taken(each)]
        except PgtiError as error:
            return [_refusal(self.n_lines, name, error)]

    def end(self, rest: str = "") -> list[Answer]:
        """The answers to the end of the input.

        Parameters
        ----------
        rest : str
            Text behind the last line break. The text is refused: numbers that were cut off are numbers still.
        """
        answers = []
        if rest:
            error = InvalidOptionError(f"expected a line break at the end of the line, got the end in {quote(rest)}")
            answers.append(_refusal(self.n_lines + 1, None, error))
        if waiting := self._waiting():
            first = waiting[0]
            key = next(key for key in first.keys if not self.isam.valueExists(key))
            more = f"; so do {len(waiting) - 1} later lines" if len(waiting) > 1 else ""
            message = (
                f"expected odometry that leads to {key_label(key)}, got the end of the input: the line waits{more}"
            )
            answers.append(_refusal(first.line, first.message.name, InvalidGraphError(message)))
        return answers

    def state(self) -> dict[str, Any]:
        """The whole state, as JSON-ready text and numbers."""
        return {
            "line": self.n_lines,
            "is_spatial": self._is_spatial,
            "ends": [[robot, *ends] for robot, ends in self._ends.items()],
            "waiting": [[tie.line, list(tie.message.texts), *tie.message[1:3]] for tie in self._waiting()],
            "radii": [[key, radius] for key, radius in self._radii.items()],
            "points": [[key, point.tolist()] for key, point in self._points.items()],
            "parameters": self._parameters,
            "undecided": [[number, head] for number, head in self._undecided.items()],
            "loss": self._loss,
            "gate": self.isam.state(),
        }

    @classmethod
    def resumed(cls, state: dict[str, Any], gate: LoopClosureGate) -> Session:
        """A session that continues from `state`; raises as `GatedISAM2.resumed` does.

        Parameters
        ----------
        state : mapping
        gate : LoopClosureGate
        """
        found = cls(
            isam=GatedISAM2.resumed(state["gate"], gate=gate),
            n_lines=state["line"],
            _is_spatial=state["is_spatial"],
            _ends={robot: (first, last) for robot, first, last in state["ends"]},
            _radii=dict(state["radii"]),
            _points={key: np.array(point) for key, point in state["points"]},
            _parameters=state["parameters"],
            _undecided=dict(state["undecided"]),
            _loss=state["loss"],
        )
        for line, texts, name, kind in state["waiting"]:
            for tie in read(Message(tuple(texts), name, kind), line, found._parameters).ties:
                found._wait(tie)
        return found

    @property
    def n_variables(self) -> int:
        """How many variables the map has, landmarks included."""
        return int(self.isam.getLinearizationPoint().size())

    @property
    def undecided(self) -> int:
        """How many closures wait for more evidence."""
        return len(self._undecided)

    def _taken(self, message: Message) -> list[Answer]:
        """Take in a message."""
        said = read(message, self.n_lines, self._parameters)
        if said.is_spatial is not None:
            if self._is_spatial is (not said.is_spatial):
                words = ("planar", "spatial") if said.is_spatial else ("spatial", "planar")
                raise InvalidGraphError(f"expected a line of a {words[0]} map as before, got one of a {words[1]} map")
            self._is_spatial = said.is_spatial
        self._note_radii(said.radii)
        self._parameters |= said.parameters
        self._points |= {key: point for key, point in said.points.items() if not self.isam.valueExists(key)}

        # the first vertex, and what ties it
        if not self._ends:
            first = dict(list(said.poses.items())[:1])
            if said.ties and said.ties[0].is_edge:
                first = {min(said.ties[0].keys): type(said.ties[0].factors[0].measured())()}
            for key, pose in first.items():
                self._start(key, pose)
            return self._tied([*self._freed(first), *said.ties])
        return self._tied(said.ties)

    def _note_radii(self, radii: Any) -> None:
        if radii and isinstance(self.isam.radii, float):
            raise InvalidOptionError(
                f"expected no radius of a single vertex, since all have {self.isam.radii:g} m; leave one of the two out"
            )
        for key, radius in radii.items():
            if not 0 < radius < np.inf:
                raise InvalidValueError(f"expected a radius above 0 m, got {radius:g} for {key_label(key)}")
        self._radii |= radii

    def _start(self, key: int, pose: Pose) -> None:
        """Begin the map with a vertex."""
        prior = gtsam.PriorFactorPose2 if isinstance(pose, gtsam.Pose2) else gtsam.PriorFactorPose3
        model = gtsam.noiseModel.Isotropic.Sigma(3 if isinstance(pose, gtsam.Pose2) else 6, ORIGIN)
        values = gtsam.Values()
        values.insert(key, pose)
        self.isam.update(graph_of([prior(key, pose, model)]), values)
        self._note_end(key)

    def _note_end(self, key: int) -> None:
        first, last = self._ends.get(key >> 56, (key, key))
        self._ends[key >> 56] = min(first, key), max(last, key)

    def _tied(self, ties: Iterable[Tie]) -> list[Answer]:
        """Take in ties, and waiting ties whose vertices are now known."""
        answers: list[Answer] = []
        pending = deque(ties)
        while pending:
            tie = pending.popleft()
            if tie.is_taken:
                continue

            # the variables that the tie brings
            missing = [key for key in tie.keys if not self.isam.valueExists(key)]
            value = self._value(tie, missing) if len(missing) == 1 else None
            if missing and value is None:
                self._wait(tie)
                continue

            # into the smoother, and on to ties that waited for those
            tie.is_taken = True
            try:
                answers += self._update(tie, missing, value)
            except PgtiError as error:
                answers.append(_refusal(tie.line, tie.message.name, error))
                continue
            pending.extend(self._freed(missing))
        return answers

    def _freed(self, keys: Iterable[int]) -> list[Tie]:
        """Ties that wait for given variables, now known, steps first."""
        found = [tie for key in keys for tie in self._early.pop(key, ())]
        return sorted(found, key=lambda tie: max(tie.keys) - min(tie.keys))

    def _value(self, tie: Tie, missing: Sequence[int]) -> Any | None:
        """The pose of the only unknown variable of a tie; None where the tie waits for another tie."""
        (new,) = missing
        if tie.message.kind == "closure":
            return None
        if new == tie.landmark:
            if tie.point is None:  # a bearing alone holds no landmark
                return None
            pose = self._pose(next(key for key in tie.keys if key != new))
            return self._points.get(new, pose.transformFrom(tie.point))
        if not tie.is_edge:
            return None
        known = next(key for key in tie.keys if key != new)
        if tie.message.kind != "odometry" and not self._continues(known, new):
            return None
        return self._pose(known).compose(measured_from(tie.factors[0], known))

    def _continues(self, known: int, new: int) -> bool:
        """Whether an edge between these is odometry."""
        ends = self._ends.get(new >> 56)
        return ends is None or (known == ends[1] < new) or (new < ends[0] == known)

    def _pose(self, key: int) -> Pose:
        isam = self.isam
        return isam.calculateEstimatePose3(key) if self._is_spatial else isam.calculateEstimatePose2(key)

    def _wait(self, tie: Tie) -> None:
        if not tie.waits:
            for key in tie.keys:
                if not self.isam.valueExists(key):
                    self._early.setdefault(key, []).append(tie)
        tie.waits = True

    def _waiting(self) -> list[Tie]:
        """Ties that wait for odometry, by line."""
        found = {id(tie): tie for ties in self._early.values() for tie in ties if not tie.is_taken}
        return sorted(found.values(), key=lambda tie: tie.line)

    def _update(self, tie: Tie, missing: Sequence[int], value: Any) -> list[Answer]:
        """A step of the smoother with a tie, and the answers to a closure."""
        # odometry, sightings and what else is not judged
        is_closure = tie.message.kind == "closure" or (tie.is_edge and tie.message.kind is None and not missing)
        if not is_closure:
            values = gtsam.Values()
            for key in missing:
                if key == tie.landmark:
                    insert_point(values, key, value)
                else:
                    values.insert(key, value)
            self.isam.update(graph_of(tie.factors), values)
            for key in missing:
                self._points.pop(key, None)
                if key != tie.landmark:
                    self._note_end(key)
            return []

        # a closure, and those that it changes
        told = {key: radius for key, radius in self._radii.items() if self.isam.valueExists(key)}
        update = self.isam.update(closures=[graph_of(tie.factors)], radii=told or None)
        self._radii = {key: radius for key, radius in self._radii.items() if key not in told}
        return self._verdicts(tie, update)

    def _verdicts(self, tie: Tie, update: GatedUpdate) -> list[Answer]:
        (number,), (decision,) = update.closures, update.decisions
        name = tie.message.name
        head: Answer = {"line": tie.line, "id": number if name is None else name, "keys": list(tie.keys)}
        answers = [_verdict(head, decision, is_change=False)]
        for earlier, changed in update.changed.items():
            answers.append(_verdict(self._undecided.pop(earlier), changed, is_change=True))
        if decision.verdict == "undecided":
            self._undecided[number] = head
        return answers


def _verdict(head: Answer, decision: ClosureDecision, *, is_change: bool) -> Answer:
    return {**head, "changed": is_change, **evidence(decision)}


def _refusal(line: int, name: Name, error: PgtiError) -> Answer:
    message = error.message if isinstance(error, FileFormatError) else str(error)
    return {"line": line, **({} if name is None else {"id": name}), "error": message}
