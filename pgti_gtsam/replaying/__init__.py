"""Section 6.2 of the paper: every metric while the graph grows keyframe by keyframe."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.checks import shown, whole
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError, PgtiError
from pgti_gtsam.pose_graph import PoseGraph, Radii
from pgti_gtsam.replaying.growth import Stage, grown, recorded, sizes
from pgti_gtsam.replaying.lag import Lag, lag
from pgti_gtsam.replaying.lines import appended, heading, known_moments
from pgti_gtsam.replaying.moment import METRICS, Measure, Moment, measured
from pgti_gtsam.replaying.record import Map, Record, checked_moments, radii_then

__all__ = ["METRICS", "Lag", "Measure", "Moment", "Record", "Replay", "lag", "replay", "replay_graph"]

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """A map as it grew.

    Attributes
    ----------
    pose_graph : PoseGraph
        The graph at the end.
    moments : tuple of Moment
        Ascending in the number of keyframes.
    """

    pose_graph: PoseGraph
    moments: tuple[Moment, ...]

    def curve(self, name: str) -> NDArray[np.float64]:
        """A field of all moments, (n_moments,): a name of `METRICS`, or a count such as "n_collisions"."""
        return np.array([getattr(moment, name) for moment in self.moments], dtype=float)

    @property
    def insertion_signal(self) -> NDArray[np.bool_]:
        """Whether edges were inserted since the moment before, (n_moments,)."""
        return self.curve("n_new") > 0

    def lags(self) -> dict[str, Lag]:
        """By the name of each metric, how soon the metric's changes answer to inserted edges: see `lag`."""
        return {name: lag(self.curve(name), self.insertion_signal) for name in METRICS}


def replay(
    graph: Any,
    values: Any = None,
    *,
    radii: Radii | None = None,
    edges: Collection[str] | None = None,
    min_shared_landmarks: int | None = None,
    closures: Collection[int] | None = None,
    every: int = 1,
    measure: Measure | None = None,
    path: Path | str | None = None,
    progress: Progress | None = None,
) -> Replay:
    """Measure a map while its graph grows, in the order of the keys (section 6.2, Fig. 4 and 5 of the paper).

    A finished map is grown with the final estimate: at each moment `assess` runs on the graph of the first
    keyframes, with all their edges and radii. A pipeline's own record is replayed with the graph and the estimate of
    each moment.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph, Record, or sequence of (graph, values)
        A map; or a record, a map a moment.
    values : gtsam.Values, optional
        The estimate of a map; a record has its own.
    radii, edges, min_shared_landmarks, closures
        As for `from_gtsam`. Of radii by key a moment has those of its keyframes; a `Record` brings its own.
    every : int
        Keyframes between two moments; the last moment is the whole graph. A record has moments of its own.
    measure : Measure, optional
        The options of `assess`: β, number of times, norm, method.
    path : Path or str, optional
        A file of JSON lines to which every moment is added. Moments in the file are not computed again.
    progress : callable, optional
        Called after every moment with how many are done, and of how many.

    Returns
    -------
    Replay

    Raises
    ------
    InvalidOptionError, InvalidGraphError
        `every` below 1; a record without a moment, or of other things than pairs of graph and values.
    FileFormatError
        The file at `path` is no replay of this map.
    PgtiError
        As of `from_gtsam`.
    """
    whole(every, "every", least=1)
    if not isinstance(measure, Measure | None) or not isinstance(path, str | Path | None):
        raise InvalidOptionError(f"expected a Measure and a path, got {shown(measure)} and {shown(path)}")
    how, file = measure or Measure(), None if path is None else Path(path)
    adapt = partial(from_gtsam, edges=edges, min_shared_landmarks=min_shared_landmarks, closures=closures)

    # one graph, grown
    if not isinstance(graph, Sequence):
        return _grown(adapt(graph, values, radii=radii), every, how, file, progress)

    # or a record of graphs
    checked_moments(graph)
    if values is not None:
        raise InvalidGraphError(f"expected no values beside a record, which has its own, got {shown(values)}")
    known = graph.radii if radii is None and isinstance(graph, Record) else radii
    return _replayed(graph, lambda one, then: adapt(one, then, radii=radii_then(known, then)), how, file, progress)


def replay_graph(
    pose_graph: PoseGraph,
    *,
    every: int = 1,
    measure: Measure | None = None,
    progress: Progress | None = None,
) -> Replay:
    """Replay a pose graph that was adapted before.

    Parameters
    ----------
    pose_graph : PoseGraph
    every, measure, progress
        As for `replay`.
    """
    return _grown(pose_graph, every, measure or Measure(), None, progress)


def _grown(pose_graph: PoseGraph, every: int, measure: Measure, path: Path | None, progress: Progress | None) -> Replay:
    wanted = sizes(len(pose_graph), every)
    first = {} if path is None else heading([pose_graph], wanted, measure)
    moments = _moments(grown(pose_graph, wanted), len(wanted), measure, first, path, progress)
    return Replay(pose_graph=pose_graph, moments=moments)


def _replayed(
    record: Sequence[Map],
    adapt: Callable[[Any, Any], PoseGraph],
    measure: Measure,
    path: Path | None,
    progress: Progress | None,
) -> Replay:
    """Replay a record. A single moment is adapted at a time: all moments together would be the map many times over."""

    def adapted(number: int) -> PoseGraph:
        try:
            return adapt(*record[number])
        except PgtiError as error:
            raise type(error)(f"{error} (moment {number} of the record, counted from 0)") from error

    numbers = range(len(record))
    first = {} if path is None else heading(map(adapted, numbers), [], measure)
    moments = _moments(recorded(map(adapted, numbers)), len(record), measure, first, path, progress)
    return Replay(pose_graph=adapted(numbers[-1]), moments=moments)


def _moments(
    stages: Iterator[Stage],
    count: int,
    measure: Measure,
    first: Mapping[str, Any],
    path: Path | None,
    progress: Progress | None,
) -> tuple[Moment, ...]:
    """Measure the stages that the file does not hold, and add the results to the file."""
    moments = known_moments(path, first)
    n_known = len(moments)
    with appended(path, first) as add:
        for done, stage in enumerate(stages, start=1):
            if done > n_known:
                moments.append(measured(stage, measure))
                add(moments[-1])
            if progress is not None:
                progress(done, count)
    return tuple(moments)
