"""Section 6.2 of the paper: every metric while the graph grows keyframe by keyframe."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.checks import shown, whole
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError
from pgti_gtsam.pose_graph import PoseGraph
from pgti_gtsam.replay.growth import Stage, grown, recorded, sizes
from pgti_gtsam.replay.lag import Lag, lag
from pgti_gtsam.replay.lines import appended, heading, known_moments
from pgti_gtsam.replay.moment import METRICS, Measure, Moment, measured

__all__ = ["METRICS", "Lag", "Measure", "Moment", "Replay", "lag", "replay", "replay_graph"]

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
        """One field of all moments, (n_moments,): a name of `METRICS`, or a count such as "n_collisions"."""
        return np.array([getattr(moment, name) for moment in self.moments], dtype=float)

    @property
    def insertion_signal(self) -> NDArray[np.bool_]:
        """Whether edges were inserted since the moment before, (n_moments,)."""
        return self.curve("n_new") > 0

    def lags(self) -> dict[str, Lag]:
        """By the name of each metric, how soon its changes answer to inserted edges: see `lag`."""
        return {name: lag(self.curve(name), self.insertion_signal) for name in METRICS}


def replay(
    graph: Any,
    values: Any,
    *,
    radii: float | Mapping[int, float] | None = None,
    edges: Collection[str] | None = None,
    min_shared_landmarks: int | None = None,
    closures: Collection[int] | None = None,
    every: int = 1,
    measure: Measure | None = None,
    path: Path | str | None = None,
    progress: Progress | None = None,
) -> Replay:
    """Measure a map while its graph grows, in the order of the keys (section 6.2, Fig. 4 and 5 of the paper).

    A finished map is grown with its final estimate: at each moment what `assess` finds on the graph of the first
    keyframes, with all their edges and radii. A record of the pipeline, a sequence of graphs and one of values, is
    replayed as it was estimated at each moment.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph, or a sequence of them
    values : gtsam.Values, or a sequence of as many
    radii, edges, min_shared_landmarks, closures
        As `from_gtsam` takes them.
    every : int
        Keyframes between two moments; the last moment is the whole graph. A record has the moments that it has.
    measure : Measure, optional
        The options of `assess`: β, number of times, norm, method.
    path : Path or str, optional
        A file of JSON lines that every moment is added to. Moments that it holds are not computed again.
    progress : callable, optional
        Called after every moment with how many are done, and of how many.

    Returns
    -------
    Replay

    Raises
    ------
    InvalidOptionError
        `every` below one, or as many values as there are graphs do not come.
    FileFormatError
        The file at `path` is no replay of this map.
    PgtiError
        Those of `from_gtsam`.
    """
    options: dict[str, Any] = {
        "radii": radii,
        "edges": edges,
        "min_shared_landmarks": min_shared_landmarks,
        "closures": closures,
    }
    whole(every, "every", least=1)
    if not isinstance(measure, Measure | None) or not isinstance(path, str | Path | None):
        raise InvalidOptionError(f"expected a Measure and a path, got {shown(measure)} and {shown(path)}")

    # one graph, grown; or a record of graphs
    how, file = measure or Measure(), None if path is None else Path(path)
    if not isinstance(graph, Sequence):
        pose_graph = from_gtsam(graph, values, **options)
        return _grown(pose_graph, every, how, file, progress)
    if not isinstance(values, Sequence):
        raise InvalidGraphError(f"expected as many gtsam.Values as graphs, in a list, got {shown(values)}")
    if len(graph) != len(values) or not len(graph):
        raise InvalidOptionError(f"expected as many values as graphs, one or more, got {len(values)} and {len(graph)}")
    record = [from_gtsam(one, estimate, **options) for one, estimate in zip(graph, values, strict=True)]
    first = heading(record, list(map(len, record)), how)
    return Replay(pose_graph=record[-1], moments=_moments(recorded(record), len(record), how, first, file, progress))


def replay_graph(
    pose_graph: PoseGraph,
    *,
    every: int = 1,
    measure: Measure | None = None,
    progress: Progress | None = None,
) -> Replay:
    """Replay a pose graph that was adapted before; parameters are those of `replay`."""
    return _grown(pose_graph, every, measure or Measure(), None, progress)


def _grown(pose_graph: PoseGraph, every: int, measure: Measure, path: Path | None, progress: Progress | None) -> Replay:
    wanted = sizes(len(pose_graph), every)
    first = heading([pose_graph], wanted, measure)
    moments = _moments(grown(pose_graph, wanted), len(wanted), measure, first, path, progress)
    return Replay(pose_graph=pose_graph, moments=moments)


def _moments(
    stages: Iterator[Stage],
    count: int,
    measure: Measure,
    first: Mapping[str, Any],
    path: Path | None,
    progress: Progress | None,
) -> tuple[Moment, ...]:
    """Measure the stages that the file does not hold, and add these to the file."""
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
