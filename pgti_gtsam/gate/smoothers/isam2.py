"""iSAM2 behind the gate: closures reach the smoother only when they pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Self

import gtsam

from pgti_gtsam.checks import in_a_line
from pgti_gtsam.errors import InvalidOptionError, UnsolvableGraphError
from pgti_gtsam.factor_graphs import Closure, joined
from pgti_gtsam.gate.gate import LoopClosureGate
from pgti_gtsam.gate.smoothers.gated import GatedSmoother
from pgti_gtsam.gate.smoothers.history import GatedUpdate, Step, made_anew, smoother_of
from pgti_gtsam.gate.smoothers.kept_map import WholeMap
from pgti_gtsam.gate.smoothers.saved import State, decoded, encoded, values_from

KIND = "ISAM2"


@dataclass(slots=True)
class GatedISAM2(GatedSmoother):
    """A `gtsam.ISAM2` with the gate in front of its loop closures.

    Everything else that a `gtsam.ISAM2` has (`calculateEstimatePose2`, `marginalCovariance`, …) is had here as well.

    Parameters
    ----------
    smoother : gtsam.ISAM2 or gtsam.ISAM2Params, optional
        A smoother of the caller, or the parameters of a new smoother. The caller may go on using the smoother, but
        must leave the slots of admitted closures alone.
    gate : LoopClosureGate, optional
    radii : float or mapping from key to float, m, optional
        As in `from_gtsam`; a mapping grows by `radii=` of `update`.

    Notes
    -----
    A rejected closure never reaches the smoother: the estimate is bit for bit the estimate without
    the closure. Bad input is refused before the smoother is touched. Where iSAM2 itself fails in the middle of
    a step, `smoother` is made anew, with the factors from before in their slots.

    An undecided closure waits, and is judged again with later closures.

    A map that grows by steps of odometry alone is read once and kept: see `GrownMap`. Decisions by a kept map hold no
    scores; where the gate's options ask for them, the map is read anew each time.
    """

    smoother: gtsam.ISAM2 = field(default_factory=gtsam.ISAM2)

    def _check_smoother(self) -> None:
        if isinstance(self.smoother, gtsam.ISAM2Params):
            self.smoother = gtsam.ISAM2(self.smoother)
        if not isinstance(self.smoother, gtsam.ISAM2):
            raise InvalidOptionError(
                f"expected a gtsam.ISAM2 as the smoother, got {self.smoother!r}; radii have a name: GatedISAM2(radii=…)"
            )

    def state(self) -> State:
        """The whole state but gate and parameters, as JSON-ready text and numbers; raises as `saved.encoded` does."""
        return encoded(self._parts, {"kind": KIND, "values": self.smoother.getLinearizationPoint().serialize()})

    @classmethod
    def resumed(
        cls, state: State, parameters: gtsam.ISAM2Params | None = None, gate: LoopClosureGate | None = None
    ) -> Self:
        """A gated smoother that continues from `state`.

        Parameters
        ----------
        state : dict
        parameters, gate
            As at the first start: parameters are not part of the state.

        Raises
        ------
        InvalidGraphError
            As of `saved.decoded`.
        """
        gate = LoopClosureGate() if gate is None else gate
        parameters = gtsam.ISAM2Params() if parameters is None else parameters
        parts = decoded(state, [KIND], reuses_slots=parameters.findUnusedFactorSlots)
        slots = [parts.graph.at(slot) for slot in range(parts.graph.size())]
        found = cls(smoother_of(slots, values_from(state["smoother"]["values"]), parameters), gate, parts.radii)
        found._offers, found._waiting, found._kept = parts.offers, parts.waiting, parts.kept
        return found

    def update(
        self,
        factors: gtsam.NonlinearFactorGraph | None = None,
        values: gtsam.Values | None = None,
        closures: Sequence[Closure] = (),
        *,
        radii: Mapping[int, float] | None = None,
        **options: Any,
    ) -> GatedUpdate:
        """Add factors and values as `gtsam.ISAM2.update` does, and the closures that pass together.

        Parameters
        ----------
        factors, values : optional
            New factors, not gated, and first values of the new variables.
        closures : sequence of gtsam.NonlinearFactorGraph, factors or lists of factors
            Each holds the factors of a closure, which pass or fail together.
        radii : mapping from key to float, m, optional
            Radii of new keyframes.
        **options
            Other arguments of `gtsam.ISAM2.update`, by GTSAM's names.

        Raises
        ------
        InvalidClosureError, PgtiError
            As of `LoopClosureGate.evaluate`; a new factor or value that does not belong. Nothing has changed then.
        UnsolvableGraphError
            A step that iSAM2 fails in. The smoother was made anew, with the state before.
        """
        return self._updated(factors, values, closures, radii, options)

    @property
    def _map(self) -> WholeMap:
        found: WholeMap = self.smoother
        return found

    @property
    def _reuses_slots(self) -> bool:
        return bool(self.smoother.params().findUnusedFactorSlots)

    def _step(
        self,
        graphs: Sequence[gtsam.NonlinearFactorGraph],
        values: gtsam.Values,
        options: Mapping[str, Any],
        removed: Sequence[int] = (),
    ) -> Step:
        """A step of the smoother; a failed step makes the smoother anew."""
        # what comes and goes
        graph = self.smoother.getFactorsUnsafe()
        size = graph.size()
        options = {**options, "removeFactorIndices": list(removed)} if removed else options
        came = graphs[0] if len(graphs) == 1 else joined(*graphs)
        going = options.get("removeFactorIndices", ()) if options else ()
        gone = {slot: graph.at(slot) for slot in going if slot < size}

        # the step
        try:
            result = self.smoother.update(came, values, **options)
        except (RuntimeError, IndexError) as error:
            self.smoother = made_anew(self.smoother, size, came, set(values.keys()), gone)
            self._kept.forget()
            raise UnsolvableGraphError(
                f"expected an update that iSAM2 can take, got: {in_a_line(error)}; the smoother was made anew with "
                "the factors from before"
            ) from error
        slots = result.getNewFactorsIndices()
        if len(graphs) == 1:
            return Step(result, [tuple(slots)], not options)
        left = iter(slots)
        return Step(result, [tuple(islice(left, graph.size())) for graph in graphs], not options)
