"""The contents of a file: a factor graph, a value of every variable, and further knowledge of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.plain_text import visible


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dataset:
    """A factor graph read from a file.

    Pose ``k`` of a text file has the key ``k``, its landmark ``k`` the key ``gtsam.symbol("l", k)``: the
    two may be numbered alike. A symbol in the file keeps its key; where poses have negative numbers
    all keys are moved up (`names` holds the names in the file). Stereo files name their poses
    ``gtsam.symbol("x", k)``. No reader adds a prior: the graph holds only the file's factors.

    Attributes
    ----------
    name : str
        The file's name without its endings.
    format : str
        The format in words.
    graph : gtsam.NonlinearFactorGraph
        The factors, in the order of the file.
    values : gtsam.Values
        The stored estimate of every variable, or a first estimate where the file stores none.
    radii : mapping of int to float, or None
        Metres of free space around the poses whose scans the file holds.
    closures : tuple of int, or None
        Slots of the loop closures, where the file itself names the closures: all others between poses are
        odometry then. None where `track.roles` has to tell (`chain.closure_slots` gives them in either case).
    true_closures : frozenset of int, or None
        Closures that are known to be true; None when nothing is known.
    truth : gtsam.Values, or None
        Ground-truth poses, in a frame of their own.
    notes : tuple of str
        Short sentences on data that was read, assumed and ignored.
    ignored_edges : int
        Lines that tie poses in an unknown way and were left out because that was asked for.
    names : mapping of int to str
        Name of a variable in the file, by key, where the name is not the key itself.
    scans : mapping of int to (n, 2) float
        Where the readings of a pose's laser scan end, seen from the pose, m; empty where the file holds no scans.
    """

    name: str
    format: str
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    radii: Mapping[int, float] | None = None
    closures: tuple[int, ...] | None = None
    true_closures: frozenset[int] | None = None
    truth: gtsam.Values | None = None
    notes: tuple[str, ...] = ()
    ignored_edges: int = 0
    names: Mapping[int, str] = field(default_factory=dict)
    scans: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Make the notes fit to be shown: notes name files."""
        object.__setattr__(self, "notes", tuple(map(visible, self.notes)))

    @property
    def title(self) -> str:
        """The name, fit to be shown, and what the map lacks."""
        name = visible(self.name)
        return f"{name} without {self.ignored_edges} unknown edges" if self.ignored_edges else name
