"""A gate in front of every loop closure: the closure's probability, by drift and by free space, and the verdict.

`reference_map` is the map before any candidate, `candidate_map` the map with some; `candidates` makes ties of closures,
`terms` puts the evidence on them into words and numbers, and `admission` takes the surest first; `paper_rule` is the
paper's gate on its own. `gate` decides, `batch` gates whole graphs, `smoothers/` stand in front of GTSAM's, and `kept/`
is the map that they keep between closures.
"""

from pgti_gtsam.gate.batch import GatedGraph, gate_graph
from pgti_gtsam.gate.decision import Change, ClosureDecision, Term
from pgti_gtsam.gate.gate import Judgement, LoopClosureGate
from pgti_gtsam.gate.options import GateOptions
from pgti_gtsam.gate.smoothers.fixed_lag import GatedFixedLagSmoother
from pgti_gtsam.gate.smoothers.history import GatedUpdate, Review
from pgti_gtsam.gate.smoothers.isam2 import GatedISAM2

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
