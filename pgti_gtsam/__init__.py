"""Pose-Graph Topological Integrity for GTSAM factor graphs: is this map right, and where not?"""

import logging

from pgti_gtsam.adapter import from_gtsam
from pgti_gtsam.diagnosis import ClosureFinding, Diagnosis, Place, Proposal, diagnose
from pgti_gtsam.errors import PgtiError
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
from pgti_gtsam.mend import Clouds, Mended, clouds_in, mend, scans_of
from pgti_gtsam.merging import Gain, Joining, LinkVerdict, Merged, merge
from pgti_gtsam.new_ties import NewTie, best_revisits
from pgti_gtsam.parts import DiagnosisInParts, diagnose_parts
from pgti_gtsam.pose_graph import Adaptation, EdgeSource, PoseGraph
from pgti_gtsam.replay import Measure, Moment, Record, Replay, replay
from pgti_gtsam.version import __version__

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
