"""A gate in front of every loop closure: what it changes in units of free space, and the verdict.

`survey` measures a map once; `attempt` tries a candidate on a copy, which `trial` optimises; `yardstick`, `evidence`
and `rules` weigh what changed; `closure_gate` decides; `revisits`, `past` and `batch` gate whole graphs in time
order; `isam2` wraps a smoother.
"""

from pgti_gtsam.gate.batch import GatedGraph, gate_graph
from pgti_gtsam.gate.closure_gate import ClosureDecision, GroupDecision, LoopClosureGate
from pgti_gtsam.gate.evidence import Evidence
from pgti_gtsam.gate.isam2 import GatedISAM2, GatedUpdate
from pgti_gtsam.gate.rules import GateOptions

__all__ = [
    "ClosureDecision",
    "Evidence",
    "GateOptions",
    "GatedGraph",
    "GatedISAM2",
    "GatedUpdate",
    "GroupDecision",
    "LoopClosureGate",
    "gate_graph",
]
