"""A case in a process of its own: `python -m scenarios.speed.child PART CASE DENSE_UP_TO [DATA]` prints the rows."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from scenarios.speed import parts, solvers

if __name__ == "__main__":
    part, case, dense_up_to, data = sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4] or ".")
    measure = {
        "solvers": lambda: solvers.solved(case, data, dense_up_to),
        "cores": lambda: solvers.by_the_clock(case, data),
        "audits": lambda: parts.audit(case, data),
        "updates": lambda: parts.updates(case),
        "decisions": lambda: parts.decisions(case, data),
    }[part]
    print(json.dumps(measure()))
