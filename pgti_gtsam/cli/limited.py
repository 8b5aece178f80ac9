"""The command line with a limit on its memory: `python -m pgti_gtsam.cli.limited BYTES COMMAND …`."""

from __future__ import annotations

import sys

from pgti_gtsam.cli import main
from pgti_gtsam.fleet.jobs import limit_memory

if __name__ == "__main__":
    limit_memory(int(sys.argv.pop(1)))
    main()
