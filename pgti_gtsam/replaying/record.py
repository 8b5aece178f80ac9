"""The state of a running pipeline at each moment: graph, estimate, radii."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

from pgti_gtsam.checks import shown
from pgti_gtsam.errors import InvalidGraphError, InvalidOptionError
from pgti_gtsam.factor_graphs import check_map, joined
from pgti_gtsam.pose_graph import Radii

Map = tuple[Any, Any]
"""A gtsam.NonlinearFactorGraph and its gtsam.Values."""


@dataclass(slots=True)
class Record(Sequence[Map]):
    """The moments of a running pipeline, for `replay`: a sequence of graphs with their values.

    Attributes
    ----------
    moments : list of (gtsam.NonlinearFactorGraph, gtsam.Values)
        A graph shares its factors with the smoother's, so that a moment costs a pointer a factor and the estimate.
    radii : float or mapping from key to float, m, optional
        As of a `GatedISAM2` at the last moment; without, landmark factors say.
    """

    moments: list[Map] = field(default_factory=list)
    radii: Radii | None = None

    def note(self, smoother: Any) -> None:
        """Add the present state of a smoother.

        Parameters
        ----------
        smoother : GatedISAM2, GatedFixedLagSmoother or gtsam.ISAM2
            Stays untouched. The factors are those that are in: closures that a gate keeps out, or takes out again, are
            not.

        Raises
        ------
        InvalidGraphError
            Another object.
        """
        if hasattr(smoother, "factors") and hasattr(smoother, "estimate"):
            moment = smoother.factors(), smoother.estimate()
        elif hasattr(smoother, "getFactorsUnsafe"):
            moment = joined(smoother.getFactorsUnsafe()), smoother.calculateEstimate()
        else:
            raise InvalidGraphError(f"expected a gated smoother or a gtsam.ISAM2, got {shown(smoother)}")
        self.moments.append(moment)
        self.radii = getattr(smoother, "radii", self.radii)

    def __len__(self) -> int:
        return len(self.moments)

    @overload
    def __getitem__(self, place: int) -> Map: ...
    @overload
    def __getitem__(self, place: slice) -> list[Map]: ...
    def __getitem__(self, place: int | slice) -> Map | list[Map]:
        return self.moments[place]

    def __iter__(self) -> Iterator[Map]:
        return iter(self.moments)


def checked_moments(moments: Sequence[Any]) -> None:
    """Refuse anything but a record.

    Raises
    ------
    InvalidOptionError, InvalidGraphError
        No moment; a moment that is no pair of a graph and values.
    """
    if not len(moments):
        raise InvalidOptionError("expected a record of one moment or more, got none")
    for each in moments:
        if not isinstance(each, tuple | list) or len(each) != 2:
            raise InvalidGraphError(f"expected a record of pairs, graph and values, got {shown(each)}; zip makes pairs")
        check_map(*each)


def radii_then(radii: Radii | None, values: Any) -> Radii | None:
    """The radii of keyframes that had come.

    Parameters
    ----------
    radii : Radii, optional
    values : object
        Of the moment.
    """
    if not isinstance(radii, Mapping):
        return radii
    return {key: radius for key, radius in radii.items() if values.exists(key)}
