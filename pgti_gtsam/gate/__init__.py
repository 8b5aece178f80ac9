"""A gate in front of every loop closure: the closure's probability, by drift and by free space, and the verdict.

`ties` and `upright` read the constraints of a map, `drift_model` the predicted relative poses, and `terms`
the evidence of a closure's measurement. `reference_map` is the map before any candidate, `candidate_map` the map
with some; `candidates` makes ties of closures, `admission` takes the surest first; `paper_rule` is the paper's gate on
its own. `gate` decides, `batch` gates whole graphs; `isam2` and `fixed_lag` wrap smoothers, in what `gated` has for
both, and keep a `grown_map`; `saved` writes all of it down. `left_out` and `own_closures` judge a finished map's
closures against each other.
"""

from pgti_gtsam.gate.batch import GatedGraph, gate_graph
from pgti_gtsam.gate.decision import Change, ClosureDecision, Term
from pgti_gtsam.gate.fixed_lag import GatedFixedLagSmoother
from pgti_gtsam.gate.gate import Judgement, LoopClosureGate
from pgti_gtsam.gate.history import GatedUpdate, Review
from pgti_gtsam.gate.isam2 import GatedISAM2
from pgti_gtsam.gate.options import GateOptions

__all__ = [
    "Change",
    "ClosureDecision",
    "GateOptions",
    "GatedFixedLagSmoother",
    "GatedGraph",
    "GatedISAM2",
    "GatedUpdate",
    "Judgement",
    "LoopClosureGate",
    "Review",
    "Term",
    "gate_graph",
]
