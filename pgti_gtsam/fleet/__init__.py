"""Many maps: the same audit of each, on as many workers as exist, and a map against an earlier audit.

Every map has a process of its own, with limits of time and memory, so that a map that never ends or cannot be read
harms no other. Rows are lines of JSON, appended as soon as they are known, and a run goes on where it stopped.
"""

from pgti_gtsam.fleet.cluster import spread
from pgti_gtsam.fleet.comparison import Comparison, compare
from pgti_gtsam.fleet.jobs import AuditJob, audited
from pgti_gtsam.fleet.maps import maps_in
from pgti_gtsam.fleet.runner import run

__all__ = ["AuditJob", "Comparison", "audited", "compare", "maps_in", "run", "spread"]
