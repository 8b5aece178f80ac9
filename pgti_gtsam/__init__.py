"""Pose-Graph Topological Integrity for GTSAM factor graphs: is this map right, and where not?

A public name loads its module, and SciPy with the module, when a program first asks for the name.
"""

import logging
from importlib import import_module
from typing import TYPE_CHECKING

from pgti_gtsam.errors import PgtiError
from pgti_gtsam.version import __version__

if TYPE_CHECKING:
    from pgti_gtsam.adapter import from_gtsam
    from pgti_gtsam.diagnosis import ClosureFinding, Diagnosis, Place, Proposal, diagnose
    from pgti_gtsam.gate import (
        ClosureDecision,
        GatedFixedLagSmoother,
        GatedISAM2,
        GatedUpdate,
        GateOptions,
        Judgement,
        LoopClosureGate,
        gate_graph,
    )
    from pgti_gtsam.integrity import BetaSplit, Distortion, Integrity, assess
    from pgti_gtsam.mending import Clouds, Mended, clouds_in, mend, scans_of
    from pgti_gtsam.merging import Gain, Joining, LinkVerdict, Merged, merge
    from pgti_gtsam.new_ties import NewTie, best_revisits
    from pgti_gtsam.parts import DiagnosisInParts, diagnose_parts
    from pgti_gtsam.pose_graph import Adaptation, EdgeSource, PoseGraph
    from pgti_gtsam.replaying import Measure, Moment, Record, Replay, replay

logging.getLogger(__name__).addHandler(logging.NullHandler())  # a program that uses the package says where records go

__all__ = [
    "Adaptation",
    "BetaSplit",
    "ClosureDecision",
    "ClosureFinding",
    "Clouds",
    "Diagnosis",
    "DiagnosisInParts",
    "Distortion",
    "EdgeSource",
    "Gain",
    "GateOptions",
    "GatedFixedLagSmoother",
    "GatedISAM2",
    "GatedUpdate",
    "Integrity",
    "Joining",
    "Judgement",
    "LinkVerdict",
    "LoopClosureGate",
    "Measure",
    "Mended",
    "Merged",
    "Moment",
    "NewTie",
    "PgtiError",
    "Place",
    "PoseGraph",
    "Proposal",
    "Record",
    "Replay",
    "__version__",
    "assess",
    "best_revisits",
    "clouds_in",
    "diagnose",
    "diagnose_parts",
    "from_gtsam",
    "gate_graph",
    "mend",
    "merge",
    "replay",
    "scans_of",
]

_NAMES_OF = {
    "adapter": ["from_gtsam"],
    "diagnosis": ["ClosureFinding", "Diagnosis", "Place", "Proposal", "diagnose"],
    "gate": ["ClosureDecision", "GateOptions", "GatedFixedLagSmoother", "GatedISAM2", "GatedUpdate", "Judgement"]
    + ["LoopClosureGate", "gate_graph"],
    "integrity": ["BetaSplit", "Distortion", "Integrity", "assess"],
    "mending": ["Clouds", "Mended", "clouds_in", "mend", "scans_of"],
    "merging": ["Gain", "Joining", "LinkVerdict", "Merged", "merge"],
    "new_ties": ["NewTie", "best_revisits"],
    "parts": ["DiagnosisInParts", "diagnose_parts"],
    "pose_graph": ["Adaptation", "EdgeSource", "PoseGraph"],
    "replaying": ["Measure", "Moment", "Record", "Replay", "replay"],
}
"""Public names by module. No public name is a module's: importing such a module would hide the name."""

_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _NAMES_OF.items() for name in names}

if not TYPE_CHECKING:  # a type checker would take any name for a public one

    def __getattr__(name: str) -> object:
        """Load a public name at its first use (PEP 562)."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = getattr(import_module(_MODULE_OF[name]), name)
        return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
